"""`python -m hil faults --hash`: equal behaviour gives equal digests, a change shows where it acts."""

from __future__ import annotations

import pathlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil.cli import faults_hash as command
from hil.faults.catalogue import BY_ID, ROWS
from hil.faults.digests import comparison, drawn_runs, name_map, play, played_rows
from hil.faults.digests.played_rows import COURSES, GATE, WORK, PlayedRow
from hil.faults.digests.streams import Digests, digests_of
from hil.faults.drawn import play as drawn_play
from hil.faults.drawn.draw import pair_of
from hil.faults.lockstep_run import Bench, Run
from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file as config
from rigctl.control.watch import safety
from rigctl.design.margins import design_and_check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Flag, Mode
from rigctl.model.verbs import Verb
from tests.builders.paths import ROOT

RIG = ROOT / "config/paper_rig.yaml"
ROW = PlayedRow(played_rows.BASE, "cell_silent", Mode.HOLD)


def bench() -> Bench:
    settings = config.load(RIG)
    return Bench(settings, design_and_check(settings).gains, most_after_s=0.1, keeps_frames=True)


@pytest.fixture(scope="module")
def run() -> Run:
    """A cell that falls silent in HOLD."""
    return bench().play(BY_ID[ROW.id], ROW.mode)


@pytest.fixture
def digests(run: Run, monkeypatch: pytest.MonkeyPatch) -> Digests:
    monkeypatch.setattr(name_map, "ADDED", frozenset())
    return digests_of(run)


def moved(here: Digests, there: Digests) -> set[str]:
    return {name for row in comparison.moved({"row": here}, {"row": there}) for name in row.names}


def test_every_stream_of_a_run_has_its_names(run: Run, digests: Digests) -> None:
    assert digests["records"].keys() == set(run.records.dtype.names or ()) - {"seq"}
    assert {"0x080", "0x184", "0x204", "0x701", "0x704"} <= digests["frames"].keys()
    assert {"order", "TRIP.a", "TRIP.text", "MODE.value"} <= digests["events"].keys()
    assert {"id", "reason", "checks"} <= digests["replies"].keys()
    assert {"tension_n", "stroke_mm", "powered"} <= digests["truth"].keys()


def test_the_same_row_gives_the_same_digests_from_another_bench(digests: Digests) -> None:
    assert digests_of(bench().play(BY_ID[ROW.id], ROW.mode)) == digests


