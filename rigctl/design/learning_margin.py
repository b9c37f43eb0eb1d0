"""Whether learning from move to move converges, with every plant of the family.

From one move to the next the table's spectrum is multiplied by ``Q (1 - L P)`` and the rest stays the same, so tables
and errors converge at every frequency where its modulus is below 1 (Bristow, Tharayil, Alleyne 2006, theorem 6: long
moves, no aliasing). P is the response of the recorded error to the table in the closed loop, L and Q are those of
`rigctl.control.law.move_learning`, with the table's interpolation and the error's averaging.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.move_learning import LearningFilter, learning_filter, step_ticks
from rigctl.control.law.tension import Gains
from rigctl.design.closed_loop import Controller, closed_loop
from rigctl.design.gains import DesignError
from rigctl.design.plant_family import Array, ComplexArray, Member
from rigctl.design.switching import largest_between, level_gains

MIN_HZ, POINTS_PER_DECADE = 0.02, 40
MOST = 0.98
"""Largest factor allowed: each move takes at least 2 % away at every frequency, also with the worst plant."""


class LearningMargin(NamedTuple):
    """The largest factor of what is left from one move to the next, where, and with which plant."""

    factor: float
    frequency_hz: float
    plant: Member


def learning_margin(
    settings: RigSettings, gains: Gains, opened: Controller, quiet: Controller | None, members: Sequence[Member]
) -> LearningMargin:
    """The largest ``|Q (1 - L P)|`` over members and every level of the filter; infinite where a loop is unstable."""
    by, period_s = learning_filter(settings, gains), 1.0 / settings.loop.rate_hz
    nyquist = 0.5 / by.step_s
    grid = np.geomspace(MIN_HZ, nyquist, round(POINTS_PER_DECADE * math.log10(nyquist / MIN_HZ)))
    near = [f * np.linspace(0.9, 1.1, 21) for plant in members for f in plant.resonances_hz if f < nyquist]
    hz = np.unique(np.concatenate([grid, *near]))
    q, l = low_pass(by, hz), learning_law(by, hz)  # noqa: E741 - Q and L are their names in the literature
    ticks = step_ticks(settings)
    played = np.sinc(hz * by.step_s) ** 2
    averaged = np.mean(
        [np.exp(2j * np.pi * hz * period_s * m) for m in range(-(ticks // 2), ticks - ticks // 2)], axis=0
    )
    lead = np.exp(2j * np.pi * hz * period_s * by.lead_ticks)
    worst = LearningMargin(0.0, 0.0, members[0])
    laws, z = [opened] if quiet is None else [quiet, opened], np.exp(2j * np.pi * hz * period_s)
    for plant in members:
        if any(closed_loop(plant, law).spectral_radius >= 1.0 for law in laws):
            return LearningMargin(math.inf, 0.0, plant)
        left = [q * (1.0 - l * lead * averaged * played * table_response(plant, law, hz, period_s)) for law in laws]
        factor = np.abs(left[0])
        if quiet is not None:
            (gain,) = level_gains([plant.response(z)], quiet, opened, hz, period_s)
            factor, _ = largest_between(left[0], left[1], gain)
        at = int(np.argmax(factor))
        if factor[at] > worst.factor:
            worst = LearningMargin(float(factor[at]), float(hz[at]), plant)
    return worst


def table_response(plant: Member, law: Controller, hz: Array, period_s: float) -> ComplexArray:
    """Tension as recorded (one tick late) per speed added to the command, N s/mm; the filter is told the sum."""
    loop = closed_loop(plant, law)
    size, n, d = len(loop.a), len(plant.a), plant.delay_ticks
    added = np.zeros(size)
    if d:
        added[n + d - 1] = 1.0
    else:
        added[:n] = plant.b_command
    added[n + d + len(law.a) - 2] = 1.0  # the newest command that the filter knows
    z = np.exp(2j * np.pi * hz * period_s)
    pencil = z[:, None, None] * np.eye(size) - loop.a
    states = np.linalg.solve(pencil, np.broadcast_to(added.astype(np.complex128)[:, None], (len(z), size, 1)))
    response: ComplexArray = states[:, 0, 0] / z
    return response


def low_pass(by: LearningFilter, hz: Array) -> Array:
    """Q, forwards and backwards: real, 1 at 0 Hz."""
    late = np.exp(-2j * np.pi * hz * by.step_s)
    once = by.b0 * (1.0 + late) ** 2 / (1.0 + by.a1 * late + by.a2 * late**2)
    both: Array = np.abs(once) ** 2
    return both


def learning_law(by: LearningFilter, hz: Array) -> ComplexArray:
    """L without its lead, as the lesson's differences and sums have it, mm/s per N."""
    angle, step_s = 2.0 * np.pi * hz * by.step_s, by.step_s
    slope, bend = 1j * np.sin(angle) / step_s, 2.0 * (np.cos(angle) - 1.0) / step_s**2
    total = 0.5 * step_s / (1j * np.tan(0.5 * angle))
    response: ComplexArray = by.on_error + by.on_integral * total + by.on_slope * slope + by.on_bend * bend
    return response


def require_convergence(
    settings: RigSettings, gains: Gains, opened: Controller, quiet: Controller | None, members: Sequence[Member]
) -> None:
    """Refuse settings whose learning need not converge.

    Raises:
        DesignError: the factor is too large with a plant of the family.
    """
    if settings.learning is None:
        return
    found = learning_margin(settings, gains, opened, quiet, members)
    if found.factor <= MOST:
        return
    plant = found.plant
    mechanism = "rigid" if plant.k_m is None else f"{plant.k_m:g} N/mm"
    which = f"k x{plant.k_scale:g}, delay x{plant.delay_scale:g}, mechanism {mechanism}"
    if not math.isfinite(found.factor):
        raise DesignError(f"learning: the loop is unstable with a plant of the family ({which}), so nothing is learnt")
    raise DesignError(
        f"learning: |Q (1 - L P)| = {found.factor:.2f} at {found.frequency_hz:.2g} Hz ({which}), expected at most "
        f"{MOST:g}: lower learning.cutoff_hz ({settings.learning.cutoff_hz:g}) or learning.rate"
    )
