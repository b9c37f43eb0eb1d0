"""Errors of the inclinometer on the rope's angles, its swing among them, whatever the protocol."""

from __future__ import annotations

import math
import random

from hil.nodes.low_pass import LowPass, time_constant_s
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings

GRAVITY_MM_S2 = 9806.65


class InclinationMeasurement:
    """The rope's angles at the sensor's own rate, low-pass filtered.

    An accelerometer takes the direction of gravity less its own acceleration a for the vertical, and so reads
    theta + atan(a / g). A point s below the pulley has a = a_pulley (1 - s/L) + a_payload s/L. Below a pulley
    at rest a free pendulum has a_payload = -g theta: it reads theta (1 - s/L), nothing at its lower end.

    A gyro-compensated sensor takes motion faster than ``gyro_s`` from its rate gyro and slower motion from its
    accelerometer: the angle passes unchanged, the acceleration through a low-pass of that time constant.
    """

    def __init__(self, settings: RigSettings, simulation: SimulationSettings, plant: Plant) -> None:
        sensor, slope = settings.inclinometer, simulation.inclinometer
        self._plant = plant
        self._gauss = random.Random(f"{simulation.seed}:inclination").gauss
        self._noise_deg = slope.noise_deg
        self._quantum_deg = slope.quantum_deg
        self._range_deg = sensor.range_deg
        self._rate_hz = sensor.rate_hz
        self._lower_share = slope.height_mm / settings.plant.rope_length_mm
        truth = plant.truth
        filter_s = time_constant_s(slope.filter_hz)
        self._filters = LowPass(filter_s, truth.tangential_rad), LowPass(filter_s, truth.normal_rad)
        self._compensation = (LowPass(slope.gyro_s), LowPass(slope.gyro_s)) if slope.kind == "gyro" else None
        self._start_ns = self._filtered_ns = plant.t_ns
        self._samples = 0
        self.angles_deg: tuple[float, float] | None = (0.0, 0.0)
        """Tangential and normal angle as last measured; None beyond the range."""

    def advance(self, t_ns: int) -> bool:
        """Filter up to the plant's time; measure if due at the sensor's time ``t_ns``; returns whether it measured."""
        self._follow()
        if (t_ns - self._start_ns) * self._rate_hz < self._samples * 1_000_000_000:
            return False
        self._samples = (t_ns - self._start_ns) * self._rate_hz // 1_000_000_000 + 1
        self._measure()
        return True

    def _follow(self) -> None:
        plant, lower = self._plant, self._lower_share
        elapsed_s = (plant.t_ns - self._filtered_ns) * 1e-9
        self._filtered_ns = plant.t_ns
        truth, swing = plant.truth, plant.swing
        upper = 1.0 - lower
        false_long = math.atan((upper * swing.upper_tangential + lower * swing.lower_tangential) / GRAVITY_MM_S2)
        false_lateral = math.atan((upper * swing.upper_normal + lower * swing.lower_normal) / GRAVITY_MM_S2)
        if self._compensation is not None:
            false_long = self._compensation[0].update(false_long, elapsed_s)
            false_lateral = self._compensation[1].update(false_lateral, elapsed_s)
        self._filters[0].update(truth.tangential_rad + false_long, elapsed_s)
        self._filters[1].update(truth.normal_rad + false_lateral, elapsed_s)

    def _measure(self) -> None:
        noisy = [math.degrees(axis.value) + self._gauss(0.0, self._noise_deg) for axis in self._filters]
        if max(map(abs, noisy)) > self._range_deg:
            self.angles_deg = None
            return
        long, lateral = (round(angle / self._quantum_deg) * self._quantum_deg for angle in noisy)
        self.angles_deg = long, lateral
