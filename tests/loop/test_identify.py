"""Identification on the simulated rig with its known truth: within the stated error, bounded, ended by any event."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.commission import proposal
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import STEP_N, STRAY_N, UNFELT_N
from rigctl.control.law.tension import Gains
from rigctl.model.faults import Fault
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations import calibration_findings as findings
from tests.builders.paths import ROOT
from tests.builders.random_plants import KEYS, identify_all, plants
from tests.loop.test_trials import cell_reads, give

Enter = Callable[[Mode], None]
LIMIT_S = 9.5  # within the records that any rig file keeps


def with_drive(settings: RigSettings, **drive: float) -> RigSettings:
    simulation = settings.simulation
    assert simulation is not None
    changed = simulation.model_copy(update={"drive": simulation.drive.model_copy(update=drive)})
    return settings.model_copy(update={"simulation": changed})


def excite(rig: Lockstep) -> npt.NDArray[Any]:
    """Identify, and return the records of that time."""
    rig.read_records()
    assert rig.command(Verb.IDENTIFY, limit_s=LIMIT_S) is Refusal.NONE
    records = rig.read_records()
    found: npt.NDArray[Any] = records[records["t_ns"] > rig.reply["t_ns"] - round(float(rig.reply["duration_s"]) * 1e9)]
    return found


def found(rig: Lockstep, records: npt.NDArray[Any]) -> dict[str, Any]:
    rows = proposal.rows(proposal.signals_of(records, 1e-3), rig.settings)
    return {row["key"]: row["found"] for row in rows}


@pytest.fixture
def held(rig: Lockstep, enter: Enter) -> Iterator[Lockstep]:
    """A rig in HOLD with 300 N on the rope."""
    enter(Mode.COMPENSATING)
    assert rig.command(Verb.HOLD) is Refusal.NONE
    rig.run(1.0)
    yield rig


def test_the_documentation_shows_the_rows_it_finds(held: Lockstep) -> None:
    page = (ROOT / "docs/commission.md").read_text()
    shown = page.split("$ rigctl identify --in tension\n")[1].split("nothing was changed")[0]
    labels = [line.strip().split("  ")[0] for line in shown.splitlines()[1:]]
    assert labels == list(found(held, excite(held)))


def test_under_tension_it_finds_the_plant_as_it_is(held: Lockstep) -> None:
    before = held.rig.truth
    records = excite(held)
    truth, plant = found(held, records), held.settings.plant
    assert truth["plant.cylinder_lag_s"] == pytest.approx(plant.cylinder_lag_s, abs=0.2e-3)
    assert truth["plant.command_delay_s"] == pytest.approx(plant.command_delay_s, abs=0.2e-3)
    # The frames take 0.1 ms, and the drive's speed is the mean over its last millisecond.
    assert truth["age of the drive's speed"] == pytest.approx(0.6e-3, abs=0.1e-3)
    # The screw's ripple of 0.003 mm is up to 0.8 % of this stroke.
    assert truth["stiffness"] == pytest.approx(plant.stiffness_n_mm, rel=0.01)
    assert truth["plant.spring_n_mm"] == pytest.approx(6.0, rel=0.01)
    assert truth["tension_cell.noise_n"] == pytest.approx(held.settings.tension_cell.noise_n, rel=0.2)
    assert truth["backlash"] == pytest.approx(0.0, abs=0.005)  # the load seats the nut
    assert truth["drive speed / command"] == pytest.approx(1.0, abs=0.002)
    drive = held.settings.simulation.drive  # type: ignore[union-attr]
    # The current's unit is 1.5 N, and 5 N of tension pass in a step of 0.25 s.
    assert truth["cylinder.force_per_ampere_n"] == pytest.approx(drive.force_n_a, rel=0.005)
    assert truth["friction of the cylinder"] == pytest.approx(drive.friction_n, abs=2.0)
    assert held.loop.machine.mode is Mode.HOLD
    assert held.rig.truth.stroke_mm == pytest.approx(before.stroke_mm, abs=0.01)
    assert np.ptp(records["stroke_mm"]) < 1.0
    assert np.ptp(records["tension_n"]) < STEP_N


@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.01, 0.004), (0.03, 0.002)])
def test_a_drive_that_is_not_the_files_is_seen(
    settings: RigSettings, gains: Gains, lag_s: float, delay_s: float
) -> None:
    true = settings.model_copy(
        update={"plant": settings.plant.model_copy(update={"cylinder_lag_s": lag_s, "command_delay_s": delay_s})}
    )
    with lockstep(true, gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rows = proposal.rows(proposal.signals_of(excite(rig), 1e-3), settings)
    truth = {row["key"]: row["found"] for row in rows}
    assert truth["plant.cylinder_lag_s"] == pytest.approx(lag_s, abs=0.5e-3)
    assert truth["plant.command_delay_s"] == pytest.approx(delay_s, abs=0.2e-3)
    assert truth["stiffness"] is None  # a slack rope does not show the stiffness


@pytest.mark.parametrize(("force_n_a", "friction_n", "status_hz"), [(400.0, 0.0, 20), (650.0, 120.0, 50)])
def test_a_motor_that_is_not_the_files_is_seen(
    settings: RigSettings, gains: Gains, force_n_a: float, friction_n: float, status_hz: int
) -> None:
    cylinder = settings.cylinder.model_copy(update={"force_per_ampere_n": None, "status_rate_hz": status_hz})
    other = with_drive(settings, force_n_a=force_n_a, friction_n=friction_n).model_copy(update={"cylinder": cylinder})
    with lockstep(other, gains) as rig:
        rig.rig.plant.preload(250.0)
        rig.run(0.5)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.5)
        rows = {row["key"]: row for row in proposal.rows(proposal.signals_of(excite(rig), 1e-3), other)}
    force, friction = rows["cylinder.force_per_ampere_n"], rows["friction of the cylinder"]
    assert abs(force["found"] - force_n_a) < force["error"] < 0.01 * force_n_a
    assert abs(friction["found"] - friction_n) < friction["error"] < 5.0
    assert force["before"] is None


@pytest.mark.parametrize(
    ("status_rate_hz", "tension_n", "why"),
    [
        (None, 250.0, "the drive is not asked for its current"),
        (5, 250.0, "the current is not known at the end of steps"),
        (20, 0.0, "the rope is slack"),
    ],
)
def test_without_a_current_that_carries_a_load_no_factor_is_proposed(
    settings: RigSettings, gains: Gains, status_rate_hz: int | None, tension_n: float, why: str
) -> None:
    with lockstep(settings, gains) as rig:
        if tension_n:
            rig.rig.plant.preload(tension_n)
        rig.run(0.5)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.5)
        signals = proposal.signals_of(excite(rig), 1e-3)
    cylinder = settings.cylinder.model_copy(update={"status_rate_hz": status_rate_hz})
    rows = {row["key"]: row for row in proposal.rows(signals, settings.model_copy(update={"cylinder": cylinder}))}
    for key in ("cylinder.force_per_ampere_n", "friction of the cylinder"):
        assert rows[key]["found"] is None
        assert rows[key]["why"].startswith(why)


def test_a_play_that_the_load_does_not_seat_is_found(settings: RigSettings, gains: Gains) -> None:
    with lockstep(with_drive(settings, backlash_mm=0.3), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        while rig.loop.inbox.cell.tension_n < 9.5:
            rig.loop.tick()
        assert rig.command(Verb.HOLD) is Refusal.NONE
        rig.run(1.0)
        truth = found(rig, excite(rig))
    assert truth["backlash"] == pytest.approx(0.3, abs=0.02)
    assert truth["stiffness"] == pytest.approx(settings.plant.stiffness_n_mm, rel=0.02)


@pytest.mark.parametrize(
    "what",
    ["hold", "trip", "load", *(pytest.param(one, marks=pytest.mark.long) for one in ("tension", "disarm", "stop"))],
)
def test_anything_ends_it_within_a_tick_and_the_stroke_is_held(held: Lockstep, what: str) -> None:
    before = held.rig.truth.stroke_mm
    give(held, Verb.IDENTIFY)
    while abs(held.loop.inbox.drive.speed_mm_s) < 2.0:
        held.loop.tick()
    verbs = {"hold": Verb.HOLD, "tension": Verb.TENSION, "disarm": Verb.DISARM}
    if what in verbs:
        give(held, verbs[what])
    elif what == "trip":
        held.rig.receive(b"\0\0\0\0\2\0\0\0\2" + bytes([held.settings.tension_cell.node]) + bytes(6))
        held.run(0.02)
    elif what == "stop":
        held.loop.stop_requested = True
    else:
        cell_reads(held, lambda n: n + 16.0)
    records = held.run(0.005)
    assert held.view.trial is None
    reply = held._replies.read()[0]
    assert reply["reason"] == (Refusal.STRAYED if what == "load" else Refusal.ABORTED)
    if what != "tension":
        assert records["command_mm_s"][-1] == 0.0
        held.run(0.3)
        assert held.rig.truth.stroke_mm == pytest.approx(before, abs=1.0)
        assert held.rig.truth.speed_mm_s == pytest.approx(0.0, abs=1e-6)
    assert (held.loop.machine.fault is Fault.NONE) == (what != "trip")


@pytest.mark.parametrize("rig", [mode for mode in Mode if mode not in (Mode.HOLD, Mode.FAULT)], indirect=["rig"])
def test_only_a_held_stroke_is_excited(rig: Lockstep) -> None:
    assert rig.command(Verb.IDENTIFY) is Refusal.WRONG_MODE


@pytest.mark.starts_in(Mode.HOLD)
def test_where_a_tight_rope_is_asked_for_a_slack_one_is_refused(rig: Lockstep) -> None:
    assert rig.command(Verb.IDENTIFY, 1.0) is Refusal.SLACK


@pytest.mark.parametrize("ends", [(-1.0, 0.7), (0.1, 100.0)])
def test_it_does_not_begin_where_the_stroke_would_end(
    settings: RigSettings, gains: Gains, ends: tuple[float, float]
) -> None:
    cylinder = settings.cylinder.model_copy(update={"stroke_min_mm": ends[0], "stroke_max_mm": ends[1]})
    with lockstep(settings.model_copy(update={"cylinder": cylinder}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM, 1.0) is Refusal.NONE  # away from an end
        assert rig.command(Verb.IDENTIFY) is Refusal.STRAYED
        assert np.ptp(rig.run(1.0)["stroke_mm"]) == 0.0


def test_it_does_not_begin_where_the_tension_would_trip(settings: RigSettings, gains: Gains) -> None:
    with tight(settings, gains, settings.safety.tension_high_n - STRAY_N + 1.0) as rig:
        assert rig.command(Verb.IDENTIFY) is Refusal.STRAYED
        assert np.ptp(rig.run(1.0)["stroke_mm"]) == 0.0


@contextlib.contextmanager
def tight(settings: RigSettings, gains: Gains, tension_n: float, stiffness_n_mm: float = 6.0) -> Iterator[Lockstep]:
    """HOLD with this tension on a rig of this stiffness, which the rig file does not have."""
    simulation = settings.simulation
    assert simulation is not None
    scale = {"stiffness_scale": stiffness_n_mm / settings.plant.stiffness_n_mm, "step_us": 50}
    with lockstep(settings.model_copy(update={"simulation": simulation.model_copy(update=scale)}), gains) as rig:
        rig.rig.plant.preload(tension_n)
        rig.run(0.3)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.2)
        yield rig


@pytest.mark.parametrize("stiffness_n_mm", [200.0, 2000.0])
def test_a_rope_far_stiffer_than_the_file_says_is_not_pulled_by_more_than_a_step(
    settings: RigSettings, gains: Gains, stiffness_n_mm: float
) -> None:
    with tight(settings, gains, 300.0, stiffness_n_mm) as rig:
        records = excite(rig)
        rows = {row["key"]: row for row in proposal.rows(proposal.signals_of(records, 1e-3), settings)}
    assert np.ptp(records["tension_n"]) < STRAY_N
    assert abs(rows["stiffness"]["found"] - stiffness_n_mm) <= rows["stiffness"]["error"]
    lag = rows["plant.cylinder_lag_s"]  # a stroke of a few units of the drive's position hardly shows it
    if lag["found"] is None:
        assert lag["why"].startswith("too uncertain: ")
    else:
        assert stiffness_n_mm == 200.0
        assert abs(lag["found"] - settings.plant.cylinder_lag_s) <= lag["error"]


def test_a_cell_that_is_stuck_does_not_have_a_stiff_rope_pulled(settings: RigSettings, gains: Gains) -> None:
    plant = settings.plant.model_copy(update={"spring_n_mm": None})  # the rig file says so too: 1000 N/mm
    with tight(settings.model_copy(update={"plant": plant}), gains, 250.0, 1000.0) as rig:
        dither = itertools.cycle((0.0, 0.02))  # a sensor that repeats one value is detected at once
        cell_reads(rig, lambda _n: 250.0 + next(dither))
        before = rig.rig.truth.tension_n
        records = excite(rig)
        rows = {row["key"]: row for row in proposal.rows(proposal.signals_of(records, 1e-3), rig.settings)}
        assert rig.rig.truth.tension_n == pytest.approx(before, abs=2.0)
    reach_mm = np.ptp(records["stroke_mm"])
    assert reach_mm * 1000.0 < UNFELT_N * 1.1
    assert rows["stiffness"]["found"] is None


def test_a_payload_that_is_bumped_makes_it_uncertain_and_not_wrong(settings: RigSettings, gains: Gains) -> None:
    with tight(settings, gains, 300.0) as rig:
        give(rig, Verb.IDENTIFY)
        parts = [rig.run(4.5)]
        start = rig.clock.now()
        cell_reads(rig, lambda n: n + 3.0 * math.exp((start - rig.clock.now()) / 3e8))
        while rig.view.trial is not None:
            parts.append(rig.run(0.001))
        records = np.concatenate(parts)
        rows = {row["key"]: row for row in proposal.rows(proposal.signals_of(records, 1e-3), settings)}
    stiffness = rows["stiffness"]
    assert stiffness["found"] is None or abs(stiffness["found"] - 6.0) <= stiffness["error"]
    assert stiffness["found"] is None or stiffness["error"] > 0.1


@pytest.mark.long
def test_twenty_random_plants_are_found_within_what_is_stated_on_a_busy_computer() -> None:
    """Over plants that differ from the rig file, with pauses of the loop; `tests.bench coverage` draws more of them."""
    results = identify_all(plants(seed=1, count=20), gap_s=2.5)
    found = [result for result in results if not result.refused]
    assert len(found) >= 16
    assert all("had the loop skip ticks in" in result.refused for result in results if result.refused)
    for result in found:
        assert abs(result.off("stiffness")) <= 0.01 * result.plant.stiffness
        assert abs(result.off("lag")) <= 0.1 * result.plant.lag
        assert abs(result.off("delay")) <= 1e-3
        assert result.span_n < STRAY_N
    inside = [result.inside(name) for result in found for name in KEYS]
    assert np.mean(inside) >= 0.87  # of 95 %: of 100 figures fewer come less than once in a thousand times


def test_the_answer_and_the_ledger_say_how_many_repetitions_were_left_out(held: Lockstep) -> None:
    missed = [1.5, 3.3]  # s: in the feelers, which are not fitted, and in a repetition

    def miss() -> None:
        if missed and held.clock.now() - start_ns >= missed[0] * 1e9:
            missed.pop(0)
            held.clock.skip = 3

    start_ns, held.on_advance = held.clock.now(), miss
    request = Request(Verb.IDENTIFY, "kim")
    found = findings.identify(held.settings, request, excite(held), 0)
    kept = found.entry.figures["repetitions"]
    assert found.entry.figures["left_out"] == 1
    assert kept >= 6
    assert found.text.endswith(f"1 of {kept + 1} repetitions, in which the loop skipped ticks, left out")


def test_what_cannot_be_told_is_not_told() -> None:
    """Stiff ropes, slack ropes, nuts that the load does not seat: no reported figure is wrong."""
    results = identify_all(plants(seed=2, count=8, wide=True))
    told = [(result, name) for result in results for name in KEYS if result.told(name)]
    assert sum(result.inside(name) for result, name in told) >= 0.85 * len(told)  # as above, of 40
    assert all(abs(result.off(name)) <= 2.5 * result.rows[name]["error"] for result, name in told)
    for result in results:
        assert all(row["why"] for row in result.rows.values() if row["found"] is None)
        assert result.told("lag") or not result.plant.slack
        assert result.span_n < 2.0 * STRAY_N
