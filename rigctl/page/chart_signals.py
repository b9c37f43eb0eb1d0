"""The signals of the charts, derived from the records of the fast stream."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.model.samples import Quality
from rigctl.model.signals import ANGLES, DEVICES, SHOWN
from rigctl.model.states import Mode
from rigctl.wire.trust import doubted_bits

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
    """A field while the value of its device, if it has one, is trusted; an old value would look like a steady one."""

    def values(records: npt.NDArray[Any]) -> Values:
        if not device:
            return np.asarray(records[field] * factor, np.float64)
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


STRIPS = tuple(sorted((row for row in SHOWN.values() if row.shown.strip), key=lambda row: row.shown.strip))
"""The signals that have a strip chart, from the top."""
_UNRECORDED = {"error_pct": _error_pct}
SIGNALS: tuple[ChartSignal, ...] = (
    *(ChartSignal(row.name, _UNRECORDED.get(row.name) or _seen(row.name, row.device)) for row in STRIPS),
    ChartSignal("target_n", lambda records: np.asarray(records["target_n"], np.float64)),
    *(ChartSignal(row.degrees, _seen(row.name, row.device, 180.0 / np.pi)) for row in ANGLES),
    ChartSignal("lateness_us", lambda records: records["lateness_ns"] / 1000.0),
    ChartSignal("mode", lambda records: np.asarray(records["mode"], np.float64)),
)


FIELDS = frozenset(
    {"target_n", "mode", "cause_bits", "setpoint_n", "tension_n", "vertical_n"}
    | {row.name for row in (*STRIPS, *ANGLES) if row.code}
    | {f"{device}_quality" for device in DEVICES}
)
"""Fields of a record from which the signals are derived."""


def values_of(records: npt.NDArray[Any]) -> Values:
    """Records (n) as values (n, signals); a value that is not finite becomes NaN."""
    with np.errstate(invalid="ignore", over="ignore"):
        values = np.stack([signal.of(records) for signal in SIGNALS], axis=1)
    values[~np.isfinite(values)] = np.nan
    return values
