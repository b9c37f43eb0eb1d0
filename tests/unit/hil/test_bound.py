"""The bound on any linear law: closed forms, simulations of the same loop, and our law, which is never below it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from hil.scenario.errors import ScenarioError
from hil.studies.cli import compare_tuned
from hil.studies.compare.bound import bound_tables, program, study
from hil.studies.compare.bound.linear_law import (
    Disturbance,
    Inclination,
    NoBoundError,
    StrokeAnswer,
    Tone,
    basis,
    law_of,
)
from hil.studies.compare.bound.nominal import TONES
from hil.studies.compare.bound.program import Task
from hil.studies.compare.bound.study import BoundRow, Joint, Ours
from hil.studies.compare.equal_limits import Known
from hil.studies.compare.tuned_laws import TunedLaw
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.control.law.estimator import filter_model
from rigctl.design import plant_family
from rigctl.design.closed_loop import closed_loop
from rigctl.design.gains import OPEN, design
from rigctl.design.knobs import knobs_for, value_of
from rigctl.design.margins import controllers
from rigctl.design.optimise import Limits
from rigctl.design.plant_family import Array, Member
from tests.builders.daemons import PAPER
from tests.builders.paths import ROOT
from tests.builders.rig_bench import SETTINGS

WIDE = Limits(100.0, 1e6, 1e6)
RATE_HZ = 1000.0
GAIN, DELAY = 0.006, 2  # N per mm/s and tick, ticks


def integrator(delay: int = DELAY) -> Member:
    """Tension is the sum of commands, ``delay`` ticks late; a disturbance of 1 mm/s in a tick moves it by GAIN."""
    return Member(
        None, 1.0, 1.0, np.diag([1.0, 0.0]), np.array([GAIN, 1.0]), np.array([GAIN, 0.0]), delay, (),
        np.array([1.0, 0.0]),
    )  # fmt: skip


def kick(plant: Member, newtons: float, ticks: int) -> Disturbance:
    speed = np.zeros(ticks + 1)
    speed[0] = newtons / GAIN
    return Disturbance.of(plant, speed, first=1)


def task(plant: Member, noise_n: float, limits: Limits = WIDE, memory: int = 300) -> Task:
    return Task(StrokeAnswer.of(plant), noise_n, limits, memory, RATE_HZ)


@pytest.mark.parametrize("noise_n", [0.0, 0.03, 0.3])
@pytest.mark.parametrize("delay", [0, 2])
def test_the_bound_of_a_random_walk_behind_a_delay_is_that_of_the_kalman_filter(noise_n: float, delay: int) -> None:
    """A kick in one of M ticks is a walk of variance q = size^2 / M in each. A sample of tick n is answered in the
    command of tick n + 1, and moves the tension delay + 1 ticks later: the least variance is that of the filtered
    tension (scalar Riccati equation) and delay + 2 steps of the walk; without noise it is Astrom's (1970)."""
    ticks, size = 400, 1.0
    plant = integrator(delay)
    q, r = size**2 / ticks, noise_n**2
    before = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    expected = math.sqrt(before - q + (delay + 2) * q)
    found = program.least(task(plant, noise_n), kick(plant, size, ticks)).value
    assert found == pytest.approx(expected, rel=2e-4)
    assert found > expected * (1.0 - 1e-5)


def test_limits_of_s_and_of_noise_are_kept_and_cost_error() -> None:
    plant = integrator()
    case = kick(plant, 1.0, 400)
    free = program.least(task(plant, 0.03), case)
    for limits in (Limits(1.2, 1e6, 1e6), Limits(100.0, 0.3, 1e6), Limits(100.0, 1e6, 0.3)):
        there = task(plant, 0.03, limits)
        kept = program.least(there, case)
        noise, steps = program.command_noise(there, kept.x)
        assert kept.ms < 1.03 * limits.ms  # between the points of its grid
        assert noise < limits.command_noise_mm_s * 1.0001
        assert steps < limits.step_mm_s * 1.0001
        assert kept.value > 1.005 * free.value
    with pytest.raises(NoBoundError, match="no bound: the convex program ended infeasible"):
        program.least(task(plant, 0.03, Limits(0.9, 1e6, 1e6)), case)


def proportional(gain: float, ticks: int) -> Array:
    """Command after a step of the cell's tension of 1 N with the loop closed on the integrator, tick by tick."""
    stroke, sent, found = 0.0, [0.0] * DELAY, np.zeros(ticks)
    for tick in range(ticks):
        found[tick] = -gain * (1.0 + GAIN * stroke)
        sent.append(found[tick])
        stroke += sent.pop(0) if tick else 0.0
    return found


