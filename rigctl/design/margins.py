"""Gains, and their margins to instability over the whole family of plants.

The loop is broken at the plant's input (the command) and at the tension output, each with the drive-speed loop
closed. With plant responses P_T, P_v and controller responses C_T, C_v (positive feedback, ``u = C_T T + C_v v``):

    S_input = 1 / (1 - C_T P_T - C_v P_v),    S_output = (1 - C_v P_v) S_input

Ms is the largest modulus of S from MIN_HZ to the Nyquist frequency. Gain, phase and delay margin are of
``L = -(C_T P_T + C_v P_v)`` at the plant's input. S_output is also the effect of a disturbance on the true tension,
over its effect with the stroke locked.

A filter with a quiet setting is judged at every level from the quiet to the open one: Ms is the largest over all of
them, exactly (`rigctl.design.switching.largest_between`); the other margins are the worst of quiet, open and the level
of that Ms. The circle criterion says beside it that no change from one level to another makes the loop unstable.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import FilterModel, filter_model
from rigctl.control.law.tension import Gains
from rigctl.design import plant_family
from rigctl.design.closed_loop import Controller, closed_loop, controller
from rigctl.design.gains import OPEN, QUIET, design, filter_gains
from rigctl.design.learning_margin import require_convergence
from rigctl.design.performance import Performance, performance
from rigctl.design.plant_family import Array, ComplexArray, Family, Member
from rigctl.design.switching import circle_margin, common_lyapunov, largest_between, level_gains
from rigctl.design.verdict import Design, MemberMargins, SettingMargins

MIN_HZ = 0.01
POINTS_PER_DECADE = 150
RESONANCE_POINTS, RESONANCE_BAND = 41, 0.1  # extra points within +-10 % of each resonance: 2 % of damping is narrow
REAL_RAD = 1e-6


def design_and_check(settings: RigSettings, family: Family | None = None) -> Design:
    """Compute the gains, close the loop around every member of the family, and judge the result.

    Raises:
        DesignError: there are no gains for these settings.
    """
    return judge(settings, design(settings), family=family)


def judge(settings: RigSettings, gains: Gains, family: Family | None = None) -> Design:
    """Close the loop with these gains around every member of the family, against the limit in the settings.

    ``family``: None for the assumed one.

    Raises:
        DesignError: the filter has no steady state.
    """
    model = filter_model(settings)
    laws = controllers(model, gains)
    family = family or plant_family.assumed(settings)
    members, beside = list(family.members), list(family.reported)
    both = [*members, *beside]
    grid, plants = _on_grid(family, model.period_s)
    found = {name: margins_over(both, law, grid, model.period_s, plants) for name, law in laws.items()}
    stable = all(member.stable for each in found.values() for member in each[: len(members)])
    switching, levels, level = None, list[ComplexArray](), 1.0
    if QUIET in laws and stable:
        levels = level_gains(plants, laws[QUIET], laws[OPEN], grid, model.period_s)
        level, peaks = _between(both, laws, grid, model.period_s, plants, levels, len(members))
        name = f"{100.0 * level:.0f} % open"
        laws[name] = controller(model, gains, _blend(model, level))
        at_level = margins_over(both, laws[name], grid, model.period_s, plants)
        found[name] = [
            replace(one, ms=max(one.ms, ms), ms_output=max(one.ms_output, ms_output))
            for one, (ms, ms_output) in zip(at_level, peaks, strict=True)
        ]
    worst = [_worst(each) for each in zip(*found.values(), strict=True)]
    margins, reported = tuple(worst[: len(members)]), tuple(worst[len(members) :])
    of_file = [at for at, plant in enumerate(members) if plant.k_m == settings.plant.mechanism_n_mm]
    of_file = of_file or list(range(len(members)))  # a family of other mechanisms: then each of them counts
    own = all(margins[at].stable for at in of_file)
    if levels:
        proofs = [circle_margin(gain) for gain in levels[: len(members)]]
        own = own and min(proofs[at] for at in of_file) > 0.0
        certified = common_lyapunov(
            plant_family.member(settings, settings.plant.mechanism_n_mm), laws[QUIET], laws[OPEN]
        )
        switching = min(proofs) if certified is not None else min(0.0, *proofs)
    require_convergence(settings, gains, laws[OPEN], laws.get(QUIET), members)
    ms_max = max(member.ms_worst for member in margins)
    limit = settings.design.ms_max
    robust = ms_max <= limit and (QUIET not in laws or (switching is not None and switching > 0.0))
    waiver = None if robust else settings.design.waiver
    return Design(
        gains,
        margins,
        reported,
        ms_max,
        limit,
        accepted=robust or (own and waiver is not None),
        waiver=waiver,
        performance=_performance(settings, laws) if own else None,
        settings=_by_setting(settings, laws, {name: found[name][: len(members)] for name in laws}, level, own=own),
        switching=switching,
        family=family.name,
    )


def _by_setting(
    settings: RigSettings,
    laws: dict[str, Controller],
    found: dict[str, list[MemberMargins]],
    level: float,
    *,
    own: bool,
) -> tuple[SettingMargins, ...]:
    """Open, quiet, and the level of the largest Ms if the loop is stable in both; none without a quiet setting."""
    if QUIET not in laws:
        return ()
    of_level = {OPEN: 1.0, QUIET: 0.0}
    return tuple(
        SettingMargins(
            name,
            max(member.ms_worst for member in found[name]),
            performance(settings, law) if own else None,
            of_level.get(name, level),
        )
        for name, law in laws.items()
    )


LEVELS = 11  # at which the least |S| of a band is looked for


def predicted_band(settings: RigSettings, gains: Gains, family: Family, hz: Array) -> tuple[Array, Array]:
    """The least and the largest |S| at the plant's input over the family and every level of the filter, at ``hz``.

    Raises:
        DesignError: the filter has no steady state.
    """
    model = filter_model(settings)
    laws, members = controllers(model, gains), list(family.members)
    plants = plant_responses(members, hz, model.period_s)
    of_open = [answer.s_input for answer in responses(members, laws[OPEN], hz, model.period_s, plants)]
    if QUIET not in laws:
        moduli = np.abs(of_open)
        return moduli.min(axis=0), moduli.max(axis=0)
    of_quiet = [answer.s_input for answer in responses(members, laws[QUIET], hz, model.period_s, plants)]
    levels = level_gains(plants, laws[QUIET], laws[OPEN], hz, model.period_s)
    ends = list(zip(of_quiet, of_open, levels, strict=True))
    shares = np.linspace(0.0, 1.0, LEVELS)[:, None]
    least = [np.abs((q + shares * (o * (1.0 - g) - q)) / (1.0 - shares * g)).min(axis=0) for q, o, g in ends]
    return np.min(least, axis=0), np.max([largest_between(q, o, g)[0] for q, o, g in ends], axis=0)


def _between(
    members: list[Member], laws: dict[str, Controller], grid_hz: Array, period_s: float, plants: list[ComplexArray],
    levels: list[ComplexArray], judged: int,
) -> tuple[float, list[tuple[float, float]]]:  # fmt: skip
    """The level of the largest Ms over the first ``judged`` members, and each member's largest Ms, in and out."""
    ends = zip(
        *(responses(members, laws[name], grid_hz, period_s, plants) for name in (QUIET, OPEN)), levels, strict=True
    )
    peaks, worst, level = [], 0.0, 1.0
    for at, (quiet, opened, gain) in enumerate(ends):
        own = []
        for a, b in ((quiet.s_input, opened.s_input), (quiet.s_output, opened.s_output)):
            moduli, where = largest_between(a, b, gain)
            highest = int(np.argmax(moduli))
            own.append(float(moduli[highest]))
            if at < judged and own[-1] > worst:
                worst, level = own[-1], float(where[highest])
        peaks.append((own[0], own[1]))
    return level, peaks


