"""The cell on a prescribed load, with the loop's own correction and trials behind it, at steps of any length.

This is the measurement chain without bus, plant and drive: the simulated cell, the loop's `CellCorrection`, its trials
`Average` and `LoadStep`. A step of h seconds stands for the loop's samples of that time: the noise of its one sample is
that of their mean. Creep is exact at any step in both cell and correction, for a load that is a straight line between.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

from hil.nodes.tension_measurement import TensionMeasurement
from hil.plant import Plant
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_correction import CellCorrection
from rigctl.control.excitation.trials import Average, LoadBin, LoadStep, Trial
from rigctl.control.snapshot import Snapshot
from rigctl.model.verbs import Refusal

S = 1_000_000_000
FINE_S, COARSE_S, WARMING_S = 0.05, 1.0, 60.0
"""Steps: while something is measured, in a long record, and while the temperature changes."""
START_NS = 1_800_000_000 * S
HUNG_S = 5.0  # after the command
RAMP_S = 6.0


class BenchError(RuntimeError):
    """The loop would refuse the trial; ``str()`` is the refusal's name."""


class HungLoad:
    """Stands for the plant under the cell."""

    def __init__(self) -> None:
        self.t_ns = 0
        self.tension_n = 0.0

    @property
    def truth(self) -> HungLoad:
        """The load itself."""
        return self


class CellBench:
    """One cell from its power-on. ``tension_n``: as the loop has it, against ``load_n``."""

    def __init__(self, settings: RigSettings) -> None:
        simulation = settings.simulation
        assert simulation is not None  # the command refuses a rig without it
        self.settings = settings
        self._slow = changed(settings, {"loop.rate_hz": round(1.0 / FINE_S)})  # of the trials, that count ticks
        self._rate_hz = settings.loop.rate_hz
        self._load = HungLoad()
        self._measurement = TensionMeasurement(settings, simulation, cast("Plant", self._load))
        self._noise_n = settings.tension_cell.noise_n
        self.cell = CellCorrection(settings)
        self._bias_n = simulation.cell.bias_n
        self.celsius = simulation.cell.temperature_c
        self.reading_n = self.tension_n = 0.0
        self._snapshot = Snapshot(cell_age_ns=0, cell_heard=True)
        self._inbox: Any = SimpleNamespace(
            cell=SimpleNamespace(), cell_correction=self.cell, cell_fresh=True,
            drive=SimpleNamespace(speed_mm_s=0.0, stroke_mm=0.0),
        )  # fmt: skip

    @property
    def load_n(self) -> float:
        """True force on the cell."""
        return float(self._load.tension_n)

    def step(self, seconds: float, load_n: float | None = None) -> None:
        """One sample, after a straight course to another load."""
        load, measurement = self._load, self._measurement
        load.t_ns += round(seconds * S)
        load.tension_n = load.tension_n if load_n is None else load_n
        measurement.warm(self.celsius)
        measurement.noise_n = self._noise_n / math.sqrt(max(1.0, seconds * self._rate_hz))
        self.reading_n = measurement.sample()[1]
        self.cell.feel(self.celsius, load.t_ns)
        self.tension_n = self.cell.tension_n(self.reading_n, load.t_ns)

    @property
    def wall_ns(self) -> int:
        """Time on the wall clock, from `START`."""
        return START_NS + int(self._load.t_ns)

    def shift_zero(self, beside_n: float) -> None:
        """From now on the zero is that much beside the cell's, whatever it was before."""
        self._measurement.bias_n = self._bias_n + beside_n

    def wait(self, seconds: float, warming_c_h: float = 0.0) -> None:
        """Let time pass under the present load, in one step where the temperature does not change."""
        count = max(1, math.ceil(seconds / WARMING_S)) if warming_c_h else 1
        for _ in range(count):
            self.celsius += warming_c_h / 3600.0 * seconds / count
            self.step(seconds / count)

    def pull(self, load_n: float, seconds: float = RAMP_S) -> None:
        """A ramp to another load."""
        start_n, count = self.load_n, max(1, round(seconds / FINE_S))
        for place in range(1, count + 1):
            self.step(seconds / count, start_n + (load_n - start_n) * place / count)

    def mean_n(self, seconds: float) -> float:
        """Mean of the tension over a time."""
        count, total_n = round(seconds / FINE_S), 0.0
        for _ in range(count):
            self.step(FINE_S)
            total_n += self.tension_n
        return total_n / count

    def average(self) -> dict[str, float]:
        """Figures of the loop's trial of TARE and CALIBRATE.

        Raises:
            BenchError: the loop would refuse it.
        """
        trial = Average(self._slow)
        verdict = None
        while verdict is None:
            self.step(FINE_S)
            verdict = self._see(trial)
        if verdict is not Refusal.NONE:
            raise BenchError(verdict.name)
        return trial.figures

    def record_creep(self, seconds: float, weight_n: float) -> list[LoadBin]:
        """The loop's record of a weight that is hung on the cell.

        Raises:
            BenchError: the loop would refuse it.
        """
        self._inbox.cell.tension_n = self.tension_n
        trial = LoadStep(self._slow, self._inbox, seconds, None)
        found: list[LoadBin] = []
        since_s, verdict = 0.0, None
        while verdict is None:
            step_s = FINE_S if since_s < HUNG_S + 20.0 else COARSE_S
            since_s += step_s
            self.step(step_s, weight_n if since_s > HUNG_S else None)
            verdict = self._see(trial)
            found += trial.take_bins()
        if verdict is not Refusal.NONE:
            raise BenchError(verdict.name)
        first = next(place for place, part in enumerate(found) if part.after_s > 0.0)
        return found[first - 1 :]

    def _see(self, trial: Trial) -> Refusal | None:
        self._inbox.cell.reading_n, self._inbox.cell.tension_n = self.reading_n, self.tension_n
        self._snapshot.t_ns = self._load.t_ns
        return trial.see(self._inbox, self._snapshot)
