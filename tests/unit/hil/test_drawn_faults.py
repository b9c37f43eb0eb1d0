"""Drawn pairs of faults: what is drawn, the file that replays a draw, and the oracle on runs made up for it."""

from __future__ import annotations

import pathlib
import warnings

import numpy as np
import numpy.typing as npt
import pytest

from hil.cli import draw as command
from hil.faults.drawn import courses, draw_file, kinds, oracle
from hil.faults.drawn.draw import LONG_SECONDS, Draw, DrawnRig, PartFault, block_of, pair_of
from hil.faults.drawn.play import Branch
from hil.faults.drawn.watch import ROW
from hil.faults.lockstep_run import KILLED_S
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from rigctl.model.states import Mode
from tests.builders.paths import ROOT

Rows = npt.NDArray[np.void]
RIG = DrawnRig(6.0, None, 300.0, limits=True)
SECONDS, FROM_S = 10.0, 2.0
PERIODS, FROM = 10_000, 2_000


def a_draw(course: str = "hold", **changes: object) -> Draw:
    values = {
        "seed": 1, "index": 7, "rig": RIG, "course": course, "faults": (PartFault("cell_stuck", 1.0, FROM_S),),
        "then": "nothing", "then_after_s": 1.0, "seconds": SECONDS, **changes,
    }  # fmt: skip
    return Draw(**values)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def settings() -> RigSettings:
    return RIG.settings(rig_file.load(ROOT / "config/paper_rig.yaml"))


def rows_in(mode: Mode, periods: int = PERIODS) -> Rows:
    rows = np.zeros(periods, ROW)
    rows["t_ns"] = np.arange(periods) * 1_000_000
    rows["tension_n"] = rows["cell_n"] = 300.0
    rows["mode"], rows["powered"] = mode, mode is not Mode.DISARMED
    rows["braked"] = mode is Mode.DISARMED
    return rows


def moved(rows: Rows, mm_s: float, *, shown_by_encoder: bool, shown_by_cell: bool) -> Rows:
    """The rows with a stroke that moves from the fault on."""
    way_mm = mm_s * np.maximum(np.arange(len(rows)) - FROM, 0) * 1e-3
    rows["stroke_mm"] += way_mm
    rows["tension_n"] += 6.0 * way_mm
    if shown_by_encoder:
        rows["position_mm"] += way_mm
        rows["speed_mm_s"] += mm_s * (way_mm != 0.0)
        rows["command_mm_s"] += mm_s * (way_mm != 0.0)
    if shown_by_cell:
        rows["cell_n"] += 6.0 * way_mm
    return rows


def verdict(settings: RigSettings, rows: Rows, twin: Rows, killed_at: int | None = None) -> oracle.DrawVerdict:
    return oracle.judge(a_draw(), settings, Branch(rows, killed_at, ()), twin)


# -- what is drawn --------------------------------------------------------------------------------------------------
def test_a_number_is_the_same_draw_every_time_and_within_the_ranges(settings: RigSettings) -> None:
    rig, _, _, course = block_of(settings, 3, 1)
    assert (rig, course) == (block_of(settings, 3, 1)[0], courses.COURSES[1].name)
    for index in range(200):
        draw = pair_of(3, index, rig, course)
        assert draw == pair_of(3, index, rig, course)
        assert len(draw.faults) == 2
        assert draw.faults[1].at_s - draw.faults[0].at_s < draw.seconds <= LONG_SECONDS[1]
        for fault in draw.faults:
            kind = kinds.BY_NAME[fault.kind]
            assert 0.999 * kind.low <= abs(fault.size) <= 1.001 * kind.high
            assert kind.signed or fault.size > 0.0


def test_a_rig_without_limits_is_written_without_a_warning() -> None:
    """Of pydantic, on a list that is something else: its text came up on the terminal of every draw."""
    rig = DrawnRig(6.0, None, 300.0, limits=False).settings(rig_file.load(ROOT / "config/paper_rig.yaml"))
    with warnings.catch_warnings(action="error"):
        assert rig.model_dump(mode="json")["limits"] == []


def test_every_part_and_every_course_is_drawn() -> None:
    drawn = {kinds.BY_NAME[fault.kind].part for i in range(200) for fault in pair_of(1, i, RIG, "hold").faults}
    assert drawn == set(kinds.PARTS) == {"cell", "encoder", "drive", "bus", "brake", "rope", "process"}
    assert {step.mode for course in courses.COURSES for step in course.steps} >= {Mode.DISARMED, Mode.COMPENSATING}