def controllers(model: FilterModel, gains: Gains) -> dict[str, Controller]:
    """The controller in each setting of the filter: ``open``, and where there is one ``quiet``.

    Raises:
        DesignError: the filter has no steady state.
    """
    return {name: controller(model, gains, gain) for name, gain in filter_gains(model).items()}


def _blend(model: FilterModel, level: float) -> Array:
    """The filter's gain at a level: 0 quiet, 1 open."""
    of_setting = filter_gains(model)
    return of_setting[QUIET] + level * (of_setting[OPEN] - of_setting[QUIET])


def _worst(margins: tuple[MemberMargins, ...]) -> MemberMargins:
    """The worst figure of each kind, of one plant in every setting."""
    first, *others = margins
    for other in others:
        first = replace(
            first,
            ms=max(first.ms, other.ms),
            ms_output=max(first.ms_output, other.ms_output),
            gm_db=min(first.gm_db, other.gm_db),
            pm_deg=min(first.pm_deg, other.pm_deg),
            dm_ms=min(first.dm_ms, other.dm_ms),
            stable=first.stable and other.stable,
        )
    return first


def _performance(settings: RigSettings, laws: dict[str, Controller]) -> Performance:
    """Disturbances with the open filter, noise at rest with the quiet one."""
    opened = performance(settings, laws[OPEN])
    if QUIET not in laws:
        return opened
    quiet = performance(settings, laws[QUIET])
    return replace(
        opened,
        command_noise_mm_s=quiet.command_noise_mm_s,
        command_noise_per_speed=quiet.command_noise_per_speed,
        tension_noise_n=quiet.tension_noise_n,
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


@dataclass(frozen=True)
class Responses:
    """Frequency responses with one plant, each of the grid's shape; of an unstable loop too."""

    loop: ComplexArray  # L, broken at the plant's input
    s_input: ComplexArray
    s_output: ComplexArray
    disturbance: ComplexArray  # true tension per disturbance speed with the stroke locked, N s/mm


def plant_responses(members: list[Member], grid_hz: Array, period_s: float) -> list[ComplexArray]:
    """`Member.response` of every member on the grid."""
    z = np.exp(2j * np.pi * grid_hz * period_s)
    return [plant.response(z) for plant in members]


@functools.lru_cache(maxsize=2)  # a search judges hundreds of designs over one family
def _on_grid(family: Family, period_s: float) -> tuple[Array, list[ComplexArray]]:
    """The grid of a family's verdict, and the response there of every member and reported one."""
    both = [*family.members, *family.reported]
    grid = frequency_grid(both, period_s)
    return grid, plant_responses(both, grid, period_s)


def responses(
    members: list[Member], law: Controller, grid_hz: Array, period_s: float, plants: list[ComplexArray] | None = None
) -> Iterator[Responses]:
    """Responses of every member with one controller; ``plants``: their own, if they are known."""
    per_tension, per_speed = law.response(np.exp(2j * np.pi * grid_hz * period_s))
    for tension, speed, disturbance in plants or plant_responses(members, grid_hz, period_s):
        loop = -(per_tension * tension + per_speed * speed)
        sensitivity = 1.0 / (1.0 + loop)
        yield Responses(loop, sensitivity, (1.0 - per_speed * speed) * sensitivity, disturbance)


def margins_over(
    members: list[Member], law: Controller, grid_hz: Array, period_s: float, plants: list[ComplexArray] | None = None
) -> list[MemberMargins]:
    """Margins of every member with one controller; ``grid_hz`` from ``frequency_grid``, plants as in `responses`."""
    omega = 2.0 * np.pi * grid_hz
    found = []
    for plant, answer in zip(members, responses(members, law, grid_hz, period_s, plants), strict=True):
        names, lag_scale = (plant.k_m, plant.k_scale, plant.delay_scale), plant.lag_scale
        if closed_loop(plant, law).spectral_radius >= 1.0:
            found.append(MemberMargins(*names, math.inf, math.inf, 0.0, 0.0, 0.0, stable=False, lag_scale=lag_scale))
            continue
        gm_db, pm_deg, dm_ms = classical_margins(answer.loop, omega)
        ms, ms_output = (float(np.abs(at).max()) for at in (answer.s_input, answer.s_output))
        found.append(MemberMargins(*names, ms, ms_output, gm_db, pm_deg, dm_ms, stable=True, lag_scale=lag_scale))
    return found


def classical_margins(loop: ComplexArray, omega: Array) -> tuple[float, float, float]:
    """Gain margin dB, phase margin deg and delay margin ms of a stable loop sampled at ``omega`` rad/s.

    The smallest over all crossovers, interpolated between samples; infinite without a crossover.
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
