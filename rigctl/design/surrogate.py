"""The study's scenarios in miniature: a law in real ticks around the linear plant, with its limits and cell noise.

The design process cannot run the simulated rig (it knows nothing of it, and takes minutes). Of what the rig does to the
loop, the linear plant with the disturbance's speed at the rope's end is the part that matters: the errors of the
comparison (`python -m hil compare`) follow from it within some percent. The law itself is not a model: `OurLaw` runs
the loop's own filter and law, so that whatever they do to a jolt, or with noise at rest, is judged too.

Every scenario starts from a settled loop at the target. Errors are of the true tension about it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from operator import mul
from typing import Protocol

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, TensionFilter, filter_model
from rigctl.control.law.tension import Estimate, Gains, TensionLaw
from rigctl.design.linear_errors import MOVE, SHAKE_MM, recorded_move, unknown_share
from rigctl.design.performance import VERTICAL_HZ, VERTICAL_MM
from rigctl.design.plant_family import Member

SETTLE_S = 0.15  # before a scenario, for the noise to go round the loop
REST, JOLT = "rest", "jolt"
MOVE_BEGIN_S, MOVE_S, MOVE_FROM_S = 2.5, 6.0, 1.5
"""Of the recorded move, in ticks: from where, how much, and what of it counts."""
JOLT_MM, JOLT_S = 1.0, 0.02
NOISE_SEED = 1


class TickedLaw(Protocol):
    """A law in the form that a scenario runs."""

    def start(self, target_n: float) -> None:
        """Begin at the target, at rest, with no memory."""

    def command(self, tension_n: float, speed_mm_s: float) -> float:
        """One tick: the command mm/s for the newest samples, after its limits."""


class OurLaw:
    """The loop's filter and law, without modes, faults and inclination."""

    def __init__(self, settings: RigSettings, gains: Gains) -> None:
        self._settings, self._gains, self._model = settings, gains, filter_model(settings)
        cylinder = settings.cylinder
        self._stroke_mm = 0.5 * (cylinder.stroke_min_mm + cylinder.stroke_max_mm)
        self.start(settings.tension.target_n)

    def start(self, target_n: float) -> None:
        """See `TickedLaw`."""
        self._filter = TensionFilter(self._model)
        self._filter.reset(target_n, 0.0)
        self._filter.settle()
        self._law = TensionLaw(self._settings, self._gains)
        self._law.target_n = target_n
        self._law.start_ramp(target_n, 0.0)

    def command(self, tension_n: float, speed_mm_s: float) -> float:
        """See `TickedLaw`."""
        kalman = self._filter
        kalman.update(tension_n, speed_mm_s)
        kalman.predict()
        tension_n, speed_mm_s, disturbance_mm_s, lead_mm_s = kalman.ahead()
        estimate = Estimate(tension_n, speed_mm_s, disturbance_mm_s, self._stroke_mm, lead_mm_s)
        command = self._law.compensating(estimate, 1.0)
        kalman.command(command)
        return command


@dataclass(frozen=True)
class DisturbanceCase:
    """A disturbance; ``speed_mm_s`` of a time in s from its start, as the rope's upper end (positive stretches it)."""

    name: str
    seconds: float
    from_s: float  # errors count from here on
    speed_mm_s: Callable[[Array], Array]


def _rest(t: Array) -> Array:
    return np.zeros_like(t)


def _move(share: float) -> Callable[[Array], Array]:
    every_s, _, speeds = recorded_move()
    at_s = (np.arange(len(speeds)) + 0.5) * every_s
    return lambda t: share * np.interp(t + MOVE_BEGIN_S, at_s, speeds)


def _vertical(t: Array) -> Array:
    w = 2.0 * math.pi * VERTICAL_HZ
    speed: Array = VERTICAL_MM * w * np.sin(w * t)
    return speed


def _shake(hz: float) -> Callable[[Array], Array]:
    w = 2.0 * math.pi * hz
    return lambda t: SHAKE_MM * w * np.cos(w * t)


