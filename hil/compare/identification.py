"""The plant of a simulated rig as built, and what `rigctl identify --response` finds of it.

Playing the identification of every rig of a study would take as long as the study. Its result is drawn instead: the
truth, with a normal error of the uncertainty that the identification itself states (95 % within it).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.nodes.low_pass import time_constant_s
from hil.plant.parameters import axial_damping_n_s_mm
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design.identified import Identified, Uncertain
from rigctl.design.plant_family import Member, sampled

WHEN = "2026-01-01T00:00:00+00:00"
COVERAGE = 1.96  # standard deviations of a normal error in its uncertainty of 95 %
STIFFNESS, LAG, MECHANISM = 0.005, 0.01, 0.03
"""Uncertainty at 95 % as a share of the value."""
DAMPING_N_S_MM = 0.0006
DELAY_S = 0.0002
SEEN_HZ = 25.0
"""Highest resonance of the mechanism that the multisine finds."""
KG_PER_N_S2_MM = 1000.0


class Built(NamedTuple):
    """The plant as built."""

    stiffness_n_mm: float
    lag_s: float
    delay_s: float
    """Of the drive, and of the cell's filter."""
    mechanism_n_mm: float | None
    damping_n_s_mm: float


def built(rig: RigSettings) -> Built:
    """The truth of a rig with a `simulation` section."""
    plant, simulation = rig.plant, rig.simulation
    assert simulation is not None  # the commands refuse a rig without it
    corner_hz = simulation.cell.filter_hz
    return Built(
        plant.stiffness_n_mm * simulation.stiffness_scale,
        plant.cylinder_lag_s * simulation.lag_scale,
        plant.command_delay_s * simulation.delay_scale + (time_constant_s(corner_hz) if corner_hz else 0.0),
        simulation.mechanism.vertical_n_mm,
        axial_damping_n_s_mm(rig, simulation),
    )


def identified(rig: RigSettings, rng: np.random.Generator | None = None) -> Identified:
    """What is found of a rig; without ``rng`` the truth, with its uncertainty all the same."""
    truth = built(rig)

    def found(value: float, uncertainty: float) -> Uncertain:
        error = 0.0 if rng is None else float(rng.standard_normal())
        return Uncertain(value + uncertainty / COVERAGE * error, uncertainty)

    mass = rig.plant.payload_kg / KG_PER_N_S2_MM
    above = mass * (2.0 * np.pi * SEEN_HZ) ** 2
    mechanism: Uncertain | None = None
    bound: float | None = float(above)
    if truth.mechanism_n_mm is not None and truth.mechanism_n_mm <= above:
        mechanism, bound = found(truth.mechanism_n_mm, MECHANISM * truth.mechanism_n_mm), None
    delay, damping = found(truth.delay_s, DELAY_S), found(truth.damping_n_s_mm, DAMPING_N_S_MM)
    return Identified(
        when=WHEN,
        entries=(),
        tension_n=rig.tension.target_n,
        believed_n_mm=rig.plant.stiffness_n_mm,
        stiffness_n_mm=found(truth.stiffness_n_mm, STIFFNESS * truth.stiffness_n_mm),
        lag_s=found(truth.lag_s, LAG * truth.lag_s),
        delay_s=Uncertain(max(delay.value, 0.0), delay.error),
        mechanism_n_mm=mechanism,
        mechanism_above_n_mm=bound,
        damping_n_s_mm=Uncertain(max(damping.value, 0.0), damping.error),
    )


def true_plant(rig: RigSettings) -> Member:
    """The linear plant as built, with the cell's filter."""
    truth, simulation = built(rig), rig.simulation
    assert simulation is not None
    there = changed(rig, {"plant.spring_n_mm": None, "plant.rope_n_mm": truth.stiffness_n_mm,
                          "plant.cylinder_lag_s": truth.lag_s})  # fmt: skip
    ticks = rig.plant.command_delay_s * simulation.delay_scale * rig.loop.rate_hz
    corner_hz = simulation.cell.filter_hz
    return sampled(there, truth.mechanism_n_mm, 1.0, 1.0, 1.0, ticks, truth.damping_n_s_mm, corner_hz)
