"""Ms of tuned designs, measured on the simulated rig: no model of the design is in the figure."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from hil.faults.in_controller import MOST_LATE
from hil.runs.rows_file import RowsFile
from hil.studies.compare import equal_limits, peak_hints, random_rigs
from hil.studies.compare.equal_limits import Known, LoopLaw, loop_law, tuning
from hil.studies.compare.identification import true_plant
from hil.studies.compare.measured_ms import measured
from hil.studies.compare.rivals import OURS
from hil.studies.compare.tuned_laws import TunedLaw, knobs_of
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.control.law.tension import Gains
from rigctl.design.knobs import value_of
from rigctl.design.margins import design_and_check, judge
from rigctl.design.plant_family import Family
from tests.builders import linear_plant
from tests.builders.linear_plant import true_sensitivities
from tests.builders.paths import ROOT

RIG = config.load(ROOT / "config/paper_rig.yaml")
SEED, DESIGNS = 1, 5
AGREES = 0.03  # between the measured peak and that of the linear plant: dead band and ripple are in the one alone


@pytest.mark.parametrize(
    ("keener", "about"), [(1.0, 1.276), pytest.param(3.0, 1.322, marks=pytest.mark.long), (20.0, 1.882)]
)
def test_the_measured_peak_is_that_of_the_plant_as_built(keener: float, about: float) -> None:
    """Two ways that share nothing: a running loop with two multisines, and the linear plant with every loss."""
    designed = design_and_check(RIG).gains
    gains = Gains(keener * designed.k_tension, designed.k_speed, designed.k_integral)
    true = judge(RIG, gains, family=Family("true", (true_plant(RIG),))).ms_max
    assert true == pytest.approx(about, abs=0.005)
    peak = measured(RIG, RIG, gains)
    assert peak.error < 0.05
    assert abs(peak.ms - true) < peak.error + AGREES


def test_a_peak_at_one_hertz_on_a_soft_mechanism_is_found() -> None:
    """It is below 1.5 Hz, and the design, for a rigid mechanism, does not have it; limits of the file trip there."""
    soft = {"plant.mechanism_n_mm": 6.0, "simulation.mechanism.vertical_n_mm": 6.0, "limits": []}
    stiff = changed(RIG, {"plant.spring_n_mm": 34.0})
    rig, gains = changed(stiff, soft), design_and_check(stiff).gains
    hz = np.geomspace(0.3, 400.0, 20_000)
    per_tension, per_speed = peak_hints.law_at(rig, gains, 1.0).response(np.exp(2j * np.pi * hz / rig.loop.rate_hz))
    moduli = np.abs(true_sensitivities(linear_plant.true_plant(rig), per_tension, per_speed, hz)).max(axis=0)
    assert float(moduli.max()) == pytest.approx(1.52, abs=0.01)
    peak = measured(rig, rig, gains)
    assert peak.hz == pytest.approx(float(hz[np.argmax(moduli)]), rel=0.02)
    assert peak.ms == pytest.approx(float(moduli.max()), abs=0.01)
    assert peak.error < 0.005


def test_ticks_that_wake_late_are_within_the_delays_that_the_design_allows_for() -> None:
    """Each wakes late by another time, up to the most that leaves its work within its period."""
    late_ms = MOST_LATE * 1e-6 * RIG.loop.period_ns
    assert 2.0 * RIG.design.identified_delay_ms >= late_ms, "about its middle, the delay found by identification"
    simulation = RIG.simulation
    assert simulation is not None
    scale = simulation.delay_scale + 1e-3 * RIG.design.identified_delay_ms / RIG.plant.command_delay_s
    longer = changed(RIG, {"simulation.delay_scale": scale})
    gains = design_and_check(RIG).gains
    worst = judge(RIG, gains, family=Family("true", (true_plant(RIG), true_plant(longer)))).ms_max
    peak = measured(RIG, RIG, gains, late=MOST_LATE)
    assert peak.error < 0.05
    assert peak.ms - peak.error < worst


def test_the_loops_own_probe_does_not_end_a_measurement() -> None:
    """On this rig our lines at those of the probe had it take the cell for a frozen one."""
    rig = random_rigs.drawn(RIG, SEED, 5)
    designed = design_and_check(rig)
    peak = equal_limits.peak_of(rig, LoopLaw(rig, designed.gains))
    assert peak is not None
    assert peak.error < 0.05


def test_a_loop_that_trips_while_it_is_measured_has_no_figure() -> None:
    """Gains of the wrong sign: the tension runs away."""
    designed = design_and_check(RIG).gains
    wrong = Gains(-designed.k_tension, designed.k_speed, -designed.k_integral)
    assert equal_limits.peak_of(RIG, LoopLaw(RIG, wrong)) is None


@pytest.mark.parametrize(("law", "values", "loss_n_s_mm"), [("pi", (0.026, 6.5), 0.5), (OURS, None, 0.1)])
def test_a_tuned_law_is_measured_on_the_rig_as_built_with_its_damping(
    law: str, values: tuple[float, ...] | None, loss_n_s_mm: float, tmp_path: pathlib.Path
) -> None:
    """The law is for a plant whose rope loses 0.05 N s/mm; that of the rig as built loses more."""
    known, rows = Known.of(RIG), RowsFile(tmp_path / "rows.jsonl", {})
    values = values or tuple(float(value_of(known.settings, knob.key)) for knob in knobs_of(law, known.settings))
    runs = loop_law(known, TunedLaw(law, values, True, 0.0, 1.5, 0.1))
    peak = equal_limits.peak_by(RIG, known, law, runs, rows)
    lossy = equal_limits.peak_of(changed(RIG, {"simulation.rope.damping_n_s_mm": loss_n_s_mm}), runs)
    assert peak is not None
    assert lossy is not None
    assert peak.ms - peak.error <= 1.6
    assert lossy.ms > 1.2 * peak.ms
    assert equal_limits.peak_by(changed(RIG, {"plant.payload_kg": 1.0}), known, law, runs, rows) == peak, "kept"


@pytest.mark.long
@pytest.mark.parametrize("stiffest", [False, True], ids=["softest", "stiffest"])
def test_a_law_tuned_from_its_own_identification_keeps_the_limit_on_its_rig(stiffest: bool) -> None:
    """The softest and the stiffest of the first twenty rigs: on soft springs the rope's loss is the larger part."""
    rigs = {index: random_rigs.drawn(RIG, SEED, index).plant.stiffness_n_mm for index in range(20)}
    index = (max if stiffest else min)(rigs, key=rigs.__getitem__)
    base = tuning(Known.of(RIG), OURS, RowsFile(None, {}), designs=DESIGNS)
    row = random_rigs.row_of(RIG, SEED, index, OURS, base, DESIGNS)
    assert row.ms is not None
    assert row.ms_error is not None
    assert row.ms - row.ms_error <= RIG.design.ms_max
    assert row.ms_error < 0.1
    assert row.ended == "COMPENSATING"
