"""The top of |S| between the lines at which S is known: a polynomial of 1/S through the lines about the largest one.

1/S is 1 + L at the plant's input, and (1 + L) over the response of the inner loop at the tension. Both have no pole
near a maximum of |S|, not even of a mechanism without damping, whose resonance is a minimum of |S| there: a polynomial
of 1/S in the logarithm of the frequency converges where one of S would need more terms. It is linear in its
coefficients, so that least squares gives it and its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

DEGREE = 3
"""Of the polynomial; that of one degree less says what the lines may miss."""
BEYOND = 2.0
"""The terms left out add up to this times the last one that is not, if each is at most 2/3 of the one before."""
COUNTS = 31, 21, 15, 11, 9, 7, 5
"""Of lines that take part: the most of which both polynomials are within their errors, the least in any case."""
FITS = 1.0
"""Most of the mean square of a residual over the 95 % error of its line; 0.52 is that of normal errors."""
FINE = 201
STEEP = 1e-3
"""Least relative change of |S| over that of the frequency, in a division."""
NO_ERROR = 1e-9
"""Least error of a line in the weights."""


class SensitivityLine(NamedTuple):
    """S measured at a frequency; ``error``: of its modulus, half of the 95 % interval."""

    place: str
    hz: float
    value: complex
    error: float


class LocalPeak(NamedTuple):
    """A maximum of |S|."""

    place: str
    hz: float
    ms: float
    scatter: float
    """Half of its 95 % interval, by the errors of the lines."""
    missed: float
    """What is not known between the lines: `BEYOND` times the difference of the polynomials of two degrees in it."""
    reach: float
    """How far from it, as a share of its frequency, lines would say more: where |S| has fallen by about 30 %, or as far
    as the next two lines if the polynomial is not that of the lines."""

    @property
    def error(self) -> float:
        """Half of its interval."""
        return self.scatter + self.missed


def local_peaks(lines: Sequence[SensitivityLine]) -> list[LocalPeak]:
    """Every maximum of |S| over the lines of one place."""
    of_place = _each_once(lines)
    moduli = np.array([abs(line.value) for line in of_place])
    about = np.pad(moduli, 2, constant_values=-np.inf)
    highest = np.max([about[shift : shift + len(moduli)] for shift in range(5)], axis=0)
    return [_peak(of_place, int(at)) for at in np.flatnonzero(moduli >= highest)]


def _each_once(lines: Sequence[SensitivityLine]) -> list[SensitivityLine]:
    """In the order of frequency; one that was measured in several passes has the mean, weighted by its errors."""
    found = []
    for _, same in groupby(sorted(lines, key=lambda line: line.hz), key=lambda line: round(line.hz, 6)):
        each = list(same)
        weights = np.array([1.0 / max(line.error, NO_ERROR) ** 2 for line in each])
        value = complex(np.average([line.value for line in each], weights=weights))
        found.append(each[0]._replace(value=value, error=float(weights.sum() ** -0.5)))
    return found


def _peak(lines: Sequence[SensitivityLine], at: int) -> LocalPeak:
    """About the line at this place of the list, which is in the order of frequency."""
    u = np.log([line.hz for line in lines])
    inverse: Complex = 1.0 / np.array([line.value for line in lines], np.complex128)
    errors = np.maximum(np.array([line.error for line in lines]) * np.abs(inverse) ** 2, NO_ERROR)
    for count in COUNTS:
        first = min(max(at - count // 2, 0), len(lines) - count)
        if first < 0:
            continue
        near = slice(first, first + count)
        middle, half = 0.5 * (u[first] + u[first + count - 1]), 0.5 * (u[first + count - 1] - u[first])
        x = (u - middle) / half
        fits = [_Fit(x[near], inverse[near], errors[near], degree) for degree in (DEGREE, DEGREE - 1)]
        if max(fit.misfit for fit in fits) <= FITS:
            break
    between = np.linspace(x[max(at - 1, 0)], x[min(at + 1, len(x) - 1)], FINE)
    curves = [fit.at(between) for fit in fits]
    tops = [int(np.argmin(np.abs(curve))) for curve in curves]
    ms, less = (1.0 / float(np.abs(curve[top])) for curve, top in zip(curves, tops, strict=True))
    line_off = abs(1.0 / abs(complex(fits[0].at(x[at : at + 1])[0])) - abs(lines[at].value))
    missed = BEYOND * abs(ms - less) + max(0.0, line_off - lines[at].error)
    slope = float(np.abs(np.gradient(curves[0], between * half)[tops[0]]))
    reach = 1.0 / max(ms * slope, STEEP)
    if fits[0].misfit > FITS:
        reach = min(reach, float(half * (between[-1] - between[0])))
    return LocalPeak(
        lines[at].place, float(np.exp(middle + half * between[tops[0]])), ms,
        ms**2 * fits[0].error_at(float(between[tops[0]])), missed, reach,
    )  # fmt: skip


class _Fit:
    """Least squares of a complex polynomial, weighted by errors."""

    def __init__(self, x: Floats, values: Complex, errors: Floats, degree: int) -> None:
        self._powers = np.vander(x, degree + 1, increasing=True) / errors[:, None]
        self._coefficients = np.linalg.lstsq(self._powers, values / errors, rcond=None)[0]
        residuals = self._powers @ self._coefficients - values / errors
        self.misfit = float(np.sum(np.abs(residuals) ** 2)) / (len(x) - degree - 1)
        """Mean square of a residual over its error."""

    def at(self, x: Floats) -> Complex:
        return np.asarray(np.vander(x, len(self._coefficients), increasing=True) @ self._coefficients)

    def error_at(self, x: float) -> float:
        row = np.vander([x], len(self._coefficients), increasing=True)[0]
        return float(np.linalg.norm(np.linalg.lstsq(self._powers.T, row, rcond=None)[0]))
