"""The judge of a draw: the plant's truth, against what the received frames showed and when."""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults.drawn import frames, stretches
from hil.faults.drawn.draw import Draw
from hil.faults.drawn.play import Branch
from hil.faults.drawn.stretches import STOP_S, Deviation, Flags
from hil.faults.judging.judge import DEAD_REST_MM, DEATH, LAST_S, MOVES_MM_S
from hil.faults.lockstep_run import KILLED_S
from rigctl.config.settings import RigSettings
from rigctl.model.states import Mode

REACTION_S = 0.22
"""Longest stated time from the first sample that shows a fault to the reaction."""
MOVED_MM, MOVED_SHARE, UNSEEN_SHARE = 1.0, 0.03, 0.1
"""What the load may move once a fault has been seen, and where it cannot be."""
GAP_S = 1.0
"""A fault that no frame has shown for so long is not seen with the next one's beginning."""


@dataclass(frozen=True)
class DrawVerdict:
    """One draw, judged."""

    index: int
    seen_s: float | None  # from power-on, of what the worst motion followed
    moved_n: float  # largest motion of the load after it was seen and the reaction's time
    unseen_n: float  # largest deviation of the load at any time
    allowed_n: float
    cap_n: float
    ended_s: float
    mode: str
    trips: tuple[str, ...]
    findings: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether the load stayed within the bound."""
        return not self.findings

    @property
    def moves_on(self) -> bool:
        """Whether the only finding is a motion within the bounds that went on to the end."""
        return bool(self.findings) and all(one.endswith(DEATH) for one in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """For files."""
        return {**asdict(self), "ok": self.ok}


def judge(draw: Draw, settings: RigSettings, branch: Branch, twin_rows: npt.NDArray[Any]) -> DrawVerdict:
    """Judge a branch by the truth, and by its frames only in when its fault could be seen."""
    k, target_n = settings.plant.stiffness_n_mm, settings.tension.target_n
    allowed_n = max(MOVED_SHARE * target_n, MOVED_MM * k)
    cap_n = max(UNSEEN_SHARE * target_n, allowed_n)
    end = branch.killed_at if branch.killed_at is not None else len(branch.rows)
    rows, twin = branch.rows[:end], twin_rows[:end]
    period_s = settings.loop.period_ns * 1e-9
    from_row = round(draw.faults[0].at_s / period_s)
    found = stretches.deviation(rows, twin, k, target_n, allowed_n, period_s)
    seen = frames.seen(rows, twin, settings, period_s)
    onsets = [round(fault.at_s / period_s) for fault in draw.faults]
    moved_n, seen_at = _moved_after(found, seen, onsets, period_s)
    excess_n = np.maximum(np.abs(found.off) - found.own, 0.0)[from_row:]
    unseen_n = float(excess_n.max(initial=0.0))
    findings = []
    if branch.error:
        findings.append(f"not played: {branch.error}")
    if moved_n > allowed_n:
        findings.append(f"seen, and the load moved by {moved_n:.1f} N, expected at most {allowed_n:.1f}")
    if unseen_n > cap_n:
        findings.append(f"the load was {unseen_n:.1f} N off, expected at most {cap_n:.1f}")
    findings += _sinks(rows, k, allowed_n, from_row)
    findings += _killed(branch, found, k, period_s)
    findings += branch.false
    return DrawVerdict(
        draw.index, None if seen_at is None else seen_at * period_s, moved_n, unseen_n, allowed_n, cap_n,
        end * period_s, Mode(int(rows["mode"][-1])).name, branch.trips, tuple(findings),
    )  # fmt: skip


def _spans(seen: Flags, onsets: list[int], gap: int) -> list[tuple[int, int]]:
    """Rows from and to of what has been seen: until the next fault begins, if no frame shows it any more by then."""
    spans: list[tuple[int, int]] = []
    edges = [*sorted(set(onsets)), len(seen)]
    for onset, end in itertools.pairwise(edges):
        rows = onset + np.flatnonzero(seen[onset:end])
        goes_on = bool(spans) and bool(seen[max(onset - gap, 0) : onset].any())
        if goes_on:
            spans[-1] = (spans[-1][0], end)
        elif len(rows):
            spans.append((int(rows[0]), end))
    return spans


def _moved_after(found: Deviation, seen: Flags, onsets: list[int], period_s: float) -> tuple[float, int | None]:
    """Largest motion of the load from the reaction's time after a fault was seen, and when that was."""
    worst, at = 0.0, None
    spans = _spans(seen, onsets, round(GAP_S / period_s))
    for start, stop in spans:
        moved_n = stretches.moved(found, start + round((REACTION_S + STOP_S) / period_s), stop)
        if (most := float(moved_n.max(initial=0.0))) > worst:
            worst, at = most, start
    return worst, at if at is not None or not spans else spans[0][0]


def _sinks(rows: npt.NDArray[Any], k: float, allowed_n: float, from_row: int) -> list[str]:
    """A closed brake that gives way is at least reported, as a fault, before the load has moved by what is allowed."""
    brake_mm, _ = stretches.own_mm(rows)
    for begin, end in stretches.parts(rows["mode"]):
        if int(rows["mode"][begin]) == Mode.FAULT:
            continue
        first = max(begin, from_row)
        if first < end and k * (brake_mm[end - 1] - brake_mm[first]) > allowed_n:
            moved = k * (brake_mm[end - 1] - brake_mm[first])
            return [f"the brake gave way by {moved:.1f} N in {Mode(int(rows['mode'][begin])).name} without a fault"]
    return []


def _killed(branch: Branch, found: Deviation, k: float, period_s: float) -> list[str]:
    """A load that stops only when the loop is dead: the rig lacked a reaction."""
    at = branch.killed_at
    if at is None:
        return []
    moved_n = stretches.moved(found, max(at - round(LAST_S / period_s), 0), at)
    rest = branch.rows["stroke_mm"][-round(KILLED_S / 3.0 / period_s) :]
    if moved_n[-1] / k > MOVES_MM_S * LAST_S and float(np.ptp(rest)) < DEAD_REST_MM:
        return [f"the load moved by {moved_n[-1] / k:.2f} mm in the last second, and only {DEATH}"]
    return []
