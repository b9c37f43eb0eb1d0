"""The convex program: the least error of any linear law within limits of S and of the command's noise.

Solved by Clarabel (Goulart, Chen 2024), an interior-point solver with certified optimality, through CVXPY.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cvxpy
import numpy as np
from scipy.linalg import block_diag, toeplitz
from scipy.signal import fftconvolve

from hil.studies.compare.bound.linear_law import Disturbance, NoBoundError, StrokeAnswer, Tone, at, basis, triangular
from rigctl.design.optimise import Limits
from rigctl.design.plant_family import Array

FROM_HZ, POINTS = 0.1, 160
"""Of the grid on which S is limited, logarithmic and as many evenly spaced: a long memory can ripple. Between its
points S may be larger, so that the bound is on the safe side."""
SIGMAS = 3.3
"""Of the noise in a largest error: what 1000 independent samples exceed once."""
EVERY = 50
REGULARISATION = 1e-7
"""Of Clarabel's linear systems; at its default of 1e-8 those of a second sensor are too near singular."""
JOLT_TICKS = 500
"""What a jolt's error is after them counts as none."""


@dataclass(frozen=True)
class FamilyGap:
    """How far the plants of a family are from the nominal one.

    With Delta_i the difference of a member's answer (N per mm/s) from the nominal one, and the same controller,
    ``S_i = S / (1 - Delta_i x)``, so that ``|S| + ms |Delta_i x| <= ms`` is sufficient for ``|S_i| <= ms``. It is
    convex in x, and of all members the largest of Delta_i counts.
    """

    hz: Array
    largest: Array
    """Modulus of Delta_i at each frequency: of the members the largest, up to the frequencies beside it."""


@dataclass(frozen=True)
class Task:
    """One plant, its cell's noise in N rms, the limits that a law keeps, and its memory in ticks."""

    answer: StrokeAnswer
    noise_n: float
    limits: Limits
    memory: int
    rate_hz: float
    family: FamilyGap | None = None
    """None: the limit of S is kept on the one plant."""

    def grid(self, points: int = POINTS) -> Array:
        """Frequencies in Hz, to Nyquist."""
        nyquist = 0.5 * self.rate_hz
        even = np.linspace(nyquist / points, nyquist, points)
        found: Array = np.unique(np.concatenate([np.geomspace(FROM_HZ, nyquist, points), even]))
        return found


class Errors(NamedTuple):
    """The true error of a law, N: root mean square with the cell's noise, its part without, largest without, noise."""

    rms_n: float
    disturbed_n: float
    largest_n: float
    noise_n: float


class Law(NamedTuple):
    """The best law of a program."""

    x: Array
    value: float
    """What was minimised: N rms, or the share of `least_share`."""
    ms: float
    """On a grid ten times as dense as that of the program."""
    command_noise_mm_s: float


Case = Disturbance | Tone


def least(task: Task, case: Case) -> Law:
    """The law with the least rms error of one disturbance and the cell's noise.

    Raises:
        NoBoundError: no law keeps the limits, or the solver fails.
    """
    laws = basis(task.memory)
    a, d, noise = _parts(task, case, laws)
    share = 1.0 / math.sqrt(len(d))
    whole = triangular(np.vstack([share * np.column_stack([a, d]), np.column_stack([noise, np.zeros(len(noise))])]))
    c, scale = cvxpy.Variable(a.shape[1]), _scale(task)
    error = (whole[:, :-1] @ c + whole[:, -1]) / scale
    return _solved(task, laws, c, cvxpy.sum_squares(error), [], lambda best: scale * math.sqrt(best))


def least_largest(task: Task, case: Disturbance, sigmas: float = SIGMAS, every: int = EVERY) -> Law:
    """The law with the least largest error of one disturbance plus so many standard deviations of its noise.

    Of the ticks only one in ``every`` is held, which leaves the bound on the safe side. Raises: as `least`.
    """
    laws, scale = basis(task.memory), _scale(task)
    a, d, noise = _parts(task, case, laws)
    c, largest, rms = cvxpy.Variable(a.shape[1]), cvxpy.Variable(), cvxpy.Variable()
    rows = [
        cvxpy.norm(triangular(noise) / scale @ c) <= rms,
        cvxpy.abs(a[::every] / scale @ c + d[::every] / scale) <= largest,
    ]
    return _solved(task, laws, c, largest + sigmas * rms, rows, lambda best: scale * best)


def least_jolt(task: Task, case: Disturbance, speed_max_mm_s: float, acceleration_max_mm_s2: float) -> float:
    """The least rms error, N, of one disturbance by any law, linear or not, whose command keeps the drive's limits.

    It may know all of the disturbance from the first tick that counts on, and answers in the next; noise is left out.
    Raises: as `least`.
    """
    d = case.true[case.first :][:JOLT_TICKS]
    count = len(d)
    late = np.cumsum(task.answer.true)[1:]  # from command to tension, without the tick of the sample
    late = np.concatenate([late, np.full(count, late[-1])])[:count]
    u = cvxpy.Variable(count)
    step = acceleration_max_mm_s2 / task.rate_hz
    rows = [u[0] == 0.0, cvxpy.abs(u) <= speed_max_mm_s, cvxpy.abs(cvxpy.diff(u)) <= step]
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(toeplitz(late, np.zeros(count)) @ u + d)), rows)
    return math.sqrt(_value(problem) / len(case.true[case.first :]))


