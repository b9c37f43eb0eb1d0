"""The signals of the charts, derived from the records of the fast stream."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.control.modes import Mode
from rigctl.ipc.record import Quality
from rigctl.metrics.tension_error import error_pct

Values = npt.NDArray[np.float64]
_NOT_SEEN = int(Quality.STALE | Quality.INVALID | Quality.NEVER)


@dataclass(frozen=True)
class ChartSignal:
    """One value per record; NaN for no value."""

    name: str
    of: Callable[[npt.NDArray[Any]], Values]


def _seen(field: str, device: str, factor: float = 1.0) -> Callable[[npt.NDArray[Any]], Values]:
    """A field while its device's sample is fresh and valid; an old value would look like a steady one."""

    def values(records: npt.NDArray[Any]) -> Values:
        return np.where(records[f"{device}_quality"] & _NOT_SEEN, np.nan, records[field] * factor)

    return values


def _error_pct(records: npt.NDArray[Any]) -> Values:
    """Vertical error in percent of the target, while COMPENSATING."""
    target = records["target_n"]
    known = (records["mode"] == Mode.COMPENSATING) & (target > 0)
    known &= (records["tension_quality"] & _NOT_SEEN) == 0
    return np.where(known, error_pct(records["vertical_n"], np.where(known, target, 1.0)), np.nan)


SIGNALS: tuple[ChartSignal, ...] = (
    ChartSignal("vertical_n", _seen("vertical_n", "tension")),
    ChartSignal("target_n", lambda records: np.asarray(records["target_n"], np.float64)),
    ChartSignal("error_pct", _error_pct),
    ChartSignal("stroke_mm", _seen("stroke_mm", "drive")),
    ChartSignal("speed_mm_s", _seen("speed_mm_s", "drive")),
    ChartSignal("tangential_deg", _seen("tangential_rad", "inclination", 180.0 / np.pi)),
    ChartSignal("normal_deg", _seen("normal_rad", "inclination", 180.0 / np.pi)),
    ChartSignal("lateness_us", lambda records: records["lateness_ns"] / 1000.0),
    ChartSignal("mode", lambda records: np.asarray(records["mode"], np.float64)),
)


FIELDS = frozenset(
    {"vertical_n", "target_n", "stroke_mm", "speed_mm_s", "tangential_rad", "normal_rad", "mode"}
    | {f"{device}_quality" for device in ("tension", "drive", "inclination")}
)
"""Fields of a record from which the signals are derived."""


def values_of(records: npt.NDArray[Any]) -> Values:
    """Records (n) as values (n, signals); a value that is not finite becomes NaN."""
    with np.errstate(invalid="ignore", over="ignore"):
        values = np.stack([signal.of(records) for signal in SIGNALS], axis=1)
    values[~np.isfinite(values)] = np.nan
    return values
