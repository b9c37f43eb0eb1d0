"""The signals of the charts, derived from the records of the fast stream."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.model.samples import Quality
from rigctl.model.states import Mode
from rigctl.wire.trust import DEVICES, doubted_bits

Values = npt.NDArray[np.float64]
_DOUBTED = {device: np.uint64(doubted_bits(device)) for device in DEVICES}
_NOT_SEEN = int(Quality.STALE | Quality.INVALID | Quality.NEVER)


@dataclass(frozen=True)
class ChartSignal:
    """One value per record; NaN for no value."""

    name: str
    of: Callable[[npt.NDArray[Any]], Values]


def _not_trusted(records: npt.NDArray[Any], device: str) -> npt.NDArray[np.bool_]:
    """Where a device's sample is not fresh and valid, or a cause puts it in doubt."""
    seen: npt.NDArray[np.bool_] = (records[f"{device}_quality"] & _NOT_SEEN) == 0
    doubted: npt.NDArray[np.bool_] = (records["cause_bits"].astype(np.uint64) & _DOUBTED[device]) != 0
    return np.logical_or(~seen, doubted)


def _seen(field: str, device: str, factor: float = 1.0) -> Callable[[npt.NDArray[Any]], Values]:
    """A field while its device's value is trusted; an old value would look like a steady one."""

    def values(records: npt.NDArray[Any]) -> Values:
        return np.where(_not_trusted(records, device), np.nan, records[field] * factor)

    return values


def _error_pct(records: npt.NDArray[Any]) -> Values:
    """Vertical error in percent of the target, while COMPENSATING; on the way to a new target that of the ramp."""
    target, tension = records["target_n"], records["tension_n"]
    cosine = np.where(np.abs(tension) > 1.0, records["vertical_n"] / np.where(tension == 0, 1.0, tension), 1.0)
    wanted = np.where(records["setpoint_n"] > 0, records["setpoint_n"] * cosine, target)
    known = (records["mode"] == Mode.COMPENSATING) & (target > 0)
    known &= ~_not_trusted(records, "tension")
    return np.where(known, 100.0 * (records["vertical_n"] - wanted) / np.where(known, target, 1.0), np.nan)


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
    {"vertical_n", "target_n", "stroke_mm", "speed_mm_s", "tangential_rad", "normal_rad", "mode", "cause_bits",
     "setpoint_n", "tension_n"}
    | {f"{device}_quality" for device in DEVICES}
)  # fmt: skip
"""Fields of a record from which the signals are derived."""


def values_of(records: npt.NDArray[Any]) -> Values:
    """Records (n) as values (n, signals); a value that is not finite becomes NaN."""
    with np.errstate(invalid="ignore", over="ignore"):
        values = np.stack([signal.of(records) for signal in SIGNALS], axis=1)
    values[~np.isfinite(values)] = np.nan
    return values
