"""The cell's creep from the record of a load's step (`rigctl.control.excitation.trials.LoadStep`). Pure functions.

After a step S of the load at time 0, on a cell at rest before, the reading is

    r(t) = L + S (a_1 (1 - exp(-t / tau_1)) + a_2 (1 - exp(-t / tau_2)))

fitted to the means of the bins, each with the variance of its mean; L, S a_1 and S a_2 follow linearly from the two
time constants (variable projection, Golub and Pereyra 1973). Uncertainties are from the covariance of all five
(JCGM 102), with Student's t, and widened where the residuals are larger than the scatter in the bins (Birge 1932).

What else moves the reading meanwhile counts against the finding: the zero's drift, and, where the load hangs on the
rope and not on the cell alone, the relaxation of rope, spring and mechanism, which no record of the cell tells apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rigctl.commission.cell_uncertainty import FLOOR_N, TEMPERATURE_N_H, student
from rigctl.control.excitation.trials import LoadBin
from rigctl.ipc.correction import CREEP_FASTEST_S, CREEP_SLOWEST_S, CreepTerm, creep_share

Array = npt.NDArray[np.float64]
FEWEST_BINS = 12
DRIFT_N_S = TEMPERATURE_N_H / 3600.0  # of the zero, where no temperature is measured
APART = 3.0  # least ratio of the two time constants: nearer ones share a creep between them as they like
KNOWN = 4.0  # the creep is stated for so many times the length of the record
_STEPS = 25
_ROUNDS = 28
_TIMES = 200


class CreepError(ValueError):
    """The record does not determine a creep; ``str()`` says why, in one line."""


@dataclass(frozen=True)
class CreepFit:
    """Creep per load. Uncertainties are expanded ones at 95 %.

    ``step_n``: of the reading. ``share_u``, ``time_u_s``: of each term. ``seen_s``: length of the record. ``total``:
    creep at its end as a share of the load, with ``total_u``. ``creep_u``: largest uncertainty of the correction up to
    ``KNOWN`` times the record, the zero's drift included. ``drift_n``: what the zero may have drifted meanwhile.
    ``misfit``: root of chi squared per degree of freedom.
    """

    terms: tuple[CreepTerm, CreepTerm]
    share_u: tuple[float, float]
    time_u_s: tuple[float, float]
    step_n: float
    seen_s: float
    total: float
    total_u: float
    creep_u: float
    drift_n: float
    misfit: float

    @property
    def told(self) -> bool:
        """The change of the reading is more than its uncertainty and more than the zero may have drifted."""
        return abs(self.total * self.step_n) > math.hypot(self.total_u * self.step_n, self.drift_n)

    @property
    def bounded(self) -> bool:
        """Both time constants are well inside what a creep and this record can show."""
        return all(CREEP_FASTEST_S <= term.time_s <= CREEP_SLOWEST_S for term in self.terms)


def fit(bins: Sequence[LoadBin], *, zero_n: float = 0.0, zero_n_k: float | None = None, u_n_k: float = 0.0) -> CreepFit:
    """Fit the creep.

    Args:
        bins: in their order; those before the step have negative times.
        zero_n: reading of the unloaded cell, where no bin comes before the step.
        zero_n_k: known change of zero per kelvin, taken out by the bins' temperatures; None: not known.
        u_n_k: its expanded uncertainty.

    Raises:
        CreepError: too few bins, or no step.
    """
    after = [part for part in bins if part.after_s > 0.0]
    if len(after) < FEWEST_BINS:
        raise CreepError(f"the record has {len(after)} parts after the load's step, expected {FEWEST_BINS} or more")
    before = [part.mean_n for part in bins if part.after_s <= 0.0]
    t_s = np.array([part.after_s for part in after])
    mean_n = np.array([part.mean_n for part in after])
    cell_c = np.array([part.cell_c for part in after])
    warmer_k = cell_c - cell_c[0]
    drift_n = DRIFT_N_S * float(t_s[-1])
    if zero_n_k is not None and np.isfinite(warmer_k).all():
        mean_n = mean_n - zero_n_k * warmer_k
        drift_n = u_n_k * float(np.max(np.abs(warmer_k)))
    deviation_n = np.array([math.hypot(part.rms_n / math.sqrt(part.samples), FLOOR_N) for part in after])
    step_n = float(mean_n[0]) - (before[-1] if before else zero_n)
    if abs(step_n) < 1.0:
        raise CreepError(f"the load's step is {step_n:z.2f} N: nothing was hung on the cell")
    return _fit(t_s, mean_n, deviation_n, step_n, drift_n)


def _fit(t_s: Array, mean_n: Array, deviation_n: Array, step_n: float, drift_n: float) -> CreepFit:
    fast_s, slow_s = _times(t_s, mean_n, deviation_n)
    linear, chi2 = _amplitudes(t_s, mean_n, deviation_n, fast_s, slow_s)
    freedom = len(t_s) - 5
    misfit = math.sqrt(chi2 / freedom)
    design = _jacobian(t_s, linear, fast_s, slow_s) / deviation_n[:, None]
    # A record without any creep does not determine the time constants: they then count as unknown by a factor e.
    prior = np.diag([0.0, 0.0, 0.0, 1.0, 1.0])
    covariance = np.linalg.inv(design.T @ design + prior) * max(1.0, misfit) ** 2
    widened = student(freedom)
    spread = widened * np.sqrt(np.diag(covariance))
    shares = linear[1:] / step_n
    terms = (CreepTerm(float(shares[0]), fast_s), CreepTerm(float(shares[1]), slow_s))
    seen_s = float(t_s[-1])

    def error(times_s: Array) -> Array:
        """Expanded uncertainty in N of the creep at these times after the step."""
        slopes = _jacobian(times_s, linear, fast_s, slow_s)
        slopes[:, 0] = 0.0
        return np.asarray(widened * np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes)), float)

    within_n = float(error(np.array([seen_s]))[0])
    largest_n = float(np.max(error(np.linspace(0.0, KNOWN * seen_s, _TIMES))))
    known = np.array([seen_s])
    total = float((_jacobian(known, linear, fast_s, slow_s)[:, 1:3] @ shares)[0])
    return CreepFit(
        terms,
        (float(spread[1] / abs(step_n)), float(spread[2] / abs(step_n))),
        (float(spread[3]) * fast_s, float(spread[4]) * slow_s),
        step_n,
        seen_s,
        total,
        within_n / abs(step_n),
        math.hypot(largest_n, drift_n) / abs(step_n),
        drift_n,
        misfit,
    )


def _times(t_s: Array, mean_n: Array, deviation_n: Array) -> tuple[float, float]:
    """Time constants of the least sum of squares, by a grid and a search that halves its steps."""
    lowest, highest = math.log(max(CREEP_FASTEST_S, t_s[0])), math.log(min(CREEP_SLOWEST_S, KNOWN * t_s[-1]))
    apart = math.log(APART)

    def cost(fast: float, slow: float) -> float:
        if not lowest <= fast <= slow - apart <= highest - apart:
            return math.inf
        return _amplitudes(t_s, mean_n, deviation_n, math.exp(fast), math.exp(slow))[1]

    grid = np.linspace(lowest, highest, _STEPS)
    best = min((cost(fast, slow), fast, slow) for fast in grid for slow in grid)
    step = float(grid[1] - grid[0])
    for _ in range(_ROUNDS):
        _, fast, slow = best
        around = [(cost(fast + i * step, slow + j * step), fast + i * step, slow + j * step)
                  for i in (-1, 0, 1) for j in (-1, 0, 1)]  # fmt: skip
        if (nearby := min(around))[0] < best[0]:
            best = nearby
        else:
            step *= 0.5
    return math.exp(best[1]), math.exp(best[2])


def _amplitudes(t_s: Array, mean_n: Array, deviation_n: Array, fast_s: float, slow_s: float) -> tuple[Array, float]:
    """Level and the two amplitudes in N, and chi squared."""
    basis = np.stack([np.ones_like(t_s), -np.expm1(-t_s / fast_s), -np.expm1(-t_s / slow_s)], axis=1)
    weighted = basis / deviation_n[:, None]
    wanted = mean_n / deviation_n
    found, *_ = np.linalg.lstsq(weighted, wanted, rcond=None)
    return np.asarray(found, float), float(np.sum((wanted - weighted @ found) ** 2))


def _jacobian(t_s: Array, linear: Array, fast_s: float, slow_s: float) -> Array:
    """Derivatives of the reading by level, amplitudes and logarithms of the time constants."""
    columns = [np.ones_like(t_s)]
    columns += [-np.expm1(-t_s / time_s) for time_s in (fast_s, slow_s)]
    columns += [
        -amplitude * (t_s / time_s) * np.exp(-t_s / time_s)
        for amplitude, time_s in zip(linear[1:], (fast_s, slow_s), strict=True)
    ]
    return np.stack(columns, axis=1)


def course(creep: Sequence[CreepTerm], after_s: float) -> float:
    """Creep as a share of the load, so long after the load came."""
    return math.fsum(term.share * -math.expm1(-after_s / term.time_s) for term in creep)


def in_words(found: CreepFit) -> str:
    """Shares in % of the load and time constants with their 95 % uncertainties."""
    terms = [
        f"{100 * term.share:+z.4f} +- {100 * share_u:.4f} % in {term.time_s:.0f} +- {time_u_s:.0f} s"
        for term, share_u, time_u_s in zip(found.terms, found.share_u, found.time_u_s, strict=True)
    ]
    return (
        f"creep {100 * found.total:+z.4f} +- {100 * found.total_u:.4f} % of the load in {found.seen_s / 60:.0f} min "
        f"({', '.join(terms)}; in the end {100 * creep_share(found.terms):+z.4f} %)"
    )
