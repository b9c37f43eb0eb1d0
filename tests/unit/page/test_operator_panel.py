"""What the page tells an operator: live commands by the modes table, devices with their ages, the timing's light."""

from __future__ import annotations

from typing import Any

import pytest

from rigctl.control.commands.situation import Situation
from rigctl.control.modes import answer
from rigctl.model.checks import Check
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.page.operator_panel import answers, devices, timing
from rigctl.wire.offers import BUTTONS, NO_LOOP, PAY_OUT, not_now, refused_now, refused_with
from tests.builders.offered import offered


def state(mode: Mode, *flags: str, **more: Any) -> dict[str, Any]:
    made = {
        "mode": mode.name, "loop_alive": True, "flag_names": list(flags), "fault": None, "fault_code": 0, "causes": [],
        "checks": 0, "preflight": {"failing": {}, "waived": {}}, "target_n": 300.0, "tension_n": 298.7,
        "quality": {"drive": "good", "tension": "good", "inclination": "good"}, "speed_mm_s": 0.0, **more,
    }  # fmt: skip
    return {"offers": offered(made), **made}


def buttons(made: dict[str, Any]) -> dict[str, str]:
    """Why each command of the bar would be refused."""
    found = refused_now(made)
    return {name: found[name] for name in (verb.name.lower() for verb in BUTTONS)}


@pytest.mark.parametrize("mode", Mode)
def test_just_the_commands_that_the_loop_would_accept_are_offered(mode: Mode) -> None:
    on = ["drive_enabled"] if mode is not Mode.DISARMED else []
    found = refused_now(state(mode, *on))
    situation = Situation(
        armed=bool(on), powered=bool(on), wanted_n=100.0, target_min_n=50.0, target_max_n=350.0, carry_s=1.0,
        measured_mm=52.3, stroke_mm=52.3, at_rest=True, unloaded=True,
    )  # fmt: skip
    assert set(found) == {*(verb.name.lower() for verb in Verb), PAY_OUT}
    for verb in Verb:
        assert (found[verb.name.lower()] == "") == (not answer(mode, verb, situation).refusal), verb


def test_a_check_that_bars_arming_says_so_in_its_words() -> None:
    failing = {"E_STOP": Check.E_STOP.words}
    found = refused_now(state(Mode.DISARMED, checks=int(Check.E_STOP), preflight={"failing": failing}))
    assert found["arm"] == Check.E_STOP.words
    assert refused_now(state(Mode.HOLD, checks=int(Check.E_STOP)))["arm"] == "already HOLD"


def test_a_reset_names_the_cause_that_blocks_it() -> None:
    cause = {"fault": "CELL_STALE", "text": "no tension sample", "blocks_reset": True}
    assert refused_now(state(Mode.FAULT, "drive_enabled", fault="CELL_STALE", fault_code=3))["reset"] == ""
    found = refused_now(state(Mode.FAULT, "drive_enabled", fault="CELL_STALE", fault_code=3, causes=[cause]))
    assert "CELL_STALE (no tension sample)" in found["reset"]


@pytest.mark.parametrize("broken", [{"mode": None}, {"loop_alive": False}, {"offers": None}])
def test_nothing_is_offered_where_the_loop_is_not_known(broken: dict[str, Any]) -> None:
    assert set(refused_now(state(Mode.HOLD) | broken | ({"offers": None} if "mode" in broken else {})).values()) == {
        NO_LOOP
    }


def test_a_slack_rope_is_paid_out_by_a_length_and_not_released() -> None:
    made = state(Mode.HOLD, "drive_enabled")
    found = refused_now(made | {"offers": offered(made, slack=True)})
    assert (found["release"], found[PAY_OUT]) == ("rope is slack already", "")
    assert "tight" in refused_now(made)[PAY_OUT]


@pytest.mark.parametrize(
    ("verb", "value", "why"),
    [
        ("target", 9999.0, "found 9999, expected 50 to 350 N"), ("target", 300.0, ""), ("carry", 0.5, "rigctl"),
        ("release", 5000.0, "found 5000, expected 0 to 60 mm"), ("release", 10.0, ""),
    ],
)  # fmt: skip
def test_a_value_is_judged_by_its_bounds(verb: str, value: float, why: str) -> None:
    made = state(Mode.HOLD, "drive_enabled")
    found = refused_with(made | {"offers": offered(made, slack=True)}, verb, value)
    assert (why in found) if why != "rigctl" else found.startswith("carry is not possible in HOLD")
    assert bool(found) is bool(why)


ACTIVE = {"settings": {"cylinder": {"e_stop_input": 0}, "io": {"node": 4}}, "bus_load": 0.412}


def rows(told: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in devices(told, ACTIVE)}


