"""The fault catalogue: its table, some rows on the real loop, and rows that fail with a broken safety table."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import pytest

from hil.cli import faults as command
from hil.faults import fault_tables as output
from hil.faults import lockstep_rows as study
from hil.faults import processes
from hil.faults.catalogue import BY_ID, CATALOGUE, PARKED, ROWS
from hil.faults.digests.played_rows import GATE
from hil.faults.expected import ARMED, InjectedFault, Reaction
from hil.faults.judging.judge import FaultResult
from hil.faults.lockstep_run import Bench, by_start
from hil.faults.rows.rows_alone import ALONE
from hil.faults.rows.rows_brake import BRAKE
from hil.faults.rows.rows_creep import CREEP
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file as config
from rigctl.control import modes, observer
from rigctl.control.power import stage
from rigctl.control.power.power_seen import PowerDetector
from rigctl.control.watch import safety
from rigctl.control.watch.escalation import Escalator
from rigctl.design.margins import design_and_check
from rigctl.model.faults import Fault
from rigctl.model.states import Event, Mode
from tests.builders.paths import ROOT

pytestmark = pytest.mark.gate
RIG = ROOT / "config/paper_rig.yaml"
PAGE = (ROOT / "docs/faults.md").read_text()

SOON_AFTER_S = 1.0
"""So long after its seconds a row is watched here: `python -m hil faults` does so for its 20 s."""
WHOLE: list[InjectedFault | processes.ProcessFault] = [*CATALOGUE, *processes.CATALOGUE]


def new_bench() -> Bench:
    """A bench whose loops have the tables of now."""
    settings = config.load(RIG)
    return Bench(settings, design_and_check(settings).gains, most_after_s=SOON_AFTER_S)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return new_bench()


def row(bench: Bench, name: str, mode: Mode) -> FaultResult:
    return study.row_of(bench, ROWS[name], mode)


# -- the table ------------------------------------------------------------------------------------------------------
def test_there_are_enough_faults_and_no_two_have_one_name() -> None:
    assert len(set(command.NAMES)) == len(command.NAMES) >= 45


@pytest.mark.parametrize("fault", CATALOGUE, ids=lambda fault: fault.id)
def test_what_is_expected_is_possible_in_that_mode(fault: InjectedFault) -> None:
    assert fault.modes
    armed = {Reaction.RIDDEN, Reaction.HELD, Reaction.EITHER, Reaction.DRIVE_OFF, Reaction.DRIVE_STOPS}
    for mode in fault.modes:
        possible = {
            Mode.DISARMED: {Reaction.RIDDEN, Reaction.REFUSED, Reaction.LATCHED, Reaction.MOVES, Reaction.EITHER},
            Mode.FAULT: {Reaction.KEPT, Reaction.DRIVE_OFF, Reaction.DRIVE_STOPS, Reaction.MOVES},
            Mode.HOLD: {*armed, Reaction.MOVES},
            Mode.COMPENSATING: {*armed, Reaction.MOVES} if fault in ALONE else armed,
        }.get(mode, armed)
        assert fault.expected[mode] in possible


def test_no_fault_is_expected_to_end_in_a_release() -> None:
    """Hold is safe, release is not: only riding through, holding or losing power is ever expected."""
    moves = {(fault.id, mode) for fault in WHOLE for mode in fault.expected if fault.expected[mode] is Reaction.MOVES}
    # The loop must not switch a motor on by itself to hold the load for a bad brake, on which HOLD and FAULT end too.
    slips = {fault.id for fault in CREEP if fault.id.startswith("encoder_stuck_brake_slips")}
    at_rest = {"brake_stuck_open", "brake_slips_slowly", *slips}
    later = {fault.id for fault in BRAKE if "later" in fault.id or "reset" in fault.id}  # than a parking's first second
    on_brake = {(name, mode) for name in later for mode in (Mode.HOLD, Mode.FAULT)}
    unseen = {(fault.id, Mode.COMPENSATING) for fault in ALONE if "then_brake_slips" in fault.id}
    assert moves == {(name, Mode.DISARMED) for name in at_rest} | on_brake | unseen
    for fault in WHOLE:
        assert not set(fault.expected.values()) & {Reaction.LEFT, Reaction.ARMED}


def test_only_what_breaks_the_rope_may_drop_the_load() -> None:
    dropped = {fault.id for fault in CATALOGUE if not fault.carried}
    assert dropped == {"rope_breaks", "rope_slips_away", "spring_breaks", "payload_lifted"}
    for name in dropped:
        assert all(BY_ID[name].expected[mode] is Reaction.HELD for mode in ARMED if mode in BY_ID[name].expected)


def test_the_page_has_every_fault_as_the_table_has_it() -> None:
    rows = [output.page_row(fault) for fault in WHOLE]
    written = [line for line in PAGE.splitlines() if line.startswith("| `")]
    assert written == rows


# -- rows, played ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "mode"), [(fault.id, mode) for fault, mode in by_start((ROWS[name], mode) for name, mode in GATE)]
)
def test_it_comes_to_what_is_expected(bench: Bench, name: str, mode: Mode) -> None:
    found = row(bench, name, mode)
    assert found.findings == ()


def test_a_rigs_row_says_what_was_so(bench: Bench) -> None:
    found = row(bench, "cell_silent", Mode.COMPENSATING)
    assert (found.reaction, found.fault, found.load_carried) == ("drive off", "CELL_STALE", True)  # on the brake
    assert found.detection_ms == pytest.approx(bench.settings.safety.stale_ms, abs=3.0)  # and the ticks on the way
    assert found.latency_ms == 0.0
    assert found.stroke_mm < 0.1
    assert found.tension_min_n == pytest.approx(300.0, abs=1.0)


@pytest.mark.gate("3-cell_silent-1", "29-io_silent-0", "23-io_e_stop-1", "51-encoder_stuck_brake_slips_later_500-5")
@pytest.mark.parametrize(
    ("fault", "name", "mode"),
    [
        (Fault.CELL_STALE, "cell_silent", Mode.HOLD),
        (Fault.CELL_INVALID, "cell_overload", Mode.COMPENSATING),
        (Fault.INCLINATION_STALE, "slope_silent", Mode.TENSIONING),
        (Fault.E_STOP_UNSEEN, "io_silent", Mode.COMPENSATING),
        (Fault.E_STOP_UNSEEN, "io_silent", Mode.DISARMED),
        (Fault.E_STOP, "io_e_stop", Mode.HOLD),
        (Fault.LOAD_SINKS, "encoder_stuck_brake_slips_later_500", Mode.FAULT),
    ],
)
def test_a_safety_table_without_a_row_makes_rows_fail(
    monkeypatch: pytest.MonkeyPatch,
    fault: InjectedFault,
    name: str,
    mode: Mode,
) -> None:
    whole = safety.table
    monkeypatch.setattr(safety, "table", lambda s: tuple(r for r in whole(s) if r.fault is not fault))
    assert row(new_bench(), name, mode).findings


def test_a_rig_that_shows_the_power_off_while_the_motor_has_it_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the drive's state alone: it reports READY TO SWITCH ON from the begin of a ramp that does not end."""
    look = PowerDetector.look

    def by_state(detector: PowerDetector, *args: Any, **seen: Any) -> None:
        look(detector, *args, **seen)
        detector.seen.braked = detector.seen.brake_time_over

    monkeypatch.setattr(PowerDetector, "look", by_state)
    monkeypatch.setattr(observer, "held_by", lambda *at, **found: stage.held_by(*at, **{**found, "rests": True}))
    found = row(new_bench(), "torque_lost", Mode.FAULT)
    assert any(text.startswith("power off shown") for text in found.findings)


