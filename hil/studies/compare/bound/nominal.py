"""The nominal plant of a bound: the plant in the settings, its program, and the disturbances that need no run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.studies.compare.bound import program
from hil.studies.compare.bound.linear_law import Disturbance, StrokeAnswer, Tone
from hil.studies.compare.bound.program import Task
from rigctl.config.settings import RigSettings
from rigctl.design import plant_family, surrogate
from rigctl.design.linear_errors import TONES as SINES
from rigctl.design.optimise import Limits
from rigctl.design.plant_family import Member
from rigctl.design.surrogate import DisturbanceCase

MOVE_MEMORY_S, SHORT_MEMORY_S = 1.0, 0.1
"""Longer ones lower the bound of a move by 1 %. A law that remembers a sine for periods finds its phase and cancels it,
so that its bound says nothing of one without a resonator."""
JOLT_S = 4.0
TONES = {name: (mm, hz) for name, (hz, mm) in SINES.items()}
JOLT = "jolt"


class Nominal:
    """The plant in the settings, alone."""

    def __init__(self, settings: RigSettings) -> None:
        self.settings = settings
        self.plant: Member = plant_family.nominal(settings)
        self.rate_hz = settings.loop.rate_hz
        self.short = self.task(SHORT_MEMORY_S)

    def task(self, memory_s: float) -> Task:
        """The program of this plant with so much memory."""
        noise_n = self.settings.tension_cell.noise_n
        memory = round(memory_s * self.rate_hz)
        return Task(StrokeAnswer.of(self.plant), noise_n, Limits.of(self.settings), memory, self.rate_hz)

    def tone(self, name: str) -> Tone:
        """A sine of `TONES`."""
        return Tone.of(self.plant, *TONES[name], 1.0 / self.rate_hz)

    def least_jolt(self, case: Disturbance) -> float:
        """The least error, N rms, of a disturbance by any law within the drive's limits; see `program.least_jolt`."""
        tension = self.settings.tension
        return program.least_jolt(self.short, case, tension.speed_max_mm_s, tension.acceleration_max_mm_s2)

    def jolt(self) -> Disturbance:
        """The jolt of the surrogate's scenarios."""
        case, rate = self.jolt_case(), self.rate_hz
        t_s = np.arange(round(case.seconds * rate)) / rate
        held = 0.5 * sum(case.speed_mm_s(t_s + share / rate) for share in (0.25, 0.75))
        return Disturbance.of(self.plant, np.asarray(held))

    def jolt_case(self) -> DisturbanceCase:
        """The same, with `JOLT_S` of time to settle."""
        case = next(each for each in surrogate.scenarios(self.settings) if each.name == JOLT)
        return replace(case, seconds=JOLT_S)
