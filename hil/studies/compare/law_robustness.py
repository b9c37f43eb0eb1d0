"""Robustness and noise of each law: its sensitivity peak over the family of plants that our design has to hold.

A rival is linear as long as no limit acts, so its responses to a single sample of tension and of speed describe it.
The loop is broken where ``rigctl.design.margins`` breaks it: at the plant's input and at the tension output.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.studies.compare.rivals import PASSIVE, ComparedLaw
from hil.studies.compare.rivals.feedback import Feedback, Sample
from rigctl.config.settings import RigSettings
from rigctl.design.margins import design_and_check, judge
from rigctl.design.plant_family import Array, ComplexArray, Family, Member, family, member

REST = Sample(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SMALL = 1e-3
"""Size of a sample, N or mm/s: far from any limit of a law."""
ANSWER_TICKS = 6000
"""By then every law's response to a single sample is over, except for the constant of its integral."""
BLOCK = 64
"""Ticks of an answer that are summed at once."""
LOOK_S = 2.0
GROWN = 0.3
"""A disturbance of one tick that has not died out to this share within ``LOOK_S`` counts as unstable."""
FROM_HZ, POINTS, NEAR = 0.05, 700, np.linspace(0.9, 1.1, 41)


class Robustness(NamedTuple):
    """A law on the linear plants, without limits."""

    ms: float
    """Sensitivity peak with the plant of the rig file."""
    ms_family: float
    """The largest over the family; infinite where one of its plants is unstable."""
    command_noise_mm_s: float
    """Root mean square of the command from the cell's noise alone."""


def robustness(rig: RigSettings, compared: ComparedLaw) -> Robustness | None:
    """Robustness of one law tuned for the rig; None for the locked cylinder."""
    if compared.name == PASSIVE:
        return None
    nominal = member(rig, rig.plant.mechanism_n_mm)
    if compared.make is None:
        over_family = design_and_check(rig)
        own = judge(rig, over_family.gains, family=Family("of the file", (nominal,)))
        noise = math.inf if own.performance is None else own.performance.command_noise_mm_s
        return Robustness(own.ms_max, over_family.ms_max, noise)
    plants, feedback = family(rig), compared.make(rig)
    grid = _grid(plants, 0.5 * rig.loop.rate_hz)
    z = np.exp(2j * np.pi * grid / rig.loop.rate_hz)
    law = response(feedback, z)
    steady = all(dies_out(plant, feedback, round(LOOK_S * rig.loop.rate_hz)) for plant in plants)
    at_rest = sensitivity(nominal, law, z)
    noise = float(np.trapezoid(np.abs(law[0] * at_rest[0]) ** 2, grid) / grid[-1])
    return Robustness(
        float(np.abs(at_rest).max()),
        max(float(np.abs(sensitivity(plant, law, z)).max()) for plant in plants) if steady else math.inf,
        rig.tension_cell.noise_n * math.sqrt(noise),
    )


def sensitivity(plant: Member, law: ComplexArray, z: ComplexArray) -> ComplexArray:
    """At the plant's input and at the tension, shape (2, len(z)); ``law`` is the result of ``response``."""
    tension, speed, _ = plant.response(z)
    at_input = 1.0 / (1.0 - law[0] * tension - law[1] * speed)
    return np.stack([at_input, at_input * (1.0 - law[1] * speed)])


def response(feedback: Feedback, z: ComplexArray, ticks: int = ANSWER_TICKS) -> ComplexArray:
    """Command per tension (mm/s per N) and per speed (1), shape (2, len(z)), with the tick before the command.

    ``ticks``: after these an answer has become constant.
    """
    samples = ("tension_n", 0.0), ("speed_mm_s", 0.0), ("", 1.0)
    answers = np.array([_answer(feedback, *sample, ticks) for sample in samples])
    kept = answers[:, -1:]  # the constant of an integral
    # Horner's scheme in blocks, so that BLAS does the work: the sum of answer(n) z^-n-1.
    blocks = np.split(np.pad(answers - kept, ((0, 0), (0, -ticks % BLOCK))), -(-ticks // BLOCK), axis=1)
    powers = z ** -np.arange(1.0, BLOCK + 1.0)[:, None]
    found = np.zeros((3, len(z)), np.complex128)
    for block in reversed(blocks):
        found = block @ powers + found * powers[-1]
    found += kept / (z - 1.0)
    result: ComplexArray = found[:2] / (1.0 - found[2])  # the sent command acts through the law's own model
    return result


@np.errstate(over="ignore", invalid="ignore")  # of a loop that is unstable: its tension is not finite
def swing(plant: Member, feedback: Feedback, kick: Array) -> Array:
    """True tension, N, of the linear loop without limits, disturbed by the speeds ``kick``, mm/s, one per tick."""
    state, late = np.zeros(len(plant.a)), [0.0] * plant.delay_ticks
    feedback.start(REST)
    tension, sample = np.zeros(len(kick)), REST
    for i, disturbance in enumerate(kick.tolist()):
        late.append(_tick(feedback, sample))
        tension[i] = plant.tension @ state + plant.loss_n_s_mm * disturbance
        sensed_n = float(state[0]) + plant.sensed_n_s_mm * disturbance
        sample = REST._replace(tension_n=sensed_n, speed_mm_s=float(state[1]))
        state = plant.a @ state + plant.b_command * late.pop(0) + plant.b_disturbance * disturbance
    return tension


def _answer(feedback: Feedback, signal: str, sent: float, ticks: int) -> Array:
    """Commands wanted after a single sample, or after a single command sent a tick before; no other is sent."""
    feedback.start(REST)
    feedback.wanted(REST)  # a difference needs an earlier sample
    feedback.sent(SMALL * sent)
    samples = [REST] * ticks
    if signal:
        samples[0] = REST._replace(**{signal: SMALL})
    answers = []
    for sample in samples:
        answers.append(feedback.wanted(sample))
        feedback.sent(0.0)
        feedback.integrate(sample.setpoint_n - sample.tension_n)
    return np.array(answers) / SMALL


def _tick(feedback: Feedback, sample: Sample) -> float:
    command = feedback.wanted(sample)
    feedback.sent(command)
    feedback.integrate(sample.setpoint_n - sample.tension_n)
    return command


def dies_out(plant: Member, feedback: Feedback, ticks: int) -> bool:
    """Whether a disturbance of one tick dies out on a plant."""
    kick = np.zeros(ticks)
    kick[0] = SMALL
    tension = np.abs(swing(plant, feedback, kick))
    return bool(tension[-ticks // 10 :].max() < GROWN * tension.max())


def _grid(plants: list[Member], nyquist_hz: float) -> Array:
    resonances = sorted({hz for plant in plants for hz in plant.resonances_hz})
    grid = np.unique(np.concatenate([np.geomspace(FROM_HZ, nyquist_hz, POINTS), *(NEAR * hz for hz in resonances)]))
    found: Array = grid[grid <= nyquist_hz]
    return found
