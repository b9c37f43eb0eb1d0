"""The steps displayed at the end of a row lead out: to DISARMED with a slack rope or a load at rest.

``python -m hil faults --ways-out FILE`` plays the whole catalogue; here is a row of each kind of way out.
"""

from __future__ import annotations

import json
import pathlib
from dataclasses import replace

import pytest

from hil.cli import faults_ways_out
from hil.faults.catalogue import ROWS
from hil.runs import rows_file
from hil.ways_out import step_follower
from rigctl.control.commands.situation import Situation
from rigctl.control.logbook import Logbook
from rigctl.model.parts import Part
from rigctl.model.states import Mode
from rigctl.wire import operator_view
from rigctl.wire.instructions import Hands
from tests.builders.paths import ROOT

RIG = ROOT / "config/paper_rig.yaml"
KINDS = (
    ("cell_silent", Mode.COMPENSATING, Hands.MEND),
    ("io_e_stop", Mode.COMPENSATING, Hands.RELEASE),
    ("drive_boots", Mode.COMPENSATING, Hands.PRESS),  # it is not seen to be off
    ("foreign_abort_option", Mode.COMPENSATING, Hands.START),
)


def taken(file: pathlib.Path) -> list[str]:
    """Of the only way out in a file."""
    _, rows = rows_file.read(file)
    ((leads, why, steps, _misoffered),) = (value for key, value in rows.items() if key.startswith("way out "))
    assert isinstance(leads, bool)
    return [why, *steps]


@pytest.mark.gate("cell_silent-COMPENSATING-MEND", "io_e_stop-COMPENSATING-RELEASE")
@pytest.mark.parametrize(("row", "mode", "hands"), KINDS, ids=lambda value: getattr(value, "name", value))
def test_the_steps_lead_out_by_hands_and_commands(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], row: str, mode: Mode, hands: Hands
) -> None:
    file = tmp_path / "ways.jsonl"
    assert faults_ways_out.run(RIG, file, [row], [mode.name]) == 0
    assert capsys.readouterr().out.endswith("1 distinct ends (1 in FAULT): 0 without a way out\n")
    assert any(f"{hands.name} at" in step for step in taken(file))


@pytest.mark.gate
def test_a_load_on_a_brake_that_does_not_hold_is_lowered_by_the_motor(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "ways.jsonl"
    assert faults_ways_out.run(RIG, file, ["brake_slips_later_100"], [Mode.HOLD.name]) == 0
    why, *steps = taken(file)
    assert why == ""
    given = [step.rpartition(" -> ")[2] for step in steps]
    assert given.index("CARRY NONE") < given.index("LOWER NONE") < given.index("RESET NONE")


@pytest.mark.gate
def test_a_step_that_is_not_displayed_is_found_to_be_missing(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stopped run is gone on with: the row is not played again, its way out is."""
    shown = operator_view.view
    file = tmp_path / "ways.jsonl"

    def without_reset(state: dict[str, object]) -> operator_view.OperatorView:
        found = shown(state)
        left = tuple(step for step in found.steps if step.verb != "reset")
        return operator_view.OperatorView(found.causes, found.does, found.blocks, left, found.entry, found.entry_why)

    monkeypatch.setattr(step_follower, "view", without_reset)
    assert faults_ways_out.run(RIG, file, ["cell_stuck"], [Mode.HOLD.name]) == 1
    out = capsys.readouterr().out
    assert "cell_stuck in HOLD\n  ends in FAULT, CELL_STUCK, HOLD, held by " in out
    assert "  no way out: FAULT, CELL_STUCK: no step leads on\n" in out
    monkeypatch.undo()
    lines = [line for line in file.read_text().splitlines() if not json.loads(line).get("key", "").startswith("way")]
    file.write_text("".join(f"{line}\n" for line in lines))
    assert faults_ways_out.run(RIG, file, ["cell_stuck"], [Mode.HOLD.name]) == 0


def test_a_command_that_is_not_answered_as_it_is_offered_is_found(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The situation that the loop publishes lacks the fault's causes, by which it answers RESET."""
    publish = Logbook.situation

    def without_causes(self: Logbook, t_ns: int, mode: int, situation: Situation) -> None:
        publish(self, t_ns, mode, replace(situation, causes=0))

    monkeypatch.setattr(Logbook, "situation", without_causes)
    assert faults_ways_out.run(RIG, tmp_path / "ways.jsonl", ["cell_silent"], [Mode.HOLD.name]) == 1
    out = capsys.readouterr().out
    assert "not as offered: RESET in FAULT, CELL_STALE: offer accepted, CAUSE_PRESENT\n" in out


def test_hands_mend_only_where_the_fault_is(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that lead to a part that is in order change nothing there."""
    elsewhere = replace(ROWS["cell_stuck"], part=(Part.RAIL_ENCODER,))
    monkeypatch.setitem(ROWS, "cell_stuck", elsewhere)
    file = tmp_path / "ways.jsonl"
    assert faults_ways_out.run(RIG, file, ["cell_stuck"], [Mode.HOLD.name]) == 1
    assert any(step.endswith("MEND at tension cell's amplifier: no") for step in taken(file))
