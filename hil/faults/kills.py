"""Kills and stops of the real daemon's processes at random instants in all modes: the load must not move."""

from __future__ import annotations

import math
import random
import signal
import time
from dataclasses import dataclass

from hil.faults.expected import Reaction
from hil.faults.judging.judge import DRIVE_STOPS_MS
from hil.faults.processes import TOLD_MS, Seen, judged, kills, strike
from hil.faults.rows.live_rows_rig import CONTROL, GATEWAY, SUPERVISOR, Live, LiveError, live
from hil.scenario.play import Advance
from rigctl.config.settings import RigSettings
from rigctl.model.states import Mode

SEED = 1
SHARES = ((CONTROL, 0.5), (GATEWAY, 0.3), (SUPERVISOR, 0.2))
SIGNALS = (signal.SIGKILL, signal.SIGSTOP)
LONGEST_WAIT_S = 0.6
"""Longest time from entering a mode to the interference; TENSIONING and RELEASING take longer."""


@dataclass(frozen=True)
class Kill:
    """One interference and its outcome."""

    victim: str
    signal: str
    mode: str
    moved_mm: float | None  # None where the loop rightly went on moving the load
    tension_off_pct: float  # NaN where rig or daemon failed
    findings: tuple[str, ...]

    @property
    def reached(self) -> bool:
        """Whether the interference took place and was observed."""
        return math.isfinite(self.tension_off_pct)

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {**vars(self), "tension_off_pct": self.tension_off_pct if self.reached else None}


def play(settings: RigSettings, count: int, advance: Advance, seed: int = SEED) -> list[Kill]:
    """Play ``count`` interferences, in each mode in turn.

    Raises:
        ScenarioError: rig and daemon do not come up, or do not come back (1).
    """
    chance = random.Random(seed)
    found: list[Kill] = []
    while len(found) < count:
        with live(settings) as rig:
            while len(found) < count and _strike(rig, chance, found, advance):
                pass
    return found


def _strike(rig: Live, chance: random.Random, found: list[Kill], advance: Advance) -> bool:
    """Play one interference; returns whether rig and daemon are fit for another."""
    mode = Mode(len(found) % len(Mode))
    victim = chance.choices([name for name, _ in SHARES], [share for _, share in SHARES])[0]
    number = chance.choice(SIGNALS)
    advance(0.0, f"{number.name} {victim} in {mode.name}")
    try:
        rig.enter(mode)
        time.sleep(chance.uniform(0.0, LONGEST_WAIT_S))
        now = rig.mode
        if now is None:
            raise LiveError(f"the loop does not tick in {mode.name}")
        dies = victim == SUPERVISOR and number is signal.SIGKILL
        seen = strike(rig, kills(victim, number), comes_back=not dies)
        if dies:
            rig.start_daemon()
    except LiveError as error:
        found.append(Kill(victim, number.name, mode.name, None, math.nan, (str(error),)))
        return False
    finally:
        advance(1.0, "")
    found.append(_judged(victim, number, now, seen, rig.target_n))
    return True


def _judged(victim: str, number: signal.Signals, mode: Mode, seen: Seen, target_n: float) -> Kill:
    stops = victim == CONTROL or (victim == SUPERVISOR and number is signal.SIGKILL)
    expected = Reaction.DRIVE_STOPS if stops and mode is not Mode.DISARMED else Reaction.RIDDEN
    if mode is Mode.FAULT and not stops:
        expected = Reaction.KEPT
    within_ms = DRIVE_STOPS_MS if victim == CONTROL else TOLD_MS
    _, findings = judged(expected, seen, mode, within_ms)
    moves = not stops and mode in (Mode.TENSIONING, Mode.RELEASING)
    off_n = seen.setpoint_off_n if moves else seen.tension_off_n
    return Kill(
        victim,
        number.name,
        mode.name,
        None if moves else seen.moved_mm,
        100.0 * off_n / target_n,
        tuple(findings),
    )


def document(found: list[Kill]) -> dict[str, object]:
    """What ``--json`` writes: every kill, and the largest figures."""
    moved = [kill.moved_mm for kill in found if kill.moved_mm is not None]
    return {
        "kills": [{**kill.as_dict(), "ok": not kill.findings} for kill in found],
        "moved_max_mm": max(moved, default=None),
        "tension_off_max_pct": max((kill.tension_off_pct for kill in found if kill.reached), default=None),
        "bad": sum(bool(kill.findings) for kill in found),
        "ok": not any(kill.findings for kill in found),
        "total": len(found),
    }
