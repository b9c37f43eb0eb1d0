"""Levels between the filter's quiet and its open setting: any sequence of them is stable; the largest Ms of them all.

The closed loop is ``x' = (A + l b c) x``: A with the quiet gain, c x the innovation of the tension, b what the
difference of the two gains does with it, and 0 <= l(n) <= 1 in any order of time. One quadratic Lyapunov function
``x' P x`` falls for every such l if and only if A is stable and

    g = min over |z| = 1 of Re(1 - G(z)) > 0,    G(z) = c (zI - A)^-1 b

which is the circle criterion for the sector [0, 1] (Hitz, Anderson, Proc. IEE 116 (1969), 153-155; for one quadratic
constraint the S-procedure loses nothing: Yakubovich, Vestnik Leningrad Univ. 1971). g = 1 where the settings are equal.
l may jump in every tick: no bound on its rate is assumed. It holds for every sample that corrects. A
missing or rejected one corrects nothing in its tick, and the next is inside the sector again; a surprising one has a
gain of its own for its tick (`rigctl.control.law.estimator`). It says nothing of Ms, which is of levels that are
settled (`largest_between`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rigctl.design.closed_loop import Controller, closed_loop
from rigctl.design.plant_family import Array, ComplexArray, Member


def level_gains(
    plants: Sequence[ComplexArray], quiet: Controller, opened: Controller, grid_hz: Array, period_s: float
) -> list[ComplexArray]:
    """G with each plant's response on the grid (`Member.response`)."""
    z: ComplexArray = np.exp(2j * np.pi * grid_hz * period_s)
    injected, to_command = _injected(quiet, opened)
    outputs = np.stack([quiet.c, _innovation(quiet)]).astype(np.complex128)
    inputs = np.column_stack([quiet.b, injected])
    pencil = z[:, None, None] * np.eye(len(quiet.a)) - quiet.a
    through = np.linalg.solve(pencil.transpose(0, 2, 1), np.broadcast_to(outputs.T, (len(z), *outputs.T.shape)))
    answer = through.transpose(0, 2, 1) @ inputs  # (frequency, command or innovation, tension, speed or injection)
    (by_tension, by_speed, by_injection), (seen_tension, seen_speed, seen_injection) = answer.transpose(1, 2, 0)
    by_injection = by_injection + to_command
    found = []
    for tension, speed, _ in plants:
        command = by_injection / (1.0 - by_tension * tension - by_speed * speed)
        found.append(seen_injection + (seen_tension * tension + seen_speed * speed) * command)
    return found


def circle_margin(gain: ComplexArray) -> float:
    """g of a loop that is stable in the quiet setting, from its G on the grid."""
    return float(np.min(1.0 - gain.real))


def largest_between(at_quiet: ComplexArray, at_open: ComplexArray, gain: ComplexArray) -> tuple[Array, Array]:
    """The largest modulus of a response of the closed loop over all settled levels 0 to 1, and its level.

    Any response of the loop is ``T(l) = (T(0) + l b) / (1 - l G)``, because l adds a matrix of rank one. Its squared
    modulus is a ratio of quadratics in l, whose extrema are the roots of a third one: exact at each frequency.
    """
    b = at_open * (1.0 - gain) - at_quiet
    n0, n1, n2 = np.abs(at_quiet) ** 2, 2.0 * (at_quiet.conj() * b).real, np.abs(b) ** 2
    d1, d2 = -2.0 * gain.real, np.abs(gain) ** 2
    second, first, last = n2 * d1 - n1 * d2, 2.0 * (n2 - n0 * d2), n1 - n0 * d1
    root = np.sqrt(np.maximum(first**2 - 4.0 * second * last, 0.0))
    half = -0.5 * (first + np.copysign(root, first))
    with np.errstate(divide="ignore", invalid="ignore"):
        extrema = np.stack([half / second, last / half])
    inner = np.clip(np.nan_to_num(extrema, nan=0.0), 0.0, 1.0)
    levels = np.concatenate([inner, np.zeros((1, len(gain))), np.ones((1, len(gain)))])
    moduli = np.abs((at_quiet + levels * b) / (1.0 - levels * gain))
    best = np.argmax(moduli, axis=0)[None]
    return np.take_along_axis(moduli, best, 0)[0], np.take_along_axis(levels, best, 0)[0]


def common_lyapunov(plant: Member, quiet: Controller, opened: Controller) -> Array | None:
    """P of ``x' P x``, which falls in both settings, so in every one between them; None if there is none.

    The states are those of `closed_loop`. It is the stabilising solution of the criterion's Riccati equation, and is
    accepted only if both inequalities hold in numbers.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    loop = closed_loop(plant, quiet)
    b, c = _joined(plant, quiet, opened)
    # In the balanced states of the loop's own Lyapunov equation the entries of P are of one size.
    scale = np.sqrt(np.diag(_gramian(loop.a)))
    a, b, c = loop.a * scale / scale[:, None], b / scale, c * scale
    size = len(a)
    for small in (1e-3, 1e-6, 1e-9):
        try:
            found = solve_discrete_are(a, b[:, None], small * np.eye(size), np.array([[-1.0]]), s=0.5 * c[:, None])
        except (LinAlgError, ValueError):
            continue
        p = 0.5 * (found + found.T)
        if _falls(p, a) and _falls(p, a + np.outer(b, c)):
            return np.asarray(p / np.outer(scale, scale))
    return None


def _gramian(a: Array) -> Array:
    from scipy.linalg import solve_discrete_lyapunov

    return np.asarray(solve_discrete_lyapunov(a, np.eye(len(a))))


def _falls(p: Array, a: Array) -> bool:
    """``x' P x`` is positive and falls under ``a``."""
    fall = p - a.T @ p @ a
    return bool(np.linalg.eigvalsh(p).min() > 0.0 and np.linalg.eigvalsh(0.5 * (fall + fall.T)).min() > 0.0)


def _innovation(law: Controller) -> Array:
    """Row of the controller's state that is the innovation of the tension."""
    row = np.zeros(len(law.a))
    row[0], row[law.states] = -1.0, 1.0
    return row


def _injected(quiet: Controller, opened: Controller) -> tuple[Array, float]:
    """What one innovation times the difference of the gains does to the controller's state, and to its command."""
    at = quiet.states
    return opened.a[:, at] - quiet.a[:, at], float(opened.c[at] - quiet.c[at])


def _joined(plant: Member, quiet: Controller, opened: Controller) -> tuple[Array, Array]:
    """b and c of the loop closed around a plant."""
    before = len(plant.a) + plant.delay_ticks
    row = np.concatenate([np.zeros(before), _innovation(quiet)])
    at = before + quiet.states
    column: Array = closed_loop(plant, opened).a[:, at] - closed_loop(plant, quiet).a[:, at]
    return column, row
