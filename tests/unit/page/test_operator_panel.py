"""What the page tells an operator: live commands by the modes table, devices with their ages, the timing's light."""

from __future__ import annotations

from typing import Any

import pytest

from rigctl.control.checks import Check
from rigctl.control.modes import Mode, Situation, Verb, decide
from rigctl.page.operator_panel import VERBS, answers, devices, possible, timing

RANGE = (50.0, 350.0)


def state(mode: Mode, *flags: str, **more: Any) -> dict[str, Any]:
    return {
        "mode": mode.name, "loop_alive": True, "flag_names": list(flags), "fault": None, "fault_code": 0, "causes": [],
        "checks": 0, "preflight": {"failing": {}, "waived": {}}, "target_n": 300.0, "tension_n": 298.7,
        "quality": {"drive": "good", "tension": "good", "inclination": "good"}, "speed_mm_s": 0.0, **more,
    }  # fmt: skip


@pytest.mark.parametrize("mode", Mode)
def test_just_the_commands_that_the_modes_table_allows_are_live(mode: Mode) -> None:
    enabled = mode is not Mode.DISARMED
    found = possible(state(mode, *(["drive_enabled"] if enabled else [])), RANGE)
    assert set(found) == {verb.name.lower() for verb in VERBS}
    for verb in VERBS:
        situation = Situation(drive_enabled=enabled, wanted_n=100.0, target_min_n=50.0, target_max_n=350.0)
        assert (found[verb.name.lower()] == "") == (not decide(mode, verb, situation).refusal), verb


def test_a_check_that_bars_arming_says_so_in_its_words() -> None:
    failing = {"E_STOP": Check.E_STOP.words}
    found = possible(state(Mode.DISARMED, checks=int(Check.E_STOP), preflight={"failing": failing}), RANGE)
    assert found["arm"] == Check.E_STOP.words
    assert possible(state(Mode.HOLD, checks=int(Check.E_STOP)), RANGE)["arm"] == "already HOLD"


def test_a_reset_names_the_cause_that_blocks_it() -> None:
    cause = {"fault": "CELL_STALE", "text": "no tension sample", "blocks_reset": True}
    faulty = state(Mode.FAULT, "drive_enabled", fault="CELL_STALE", fault_code=3)
    assert possible(faulty, RANGE)["reset"] == ""
    refusal = possible(faulty | {"causes": [cause]}, RANGE)["reset"]
    assert "CELL_STALE (no tension sample)" in refusal


@pytest.mark.parametrize("broken", [{"mode": None}, {"mode": "NO SUCH"}, {"loop_alive": False}, {"fault_code": 9999}])
def test_nothing_is_live_where_the_loop_is_not_known(broken: dict[str, Any]) -> None:
    assert set(possible(state(Mode.HOLD) | broken, RANGE).values()) == {"the loop does not run"}


ACTIVE = {"settings": {"cylinder": {"e_stop_input": 0}, "io": {"node": 4}}, "bus_load": 0.412}


def rows(told: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in devices(told, ACTIVE)}


def test_every_device_has_its_words_and_its_age() -> None:
    found = rows(state(Mode.HOLD, "drive_enabled", drive_age_ns=1_500_000, drive_current_a=1.25, tension_age_ns=None))
    assert (found["drive"]["text"], found["drive"]["age_ms"]) == ("on", 1.5)
    assert found["brake"]["text"].startswith("open")
    assert found["motor current"]["text"] == "1.25 A"
    assert found["drive temperature"]["text"] == "not known"
    assert found["tension cell"]["age_ms"] is None
    assert "41 %" in found["bus load"]["text"]
    assert rows(state(Mode.DISARMED))["brake"]["text"].startswith("closed")


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


def test_the_light_of_the_timing() -> None:
    figures = {"p50": 1.0, "p99": 2.0, "p999": 900.0, "max": 1900.0}
    told = state(Mode.HOLD, lateness_us=figures, work_us=None)
    assert timing(told, 1000.0, 0) == {"good": True, "text": "in time"}
    assert not timing(told, 500.0, 0)["good"]
    assert timing(told, 1000.0, 3)["text"] == "3 late in a minute"


def test_the_answers_are_ready_for_the_browser() -> None:
    cause = {"fault": "CELL_STALE", "text": "words", "value": 12e6, "limit": 5e6, "since_wall_ns": 2_000_000}
    (told,) = answers(state(Mode.FAULT, fault="CELL_STALE", causes=[cause]), [])["causes"]
    assert (told["value"], told["limit"], told["since_ms"]) == ("12 ms", "5 ms", 2.0)


def test_hold_is_no_command_that_waits_for_a_mode() -> None:
    assert Verb.HOLD not in VERBS
