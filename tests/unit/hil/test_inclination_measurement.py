"""An inclinometer on a swinging rope: prescribed in closed form, and by the plant."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest

from hil.nodes.inclination_measurement import GRAVITY_MM_S2, InclinationMeasurement
from hil.plant import Plant
from hil.plant.plant import Swing
from tests.builders.rig_bench import MS, SETTINGS, changed

LENGTH = SETTINGS.plant.rope_length_mm
OMEGA = math.sqrt(GRAVITY_MM_S2 / LENGTH)  # 2.69 s
AMPLITUDE = math.radians(0.5)
SENSOR = {"filter_hz": 1000.0, "quantum_deg": 1e-9, "noise_deg": 0.0, "clock_ppm": 0.0}
EVERY_MS = {"rate_hz": 1000}


class Pendulum:
    """Stands for the plant: a small free swing below a pulley at rest, along the rail and across it."""

    def __init__(self, **sensor: Any) -> None:
        self.t_ns = 0
        self.tangential_rad = self.normal_rad = 0.0
        self.swing = Swing(0.0, 0.0, 0.0, 0.0)
        settings = changed(inclinometer=EVERY_MS, simulation={"inclinometer": SENSOR | sensor})
        assert settings.simulation is not None
        plant: Any = self
        self.sensor = InclinationMeasurement(settings, settings.simulation, plant)

    @property
    def truth(self) -> Pendulum:
        return self

    def step(self) -> tuple[float, float]:
        """Angles read one millisecond later, rad."""
        self.t_ns += MS
        assert self.sensor.advance(self.t_ns)
        assert self.sensor.angles_deg is not None
        return math.radians(self.sensor.angles_deg[0]), math.radians(self.sensor.angles_deg[1])

    def swung(self, seconds: float) -> tuple[complex, complex]:
        """Both readings over the last period, as phasors relative to the angle's own swing."""
        period = round(2.0 * math.pi / OMEGA * 1e3)
        seen = []
        for _ in range(round(seconds * 1e3)):
            angle = OMEGA * (self.t_ns + MS) * 1e-9
            self.tangential_rad, self.normal_rad = AMPLITUDE * math.sin(angle), AMPLITUDE * math.cos(angle)
            lower = -GRAVITY_MM_S2 * self.tangential_rad, -GRAVITY_MM_S2 * self.normal_rad
            self.swing = Swing(0.0, 0.0, *lower)
            seen.append((angle, *self.step()))
        angles, tangential, normal = np.array(seen[-period:]).T
        turn = np.exp(-1j * angles) * 2.0 / AMPLITUDE
        return complex(np.mean(tangential * turn) * 1j), complex(np.mean(normal * turn))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_an_accelerometer_reads_a_free_swing_by_its_height_and_is_blind_to_it_at_the_lower_end(share: float) -> None:
    """theta (1 - s/L), along the rail and across it."""
    tangential, normal = Pendulum(kind="accelerometer", height_mm=share * LENGTH).swung(6.0)
    # 1000 Hz filter: 0.16 ms behind, 0.0004 of the amplitude; mean over whole milliseconds of a period: 0.0003
    assert abs(tangential - (1.0 - share)) < 0.001
    assert abs(normal - (1.0 - share)) < 0.001


@pytest.mark.parametrize("gyro_s", [0.1, 0.5, 2.0])
def test_gyros_keep_what_is_faster_than_their_time_constant(gyro_s: float) -> None:
    """At the lower end the accelerometer's error is -theta; a low-pass of gyro_s passes its share of it."""
    tangential, normal = Pendulum(kind="gyro", height_mm=LENGTH, gyro_s=gyro_s).swung(8.0 * gyro_s + 6.0)
    expected = 1.0 - 1.0 / (1.0 + 1j * OMEGA * gyro_s)
    assert abs(tangential - expected) < 0.002
    assert abs(normal - expected) < 0.002
    assert 0.2 < abs(expected) < 0.99
    assert cmath.phase(expected) > 0.1


def test_a_load_towed_at_constant_acceleration_hangs_plumb_to_an_accelerometer() -> None:
    """It trails its pulley by atan(a / g), along the rope's own apparent vertical."""
    acceleration = 200.0
    pendulum = Pendulum(kind="accelerometer", height_mm=700.0)
    pendulum.swing = Swing(acceleration, -acceleration, acceleration, -acceleration)
    pendulum.tangential_rad = -math.atan(acceleration / GRAVITY_MM_S2)
    pendulum.normal_rad = -pendulum.tangential_rad
    for _ in range(100):
        read = pendulum.step()
    assert read == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_pulleys_acceleration_counts_whole_at_its_own_height() -> None:
    pendulum = Pendulum(kind="accelerometer", height_mm=0.0)
    pendulum.swing = Swing(100.0, 50.0, 9999.0, 9999.0)
    for _ in range(100):
        read = pendulum.step()
    assert read == pytest.approx((math.atan(100.0 / GRAVITY_MM_S2), math.atan(50.0 / GRAVITY_MM_S2)))


def test_gyros_give_in_to_a_lasting_acceleration() -> None:
    pendulum = Pendulum(kind="gyro", gyro_s=0.5)
    pendulum.step()
    pendulum.swing = Swing(100.0, 0.0, 100.0, 0.0)
    error = math.atan(100.0 / GRAVITY_MM_S2)
    read = [pendulum.step()[0] for _ in range(4000)]
    assert read[0] < 0.01 * error
    assert read[499] == pytest.approx(error * (1.0 - math.exp(-1)), rel=0.01)
    assert read[-1] == pytest.approx(error, rel=0.001)


@pytest.mark.parametrize("height_mm", [0.0, 900.0, 1800.0])
def test_on_the_plant_too_an_accelerometer_reads_theta_less_its_share(height_mm: float) -> None:
    """The payload free to swing below a stuck rail, the rope carrying just its weight."""
    settings = changed(
        inclinometer=EVERY_MS,
        simulation={
            "inclinometer": SENSOR | {"kind": "accelerometer", "height_mm": height_mm},
            "mechanism": {"tangential_n_mm": 1e-6, "damping_ratio": 0.0},
            "rail": {"friction_static": 1.0},
            "rope": {"mass_kg": 0.0},
        },
    )
    assert settings.simulation is not None
    plant = Plant(settings, 0)
    plant.preload(settings.plant.payload_kg * GRAVITY_MM_S2 * 1e-3)
    plant.state[0]["ut"] = LENGTH * AMPLITUDE
    sensor = InclinationMeasurement(settings, settings.simulation, plant)
    read, true = [], []
    for _ in range(3000):
        plant.advance(plant.t_ns + MS)
        assert sensor.advance(plant.t_ns)
        assert sensor.angles_deg is not None
        read.append(math.radians(sensor.angles_deg[0]))
        true.append(plant.truth.tangential_rad)
    assert min(true) < -0.95 * AMPLITUDE
    expected = (1.0 - height_mm / LENGTH) * np.array(true)
    # stretch by the swing adds 0.2 N to 294 N; the filter is 0.16 ms behind
    assert np.abs(np.array(read) - expected)[10:].max() < 0.003 * AMPLITUDE