def test_no_proportional_law_within_the_limits_is_below_the_bound() -> None:
    plant, limits = integrator(), Limits(1.5, 1e6, 1e6)
    there = task(plant, 0.03, limits)
    case = kick(plant, 1.0, 400)
    bound, kept = program.least(there, case).value, 0
    for gain in np.geomspace(1.0, 60.0, 25):
        x = proportional(float(gain), 2000)
        if abs(x[-1]) < 1e-9 and program.peak(there, x) <= limits.ms:
            kept += 1
            assert program.errors(there, case, x).rms_n > bound
    assert kept > 10


def test_a_jolt_is_answered_at_full_speed_at_best() -> None:
    plant, ticks, size, speed = integrator(), 400, 1.0, 2.0
    late = DELAY + 2
    ramp = np.maximum(size - GAIN * speed * np.maximum(np.arange(1, ticks + 1) - late, 0), 0.0)
    found = program.least_jolt(task(plant, 0.03), kick(plant, size, ticks), speed, 1e9)
    assert found == pytest.approx(float(np.sqrt(np.mean(ramp**2))), rel=1e-3)
    assert program.least_jolt(task(plant, 0.03), kick(plant, size, ticks), speed, 50.0) > 1.01 * found


def rig() -> tuple[Member, dict[str, Array], Task]:
    settings = Known.of(SETTINGS).settings
    plant, laws = plant_family.nominal(settings), controllers(filter_model(settings), design(settings))
    there = Task(StrokeAnswer.of(plant), settings.tension_cell.noise_n, Limits.of(settings), 400, RATE_HZ)
    return plant, {name: law_of(plant, law, 4000) for name, law in laws.items()}, there


