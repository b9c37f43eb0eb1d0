"""Commands on the wire: every message is parsed into a command or refused in words."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.control.power.arming import LONG_TEST_NS
from rigctl.ipc import hold_socket
from rigctl.ipc.record import REPLY
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.lease_acts import is_id
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.wire.command_request import NewestRecord, RequestError, answer, parse, verb_of

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
LIMITS = (50.0, 350.0)


def reply_of(**given: Any) -> dict[str, Any]:
    names = (field.name for field in REPLY.fields)
    return dict(zip(names, REPLY.values(t_ns=5, id=1, **given), strict=True))


def is_command(verb: Verb, payload: bytes) -> bool:
    try:
        found = parse(verb, payload)
    except RequestError as error:
        assert "\n" not in str(error)
        return False
    assert isinstance(found, Request)
    assert 1 <= len(found.operator) <= 64
    assert found.operator.isprintable()
    assert math.isfinite(found.value) or verb not in (Verb.TARGET, Verb.CONFIRM_STROKE, Verb.MOVE, Verb.CARRY)
    assert math.isnan(found.value) or verb in (Verb.TARGET, Verb.CALIBRATE, Verb.CONFIRM_STROKE, Verb.MOVE, Verb.CARRY)
    return True


@given(verb=st.sampled_from(Verb), payload=st.binary(max_size=200))
def test_any_bytes(verb: Verb, payload: bytes) -> None:
    is_command(verb, payload)


@given(verb=st.sampled_from(Verb), value=JSON)
def test_any_json(verb: Verb, value: Any) -> None:
    is_command(verb, msgspec.json.encode(value))


@given(verb=st.sampled_from(Verb), operator=JSON, value=JSON)
def test_any_values_under_the_right_keys(verb: Verb, operator: Any, value: Any) -> None:
    payload = msgspec.json.encode({"operator": operator, "value": value})
    well = isinstance(operator, str) and 1 <= len(operator.strip()) <= 64 and operator.strip().isprintable()
    number = isinstance(value, int | float) and not isinstance(value, bool)
    needed = dict.fromkeys((Verb.TARGET, Verb.CONFIRM_STROKE, Verb.MOVE, Verb.CARRY), number)
    needed |= {Verb.CALIBRATE: number or value is None}
    fits = needed.get(verb, value is None)
    assert is_command(verb, payload) == (well and fits)


@given(verb=st.sampled_from(Verb), lease=JSON | st.text("0123456789abcdefA\n", min_size=30, max_size=34))
def test_a_lease_that_is_no_id_is_a_refusal_but_for_hold(verb: Verb, lease: Any) -> None:
    needed: dict[Verb, dict[str, Any]] = {
        Verb.TARGET: {"value": 300.0},
        Verb.CONFIRM_STROKE: {"value": 0.0},
        Verb.MOVE: {"value": 1.0},
        Verb.CARRY: {"value": 60.0},
        Verb.GAINS: {"gain_file": "a", "name": "b"},
    }
    payload = msgspec.json.encode({"operator": "kim", "lease": lease} | needed.get(verb, {}))
    good = isinstance(lease, str) and is_id(lease)
    assert is_command(verb, payload) == (lease is None or good or verb is Verb.HOLD)
    if is_command(verb, payload):
        assert parse(verb, payload).lease == (lease if good else None)


@given(operator=st.text("abc xyz-", min_size=1).filter(str.strip), value=st.floats(-1e6, 1e6))
def test_a_proper_command_is_read(operator: str, value: float) -> None:
    name = operator.strip()[:64]
    found = parse(Verb.TARGET, msgspec.json.encode({"operator": name, "value": value}))
    assert (found.operator, found.value) == (name.strip(), value)
    assert parse(Verb.ARM, msgspec.json.encode({"operator": name})).verb is Verb.ARM


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "no payload"), (b"{", "truncated"), (b"\xff\xfe", "malformed"), (b"[1]", "Expected `object`"),
        (b'{"value": 300}', "operator"), (b'{"operator": "kim"}', "no value"),
        (b'{"operator": "kim", "value": null}', "no value"), (b'{"operator": "kim", "value": "3"}', "Expected `float"),
        (b'{"operator": "kim", "value": true}', "Expected `float"),
        (b'{"operator": "kim", "value": NaN}', "malformed"), (b'{"operator": "kim", "value": 1e999}', "out of range"),
        (b'{"operator": "kim", "value": 1, "force": 1}', "force"), (b'{"operator": 7, "value": 3}', "Expected `str`"),
        (b'{"operator": "", "value": 300}', "operator"), (b'{"operator": "a\\nb", "value": 300}', "operator"),
        (b"[" * 4000, "Expected `object`"), (b" " * 20_000, "20000 bytes"),
    ],
)  # fmt: skip
def test_a_refusal_says_what_is_wrong_with_the_message(payload: bytes, words: str) -> None:
    with pytest.raises(RequestError, match="expected") as refused:
        parse(Verb.TARGET, payload)
    assert words in str(refused.value)


def test_verbs_are_the_modes_verbs() -> None:
    assert [verb_of(verb.name.lower()) for verb in Verb] == list(Verb)
    for name in ("ARM", "", "*", "fly"):
        with pytest.raises(RequestError, match="expected arm, tension"):
            verb_of(name)


@pytest.mark.parametrize("verb", Verb)
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("refusal", Refusal)
def test_every_answer_has_one_line(verb: Verb, mode: Mode, refusal: Refusal) -> None:
    reply = reply_of(
        accepted=refusal is Refusal.NONE, reason=int(refusal), checks=int(Check.CELL_STALE), mode=int(mode),
        target_n=300.0,
    )  # fmt: skip
    found = answer(Request(verb, "kim"), reply, NewestRecord(Fault.TENSION_HIGH, 1.0, 2.0, 300.0), LIMITS)
    assert found["accepted"] is (refusal is Refusal.NONE)
    assert found["text"].startswith(f"{verb.name}: " if found["accepted"] else f"{verb.name} refused: ")
    assert "\n" not in found["text"]
    assert (found["operator"], found["verb"], found["mode"]) == ("kim", verb.name.lower(), mode.name)
    assert found.get("checks") == ([Check.CELL_STALE.words] if refusal is Refusal.PREFLIGHT else None)
    msgspec.json.encode(found)


@pytest.mark.parametrize("verb", [Verb.TENSION, Verb.RELEASE, Verb.IDENTIFY, Verb.CARRY])
def test_the_answer_to_what_takes_the_load_back_says_so_with_its_time(verb: Verb) -> None:
    reply = reply_of(accepted=True, reason=0, checks=0, mode=int(Mode.TENSIONING), target_n=300.0, taken_s=0.23)
    text = answer(Request(verb, "kim"), reply, NewestRecord(target_n=300.0), LIMITS)["text"]
    assert text.startswith(f"{verb.name}: taking the load from the brake, 0.2 s; ")
    without = reply_of(accepted=True, reason=0, checks=0, mode=int(Mode.TENSIONING), target_n=300.0)
    assert "brake" not in answer(Request(verb, "kim"), without, NewestRecord(target_n=300.0), LIMITS)["text"]


def test_a_reset_that_leaves_the_fault_to_a_loop_that_ends_says_so() -> None:
    reply = reply_of(accepted=True, reason=0, checks=0, mode=int(Mode.FAULT))
    text = answer(Request(Verb.RESET, "kim"), reply, NewestRecord(), LIMITS)["text"]
    assert text == "RESET: the loop ends, and the next one starts all devices up; it is DISARMED once they answer"
    reply = reply_of(accepted=True, reason=0, checks=0, mode=int(Mode.HOLD))
    assert answer(Request(Verb.RESET, "kim"), reply, NewestRecord(), LIMITS)["text"] == "RESET: fault cleared, HOLD"


def test_arm_at_an_end_is_an_option_of_arm_alone_and_reaches_the_loop() -> None:
    payload = msgspec.json.encode({"operator": "kim", "near_end": True})
    assert parse(Verb.ARM, payload).number == 1.0
    assert parse(Verb.ARM, msgspec.json.encode({"operator": "kim"})).number == 0.0
    with pytest.raises(RequestError, match="found near_end"):
        parse(Verb.HOLD, payload)


def test_a_brake_test_says_that_the_payload_is_supported() -> None:
    with pytest.raises(RequestError, match="found no supported"):
        parse(Verb.BRAKE_TEST, msgspec.json.encode({"operator": "kim"}))
    assert parse(Verb.BRAKE_TEST, msgspec.json.encode({"operator": "kim", "supported": True})).supported


def test_a_release_has_no_length_or_one_above_0_and_its_answer_says_which() -> None:
    assert math.isnan(parse(Verb.RELEASE, msgspec.json.encode({"operator": "kim"})).number)
    for value in (0.0, -5.0):
        with pytest.raises(RequestError, match="expected a length of rope above 0 mm"):
            parse(Verb.RELEASE, msgspec.json.encode({"operator": "kim", "value": value}))
    reply = reply_of(accepted=1, reason=0, checks=0, mode=int(Mode.RELEASING))
    for value, text in ((20.0, "paying out 20.0 mm of rope"), (math.nan, "ramping to slack")):
        assert text in answer(Request(Verb.RELEASE, "kim", value), reply, NewestRecord(), LIMITS)["text"]


def test_what_is_known_of_a_check_is_said_instead_of_its_general_phrase() -> None:
    checks = Check.CELL_STALE | Check.DISK
    reply = reply_of(accepted=0, reason=2, checks=int(checks), mode=0)
    found = answer(Request(Verb.ARM, "kim"), reply, NewestRecord(), LIMITS, {Check.DISK: "/data is full"})
    assert found["checks"] == [Check.CELL_STALE.words, "/data is full"]
    assert "; /data is full" in found["text"]


def test_an_armed_rig_says_what_was_waived_and_why() -> None:
    reply = reply_of(accepted=1, reason=0, checks=0, mode=1)
    waived = {Check.CALIBRATION: "no weight", Check.TARE: "no weight", Check.REALTIME: "a toy"}
    found = answer(Request(Verb.ARM, "kim"), reply, NewestRecord(), LIMITS, {}, waived)
    assert found["text"].endswith("; waived: calibration, tare (no weight), realtime (a toy)")
    assert "waived" not in answer(Request(Verb.HOLD, "kim"), reply, NewestRecord(), LIMITS, {}, waived)["text"]


@pytest.mark.parametrize("check", Check)
def test_every_check_has_a_phrase(check: Check) -> None:
    assert check.words


def test_words_of_a_row_are_those_of_the_loop_and_of_the_short_way_to_it() -> None:
    """`rigctl hold` loads no catalogue, and the catalogue no loop."""
    assert Verb.HOLD.row.done == hold_socket.HELD
    assert f"for {LONG_TEST_NS * 1e-9:g} s" in Verb.BRAKE_TEST.row.done