def test_every_device_has_its_words_and_its_age() -> None:
    held = {"held_by": "MOTOR"}
    found = rows(
        state(Mode.HOLD, "drive_enabled", **held, drive_age_ns=1_500_000, drive_current_a=1.25, tension_age_ns=None)
    )
    assert (found["drive"]["text"], found["drive"]["age_ms"]) == ("on", 1.5)
    assert rows(state(Mode.DISARMED, drive_power="OFF", drive_state="FAULT"))["drive"]["text"] == "off (FAULT)"
    assert found["load"]["text"] == "held by the motor"
    assert found["motor current"]["text"] == "1.25 A"
    assert found["drive temperature"]["text"] == "not known"
    assert found["tension cell"]["age_ms"] is None
    assert "41 %" in found["bus"]["text"]
    assert rows(state(Mode.DISARMED, held_by="BRAKE"))["load"]["text"] == "held by the brake (inferred)"
    assert rows(state(Mode.DISARMED, load_at_rest="BOTH"))["load at rest"]["text"] == "yes, by tension and stroke"
    assert rows(state(Mode.DISARMED, load_at_rest="MOVES"))["load at rest"]["text"] == "no, or not for 2 s"
    slips = rows(state(Mode.FAULT, held_by="BRAKE", sink_mm_s=-0.3, slack_s=160.0))["load"]["text"]
    assert slips == "held by the brake (inferred), which SLIPS by 0.30 mm/s: rope slack in 160 s"


def test_a_loop_that_writes_no_records_leaves_no_ages() -> None:
    """Seen: "the loop writes no records, 1 ms old"."""
    old = state(Mode.HOLD, loop_alive=False, tension_age_ns=1_000_000, drive_age_ns=1_000_000)
    assert {row["age_ms"] for row in rows(old).values()} == {None}


def test_each_input_of_the_emergency_stop_has_a_row() -> None:
    drive, node = "E-stop, drive's input", "E-stop, I/O node's input"
    pressed = {"fault": "E_STOP", "text": "emergency stop pressed (I/O node's input)"}
    found = rows(state(Mode.FAULT, causes=[pressed]))
    assert (found[drive]["text"], found[node]["text"], found[node]["bad"]) == ("released", "PRESSED", True)
    failing = {"E_STOP": "pressed", "E_STOP_IO_UNSEEN": "unseen"}
    found = rows(state(Mode.DISARMED, preflight={"failing": failing}))
    assert (found[drive]["text"], found[node]["text"]) == ("PRESSED", "not seen")
    assert rows(state(Mode.HOLD, preflight={"failing": failing}))[drive]["text"] == "released"
    bare = {row["name"]: row["text"] for row in devices(state(Mode.HOLD), {})}
    assert bare[drive] == bare[node] == "not fitted"


def test_the_only_emergency_stop_that_is_fitted_is_the_one_that_is_pressed() -> None:
    """Seen: "not known: one of the inputs is pressed", beside "not fitted"."""
    unnamed = state(Mode.FAULT, causes=[{"fault": "E_STOP", "text": "emergency stop pressed (input not known)"}])
    one = devices(unnamed, {"settings": {"cylinder": {"e_stop_input": 0}}})
    found = {row["name"]: row["text"] for row in one}
    assert (found["E-stop, drive's input"], found["E-stop, I/O node's input"]) == ("PRESSED", "not fitted")
    assert rows(unnamed)["E-stop, drive's input"]["text"] == "not known: one of the inputs is pressed"


def test_the_light_of_the_timing() -> None:
    figures = {"p50": 1.0, "p99": 2.0, "p999": 900.0, "max": 1900.0}
    told = state(Mode.HOLD, lateness_us=figures, work_us=None)
    assert timing(told, 1000.0, 0) == {"good": True, "text": "in time"}
    assert not timing(told, 500.0, 0)["good"]
    assert timing(told, 1000.0, 3)["text"] == "3 late in a minute"


def test_the_answers_are_ready_for_the_browser() -> None:
    cause = {"fault": "CELL_STALE", "text": "words", "value": 12e6, "limit": 5e6, "since_wall_ns": 2_000_000}
    told = answers(state(Mode.FAULT, fault="CELL_STALE", causes=[cause]), [])
    assert (told["value"], told["limit"], told["since_ms"]) == ("12 ms", "5 ms", 2.0)


def test_hold_is_no_command_that_waits_for_a_mode() -> None:
    assert Verb.HOLD not in BUTTONS


def test_each_reason_is_given_once() -> None:
    """The bar shows what the mode forbids with why, and names the commands that share the reason together."""
    lines = not_now(buttons(state(Mode.FAULT, fault="LIMIT", fault_code=18)))
    assert "ARM, TENSION: not possible in FAULT: reset first" in " ".join(lines).replace("RELEASE, ", "")
    assert len(lines) == len({line.partition(": ")[2] for line in lines})


def test_what_is_not_heard_of_is_not_known() -> None:
    """Seen on a dead bus: "brake open", "0 error frames", "E-stop released"."""
    causes = [{"fault": "BUS_SILENT", "text": "no frame"}]
    ages = {"drive_age_ns": 1_000_000}
    found = rows(state(Mode.FAULT, "drive_enabled", held_by="MOTOR", causes=causes, drive_current_a=1.0, **ages))
    for name in ("drive", "brake", "motor current"):
        assert found[name]["text"] == "not known"
    assert found["drive"]["age_ms"] is None, "nothing known has an age"
    assert found["load"]["text"] == "not known what holds the load"
    assert found["bus"]["text"].startswith("nothing is heard")
    assert found["E-stop, drive's input"]["text"] == "not seen"


def test_the_brake_is_inferred_and_the_drive_measured() -> None:
    found = rows(state(Mode.DISARMED, held_by="BRAKE"))
    assert (found["brake"]["sure"], found["drive"]["sure"], found["brake"]["text"]) == (False, True, "closed")
