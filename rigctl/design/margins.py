"""Gains, and how far they are from instability over the whole family of plants.

The loop is broken at the plant's input (the command) and at the tension output, each with the drive-speed loop
closed. With plant responses P_T, P_v and controller responses C_T, C_v (positive feedback, ``u = C_T T + C_v v``):

    S_input = 1 / (1 - C_T P_T - C_v P_v),    S_output = (1 - C_v P_v) S_input

Ms is the largest modulus of S from MIN_HZ to the Nyquist frequency. Gain, phase and delay margin are of
``L = -(C_T P_T + C_v P_v)`` at the plant's input.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rigctl.config import RigSettings
from rigctl.control.estimator import filter_model
from rigctl.control.tension import Gains
from rigctl.design import plant_family
from rigctl.design.closed_loop import Controller, closed_loop, controller
from rigctl.design.gains import design, filter_gain
from rigctl.design.performance import Performance, performance
from rigctl.design.plant_family import Array, ComplexArray, Member

MIN_HZ = 0.01
POINTS_PER_DECADE = 150
RESONANCE_POINTS, RESONANCE_BAND = 41, 0.1  # extra points within +-10 % of each resonance: 2 % of damping is narrow
REAL_RAD = 1e-6


@dataclass(frozen=True)
class MemberMargins:
    """Robustness of one plant of the family; an unstable loop has ``ms`` infinite and no margins."""

    k_m: float | None  # mechanism's stiffness N/mm, None = rigid
    k_scale: float
    delay_scale: int
    ms: float  # at the plant's input
    ms_output: float  # at the tension output
    gm_db: float  # smallest change of gain, up or down, that ends stability
    pm_deg: float
    dm_ms: float  # smallest further delay that ends stability
    stable: bool

    def as_dict(self) -> dict[str, Any]:
        """For JSON: what is infinite is null."""
        return {name: None if value in (math.inf, -math.inf) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Design:
    """Gains with their verdict.

    ``accepted``: stable and below the limit everywhere, or waived in words. A waiver excuses plants the rig does not
    have; with the mechanism in the file the loop must be stable at every k and delay all the same.
    """

    gains: Gains
    margins: tuple[MemberMargins, ...]
    reported: tuple[MemberMargins, ...]  # K_m = 2 N/mm: shown, not judged
    ms_max: float  # over the family, both places
    limit: float
    accepted: bool
    waiver: str | None  # the words, only where they were needed
    performance: Performance | None  # None where the loop is unstable with the plant in the file

    def as_dict(self) -> dict[str, Any]:
        """For JSON: what is infinite is null."""
        return {
            "gains": asdict(self.gains),
            "margins": [member.as_dict() for member in self.margins],
            "reported": [member.as_dict() for member in self.reported],
            "ms_max": self.ms_max if math.isfinite(self.ms_max) else None,
            "limit": self.limit,
            "accepted": self.accepted,
            "waiver": self.waiver,
            "performance": asdict(self.performance) if self.performance else None,
        }


def design_and_check(settings: RigSettings) -> Design:
    """Compute the gains, close the loop around every member of the family, and judge.

    Raises:
        DesignError: there are no gains for these settings.
    """
    gains, model = design(settings), filter_model(settings)
    law = controller(model, gains, filter_gain(model))
    members, beside = plant_family.family(settings), plant_family.reported(settings)
    grid = frequency_grid([*members, *beside], model.period_s)
    margins = tuple(margins_over(members, law, grid, model.period_s))
    reported = tuple(margins_over(beside, law, grid, model.period_s))
    ms_max = max(max(member.ms, member.ms_output) for member in margins)
    limit, waiver = settings.design.ms_max, settings.design.waiver
    robust = ms_max <= limit
    own = all(member.stable for member in margins if member.k_m == settings.plant.mechanism_n_mm)
    return Design(
        gains,
        margins,
        reported,
        ms_max,
        limit,
        accepted=robust or (own and waiver is not None),
        waiver=None if robust else waiver,
        performance=performance(settings, law) if own else None,
    )


def frequency_grid(members: list[Member], period_s: float) -> Array:
    """Frequencies in Hz, logarithmic from MIN_HZ to Nyquist, denser about every member's resonances."""
    nyquist = 0.5 / period_s
    decades = math.log10(nyquist / MIN_HZ)
    parts = [nyquist * np.logspace(-decades, 0.0, round(POINTS_PER_DECADE * decades))]
    near = np.linspace(1.0 - RESONANCE_BAND, 1.0 + RESONANCE_BAND, RESONANCE_POINTS)
    parts += [near * resonance for resonance in sorted({f for member in members for f in member.resonances_hz})]
    every = np.unique(np.concatenate(parts))
    grid: Array = every[every <= nyquist]
    return grid


def margins_over(members: list[Member], law: Controller, grid_hz: Array, period_s: float) -> list[MemberMargins]:
    """Margins of every member with one controller; ``grid_hz`` from ``frequency_grid``."""
    omega = 2.0 * np.pi * grid_hz
    z = np.exp(1j * omega * period_s)
    per_tension, per_speed = law.response(z)
    found = []
    for plant in members:
        names = (plant.k_m, plant.k_scale, plant.delay_scale)
        if closed_loop(plant, law).spectral_radius >= 1.0:
            found.append(MemberMargins(*names, math.inf, math.inf, 0.0, 0.0, 0.0, stable=False))
            continue
        tension, speed, _ = plant.response(z)
        loop = -(per_tension * tension + per_speed * speed)
        sensitivity = 1.0 / (1.0 + loop)
        at_output = np.abs((1.0 - per_speed * speed) * sensitivity)
        gm_db, pm_deg, dm_ms = classical_margins(loop, omega)
        ms, ms_output = float(np.abs(sensitivity).max()), float(at_output.max())
        found.append(MemberMargins(*names, ms, ms_output, gm_db, pm_deg, dm_ms, stable=True))
    return found


def classical_margins(loop: ComplexArray, omega: Array) -> tuple[float, float, float]:
    """Gain margin dB, phase margin deg and delay margin ms of a stable loop sampled at ``omega`` rad/s.

    The smallest over all crossovers, interpolated between samples; infinite where there is none.
    """
    modulus_db = 20.0 * np.log10(np.abs(loop))
    turned = np.unwrap(np.angle(-loop))  # 0 where the loop is real and negative
    at = np.flatnonzero(np.diff(np.signbit(modulus_db)))
    share = modulus_db[at] / (modulus_db[at] - modulus_db[at + 1])
    crossover = omega[at] + share * (omega[at + 1] - omega[at])
    phase = turned[at] + share * (turned[at + 1] - turned[at])
    pm_deg = np.degrees(np.abs(np.angle(np.exp(1j * phase))))
    dm_ms = 1000.0 * (phase % (2.0 * np.pi)) / crossover
    # The loop is real at half turns; only the even ones are on the side of -1.
    turns = np.floor(turned / (2.0 * np.pi))
    at = np.flatnonzero(np.diff(turns))
    level = 2.0 * np.pi * np.maximum(turns[at], turns[at + 1])
    share = (level - turned[at]) / (turned[at + 1] - turned[at])
    gm_db = np.abs(modulus_db[at] + share * (modulus_db[at + 1] - modulus_db[at]))
    if abs(np.angle(-loop[-1])) < REAL_RAD:  # at Nyquist the loop is real and may end on that side
        gm_db = np.append(gm_db, abs(modulus_db[-1]))
    return _least(gm_db), _least(pm_deg), _least(dm_ms)


def _least(values: Array) -> float:
    return float(values.min()) if len(values) else math.inf