# -- the file -------------------------------------------------------------------------------------------------------
def test_a_file_gives_the_draw_that_was_written(tmp_path: pathlib.Path) -> None:
    draw = pair_of(5, 11, RIG, "response")
    draw_file.write(tmp_path / "draw.yaml", draw, ("the load was 40 N off",))
    assert draw_file.read(tmp_path / "draw.yaml") == draw


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("kind: cell_stuck", "kind: cell_gone", "faults.0.kind"),
        ("course: hold", "course: flying", "course"),
        ("seconds: 10.0", "seconds: -1", "seconds"),
        ("then: nothing", "than: nothing", "than"),
    ],
)
def test_a_file_that_is_no_draw_is_refused(tmp_path: pathlib.Path, old: str, new: str, said: str) -> None:
    file = tmp_path / "draw.yaml"
    draw_file.write(file, a_draw(), ())
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(ScenarioError, match=said) as refused:
        draw_file.read(file)
    assert refused.value.exit_code == 2


def test_rows_are_those_of_the_rig_file_wherever_it_is(settings: RigSettings) -> None:
    moved_file = settings.model_copy(update={"directory": "elsewhere"})
    assert command.study_of(moved_file, 1) == command.study_of(settings, 1) != command.study_of(settings, 2)


# -- the oracle -----------------------------------------------------------------------------------------------------
def test_a_load_that_stays_is_within_the_bound(settings: RigSettings) -> None:
    found = verdict(settings, rows_in(Mode.HOLD), rows_in(Mode.HOLD))
    assert (found.findings, found.seen_s) == ((), None)


def test_a_load_that_moves_once_the_frames_show_it_is_found(settings: RigSettings) -> None:
    """0.4 mm/s in HOLD: 0.02 mm are seen after 50 ms, and 1.5 mm (3 %) are exceeded within 4.5 s."""
    rows = moved(rows_in(Mode.HOLD), 0.4, shown_by_encoder=True, shown_by_cell=True)
    found = verdict(settings, rows, rows_in(Mode.HOLD))
    assert "seen, and the load moved by" in found.findings[0]
    assert found.seen_s == pytest.approx(FROM_S + 0.05, abs=0.005)


def test_in_place_the_cell_alone_shows_it(settings: RigSettings) -> None:
    rows = moved(rows_in(Mode.HOLD), 0.4, shown_by_encoder=False, shown_by_cell=True)
    assert "seen, and" in verdict(settings, rows, rows_in(Mode.HOLD)).findings[0]


def test_what_no_frame_shows_may_move_the_load_by_the_cap_alone(settings: RigSettings) -> None:
    for speed_mm_s, beyond in ((0.5, False), (0.8, True)):  # 24 N and 38 N, cap 30 N
        rows = moved(rows_in(Mode.HOLD), speed_mm_s, shown_by_encoder=False, shown_by_cell=False)
        found = verdict(settings, rows, rows_in(Mode.HOLD))
        assert found.seen_s is None
        assert bool(found.findings) is beyond


def test_a_payload_could_have_moved_a_stroke_that_follows_the_cell(settings: RigSettings) -> None:
    """The cell drifts, the law follows: frames as of a rig whose payload moves by 0.5 mm/s, so the cap counts."""
    rows = moved(rows_in(Mode.COMPENSATING), 0.5, shown_by_encoder=True, shown_by_cell=False)
    found = verdict(settings, rows, rows_in(Mode.COMPENSATING))
    assert (found.seen_s, found.findings) == (None, ())
    rows = moved(rows_in(Mode.COMPENSATING), 0.8, shown_by_encoder=True, shown_by_cell=False)
    assert "expected at most 30.0" in verdict(settings, rows, rows_in(Mode.COMPENSATING)).findings[0]


def test_a_payload_is_not_faster_than_the_rig_files_limits(settings: RigSettings) -> None:
    rows = moved(rows_in(Mode.COMPENSATING), 9.0, shown_by_encoder=True, shown_by_cell=False)
    assert verdict(settings, rows, rows_in(Mode.COMPENSATING)).seen_s == pytest.approx(FROM_S, abs=0.16)


def test_a_drive_that_does_not_follow_its_commands_is_seen(settings: RigSettings) -> None:
    rows = moved(rows_in(Mode.COMPENSATING), 2.0, shown_by_encoder=True, shown_by_cell=True)
    rows["command_mm_s"] = 0.0
    assert verdict(settings, rows, rows_in(Mode.COMPENSATING)).seen_s == pytest.approx(FROM_S, abs=0.1)


def test_a_brake_that_gives_way_has_to_be_reported(settings: RigSettings) -> None:
    rows = moved(rows_in(Mode.DISARMED), -0.4, shown_by_encoder=True, shown_by_cell=True)
    assert "gave way" in verdict(settings, rows, rows_in(Mode.DISARMED)).findings[0]
    rows["mode"][FROM + 300 :] = Mode.FAULT
    assert verdict(settings, rows, rows_in(Mode.DISARMED)).findings == ()


