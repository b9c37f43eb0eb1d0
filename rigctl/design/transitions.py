"""A dwell time with which changes between the entries of a gain table leave the loop stable, with every member.

Each entry has passed the gate by itself, but a sequence of stable loops may be unstable. With every plant p of the
families of two entries i and j, the loop in entry i is ``x' = A_i x``; where it changes to j, one tick is
``x' = M_ij x``, in which the integral takes over the change of the feedback. With ``V_i = x' P_i x`` falling in every
setting of entry i's filter, the loop is stable under any sequence of changes that are at least N ticks apart if

    M_ij' (A_j^N)' P_j A_j^N M_ij < P_i    for all i, j

(Geromel, Colaneri: Stability and stabilization of discrete time switched systems, International Journal of Control 79
(2006), 719-728, with the tick of the change added). A_j is that of the open filter, in which the loop keeps it for N
ticks; from then on V_j falls however the filter opens. This is a bound on slow variation in time, not a common Lyapunov
function, which neighbouring entries with much different stiffness need not have. The plant is each member in turn, as
in the gate: its own change from entry to entry is slow against the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Gains
from rigctl.design.closed_loop import Controller, closed_loop, controller, law_errors
from rigctl.design.gains import OPEN, QUIET, filter_gains
from rigctl.design.plant_family import Array, Family, Member
from rigctl.design.switching import common_lyapunov

FINE = 0.15
LONGEST_S = 60.0
"""A dwell time beyond this is no proof of use: the operating point moves within it."""


class TransitionError(ValueError):
    """The changes cannot be proven; ``str()`` is one line that says why."""


@dataclass(frozen=True)
class EntryLoop:
    """An entry of a table: the settings that it believes, its gains, and the family it was judged over."""

    settings: RigSettings
    gains: Gains
    family: Family


@dataclass(frozen=True)
class _Parts:
    opened: Controller
    quiet: Controller
    errors: Array  # rows, see `law_errors`
    quiet_errors: Array
    gains: Gains


def dwell_time_s(entries: Sequence[EntryLoop]) -> float:
    """The shortest time for which an entry has to stay in force, for every pair of entries and every plant of theirs.

    Raises:
        TransitionError: there is none, or it is longer than ``LONGEST_S``.
    """
    rate_hz = entries[0].settings.loop.rate_hz
    parts = [_parts(entry) for entry in entries]
    if len({len(part.opened.a) for part in parts}) > 1:
        raise TransitionError("the entries differ in the drive's delay by a tick or more")
    longest = 0
    for i, j in permutations(range(len(entries)), 2):
        for plant in (*entries[i].family.members, *entries[j].family.members):
            ticks = _ticks(plant, parts[i], parts[j], round(LONGEST_S * rate_hz))
            if ticks is None:
                point = plant.k_scale * entries[i].settings.plant.stiffness_n_mm
                raise TransitionError(
                    f"no dwell time within {LONGEST_S:g} s from entry {i + 1} to {j + 1} "
                    f"(plant of about {point:.4g} N/mm)"
                )
            longest = max(longest, ticks)
    return longest / rate_hz


def _parts(entry: EntryLoop) -> _Parts:
    model = filter_model(entry.settings)
    of_setting = filter_gains(model)
    opened = of_setting[OPEN]
    quiet = of_setting.get(QUIET, opened)
    return _Parts(
        controller(model, entry.gains, opened),
        controller(model, entry.gains, quiet),
        law_errors(model, entry.gains, opened),
        law_errors(model, entry.gains, quiet),
        entry.gains,
    )


def _ticks(plant: Member, before: _Parts, after: _Parts, most: int) -> int | None:
    """The least N, to a share of ``FINE``, for one change on one plant."""
    p_before, p_after = _lyapunov(plant, before), _lyapunov(plant, after)
    if p_before is None or p_after is None:
        return None
    # The change is affine in the filter's gain, so that its two settings stand for all between them.
    changes = [
        _change(plant, law, errors, before.gains, after.gains)
        for law, errors in ((before.opened, before.errors), (before.quiet, before.quiet_errors))
    ]
    scale = 1.0 / np.sqrt(np.diag(p_before))
    p_before = p_before * scale * scale[:, None]
    a = closed_loop(plant, after.opened).a

    def proven(ticks: int) -> bool:
        through = np.linalg.matrix_power(a, ticks)
        return all(_falls(p_before, p_after, through @ change * scale) for change in changes)

    ticks = 1
    while not proven(ticks):
        ticks *= 2
        if ticks > most:
            return None
    too_few = ticks // 2
    while ticks - too_few > max(1.0, FINE * ticks):  # what holds at N holds beyond, because V falls
        middle = (too_few + ticks) // 2
        ticks, too_few = (middle, too_few) if proven(middle) else (ticks, middle)
    return ticks


def _falls(p_before: Array, p_after: Array, through: Array) -> bool:
    fall = p_before - through.T @ p_after @ through
    return bool(np.linalg.eigvalsh(0.5 * (fall + fall.T)).min() > 0.0)


def _lyapunov(plant: Member, parts: _Parts) -> Array | None:
    """P of a function that falls in every setting of the filter; None if the loop is not stable in all of them."""
    from scipy.linalg import solve_discrete_lyapunov

    if parts.quiet is not parts.opened and not np.array_equal(parts.quiet.a, parts.opened.a):
        return common_lyapunov(plant, parts.quiet, parts.opened)
    loop = closed_loop(plant, parts.opened)
    if loop.spectral_radius >= 1.0:
        return None
    a = loop.a
    # Balanced by the loop's own states under unit noise, so that newtons and millimetres weigh alike.
    size = np.sqrt(np.diag(solve_discrete_lyapunov(a, np.eye(len(a)))))
    balanced = a * size / size[:, None]
    p = np.asarray(solve_discrete_lyapunov(balanced.T, np.eye(len(a))))
    return np.asarray(0.5 * (p + p.T) / np.outer(size, size))


def _change(plant: Member, law: Controller, errors: Array, old: Gains, new: Gains) -> Array:
    """The tick at whose end the entry changes: the integral takes over the change of the feedback."""
    a = closed_loop(plant, law).a.copy()
    first = len(a) - len(law.a)
    a[-1, first:] += (old.k_tension - new.k_tension) * errors[0] + (old.k_speed - new.k_speed) * errors[1]
    return a
