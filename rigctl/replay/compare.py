"""Comparison of a replay with its recording, tick by tick; and with the commands that other settings would give."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.ipc.record import RECORD
from rigctl.model.signals import RECORDED
from rigctl.model.states import Mode
from rigctl.replay.feed import Slots
from rigctl.replay.play import Batch

Advance = Callable[[float, str], None]
"""Called with the amount compared since the last call, and its name."""
NOT_COMPARED = ("seq", "command_seq", "hold_seq")
"""Numbers of slots, which differ because the replay has rings of its own."""
EXACT = frozenset(row.name for row in RECORDED if row.exact or row.code != "d")
"""Fields with full precision in a recording; the others have that of a float32."""
FRAMES = "frames sent"


@dataclass(frozen=True)
class Difference:
    """One field of one tick, then and now."""

    field: str
    then: Any
    now: Any


@dataclass(frozen=True)
class Divergence:
    """The first tick that differs."""

    t_ns: int
    tick: int
    differences: tuple[Difference, ...]


def first_difference(batches: Iterable[Batch], advance: Advance) -> tuple[int, Divergence | None]:
    """Number of equal ticks, and the first that differs.

    Args:
        batches: from `rigctl.replay.play.play`.
        advance: called with the number of ticks compared.
    """
    same = 0
    for batch in batches:
        at = _first_bad(batch)
        if at is not None:
            return same + at, _divergence(batch, at)
        same += len(batch.recorded)
        advance(len(batch.recorded), "")
    return same, None


def _equal(then: Slots, now: Slots, name: str) -> npt.NDArray[np.bool_]:
    if name in EXACT:
        a, b = then[name], now[name]
        nan = np.isnan(a) & np.isnan(b) if a.dtype.kind == "f" else False
        return np.asarray((a == b) | nan)
    with np.errstate(over="ignore"):
        a, b = then[name].astype(np.float32), now[name].astype(np.float32)
    return np.asarray((a == b) | (np.isnan(a) & np.isnan(b)))


def _compared() -> tuple[str, ...]:
    return tuple(name for name in RECORD.dtype.names or () if name not in NOT_COMPARED)


def _first_bad(batch: Batch) -> int | None:
    if len(batch.replayed) != len(batch.recorded):
        return min(len(batch.replayed), len(batch.recorded))
    good = np.array([then == now for then, now in batch.sent], bool)
    for name in _compared():
        good &= _equal(batch.recorded, batch.replayed, name)
    return None if good.all() else int(np.argmin(good))


def _divergence(batch: Batch, at: int) -> Divergence:
    then = batch.recorded[at : at + 1]
    now = batch.replayed[at : at + 1]
    found = []
    if not len(now):
        found.append(Difference("record", "written", "none"))
    else:
        for name in _compared():
            if not _equal(then, now, name)[0]:
                found.append(Difference(name, then[name][0].item(), now[name][0].item()))
    sent_then, sent_now = batch.sent[at]
    if sent_then != sent_now:
        found.append(Difference(FRAMES, _shown(sent_then), _shown(sent_now)))
    return Divergence(int(then["t_ns"][0]), int(then["tick"][0]), tuple(found))


def _shown(frames: list[tuple[int, bytes]]) -> str:
    return " ".join(f"{can_id:03X}#{data.hex().upper()}" for can_id, data in frames) or "none"


@dataclass
class Against:
    """Commands of other settings compared with those given, where both have the same mode and the drive is on."""

    ticks: dict[Mode, int] = field(default_factory=dict)
    then_mm2: dict[Mode, float] = field(default_factory=dict)  # sums of squares of the command
    now_mm2: dict[Mode, float] = field(default_factory=dict)
    apart_mm2: dict[Mode, float] = field(default_factory=dict)
    apart_max_mm_s: dict[Mode, float] = field(default_factory=dict)
    first_other_mode: tuple[int, Mode, Mode] | None = None  # t_ns, then, now
    other_mode_ticks: int = 0
    first_fault: tuple[int, int] | None = None  # t_ns and fault of the first that only the replay has
    t_ns: list[npt.NDArray[np.int64]] = field(default_factory=list)
    then_mm_s: list[npt.NDArray[np.float64]] = field(default_factory=list)
    now_mm_s: list[npt.NDArray[np.float64]] = field(default_factory=list)

    def add(self, batch: Batch) -> None:
        """Add a batch."""
        count = min(len(batch.recorded), len(batch.replayed))
        then, now = batch.recorded[:count], batch.replayed[:count]
        self.t_ns.append(then["t_ns"].copy())
        self.then_mm_s.append(then["command_mm_s"].copy())
        self.now_mm_s.append(now["command_mm_s"].copy())
        same = then["mode"] == now["mode"]
        self.other_mode_ticks += int(np.count_nonzero(~same))
        if self.first_other_mode is None and not same.all():
            at = int(np.argmin(same))
            self.first_other_mode = int(then["t_ns"][at]), Mode(int(then["mode"][at])), Mode(int(now["mode"][at]))
        faults = (now["fault"] != 0) & (then["fault"] == 0)
        if self.first_fault is None and faults.any():
            at = int(np.argmax(faults))
            self.first_fault = int(then["t_ns"][at]), int(now["fault"][at])
        for number in np.unique(then["mode"][same]).tolist():
            mode = Mode(number)
            here = same & (then["mode"] == number)
            a, b = then["command_mm_s"][here], now["command_mm_s"][here]
            self.ticks[mode] = self.ticks.get(mode, 0) + len(a)
            self.then_mm2[mode] = self.then_mm2.get(mode, 0.0) + float(a @ a)
            self.now_mm2[mode] = self.now_mm2.get(mode, 0.0) + float(b @ b)
            self.apart_mm2[mode] = self.apart_mm2.get(mode, 0.0) + float((b - a) @ (b - a))
            largest = float(np.max(np.abs(b - a)))
            self.apart_max_mm_s[mode] = max(self.apart_max_mm_s.get(mode, 0.0), largest)

    def rows(self) -> list[dict[str, Any]]:
        """One row for each mode: ticks, rms of both commands, rms and largest of their difference; mm/s."""
        return [
            {
                "mode": mode.name,
                "ticks": ticks,
                "then_rms_mm_s": (self.then_mm2[mode] / ticks) ** 0.5,
                "now_rms_mm_s": (self.now_mm2[mode] / ticks) ** 0.5,
                "apart_rms_mm_s": (self.apart_mm2[mode] / ticks) ** 0.5,
                "apart_max_mm_s": self.apart_max_mm_s[mode],
            }
            for mode, ticks in sorted(self.ticks.items())
        ]