def test_a_cell_that_repeats_itself_or_has_more_noise_is_seen_in_every_mode(settings: RigSettings) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.03, PERIODS)
    twin = rows_in(Mode.COMPENSATING)
    twin["cell_n"] += noise
    stuck, noisy = twin.copy(), twin.copy()
    stuck["cell_n"][FROM:] = stuck["cell_n"][FROM]
    noisy["cell_n"][FROM:] += 4.0 * noise[FROM:]
    assert verdict(settings, twin, twin).seen_s is None
    assert verdict(settings, stuck, twin).seen_s == pytest.approx(FROM_S + 0.02, abs=0.002)
    assert verdict(settings, noisy, twin).seen_s == pytest.approx(FROM_S, abs=0.1)


def test_a_drive_that_falls_behind_its_commands_is_seen_however_slowly(settings: RigSettings) -> None:
    """0.5 mm/s less than commanded: no speed limit shows it, 0.3 mm in a second do."""
    rows = moved(rows_in(Mode.COMPENSATING), 0.5, shown_by_encoder=True, shown_by_cell=True)
    rows["command_mm_s"] = 0.0
    assert verdict(settings, rows, rows_in(Mode.COMPENSATING)).seen_s == pytest.approx(FROM_S + 0.6, abs=0.05)


def test_what_was_seen_counts_until_the_next_fault_begins(settings: RigSettings) -> None:
    """One silent moment of the cell, then frames as they should be: the load may not move by more than 9 N."""
    rows = moved(rows_in(Mode.HOLD), 0.4, shown_by_encoder=False, shown_by_cell=False)
    rows["cell_age"][FROM : FROM + 10] = np.arange(10)
    assert "seen, and the load moved" in verdict(settings, rows, rows_in(Mode.HOLD)).findings[0]
    faults = (PartFault("frames_gone", 0.01, FROM_S), PartFault("cell_frozen", 0.02, FROM_S + 2.0))
    draw = a_draw(faults=faults)
    found = oracle.judge(draw, settings, Branch(rows, None, ()), rows_in(Mode.HOLD))
    assert found.findings == (), "4.8 N while the first is seen; the second cannot be seen"


def test_the_keeping_modes_share_one_allowance_with_what_went_before(settings: RigSettings) -> None:
    """6 N off in COMPENSATING, and 2 N in each of three modes that keep the stroke: 12 N in all, where 9 N are."""
    rows = rows_in(Mode.COMPENSATING)
    rows["cell_age"][FROM:] = 9
    for row, mode, n in ((3000, None, 6.0), (4000, Mode.FAULT, 0.0), (5000, None, 2.0), (6000, Mode.HOLD, 0.0),
                         (7000, None, 2.0), (8000, Mode.FAULT, 0.0), (9000, None, 2.0)):  # fmt: skip
        if mode is not None:
            rows["mode"][row:] = mode
        rows["tension_n"][row:] += n
        rows["stroke_mm"][row:] += n / 6.0
    found = verdict(settings, rows, rows_in(Mode.COMPENSATING))
    assert found.moved_n == pytest.approx(12.0, rel=0.01)
    assert found.unseen_n == pytest.approx(12.0, rel=0.01)


@pytest.mark.parametrize(("mode", "moved_n"), [(Mode.COMPENSATING, 0.0), (Mode.FAULT, 12.0)])
def test_only_a_law_may_bring_a_load_back(settings: RigSettings, mode: Mode, moved_n: float) -> None:
    """The rope has given 2 mm at once; it is 0 again within 2 s."""
    rows = moved(rows_in(mode), 0.0, shown_by_encoder=False, shown_by_cell=False)
    way_mm = np.interp(np.arange(PERIODS), [FROM, FROM + 1, 5_000, 7_000], [0.0, -2.0, -2.0, 0.0])
    rows["tension_n"] += 6.0 * way_mm
    rows["stroke_mm"] += way_mm
    rows["cell_age"][FROM:] = 9
    assert verdict(settings, rows, rows_in(mode)).moved_n == pytest.approx(moved_n, rel=0.01)


@pytest.mark.parametrize(("stops", "findings"), [(True, 1), (False, 0)])
def test_a_load_that_only_the_death_of_the_loop_stops_is_found(
    settings: RigSettings, stops: bool, findings: int
) -> None:
    """0.2 mm/s in COMPENSATING are below every other bound; afterwards the drive stops by itself, or it does not."""
    killed_at = FROM + 3_000
    rows = moved(rows_in(Mode.COMPENSATING), 0.2, shown_by_encoder=False, shown_by_cell=False)
    rows = rows[: killed_at + round(KILLED_S * 1e3)]
    if stops:
        rows["stroke_mm"][killed_at:] = rows["stroke_mm"][killed_at]
    found = verdict(settings, rows, rows_in(Mode.COMPENSATING), killed_at)
    assert len([line for line in found.findings if "death of the loop" in line]) == findings
