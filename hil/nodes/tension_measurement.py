"""Errors of cell and amplifier on the rope's tension, whatever the protocol."""

from __future__ import annotations

import random

from hil.nodes.low_pass import LowPass, time_constant_s
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings
from rigctl.devices.objects import AiStatus

_GOOD = AiStatus(0)
_NS_PER_H = 3_600_000_000_000


class TensionMeasurement:
    """The rope's tension at its upper end, sampled on demand.

    The cell creeps, drifts and has errors of zero and gain, the amplifier filters, then come noise (of the value sent),
    range and resolution. Creep and filter are analogue: they follow the tension between samples too, as a straight line
    from one ``advance`` or ``sample`` to the next. Cell and amplifier start unloaded.
    """

    def __init__(self, settings: RigSettings, simulation: SimulationSettings, plant: Plant) -> None:
        cell = simulation.cell
        self._plant = plant
        self._gauss = random.Random(f"{simulation.seed}:tension").gauss
        self._noise_n = settings.tension_cell.noise_n
        self._range_n = settings.tension_cell.range_n
        self._quantum_n = cell.quantum_n
        self._creep_share = cell.creep_pct / 100.0
        self._bias_n, self._gain = cell.bias_n, 1.0 + cell.gain_pct / 100.0
        self._crept = LowPass(cell.creep_s)
        self._filter = None if cell.filter_hz is None else LowPass(time_constant_s(cell.filter_hz))
        self._drift_n_ns = cell.drift_n_h / _NS_PER_H
        self._start_ns = self._t_ns = plant.t_ns
        self._filtered_n = 0.0

    def advance(self) -> None:
        """Follow the tension to the plant's time."""
        t_ns = self._plant.t_ns
        tension = self._plant.truth.tension_n
        elapsed_s = (t_ns - self._t_ns) * 1e-9
        self._t_ns = t_ns
        tension += self._creep_share * self._crept.update(tension, elapsed_s)
        tension = self._gain * tension + self._bias_n + self._drift_n_ns * (t_ns - self._start_ns)
        self._filtered_n = tension if self._filter is None else self._filter.update(tension, elapsed_s)

    def sample(self) -> tuple[AiStatus, float]:
        """Status and reading in N."""
        self.advance()
        status, tension = saturate(self._filtered_n + self._gauss(0.0, self._noise_n), self._range_n)
        return status, round(tension / self._quantum_n) * self._quantum_n


def saturate(tension_n: float, range_n: float) -> tuple[AiStatus, float]:
    """Status and reading of an amplifier with a range of +-``range_n``."""
    if tension_n > range_n:
        return AiStatus.POSITIVE_OVERLOAD, range_n
    if tension_n < -range_n:
        return AiStatus.NEGATIVE_OVERLOAD, -range_n
    return _GOOD, tension_n
