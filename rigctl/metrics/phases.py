"""The phases in which a recording is judged: COMPENSATING on one target, once it has settled."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.metrics.tension_error import stretches
from rigctl.model.states import Mode

SETTLE_S = 2.0
"""Time left out after entry into COMPENSATING, and after a new target is reached."""
ON_TARGET = 5e-4
"""A ramp is over when the set-point is within this fraction of the target; it ends there up to a float's precision."""

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class JudgedPhase:
    """A stay in COMPENSATING on one target; the records ``first`` to ``after`` (exclusive) are judged."""

    number: int
    entered_ns: int
    first: int
    after: int
    target_n: float
    ended: str
    """Why it ended, in words."""
    faulted: bool

    @property
    def judged(self) -> slice:
        """Indices of the judged records."""
        return slice(self.first, self.after)


def phases(records: Array, settle_s: float = SETTLE_S) -> list[JudgedPhase]:
    """Every phase long enough to be judged, in order.

    A change of target ends one phase and begins another, which is judged after the end of the set-point's ramp.

    Args:
        records: ``RECORD`` slots, sorted.
        settle_s: time left out at the beginning of each phase.
    """
    found: list[JudgedPhase] = []
    for begin, end in stretches(records["mode"] == Mode.COMPENSATING):
        targets = records["target_n"][begin:end]
        cuts = [begin, *(np.flatnonzero(np.diff(targets)) + begin + 1).tolist(), end]
        for start, after in itertools.pairwise(cuts):
            settled = start if start == begin else _on_target(records, start, after)
            t_ns = records["t_ns"][settled:after]
            first = settled + int(np.searchsorted(t_ns, int(t_ns[0]) + round(settle_s * 1e9))) if len(t_ns) else after
            if first >= after - 1 or not records["target_n"][start] > 0.0:
                continue
            ended, faulted = _end(records, after, end)
            entered_ns, target_n = int(records["t_ns"][start]), float(records["target_n"][start])
            found.append(JudgedPhase(len(found) + 1, entered_ns, first, after, target_n, ended, faulted))
    return found


def _on_target(records: Array, start: int, after: int) -> int:
    """Index at which the ramp to a new target is over."""
    there = records[start:after]
    cosine = np.cos(there["tangential_estimate_rad"]) * np.cos(there["normal_estimate_rad"])
    close = np.abs(there["setpoint_n"] * cosine / there["target_n"] - 1.0) < ON_TARGET
    return start + int(np.argmax(close)) if np.any(close) else after


def _end(records: Array, after: int, end: int) -> tuple[str, bool]:
    if after < end:
        return f"target changed to {records['target_n'][after]:g} N", False
    if after == len(records):
        return "end of the recording", False
    mode = int(records["mode"][after])
    name = Mode(mode).name if mode in Mode._value2member_map_ else str(mode)
    return name, mode == Mode.FAULT or bool(records["fault"][after])
