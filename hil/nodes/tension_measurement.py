"""Errors of cell and amplifier on the rope's tension, whatever the protocol."""

from __future__ import annotations

import random

from hil.nodes.low_pass import LowPass, time_constant_s
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import CellSettings, SimulationSettings
from rigctl.devices.objects import AiStatus

_GOOD = AiStatus(0)
_NS_PER_H = 3_600_000_000_000
PLAY_OF_RANGE = 0.1  # a load that has turned around by this much of the range is on the other branch of the hysteresis


class TensionMeasurement:
    """The rope's tension at its upper end, sampled on demand.

    The cell creeps, drifts with time and temperature, has errors of zero and gain, of linearity and hysteresis; the
    amplifier filters; then come noise (of the value sent), range and resolution. Creep and filter are analogue: they
    follow the tension between samples too, as a straight line from one ``advance`` or ``sample`` to the next. Cell and
    amplifier start unloaded. ``noise_n`` and ``bias_n`` may be changed meanwhile.
    """

    def __init__(self, settings: RigSettings, simulation: SimulationSettings, plant: Plant) -> None:
        cell = simulation.cell
        self._plant = plant
        self._gauss = random.Random(f"{simulation.seed}:tension").gauss
        self.noise_n = settings.tension_cell.noise_n
        self._range_n = settings.tension_cell.range_n
        self._quantum_n = cell.quantum_n
        self._creep_share = cell.creep_pct / 100.0
        self.bias_n, self._gain = cell.bias_n, 1.0 + cell.gain_pct / 100.0
        self._crept = LowPass(cell.creep_s)
        self._more_creep_share = cell.creep2_pct / 100.0
        self._crept_more = LowPass(cell.creep2_s)
        self._curve = _Curve(cell, self._range_n) if cell.linearity_pct or cell.hysteresis_pct else None
        self._filter = None if cell.filter_hz is None else LowPass(time_constant_s(cell.filter_hz))
        self._drift_n_ns = cell.drift_n_h / _NS_PER_H
        self._start_c, self._warming_c_ns = cell.temperature_c, cell.warming_c_h / _NS_PER_H
        self._zero_n_k, self._gain_k = cell.zero_n_k, cell.gain_pct_k / 100.0
        self._follows_temperature = bool(self._zero_n_k or self._gain_k)
        self._start_ns = self._t_ns = plant.t_ns
        self._filtered_n = 0.0
        self._hung_n = 0.0
        self._fixed_c: float | None = None

    @property
    def temperature_c(self) -> float:
        """Of the cell."""
        if self._fixed_c is not None:
            return self._fixed_c
        return self._start_c + self._warming_c_ns * (self._plant.t_ns - self._start_ns)

    def warm(self, celsius: float) -> None:
        """From now on the cell has this temperature."""
        self._fixed_c = celsius

    def hang(self, weight_n: float) -> None:
        """Hang a known weight on the cell beside the rope, at rest at once; 0 takes it off."""
        self._hung_n = weight_n

    def advance(self) -> None:
        """Follow the tension to the plant's time."""
        t_ns = self._plant.t_ns
        tension = load = self._plant.truth.tension_n + self._hung_n
        elapsed_s = (t_ns - self._t_ns) * 1e-9
        self._t_ns = t_ns
        tension += self._creep_share * self._crept.update(load, elapsed_s)
        if self._more_creep_share:
            tension += self._more_creep_share * self._crept_more.update(load, elapsed_s)
        if self._curve is not None:
            tension += self._curve.error_n(load)
        warmer_k = self.temperature_c - self._start_c if self._follows_temperature else 0.0
        gain = self._gain + self._gain_k * warmer_k
        tension = gain * tension + self.bias_n + self._drift_n_ns * (t_ns - self._start_ns)
        if self._follows_temperature:
            tension += self._zero_n_k * warmer_k
        self._filtered_n = tension if self._filter is None else self._filter.update(tension, elapsed_s)

    def sample(self) -> tuple[AiStatus, float]:
        """Status and reading in N."""
        self.advance()
        status, tension = saturate(self._filtered_n + self._gauss(0.0, self.noise_n), self._range_n)
        return status, round(tension / self._quantum_n) * self._quantum_n


class _Curve:
    """Errors of linearity (a parabola) and of hysteresis: one play operator of Prandtl and Ishlinskii."""

    def __init__(self, cell: CellSettings, range_n: float) -> None:
        self._range_n, self._play_n = range_n, PLAY_OF_RANGE * range_n
        self._bow_n = cell.linearity_pct / 100.0 * range_n
        self._half_n = 0.5 * cell.hysteresis_pct / 100.0 * range_n
        self._behind_n = 0.0

    def error_n(self, load_n: float) -> float:
        """Error at a load that has moved there since the last call."""
        self._behind_n = max(load_n - self._play_n, min(load_n + self._play_n, self._behind_n))
        share = load_n / self._range_n
        return 4.0 * self._bow_n * share * (1.0 - share) + self._half_n * (self._behind_n - load_n) / self._play_n


def saturate(tension_n: float, range_n: float) -> tuple[AiStatus, float]:
    """Status and reading of an amplifier with a range of +-``range_n``."""
    if tension_n > range_n:
        return AiStatus.POSITIVE_OVERLOAD, range_n
    if tension_n < -range_n:
        return AiStatus.NEGATIVE_OVERLOAD, -range_n
    return _GOOD, tension_n
