"""Statistics of the error of the vertical tension: largest, rms, spread, and longest time beyond a bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.metrics.phases import JudgedPhase
from rigctl.metrics.tension_error import largest_and_rms_pct, stretches

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics over one or several phases; the error is vertical less target, in percent of it (equation 16)."""

    seconds: float
    samples: int
    eta_max_pct: float
    eta_rms_pct: float
    eta_p99_pct: float
    mean_n: float
    spread_n: float
    """Standard deviation."""
    vertical_min_n: float
    vertical_max_n: float
    max_at_ns: int
    not_good: int
    """Samples of cell or inclinometer that were not good; they count in the statistics."""
    without_value: int
    """Ticks without a finite error."""
    missing: int
    """Records missing from the file."""


def error_n(records: Array, phase: JudgedPhase) -> Floats:
    """Vertical tension less the target over the judged part of a phase, in N; NaN for no value."""
    return np.asarray(records["vertical_n"][phase.judged], np.float64) - phase.target_n


def statistics(records: Array, judged: list[JudgedPhase], rate_hz: float) -> ErrorStatistics | None:
    """Statistics over all of ``judged`` together, each against its own target; None without a sample."""
    errors = [error_n(records, phase) for phase in judged]
    whole = np.concatenate(errors) if errors else np.empty(0)
    known = np.isfinite(whole)
    if not np.any(known):
        return None
    relative = np.concatenate([error / phase.target_n for error, phase in zip(errors, judged, strict=True)])
    largest, rms = largest_and_rms_pct(1.0 + relative[known], 1.0)
    at = int(np.argmax(np.where(known, np.abs(relative), -1.0)))
    rows = np.concatenate([np.arange(phase.first, phase.after) for phase in judged])
    there = [records[phase.judged] for phase in judged]
    verticals = np.concatenate([part["vertical_n"] for part in there])[known]
    bad = [np.count_nonzero((part["tension_quality"] | part["inclination_quality"]) != 0) for part in there]
    gone = [int(part["seq"][-1]) - int(part["seq"][0]) + 1 - len(part) for part in there]
    return ErrorStatistics(
        seconds=sum((int(part["t_ns"][-1]) - int(part["t_ns"][0])) * 1e-9 + 1.0 / rate_hz for part in there),
        samples=int(np.count_nonzero(known)),
        eta_max_pct=largest,
        eta_rms_pct=rms,
        eta_p99_pct=float(np.percentile(np.abs(relative[known]), 99.0)) * 100.0,
        mean_n=float(np.mean(whole[known])),
        spread_n=float(np.std(whole[known])),
        vertical_min_n=float(np.min(verticals)),
        vertical_max_n=float(np.max(verticals)),
        max_at_ns=int(records["t_ns"][rows[at]]),
        not_good=int(sum(bad)),
        without_value=int(np.count_nonzero(~known)),
        missing=int(sum(gone)),
    )


def longest_beyond_s(errors_n: Floats, bound_n: float, rate_hz: float) -> float:
    """Longest unbroken time of ``|error|`` above ``bound_n``, in s; 0 if it never was."""
    longest = max((after - first for first, after in stretches(np.abs(errors_n) > bound_n)), default=0)
    return longest / rate_hz