def test_a_rig_that_cuts_the_power_of_a_runaway_late_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = safety.table
    monkeypatch.setattr(safety, "table", lambda s: tuple(r for r in whole(s) if not r.at_once))
    found = row(new_bench(), "torque_lost_free", Mode.COMPENSATING)
    assert any(text.startswith("tension") for text in found.findings)


@pytest.mark.gate("True-drive off")
@pytest.mark.parametrize(("escalates", "reaction"), [(True, Reaction.DRIVE_OFF), (False, Reaction.LEFT)])
def test_a_rig_that_releases_the_load_after_a_trip_is_found_out(
    monkeypatch: pytest.MonkeyPatch, escalates: bool, reaction: Reaction
) -> None:
    """The escalation ends such a release by taking the drive's power away: too late for the row, which reports it."""
    monkeypatch.setitem(modes.TRANSITIONS, (Mode.COMPENSATING, Event.TRIP), modes.Transition(Mode.RELEASING))
    if not escalates:
        monkeypatch.setattr(Escalator, "look", lambda *_: None)
    found = row(new_bench(), "payload_caught", Mode.COMPENSATING)
    assert found.reaction == reaction
    assert found.findings


@pytest.mark.study
def test_rows_are_the_same_every_time(bench: Bench) -> None:
    first, again = (row(bench, "frames_lost_10pct", Mode.HOLD) for _ in range(2))
    assert first == again


