"""The design's linear plant is the simulated plant, linearised numerically: random rigs, to 300 Hz.

The plant is driven with a held speed a tick by a multisine, around a tensioned rope at rest, and its tension read
through a low-pass written here; nothing of the design is used for that.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from hil.plant import Plant
from hil.studies.compare.identification import true_plant
from hil.studies.compare.random_rigs import drawn
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from tests.builders.daemons import PAPER

RIGS, IN_THE_GATE = 50, 8
SEED = 23
HZ = np.array([2.0, 5.0, 11.0, 23.0, 47.0, 79.0, 125.0, 180.0, 240.0, 300.0])
PERIOD_S, PERIODS = 1.0, 2
"""A second holds every line whole."""
DIES_OUT = 8.0  # time constants of the mechanism's own vibration before the periods that count
SOFT_N_MM = 300.0
"""A softer one vibrates for long; it is played without the cell's low-pass, which needs every step of the plant."""
GAIN, PHASE_DEG = 0.01, 1.0
SMALL_MM_S = 0.2  # per line; a stroke of 0.02 mm, and far from slack
LINEAR = {
    "simulation.drive.dead_band_mm_s": 0.0,
    "simulation.drive.ripple_mm": 0.0,
    "simulation.drive.backlash_mm": 0.0,
    "simulation.drive.acceleration_mm_s2": 1e6,
    "simulation.drive.speed_mm_s": 1000.0,
    "simulation.rail.friction_static": 0.0,
    "simulation.rail.friction_dynamic": 0.0,
    "simulation.pulley.friction_static": 0.0,
    "simulation.pulley.friction_dynamic": 0.0,
    "simulation.pulley.rest_share": 0.0,
}
"""What a linear plant does not have; the law's design leaves it to the simulated rig."""


def _decay_s(rig: RigSettings) -> float:
    """Time constant of the mechanism's own vibration."""
    assert rig.simulation is not None
    mechanism, mass = rig.simulation.mechanism, 1e-3 * rig.plant.payload_kg
    if mechanism.vertical_n_mm is None:
        return 0.0
    return 1.0 / (mechanism.damping_ratio * math.sqrt(mechanism.vertical_n_mm / mass))


def on_the_grid(rig: RigSettings) -> RigSettings:
    """The rig with a delay of whole steps of the integration, as a command counts from a whole step on."""
    simulation = rig.simulation
    assert simulation is not None
    step_s, delay_s = simulation.step_us * 1e-6, rig.plant.command_delay_s * simulation.delay_scale
    return changed(rig, {"simulation.delay_scale": round(delay_s / step_s) * step_s / rig.plant.command_delay_s})


def measured(rig: RigSettings) -> npt.NDArray[np.complex128]:
    """Tension behind the cell's low-pass per held command, N s/mm, at ``HZ``."""
    simulation = rig.simulation
    assert simulation is not None
    rate, step_ns = rig.loop.rate_hz, simulation.step_us * 1000
    plant = Plant(rig, 0)
    plant.preload(rig.tension.target_n)
    count = round(PERIOD_S * rate)
    at = np.arange(count) / rate
    phases = np.pi * np.arange(len(HZ)) ** 2 / len(HZ)
    command = SMALL_MM_S * np.cos(2.0 * np.pi * np.outer(at, HZ) + phases).sum(axis=1)
    corner_hz, tick_ns = simulation.cell.filter_hz, 1_000_000_000 // rate
    keep, step_ns = (0.0, tick_ns) if corner_hz is None else (math.exp(-2e-9 * math.pi * corner_hz * step_ns), step_ns)
    filtered = before = plant.truth.tension_n
    settle = 1 + math.ceil(DIES_OUT * _decay_s(rig) / PERIOD_S)
    read = np.zeros((settle + PERIODS) * count)
    for n in range(len(read)):
        read[n] = filtered
        plant.set_drive(float(command[n % count]), braked=False)
        for _ in range(tick_ns // step_ns):
            plant.advance(plant.t_ns + step_ns)
            now = plant.truth.tension_n
            filtered = now if corner_hz is None else keep * filtered + (1.0 - keep) * 0.5 * (before + now)
            before = now
    means = read[settle * count :].reshape(PERIODS, count).mean(axis=0)
    lines = np.exp(-2j * np.pi * np.outer(HZ, at))
    return np.asarray((lines @ (means - means.mean())) / (lines @ command))


@pytest.mark.gate(*map(str, range(IN_THE_GATE)))
@pytest.mark.parametrize("index", range(RIGS))
def test_design_and_simulated_plant_have_one_response(index: int) -> None:
    rig = on_the_grid(changed(drawn(config.load(PAPER), SEED, index), LINEAR))
    assert rig.simulation is not None
    if (rig.simulation.mechanism.vertical_n_mm or math.inf) < SOFT_N_MM:
        rig = changed(rig, {"simulation.cell.filter_hz": None})
    linear = true_plant(rig).response(np.exp(2j * np.pi * HZ / rig.loop.rate_hz))[0]
    ratio = measured(rig) / linear
    assert np.abs(np.abs(ratio) - 1.0).max() < GAIN, np.abs(ratio)
    assert np.abs(np.degrees(np.angle(ratio))).max() < PHASE_DEG, np.degrees(np.angle(ratio))
