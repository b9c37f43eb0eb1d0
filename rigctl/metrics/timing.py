"""Timing of the loop: lateness, work, missed deadlines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.metrics.tension_error import percentiles_us

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Timing:
    """Timing of all ticks in the recording; a missed deadline is a grid period without a tick."""

    ticks: int
    period_us: float
    lateness_us: dict[str, float]
    work_us: dict[str, float]
    missed_deadlines: int
    later_than_period: int
    simulated: bool
    """The recording is of simulated time, in which no tick is late."""
    latest_ns: int
    """Time of the tick with the largest lateness."""


def timing(records: Array, rate_hz: float) -> Timing:
    """Figures of ``RECORD`` slots, at least one."""
    lateness = np.asarray(records["lateness_ns"])
    period_ns = 1e9 / rate_hz
    return Timing(
        ticks=len(records),
        period_us=period_ns / 1000.0,
        lateness_us=percentiles_us(lateness),
        work_us=percentiles_us(np.asarray(records["work_ns"])),
        missed_deadlines=grown(records, "skipped"),
        later_than_period=int(np.count_nonzero(lateness > period_ns)),
        simulated=not bool(np.any(lateness)),
        latest_ns=int(records["t_ns"][int(np.argmax(lateness))]),
    )


def grown(records: Array, name: str) -> int:
    """Growth of a counter over the records; each control process starts it at 0 again."""
    values = np.asarray(records[name]).astype(np.int64)
    steps = np.diff(values)
    restarted = np.diff(np.asarray(records["tick"]).astype(np.int64)) < 0
    return int(np.sum(np.where(restarted, values[1:], steps)))