def _jolt(t: Array) -> Array:
    share = np.clip(t / JOLT_S, 0.0, 1.0)
    speed: Array = -6.0 * JOLT_MM / JOLT_S * share * (1.0 - share)  # of a rise 3 x^2 - 2 x^3
    return speed


def scenarios(settings: RigSettings) -> tuple[DisturbanceCase, ...]:
    """Every scenario in ticks; of periodic ones whole periods, of the slow one where its acceleration is large."""
    return (
        DisturbanceCase(REST, 1.0, 0.0, _rest),
        DisturbanceCase(MOVE, MOVE_S, MOVE_FROM_S, _move(unknown_share(settings))),
        DisturbanceCase("vertical", 1.3, 0.3, _vertical),
        DisturbanceCase("shake_3hz", 1.0, 1.0 / 3.0, _shake(3.0)),
        DisturbanceCase("shake_8hz", 0.625, 0.25, _shake(8.0)),
        DisturbanceCase(JOLT, 0.6, 0.0, _jolt),
    )


@dataclass(frozen=True)
class CaseErrors:
    """True error of the tension in a scenario, N, and the command's noise and its steps from tick to tick, rms."""

    rms_n: float
    peak_n: float
    command_mm_s: float
    step_mm_s: float


def play(settings: RigSettings, law: TickedLaw, plant: Member, scenario: DisturbanceCase) -> CaseErrors:
    """Run one scenario; deterministic."""
    rate, target_n = settings.loop.rate_hz, settings.tension.target_n
    first = round((SETTLE_S + scenario.from_s) * rate)
    speeds = _disturbance(scenario, rate)
    error, command = _run(law, plant, speeds, _noise(settings, len(speeds)), target_n)
    counted, sent = error[first:], command[first:]
    return CaseErrors(
        float(np.sqrt(np.mean(counted**2))),
        float(np.abs(counted).max()),
        float(np.std(sent)),
        float(np.std(np.diff(sent))),
    )


def _disturbance(scenario: DisturbanceCase, rate_hz: int) -> Array:
    """Speed of each tick, its mean over the tick (the plant holds it), with the time before the scenario at rest."""
    t = np.arange(round(scenario.seconds * rate_hz)) / rate_hz
    parts = [scenario.speed_mm_s(t + share / rate_hz) for share in (0.25, 0.75)]
    return np.concatenate([np.zeros(round(SETTLE_S * rate_hz)), 0.5 * (parts[0] + parts[1])])


@lru_cache(maxsize=32)
def _white(count: int) -> tuple[float, ...]:
    return tuple(np.random.default_rng(NOISE_SEED).standard_normal(count).tolist())


def _noise(settings: RigSettings, count: int) -> list[float]:
    rms = settings.tension_cell.noise_n
    return [rms * one for one in _white(count)]


def _run(law: TickedLaw, plant: Member, speeds: Array, noise: list[float], target_n: float) -> tuple[Array, Array]:
    """Error of the true tension, N, and command, mm/s, tick by tick."""
    law.start(target_n)
    rows = [
        (*row, by_command, by_disturbance)
        for row, by_command, by_disturbance in zip(
            plant.a.tolist(), plant.b_command.tolist(), plant.b_disturbance.tolist(), strict=True
        )
    ]
    state, sample = [0.0] * len(plant.a), (target_n, 0.0)
    late = [0.0] * plant.delay_ticks
    tension, loss, sensed = plant.tension.tolist(), plant.loss_n_s_mm, plant.sensed_n_s_mm
    errors, commands = [], []
    for speed, cell in zip(speeds.tolist(), noise, strict=True):
        command = law.command(*sample)
        errors.append(sum(map(mul, tension, state)) + loss * speed)
        commands.append(command)
        sample = target_n + state[0] + sensed * speed + cell, state[1]
        late.append(command)
        vector = (*state, late.pop(0), speed)
        state = [sum(map(mul, row, vector)) for row in rows]
    return np.array(errors), np.array(commands)