def _parts(task: Task, case: Case, laws: Array) -> tuple[Array, Array, Array]:
    """``A, d`` of the error ``A c + d`` and rows of the noise, c of the cell's law and of one fed the inclination."""
    a, d = case.errors(task.answer, laws)
    noise = _noise(task, laws)
    if isinstance(case, Disturbance) and case.seen is not None:
        forward, its_noise = case.forward(task.answer, laws)
        a, noise = np.column_stack([a, forward]), block_diag(noise, its_noise)
    return a, d, noise


def _noise(task: Task, laws: Array) -> Array:
    """Rows of the true tension's noise from the cell, N."""
    found: Array = task.noise_n * fftconvolve(task.answer.true[:, None], laws, axes=0)
    return found


def _scale(task: Task) -> float:
    """Unit of an error in N that the solver sees as about one."""
    return 0.1 * task.noise_n or 1.0


def least_share(task: Task, cases: Sequence[Case], reached_n: Sequence[float]) -> Law:
    """The law with the least share t, so that each disturbance's rms error is at most t times that ``reached_n``.

    Raises: as `least`.
    """
    laws = basis(task.memory)
    c, t, noise = cvxpy.Variable(laws.shape[1]), cvxpy.Variable(), cvxpy.Variable()
    scale = _scale(task)
    rows = [cvxpy.norm(triangular(_noise(task, laws)) / scale @ c) <= noise]
    for case, reached in zip(cases, reached_n, strict=True):
        a, d = case.errors(task.answer, laws)
        whole = triangular(np.column_stack([a, d])) / (math.sqrt(len(d)) * scale)
        rows.append(cvxpy.norm(cvxpy.hstack([whole[:, :-1] @ c + whole[:, -1], noise])) <= t * (reached / scale))
    return _solved(task, laws, c, t, rows, float)


def errors(task: Task, case: Case, x: Array) -> Errors:
    """What a law with the sequence x makes of a disturbance; x may be longer than the task's memory."""
    a, d = case.errors(task.answer, x[:, None])
    error = a[:, 0] + d
    disturbed = float(np.sqrt(np.mean(error**2)))
    largest = float(np.hypot(*error) if isinstance(case, Tone) else np.abs(error).max())
    noise = task.noise_n * float(np.linalg.norm(np.convolve(task.answer.true, x)))
    return Errors(math.hypot(disturbed, noise), disturbed, largest, noise)


def command_noise(task: Task, x: Array) -> tuple[float, float]:
    """Rms of the command from the cell's noise, mm/s, and of its steps from tick to tick."""
    padded = np.concatenate([[0.0], x, [0.0]])
    steps = np.diff(np.concatenate([[0.0], np.diff(padded), [0.0]]))
    return task.noise_n * float(np.linalg.norm(np.diff(padded))), task.noise_n * float(np.linalg.norm(steps))


def peak(task: Task, x: Array) -> float:
    """Largest \\|S\\| of a law, on a dense grid."""
    z = np.exp(2j * np.pi * task.grid(10 * POINTS) / task.rate_hz)
    return float(np.abs(1.0 + at(task.answer.sensed, z) * at(x, z)).max())


def _solved(
    task: Task,
    laws: Array,
    c: cvxpy.Variable,
    cost: cvxpy.Expression,
    rows: list[cvxpy.Constraint],
    value: Callable[[float], float],
) -> Law:
    """Solve with the limits of every task; ``value`` gives the law's value by that of the cost."""
    command = np.diff(laws, axis=0, prepend=0.0, append=0.0)
    steps = np.diff(command, axis=0, prepend=0.0, append=0.0)
    limits, cell = task.limits, c[: laws.shape[1]]
    rows = [
        *rows,
        task.answer.gain * (laws.sum(axis=0) @ cell) == -1.0,
        _sensitivity(task, laws, cell) <= limits.ms,
        task.noise_n * cvxpy.norm(triangular(command) @ cell) <= limits.command_noise_mm_s,
        task.noise_n * cvxpy.norm(triangular(steps) @ cell) <= limits.step_mm_s,
    ]
    reached = _value(cvxpy.Problem(cvxpy.Minimize(cost), rows))
    x = laws @ np.asarray(c.value)[: laws.shape[1]]
    return Law(x, value(reached), peak(task, x), command_noise(task, x)[0])


def _sensitivity(task: Task, laws: Array, cell: cvxpy.Expression) -> cvxpy.Expression:
    """\\|S\\| at each frequency; with a family what `FamilyGap` adds to it."""
    hz = task.grid() if task.family is None else task.family.hz
    z = np.exp(2j * np.pi * hz / task.rate_hz)
    x = at(laws, z)
    b = (at(task.answer.sensed, z) * x).T
    own = cvxpy.norm(cvxpy.vstack([1.0 + b.real @ cell, b.imag @ cell]), axis=0)
    if task.family is None:
        return own
    gap = (task.limits.ms * task.family.largest * x).T
    return own + cvxpy.norm(cvxpy.vstack([gap.real @ cell, gap.imag @ cell]), axis=0)


def _value(problem: cvxpy.Problem) -> float:
    """The optimum; one that is known to Clarabel's reduced accuracy alone (a gap of 5e-5) is accepted."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # CVXPY's of that accuracy
            problem.solve(solver=cvxpy.CLARABEL, static_regularization_constant=REGULARISATION)
    except cvxpy.SolverError as error:
        raise NoBoundError(f"no bound: {error}") from None
    if problem.status not in (cvxpy.OPTIMAL, cvxpy.OPTIMAL_INACCURATE):
        raise NoBoundError(f"no bound: the convex program ended {problem.status}")
    return float(problem.value)