# -- the command ----------------------------------------------------------------------------------------------------
def test_the_command_writes_the_rows(tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.json"
    assert command.run(RIG, ["cell_silent"], ["HOLD", "FAULT"], file) == 0
    written = json.loads(file.read_text())
    assert (written["ok"], written["total"]) == (True, 2)
    keys = {"id", "mode", "expected", "reaction", "latency_ms", "tension_min_n", "tension_max_n", "stroke_mm", "ok"}
    assert all(keys <= set(found) for found in written["faults"])
    assert [found["mode"] for found in written["faults"]] == ["HOLD", "FAULT"]
    assert "2 rows of 1 fault: all as expected" in capsys.readouterr().out


def test_the_command_writes_a_row_whose_load_is_lost(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "rows.json"
    assert command.run(RIG, ["rope_breaks"], ["HOLD"], file) == 0
    assert json.loads(file.read_text())["faults"][0]["load_carried"] is False


def test_what_is_not_as_expected_comes_first_and_ends_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = safety.table
    monkeypatch.setattr(safety, "table", lambda s: tuple(r for r in whole(s) if r.fault is not Fault.CELL_INVALID))
    assert command.run(RIG, ["cell_silent", "cell_overload"], ["HOLD"], None) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[1].startswith("cell_overload")
    assert "1 not as expected" in said[-1]


def test_hold_and_fault_are_played_parked_too_unless_a_mode_is_named() -> None:
    def chosen(*modes: str) -> list[tuple[str, Mode]]:
        return [(fault.id, mode) for fault, mode in command.choose(["cell_silent"], modes).lockstep]

    parked = [("cell_silent_parked", Mode.HOLD), ("cell_silent_parked", Mode.FAULT)]
    assert chosen() == [*(("cell_silent", mode) for mode in Mode), *parked]
    assert chosen("HOLD") == [("cell_silent", Mode.HOLD)]
    assert chosen("HOLD_PARKED") == parked[:1]
    assert chosen("FAULT_PARKED", "HOLD") == [("cell_silent", Mode.HOLD), *parked[1:]]
    assert len(PARKED) > 150
    for played in PARKED.values():
        slips = Reaction.MOVES in played.expected.values() or not played.carried
        assert slips or played.held_mm <= 1.0, played.id


@pytest.mark.parametrize(
    ("only", "modes", "said"),
    [
        (["cell_gone"], [], "--only: found 'cell_gone'"),
        ([], ["COMPENSATE"], "--mode: found 'COMPENSATE'"),
        (["drive_runs_up"], ["DISARMED"], "--mode: found DISARMED"),
    ],
)
def test_what_does_not_exist_is_refused_in_one_line(only: list[str], modes: list[str], said: str) -> None:
    with pytest.raises(ScenarioError, match=said) as refused:
        command.choose(only, modes)
    assert refused.value.exit_code == 2
    assert len(refused.value.findings) == 1


# -- commands as part of a row --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "fault"),
    [("take_back_200_cell_silent", Fault.CELL_STALE), ("creeps_reset_tension", Fault.DRIVE_NOT_FOLLOWING)],
)
def test_a_row_with_commands_is_judged_by_its_last_reaction(bench: Bench, name: str, fault: Fault) -> None:
    found = row(bench, name, Mode.HOLD)
    assert found.findings == ()
    assert (found.reaction, found.fault) == (Reaction.DRIVE_OFF, fault.name)


# -- culprits -------------------------------------------------------------------------------------------------------
def test_the_command_names_the_culprits_and_plays_no_row_twice(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, file = tmp_path / "windows", tmp_path / "culprits.json"
    assert command.run_diagnosis(RIG, folder, ["cell_sign"], ["COMPENSATING"], file) == 0
    assert "1 row that trip: 1 right" in capsys.readouterr().out
    (found,) = json.loads(file.read_text())["rows"]
    assert (found["named"], found["naming"]) == (["tension cell's amplifier"], "right")
    monkeypatch.setattr(Bench, "play", None)
    assert command.run_diagnosis(RIG, folder, ["cell_sign"], ["COMPENSATING"], None) == 0
