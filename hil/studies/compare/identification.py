"""The plant of a simulated rig as built, and what `rigctl identify` and `rigctl identify --response` find of it.

Both are played on the rig in lockstep, one after the other in HOLD, and evaluated as the gateway does.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep, lockstep
from hil.nodes.low_pass import time_constant_s
from hil.plant.parameters import axial_damping_n_s_mm
from hil.scenario.errors import ScenarioError
from hil.scenario.play import bring_to_target
from rigctl.commission.identification import IdentificationError
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design.gains import design
from rigctl.design.identified import Identified, NotIdentifiedError, Uncertain, points
from rigctl.design.plant_family import Member, sampled
from rigctl.ipc.ledger import Entry
from rigctl.model.requests import Request
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.evaluation import response

WHEN, WHEN_NS = "2026-01-01T00:00:00+00:00", 1_767_225_600_000_000_000
STIFFNESS, LAG, MECHANISM = 0.005, 0.01, 0.03
"""Uncertainty at 95 % as a share of the value."""
DAMPING_N_S_MM = 0.0006
DELAY_S = 0.0002
SEEN_HZ = 25.0
"""Highest resonance of the mechanism that the multisine finds."""
KG_PER_N_S2_MM = 1000.0
SETTLE_S, REST_S, LONGEST_S, PART_S = 3.0, 1.0, 120.0, 0.5


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
        try:
            steps = findings.identify(rig, _request(Verb.IDENTIFY), trial(subject, Verb.IDENTIFY), WHEN_NS)
            answer = response(rig, gains, trial(subject, Verb.RESPONSE))
            entries: list[Entry] = [steps.entry, findings.response(rig, _request(Verb.RESPONSE), answer, WHEN_NS).entry]
            return points(entries, rig)[0]
        except (findings.FindingError, IdentificationError, NotIdentifiedError) as error:
            raise ScenarioError([f"{rig.rig}: not identified: {error}"], exit_code=1) from None


def trial(rig: Lockstep, verb: Verb) -> npt.NDArray[Any]:
    """The records of a trial, IDENTIFY or RESPONSE, from its begin to its answer.

    Raises:
        ScenarioError: it was refused or has ended early.
    """
    rig.read_records()
    given = rig.give(verb, math.nan)
    parts = []
    for _ in range(round(LONGEST_S / PART_S)):
        parts.append(rig.run(PART_S))
        if (reply := rig.reply_to(given)) is None:
            continue
        if (ended := Refusal(int(reply["reason"]))) is not Refusal.NONE:
            raise ScenarioError([f"{rig.settings.rig}: {verb.name} ended with {ended.name}"], exit_code=1)
        records = np.concatenate(parts)
        after_ns = records["t_ns"].astype(np.int64) - int(reply["t_ns"])
        return records[(after_ns <= 0) & (after_ns > -round(float(reply["duration_s"]) * 1e9))]
    raise ScenarioError([f"{rig.settings.rig}: {verb.name} has not ended after {LONGEST_S:g} s"], exit_code=1)


def _request(verb: Verb) -> Request:
    return Request(verb, "study")


def true_plant(rig: RigSettings) -> Member:
    """The linear plant as built, with the cell's filter."""
    truth, simulation = built(rig), rig.simulation
    assert simulation is not None
    there = changed(rig, {"plant.spring_n_mm": None, "plant.rope_n_mm": truth.stiffness_n_mm,
                          "plant.cylinder_lag_s": truth.lag_s})  # fmt: skip
    ticks = rig.plant.command_delay_s * simulation.delay_scale * rig.loop.rate_hz
    corner_hz = simulation.cell.filter_hz
    return sampled(there, truth.mechanism_n_mm, 1.0, 1.0, 1.0, ticks, truth.damping_n_s_mm, corner_hz)
