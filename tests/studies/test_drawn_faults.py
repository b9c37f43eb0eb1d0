"""Drawn faults by the command line: the same draw each time, alone or among others, and a miss that replays."""

from __future__ import annotations

import json
import pathlib
from dataclasses import replace

import pytest

from hil.cli import draw as command
from hil.faults.drawn import draw_file, oracle, played_draws
from hil.faults.drawn.draw import Draw, DrawnRig, PartFault, block_of, pair_of
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file
from rigctl.control.load.load_at_rest import LoadRest
from rigctl.model.states import LoadAtRest
from tests.builders.paths import ROOT

RIG = ROOT / "config/paper_rig.yaml"


def verdicts(file: pathlib.Path) -> list[dict[str, object]]:
    found: list[dict[str, object]] = json.loads(file.read_text())["draws"]
    return found


def test_a_draw_is_the_same_alone_among_others_and_from_its_file(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draws 0 and 1 are branches of one run in DISARMED: what one branch does must not reach the other."""
    monkeypatch.chdir(tmp_path)
    both, alone, again = (tmp_path / name for name in ("both.json", "alone.json", "again.json"))
    rows = tmp_path / "rows.jsonl"
    assert command.run(RIG, 2, 1, [], both, rows) == 0
    monkeypatch.setattr(played_draws, "_play_block", None)
    assert command.run(RIG, 2, 1, [], alone, rows) == 0, "what the rows have is not played again"
    assert alone.read_text() == both.read_text()
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert command.run(RIG, 2, 1, ["1"], alone) == 0
    assert verdicts(both)[1:] == verdicts(alone)
    drawn, _, _, course = block_of(rig_file.load(RIG), 1, 0)
    draw_file.write(tmp_path / "draw.yaml", pair_of(1, 1, drawn, course), ())
    assert command.replay(RIG, tmp_path / "draw.yaml", again) == 0
    assert verdicts(again) == verdicts(alone)


def test_a_miss_is_written_as_a_file_and_ends_with_1(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The judge finds fault with whatever is drawn."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(oracle, "_sinks", lambda *_: ["the brake gave way"])
    assert command.run(RIG, 1, 1, [], None) == 1
    drawn, _, _, course = block_of(rig_file.load(RIG), 1, 0)
    assert draw_file.read(tmp_path / "misses/draw_1_0.yaml") == pair_of(1, 0, drawn, course)
    assert "1 beyond the bound" in capsys.readouterr().out


def test_a_load_that_moves_within_the_bounds_at_its_end_is_watched_until_the_rig_reacts() -> None:
    """A cell that freezes; the draw's seconds are over before the bound of the unseen travel ends it."""
    freezes = a_draw(
        DrawnRig(31.07, 270.3, 350.0, limits=False), "compensating",
        (PartFault("cell_frozen", 0.02398, 7.171), PartFault("backlash_grows", 9.037, 7.171)), 3.29,
    )  # fmt: skip
    draw, verdict = played_draws.replayed(rig_file.load(RIG), replace(freezes, index=613, then="reset"))
    assert verdict.ok
    assert draw.seconds == freezes.seconds + played_draws.LONGER_S
    assert any("LOAD_UNSEEN" in trip for trip in verdict.trips)


def test_what_the_records_say_is_judged_by_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A brake that slips, with a load at rest in every record."""
    slips = a_draw(DrawnRig(6.0, None, 300.0, limits=True), "disarmed", (PartFault("brake_slips", 0.3, 1.5),), 6.0)
    assert not said(slips)

    def at_rest(rest: LoadRest, *_: object) -> LoadAtRest:
        rest.shown = LoadAtRest.BOTH
        return rest.shown

    monkeypatch.setattr(LoadRest, "look", at_rest)
    assert any(found.startswith("load at rest in") for found in said(slips))


def a_draw(rig: DrawnRig, course: str, faults: tuple[PartFault, ...], seconds: float) -> Draw:
    return Draw(1, 0, rig, course, faults, "nothing", 0.5, seconds)


def said(draw: Draw) -> list[str]:
    """Statements against the truth."""
    return [found for found in played_draws.replayed(rig_file.load(RIG), draw)[1].findings if "against the" in found]


@pytest.mark.parametrize("number", ["2", "-1", "cell_silent"])
def test_a_number_that_is_not_drawn_is_refused(number: str) -> None:
    with pytest.raises(ScenarioError, match="--only: found") as refused:
        command.run(RIG, 2, 1, [number], None)
    assert refused.value.exit_code == 2