def swing(seconds: float = 4.0) -> Array:
    """Speed of a stretch like that of the paper's move."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.asarray(0.08 * np.cos(2.0 * math.pi * 0.58 * np.maximum(t - 1.0, 0.0)))


def test_a_law_makes_of_a_disturbance_what_the_closed_loop_makes_of_it() -> None:
    settings = Known.of(SETTINGS).settings
    plant, laws, there = rig()
    loop = closed_loop(plant, controllers(filter_model(settings), design(settings))[OPEN])
    state, error = np.zeros(len(loop.a)), []
    for speed in swing():
        error.append(loop.tension @ state + loop.loss_n_s_mm * speed)
        state = loop.a @ state + loop.b[:, 2] * speed
    a, d = Disturbance.of(plant, swing()).errors(there.answer, laws[OPEN][:, None])
    assert a[:, 0] + d == pytest.approx(np.array(error), abs=1e-6)


def test_a_sine_is_the_disturbance_that_it_becomes() -> None:
    plant, laws, there = rig()
    w = 2.0 * math.pi * 3.0
    t = np.arange(5001) / RATE_HZ
    speed = np.diff(0.05 * np.sin(w * t)) * RATE_HZ
    long = program.errors(there, Disturbance.of(plant, speed, 4000), laws[OPEN])
    tone = program.errors(there, Tone.of(plant, 0.05, 3.0, 1.0 / RATE_HZ), laws[OPEN])
    assert long.disturbed_n == pytest.approx(tone.disturbed_n, rel=1e-3)
    assert long.noise_n == tone.noise_n
    assert tone.largest_n == pytest.approx(math.sqrt(2.0) * tone.disturbed_n)


def test_ours_is_never_below_the_bound() -> None:
    plant, laws, there = rig()
    move = Disturbance.of(plant, swing(), 1000)
    for case in (move, Tone.of(plant, 10.0, 0.1, 1.0 / RATE_HZ), Tone.of(plant, 0.05, 8.0, 1.0 / RATE_HZ)):
        bound = program.least(there, case).value
        for x in laws.values():
            assert program.peak(there, x) <= there.limits.ms  # else the bound would not be its
            assert program.errors(there, case, x).rms_n > bound
    largest = program.least_largest(there, move).value
    errors = [program.errors(there, move, x) for x in laws.values()]
    assert min(each.largest_n + program.SIGMAS * each.noise_n for each in errors) > largest


def test_sines_have_the_bounds_of_an_outside_calculation() -> None:
    """Another author's program, on this plant with 100 ms of memory, the cell's low-pass taken as delay: heave
    0.0033 %, 3 Hz 0.0040 %, and both with 8 Hz by one law at 0.94 of 0.0040, 0.0247 and 0.0569 %."""
    paper = config.load(PAPER)
    late = {"tension_cell.filter_hz": None, "simulation.cell.filter_hz": None,
            "plant.command_delay_s": paper.plant.command_delay_s + paper.tension_cell.late_s}  # fmt: skip
    here = study.NominalPlant(Known.of(changed(paper, late)), (law_of_the_file(), law_of_the_file()))
    tones = [here.tone(name) for name in TONES]
    found = [program.least(here.short, tone).value / 3.0 for tone in tones[:2]]
    assert found == pytest.approx([0.0033, 0.0040], abs=0.00005)
    share = program.least_share(here.short, tones, [3.0 * pct for pct in (0.0040, 0.0247, 0.0569)]).value
    assert share == pytest.approx(0.94, abs=0.005)


def law_of_the_file() -> TunedLaw:
    settings = Known.of(config.load(PAPER)).settings
    values = tuple(float(value_of(settings, knob.key)) for knob in knobs_for(settings))
    return TunedLaw("ours", values, True, 0.0, 1.6, 0.5)


def test_one_law_for_several_sines_is_not_better_at_any_than_their_own_bounds() -> None:
    plant, laws, there = rig()
    there = replace(there, memory=100)
    tones = [Tone.of(plant, amplitude, hz, 1.0 / RATE_HZ) for amplitude, hz in ((0.05, 3.0), (0.05, 8.0))]
    reached = [program.errors(there, tone, laws[OPEN]).rms_n for tone in tones]
    both = program.least_share(there, tones, reached)
    assert both.value < 1.0
    for tone, ours in zip(tones, reached, strict=True):
        error = program.errors(there, tone, both.x).rms_n
        assert error < both.value * ours * 1.001
        assert error > program.least(there, tone).value


def test_an_inclination_lowers_the_bound_by_what_it_is_worth() -> None:
    plant, _, there = rig()
    speed = swing()
    cell = Disturbance.of(plant, speed, 1000)
    stretch = np.cumsum(speed) / RATE_HZ
    bounds = [
        program.least(there, replace(cell, seen=Inclination(stretch, noise_mm, 10))).value
        for noise_mm in (1e-4, 1e-3, 10.0)
    ]
    alone = program.least(there, cell).value
    assert bounds[0] < 0.8 * alone
    assert bounds == sorted(bounds)
    assert bounds[-1] == pytest.approx(alone, rel=1e-3)


def test_the_knots_of_a_long_memory_are_a_law_of_their_own_in_every_tick_at_first() -> None:
    laws = basis(1000)
    assert laws.shape[0] == 1000
    assert laws.shape[1] < 150
    assert np.array_equal(laws[:60, :60], np.eye(60))
    assert laws.sum(axis=1) == pytest.approx(1.0)
    assert np.array_equal(basis(50), np.eye(50))


OURS = Ours(0.006, 0.02, 1.5, 0.3)
ROW = BoundRow("paper_k6", 0.004, 0.015, 0.003, 0.012, OURS, OURS._replace(rms_n=0.0066), 0.007, 0.03)


def shown(*rows: BoundRow) -> str:
    said = StringIO()
    bound_tables.show_bound(SETTINGS, rows, Joint(0.8, 0.9), Console(file=said, width=132))
    return said.getvalue()


def test_table_and_json_have_ours_over_the_bound_and_the_price_of_the_family() -> None:
    words = shown(ROW)
    assert "0.0013 / 0.0050" in words
    assert "1.50" in words  # ours over the bound, tuned for this plant alone
    assert "1.65" in words  # over the family
    assert "1.10" in words  # the price
    assert "1.25 alone, 1.11 over the family" in words
    assert "below" not in words
    found = json.loads(json.dumps(study.document(SETTINGS, [ROW], Joint(0.8, 0.9)), allow_nan=False))
    row = found["rows"]["paper_k6"]
    assert row["bound_rms_pct"] == pytest.approx(100.0 * 0.004 / 300.0)
    assert row["ours_family"]["over_bound"] == pytest.approx(1.65)
    assert row["price_of_the_family"] == pytest.approx(1.1)
    assert found["joint"] == {"alone": 1.25, "family": pytest.approx(1.0 / 0.9)}


def test_ours_below_the_bound_shows_the_bound_to_be_wrong() -> None:
    wrong = ROW._replace(bound_rms_n=0.0061)
    assert wrong.below
    assert not ROW.below
    assert not wrong._replace(name="vertical").below, "the bound of a sine is that of a short memory"
    assert "paper_k6: ours is below the bound" in shown(wrong)


def test_a_row_that_does_not_exist_is_refused() -> None:
    asked = compare_tuned.Asked(["paper_k7"], [], None, None)
    with pytest.raises(ScenarioError, match="paper_k7"):
        compare_tuned.run_bound(ROOT / "config/paper_rig.yaml", asked)
