"""The plant of a simulated rig as built, and what `rigctl identify` and `rigctl identify --response` find of it.

Both are played on the rig in lockstep, one after the other in HOLD, and evaluated as the gateway does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hil.lockstep import lockstep
from hil.plant.parameters import axial_damping_n_s_mm
from hil.rig_with_ledger import RigWithLedger
from hil.scenario.errors import ScenarioError
from hil.scenario.play import bring_to_target
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design.gains import design
from rigctl.design.identified import Identified, NotIdentifiedError, Uncertain, points
from rigctl.design.plant_family import Member, sampled
from rigctl.ipc.ledger import Entry
from rigctl.model.requests import Request
from rigctl.model.verbs import Verb

WHEN = "2026-01-01T00:00:00+00:00"
STIFFNESS, LAG, MECHANISM = 0.005, 0.01, 0.03
"""Uncertainty at 95 % as a share of the value."""
DAMPING_N_S_MM = 0.0006
DELAY_S = 0.0002
SEEN_HZ = 25.0
"""Highest resonance of the mechanism that the multisine finds."""
KG_PER_N_S2_MM = 1000.0
SETTLE_S, REST_S = 3.0, 1.0


class Built(NamedTuple):
    """The plant as built."""

    stiffness_n_mm: float
    lag_s: float
    delay_s: float
    """Of the drive."""
    mechanism_n_mm: float | None
    damping_n_s_mm: float


def built(rig: RigSettings) -> Built:
    """The truth of a rig with a `simulation` section."""
    plant, simulation = rig.plant, rig.simulation
    assert simulation is not None  # the commands refuse a rig without it
    return Built(
        plant.stiffness_n_mm * simulation.stiffness_scale,
        plant.cylinder_lag_s * simulation.lag_scale,
        plant.command_delay_s * simulation.delay_scale,
        simulation.mechanism.vertical_n_mm,
        axial_damping_n_s_mm(rig, simulation),
    )


def exact(rig: RigSettings) -> Identified:
    """The truth of a rig, with the uncertainty that an identification states of it."""
    truth = built(rig)
    above = rig.plant.payload_kg / KG_PER_N_S2_MM * (2.0 * math.pi * SEEN_HZ) ** 2
    k_m = truth.mechanism_n_mm
    seen = k_m is not None and k_m <= above
    return Identified(
        when=WHEN,
        entries=(),
        tension_n=rig.tension.target_n,
        believed_n_mm=rig.plant.stiffness_n_mm,
        stiffness_n_mm=Uncertain(truth.stiffness_n_mm, STIFFNESS * truth.stiffness_n_mm),
        lag_s=Uncertain(truth.lag_s, LAG * truth.lag_s),
        delay_s=Uncertain(truth.delay_s, DELAY_S),
        mechanism_n_mm=Uncertain(k_m, MECHANISM * k_m) if k_m is not None and seen else None,
        mechanism_above_n_mm=None if seen else above,
        damping_n_s_mm=Uncertain(truth.damping_n_s_mm, DAMPING_N_S_MM),
    )


def played(rig: RigSettings) -> Identified:
    """What is found of a rig at its target, by steps and by a frequency response.

    Raises:
        ScenarioError: the rig does not get there, or its identification ends without figures.
    """
    gains = design(rig)
    with lockstep(rig, gains) as subject:
        bring_to_target(subject, rig.tension.target_n, SETTLE_S)
        subject.command(Verb.HOLD)
        subject.run(REST_S)
        twin = RigWithLedger(subject, gains)
        entries: list[Entry] = []
        for verb in (Verb.IDENTIFY, Verb.RESPONSE):
            filed = twin.carry_out(Request(verb, "study"))
            if filed.finding is None:
                raise ScenarioError([f"{rig.rig}: not identified: {filed.text}"], exit_code=1)
            entries.append(filed.finding.entry)
    try:
        return points(entries, rig)[0]
    except NotIdentifiedError as error:
        raise ScenarioError([f"{rig.rig}: not identified: {error}"], exit_code=1) from None


def true_plant(rig: RigSettings) -> Member:
    """The linear plant as built, with the cell's filter."""
    truth, simulation = built(rig), rig.simulation
    assert simulation is not None
    there = changed(
        rig,
        {
            "plant.spring_n_mm": None,
            "plant.rope_n_mm": truth.stiffness_n_mm,
            "plant.cylinder_lag_s": truth.lag_s,
            "tension_cell.filter_hz": simulation.cell.filter_hz,
        },
    )
    ticks = rig.plant.command_delay_s * simulation.delay_scale * rig.loop.rate_hz
    return sampled(
        there, truth.mechanism_n_mm, 1.0, 1.0, 1.0, ticks, truth.damping_n_s_mm,
        simulation.mechanism.damping_ratio,
    )  # fmt: skip
