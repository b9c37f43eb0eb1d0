"""The compensating error of equation (16), its windows, and percentiles of nanoseconds."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.model.states import Mode

Array = npt.NDArray[Any]
IN_FLIGHT_TICKS = 200  # answers to the last SYNCs may still arrive: the fewest missing within these ticks are lost
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}


def percentiles_us(values_ns: Array) -> dict[str, float]:
    """p50, p99, p99.9 and maximum of nanoseconds, in microseconds (interpolated between ranks); zeros for none."""
    if not len(values_ns):
        return dict.fromkeys(PERCENTILES, 0.0)
    found = np.percentile(values_ns, list(PERCENTILES.values()))
    return {name: round(float(value) / 1000.0, 1) for name, value in zip(PERCENTILES, found, strict=True)}


def stretches(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and after-last index of each unbroken stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def compensating_windows(records: Array, settle_s: float) -> list[tuple[int, int]]:
    """Spans ``(from_ns, to_ns)`` of COMPENSATING, each without its first ``settle_s``."""
    spans = []
    for first, after in stretches(records["mode"] == Mode.COMPENSATING):
        start = int(records["t_ns"][first]) + round(settle_s * 1e9)
        end = int(records["t_ns"][after - 1])
        if start < end:
            spans.append((start, end))
    return spans


def within(t_ns: Array, spans: list[tuple[int, int]]) -> npt.NDArray[np.bool_]:
    """Mask of the times that lie in any of the spans."""
    inside = np.zeros(len(t_ns), dtype=bool)
    for start, end in spans:
        inside |= (t_ns >= start) & (t_ns <= end)
    return inside


def error_pct(vertical_n: Any, target_n: Any) -> Any:
    """Compensating error ``(Fz - Fd) / Fd`` in percent: equation (16) with its sign; of numbers or arrays."""
    return (vertical_n - target_n) / target_n * 100.0


def largest_and_rms_pct(vertical_n: Array, target_n: float) -> tuple[float, float]:
    """Largest magnitude and rms of the compensating error in percent; NaN for no sample."""
    if not len(vertical_n):
        return float("nan"), float("nan")
    error = error_pct(vertical_n, target_n)
    return float(np.max(np.abs(error))), float(np.sqrt(np.mean(error**2)))