def test_a_later_reaction_shows_in_what_it_changes(digests: Digests, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = safety.table

    def later(settings: Any) -> tuple[safety.Row, ...]:
        return tuple(
            replace(row, limit=row.limit * 1.2) if row.fault is Fault.CELL_STALE else row for row in whole(settings)
        )

    monkeypatch.setattr(safety, "table", later)
    names = moved(digests, digests_of(bench().play(BY_ID[ROW.id], ROW.mode)))
    assert {"records/fault", "records/mode", "events/TRIP.limit", "frames/0x204"} <= names
    assert not names & {"records/t_ns", "replies/id", "frames/0x080"}


@pytest.mark.parametrize(("stream", "field"), [("records", "tension_n"), ("events", "value")])
def test_the_last_bit_of_one_value_shows(run: Run, digests: Digests, stream: str, field: str) -> None:
    array = getattr(run, stream).copy()
    column = array[field]
    column[-1] = np.nextafter(column[-1], np.inf) if column.dtype.kind == "f" else column[-1] ^ 1
    changed = digests_of(replace(run, **{stream: array}))
    kind = Kind(int(array["kind"][-1])).name + "." if stream == "events" else ""
    assert moved(digests, changed) == {f"{stream}/{kind}{field}"}


def test_a_check_of_a_refusal_shows() -> None:
    refused = bench().play(BY_ID[ROW.id], Mode.DISARMED)
    replies = refused.replies.copy()
    replies["checks"][-1] ^= 1
    assert moved(digests_of(refused), digests_of(replace(refused, replies=replies))) == {"replies/checks"}


def test_one_bit_and_the_time_of_a_frame_show(run: Run, digests: Digests) -> None:
    t_ns, frame = run.frames[100]
    name = f"frames/0x{int.from_bytes(frame[:4], 'little'):03X}"
    for other in ((t_ns + 1, frame), (t_ns, frame[:8] + bytes([frame[8] ^ 1]) + frame[9:])):
        changed = replace(run, frames=[*run.frames[:100], other, *run.frames[101:]])
        assert moved(digests, digests_of(changed)) == {name}


def test_a_number_of_an_enumeration_counts_by_its_name(run: Run, digests: Digests) -> None:
    """With its new number a fault would be another one; only the name of a number is hashed."""
    records = run.records.copy()
    records["fault"][records["fault"] == Fault.CELL_STALE] = Fault.CELL_INVALID
    assert moved(digests, digests_of(replace(run, records=records))) == {"records/fault"}


def test_a_renamed_member_is_hashed_under_the_name_before(
    run: Run, digests: Digests, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(name_map, "RENAMED", {"Fault.CELL_STALE": "Fault.CELL_OLD", "records/tension_n": "records/t"})
    names = moved(digests, digests_of(run))
    assert {"records/tension_n", "records/t"} <= names
    assert {"records/fault", "records/cause_bits", "events/TRIP.a"} <= names
    monkeypatch.setattr(name_map, "RENAMED", {"Kind.TRIP": "Kind.TRIPPED"})
    assert {"events/order", "events/TRIP.a", "events/TRIPPED.a"} <= moved(digests, digests_of(run))


def test_what_one_side_alone_has_is_left_out_where_it_is_named(
    run: Run, digests: Digests, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(name_map, "ADDED", frozenset({"records/sink_mm_s", "Flag.DRIVE_OFF", "Kind.TRIP"}))
    without = digests_of(run)
    untripped = replace(run, events=run.events[run.events["kind"] != Kind.TRIP])
    assert digests_of(untripped)["events"] == without["events"]
    assert "sink_mm_s" not in without["records"]
    flags = run.records.copy()
    flags["flags"] &= ~np.uint16(Flag.DRIVE_OFF)
    assert digests_of(replace(run, records=flags))["records"]["flags"] == without["records"]["flags"]
    assert {"records/sink_mm_s", "events/order", "events/TRIP.a"} <= moved(without, digests)
    monkeypatch.setattr(name_map, "REMOVED", frozenset({"records/sink_mm_s"}))
    assert "records/sink_mm_s" not in moved(without, digests)


def test_an_exceptions_place_is_not_hashed(run: Run) -> None:
    def with_exception(text: bytes) -> Digests:
        events = run.events.copy()
        events["kind"][-1], events["text"][-1] = Kind.EXCEPTION, text
        return digests_of(replace(run, events=events))

    one = with_exception(b"ValueError in _speed:12: no value")
    assert one == with_exception(b"ValueError in speed_of:400: no value")
    assert moved(one, with_exception(b"ValueError in _speed:12: another")) == {"events/EXCEPTION.text"}


# -- what is played -------------------------------------------------------------------------------------------------
def test_the_default_set_has_every_verb_every_rig_and_the_gates_rows() -> None:
    assert {one[2] for course in COURSES for one in course.commands if isinstance(one[2], Verb)} == set(Verb)
    rigs = played_rows.rigs(RIG)
    sets = {f"set {file.stem}" for file in (RIG.parent / "sets").glob("*.yaml")}
    assert rigs.keys() == {played_rows.BASE, "plain_rig"} | sets
    rows = played_rows.default(rigs)
    assert {row.rig for row in rows if row.id == WORK.id} == rigs.keys()
    assert {(row.id, row.mode) for row in rows} >= set(GATE)
    assert len({row.key for row in rows}) == len(rows)


def test_the_larger_set_has_every_row_of_the_catalogue_in_its_modes() -> None:
    rows = played_rows.every([played_rows.BASE])
    assert {(row.id, row.mode) for row in rows} >= {(fault.id, mode) for fault in ROWS.values() for mode in fault.modes}
    assert set(played_rows.default([played_rows.BASE])) <= set(rows)
    assert len({row.key for row in rows}) == len(rows)


@pytest.fixture
def short_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws end half a second after their first fault."""
    monkeypatch.setattr(drawn_runs, "pair_of", lambda *drawn: replace(pair_of(*drawn), seconds=0.5))


@pytest.mark.usefixtures("short_draws")
def test_a_draw_has_every_stream_and_is_the_same_without_the_others_of_its_block() -> None:
    settings = config.load(RIG)
    found = drawn_runs.play_block(settings, 1, [8, 9])
    assert [*found] == [drawn_runs.key(8), drawn_runs.key(9)]
    one, other = found.values()
    assert {"0x080", "0x184", "0x701"} <= one["frames"].keys()
    assert {"tension_n", "mode"} <= one["records"].keys()
    assert {"tension_n", "free_mm", "braked"} <= one["truth"].keys()
    assert {"frames/0x184", "records/t_ns", "truth/t_ns"} <= moved(one, other)
    assert drawn_runs.play_block(settings, 1, [9]) == {drawn_runs.key(9): other}


def test_a_draw_that_cannot_be_played_has_its_reason_without_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise AssertionError("no such state")

    monkeypatch.setattr(drawn_play, "branch", fails)
    found = drawn_runs.play_block(config.load(RIG), 0, [0])
    assert found == {drawn_runs.key(0): {"not played": {"AssertionError": "no such state"}}}


def test_a_row_that_cannot_be_played_is_a_row_with_its_reason() -> None:
    play._start({played_rows.BASE: config.load(RIG)})
    play._rigs[played_rows.BASE] = config.load(RIG).model_copy(
        update={"preflight": config.load(RIG).preflight.model_copy(update={"stroke_margin_mm": 1e3})}
    )
    play._benches.clear()
    assert play._play(ROW) == {ROW.key: {"not played": {"CommandRefusedError": "ARM was refused: PREFLIGHT"}}}


# -- the command ----------------------------------------------------------------------------------------------------
@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The default set is one row."""
    monkeypatch.setattr(played_rows, "default", lambda _: [ROW])
    monkeypatch.setattr(played_rows, "rigs", lambda file: {played_rows.BASE: config.load(file)})
    yield


@pytest.mark.usefixtures("short")
def test_a_file_is_written_compared_and_gone_on_with(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert command.run(RIG, first, None) == 0
    assert command.run(RIG, second, first) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "equal"
    monkeypatch.setattr(play, "_play", None)  # nothing is played again
    assert command.run(RIG, second, first) == 0
    rows = RowsFile(tmp_path / "third", {"digests": 1, "computer": command._computer()})
    digests = RowsFile(second, {"digests": 1, "source": command.source_of(RIG), "computer": command._computer()}).get(
        ROW.key
    )
    rows.put(ROW.key, {**digests, "records": {**digests["records"], "stroke_mm": "0"}})
    assert command.run(RIG, second, tmp_path / "third") == 1
    shown = capsys.readouterr().out.splitlines()
    assert shown[-2:] == [
        f"{ROW.key}: records/stroke_mm", f"1 of 1 rows differ; the first: {ROW.key}, records/stroke_mm"
    ]  # fmt: skip


@pytest.mark.usefixtures("short", "short_draws")
def test_the_larger_set_goes_on_with_a_file_and_is_compared_where_both_have_rows(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(played_rows, "every", lambda _: [ROW])
    monkeypatch.setattr(drawn_runs, "COUNT", 2)
    small, large = tmp_path / "small", tmp_path / "large"
    assert command.run(RIG, small, None) == 0
    large.write_bytes(small.read_bytes())
    with monkeypatch.context() as patch:
        patch.setattr(play, "_play", None)  # the row is there already
        assert command.run(RIG, large, None, every=True) == 0
    with monkeypatch.context() as patch:
        patch.setattr(drawn_runs, "play_block", None)  # and now the draws are
        assert command.run(RIG, large, small, every=True) == 1
    draws = ", ".join(map(drawn_runs.key, range(2)))
    assert capsys.readouterr().out.splitlines()[-2:] == [
        f"only this file has 2 rows: {draws}", "1 row in both files: equal"
    ]  # fmt: skip
    assert command.run(RIG, small, large) == 0  # the draws were not to be played here
    monkeypatch.setattr(drawn_runs, "COUNT", 0)
    assert command.run(RIG, small, large) == 1  # and now there are none any more
    assert "only the other file has 2 rows: draw 1 " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("study", "said"),
    [({"drawn": 1}, "holds rows of another study"), ({"digests": 1, "computer": "elsewhere"}, "another computer")],
)
def test_what_cannot_be_compared_is_refused_in_one_line(
    tmp_path: pathlib.Path, study: dict[str, Any], said: str
) -> None:
    RowsFile(tmp_path / "other", study)
    with pytest.raises(ScenarioError, match=said) as refused:
        command.run(RIG, tmp_path / "file", tmp_path / "other")
    assert len(refused.value.findings) == 1
    assert not (tmp_path / "file").exists()
