"""The errors of cell and amplifier on a tension that the test prescribes."""

from __future__ import annotations

import math
import statistics
from typing import Any

import pytest

from hil.nodes.tension_measurement import TensionMeasurement
from tests.builders.rig_bench import changed

S = 1_000_000_000
PERFECT = {"quantum_n": 1e-9, "filter_hz": None, "drift_n_h": 0.0, "creep_pct": 0.0}


class Load:
    """Stands for the plant: its tension, and the cell that measures it."""

    def __init__(self, noise_n: float = 1e-12, **cell: Any) -> None:
        self.t_ns = 5 * S
        self.tension_n = 0.0
        settings = changed(tension_cell={"noise_n": noise_n}, simulation={"cell": PERFECT | cell})
        assert settings.simulation is not None
        plant: Any = self
        self.cell = TensionMeasurement(settings, settings.simulation, plant)

    @property
    def truth(self) -> Load:
        return self

    def after(self, seconds: float, tension_n: float) -> float:
        """The reading ``seconds`` later, after a straight course of the tension to ``tension_n``."""
        self.t_ns += round(seconds * S)
        self.tension_n = tension_n
        return self.cell.sample()[1]


def test_a_perfect_cell_reads_the_tension() -> None:
    assert Load().after(0.001, 300.0) == pytest.approx(300.0)


@pytest.mark.parametrize("creep_pct", [0.02, -0.05])
def test_it_creeps_toward_its_share_of_the_load_with_its_time_constant(creep_pct: float) -> None:
    load = Load(creep_pct=creep_pct, creep_s=600.0)
    full = 3.0 * creep_pct  # at 300 N
    assert load.after(0.001, 300.0) == pytest.approx(300.0, abs=1e-6)
    assert load.after(600.0, 300.0) - 300.0 == pytest.approx(full * (1 - math.exp(-1)), rel=1e-5)
    assert load.after(6000.0, 300.0) - 300.0 == pytest.approx(full, rel=1e-4)
    assert load.after(0.001, 0.0) == pytest.approx(full, rel=1e-4)  # the creep remains after unloading
    assert load.after(600.0, 0.0) == pytest.approx(full * math.exp(-1), rel=1e-4)


def test_its_zero_drifts_by_so_much_an_hour() -> None:
    load = Load(drift_n_h=0.5)
    assert load.after(3600.0, 100.0) == pytest.approx(100.5)
    assert load.after(1800.0, 0.0) == pytest.approx(0.75)


def test_the_filter_answers_a_step_with_its_time_constant() -> None:
    load = Load(filter_hz=50.0)
    tau_s = 1.0 / (2.0 * math.pi * 50.0)
    load.after(1e-6, 100.0)
    assert load.after(tau_s, 100.0) == pytest.approx(100.0 * (1 - math.exp(-1)), abs=0.02)  # the step took 1 us
    assert load.after(4 * tau_s, 100.0) == pytest.approx(100.0 * (1 - math.exp(-5)), abs=0.02)


@pytest.mark.parametrize("steps_s", [(0.001,) * 100, (0.0001, 0.0009) * 100, (0.1,)])
def test_the_filter_trails_a_ramp_by_its_time_constant_however_often_it_is_looked_at(
    steps_s: tuple[float, ...],
) -> None:
    """60 N/s through 50 Hz: 0.19 N behind, 31 time constants after the start."""
    load = Load(filter_hz=50.0)
    reading = 0.0
    for step_s in steps_s:
        reading = load.after(step_s, load.tension_n + 60.0 * step_s)
    assert reading == pytest.approx(6.0 - 60.0 / (2.0 * math.pi * 50.0), abs=1e-6)


def test_at_its_corner_the_filter_is_3_db_down() -> None:
    load = Load(filter_hz=20.0)
    seen = [load.after(0.001, math.sin(2.0 * math.pi * 20.0 * i * 0.001)) for i in range(1, 1001)]
    assert max(seen[500:]) == pytest.approx(math.sqrt(0.5), rel=0.01)  # straight lines between 50 points a period


def test_two_looks_at_one_moment_differ_by_noise_only() -> None:
    load = Load(filter_hz=50.0, creep_pct=0.02)
    first = load.after(0.002, 100.0)
    assert load.after(0.0, 100.0) == pytest.approx(first, abs=1e-9)


def test_noise_is_that_of_what_is_sent_whatever_the_filter() -> None:
    load = Load(noise_n=0.03, filter_hz=1.0)
    seen = [load.after(0.001, 0.0) for _ in range(4000)]
    assert statistics.pstdev(seen) == pytest.approx(0.03, rel=5 / math.sqrt(8000))  # 5 sigma of an estimate from 4000


def test_errors_of_zero_and_gain_are_of_what_is_read() -> None:
    assert Load(bias_n=0.15, gain_pct=0.02).after(0.001, 300.0) == pytest.approx(300.0 * 1.0002 + 0.15)
    assert Load(bias_n=-0.15).after(0.001, 0.0) == pytest.approx(-0.15)


def test_two_creeps_add_up() -> None:
    load = Load(creep_pct=0.01, creep_s=1000.0, creep2_pct=0.02, creep2_s=50.0)
    load.after(1e-6, 300.0)
    expected = 0.03 * (1 - math.exp(-0.05)) + 0.06 * (1 - math.exp(-1))
    assert load.after(50.0, 300.0) - 300.0 == pytest.approx(expected, rel=1e-4)


def test_zero_and_gain_follow_the_cells_temperature() -> None:
    load = Load(temperature_c=18.0, warming_c_h=2.0, zero_n_k=0.01, gain_pct_k=0.001)
    assert load.after(0.001, 300.0) == pytest.approx(300.0, abs=1e-6)
    assert load.after(3 * 3600.0, 300.0) == pytest.approx(300.0 + 6 * 0.01 + 300.0 * 6e-5, abs=1e-6)
    assert load.cell.temperature_c == pytest.approx(24.0)


def test_a_hung_weight_adds_to_the_rope() -> None:
    load = Load()
    load.cell.hang(294.2)
    assert load.after(0.001, 0.0) == pytest.approx(294.2)
    assert load.after(0.001, 1.0) == pytest.approx(295.2)
    load.cell.hang(0.0)
    assert load.after(0.001, 0.0) == pytest.approx(0.0, abs=1e-9)


def test_linearity_bows_between_zero_and_the_range() -> None:
    load = Load(linearity_pct=0.02)
    seen = {share: load.after(0.001, 500.0 * share) - 500.0 * share for share in (0.0, 0.25, 0.5, 1.0)}
    assert seen == pytest.approx({0.0: 0.0, 0.25: 0.075, 0.5: 0.1, 1.0: 0.0}, abs=1e-9)


def test_hysteresis_lies_between_rising_and_falling_load_and_needs_a_turn_of_a_tenth_of_the_range() -> None:
    load = Load(hysteresis_pct=0.02)
    rising = load.after(0.001, 300.0) - 300.0
    assert load.after(0.001, 400.0) - 400.0 == pytest.approx(rising)
    assert load.after(0.001, 399.0) - 399.0 == pytest.approx(rising + 0.05 / 50.0)  # turned around by 1 of 50 N
    assert load.after(0.001, 300.0) - 300.0 - rising == pytest.approx(0.1)
    assert load.after(0.001, 0.0) == pytest.approx(0.05)  # a return to zero keeps half of it
