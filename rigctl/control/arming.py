"""What is awaited between an accepted ARM and the drive's power, and the brake test.

The sequence of a stop ends in this order: the motor has stopped, the drive reports a state without power, the brake
has had its time to close, the stroke stands still. The drive is not switched on before all of it is over: CiA 402 lets
a controller take a drive from QUICK STOP ACTIVE or from a closing brake back to OPERATION ENABLED, and the load would
hang on neither motor nor brake meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum, auto
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.control.checks import Check
from rigctl.control.safety import Snapshot

STILL_NS = 200_000_000
STILL_MM = 0.02
"""20 units of 0x6064 (um), and four counts of an encoder of 5 um: more than quantisation and a toggling count make.
Over ``STILL_NS`` it is 0.1 mm/s, half of what `rigctl.control.safety` calls a brake that slips."""
STILL_MM_S = 0.05
"""5 units of 0x2044; below it the brake may close. Judged low-passed, because one count of the encoder in one
millisecond is 1 to 5 mm/s by itself."""
SPEED_S = 0.02
AWAIT_NS = 2_000_000_000
"""An accepted ARM waits so long; the longest stop a rig file may ask for is shorter."""
BRAKE_TEST_NS = 2_000_000_000
BRAKE_TEST_MM = 0.05
"""A brake holds without creep: play and wind-up of the brake are taken up while it closes, before the test begins."""
REACTION_NS = 2_000_000_000
"""A stroke that still moves so long after the drive has gone off hangs on a brake that slips: no stop will end that."""


class Standstill:
    """For how long the stroke has stood still, from position and reported speed."""

    def __init__(self, settings: RigSettings) -> None:
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        self._share = 1.0 / (1.0 + SPEED_S * settings.loop.rate_hz)
        self._anchor_mm, self._slow_mm_s = math.nan, 0.0
        self._since_ns = 0

    def look(self, now_ns: int, stroke_mm: float, speed_mm_s: float, age_ns: int) -> int:
        """Nanoseconds of standstill as of ``now_ns``; 0 while the drive's samples are missing or not finite."""
        self._slow_mm_s += (speed_mm_s - self._slow_mm_s) * self._share
        if not math.isfinite(self._slow_mm_s):
            self._slow_mm_s = 0.0
        near = abs(stroke_mm - self._anchor_mm) <= STILL_MM  # False for NaN
        if not (near and abs(self._slow_mm_s) < STILL_MM_S and age_ns <= self._stale_ns):
            self._anchor_mm, self._since_ns = stroke_mm, now_ns
        return now_ns - self._since_ns


class Awaited(NamedTuple):
    """One row: the check that names it, and whether it is met."""

    check: Check
    met: Callable[[Snapshot, RigSettings], bool]


AWAITED = (
    Awaited(Check.SEQUENCE_RUNNING, lambda x, s: x.off_ns >= s.cylinder.brake_delay_ms * 1_000_000),
    Awaited(Check.NOT_AT_STANDSTILL, lambda x, _: x.still_ns >= STILL_NS or x.brake_slip_known),
)
"""In order. They pass by themselves: ARM waits for them, and names them only if they do not."""
AWAITED_CHECKS = Check.SEQUENCE_RUNNING | Check.NOT_AT_STANDSTILL


def awaited(snapshot: Snapshot, settings: RigSettings) -> Check:
    """Rows that are not met now."""
    found = Check(0)
    for row in AWAITED:
        if not row.met(snapshot, settings):
            found |= row.check
    return found


def stop_running(snapshot: Snapshot, settings: RigSettings) -> bool:
    """A stop has begun and not ended: the drive has power, its brake closes, or the stroke has yet to come to rest."""
    if snapshot.off_ns >= max(REACTION_NS, settings.cylinder.brake_delay_ms * 1_000_000):
        return False
    return bool(awaited(snapshot, settings))


class Step(Enum):
    """Where the sequence before the drive's power stands."""

    WAIT = auto()
    READY = auto()
    LATE = auto()  # what is awaited did not come
    SLIPPED = auto()  # the brake test has failed


class Sequence:
    """From an accepted ARM to the drive's power: the rows of `AWAITED`, then the brake test.

    ``moved_mm`` and ``tension_n``: stroke moved, and the tension on the brake, of the last test. ``tested``: True the
    brake has held, False there was no tension to test it with, None no test.
    """

    def __init__(self, settings: RigSettings) -> None:
        self._settings = settings
        self._until_ns = self._test_ns = 0
        self._anchor_mm: float | None = None
        self._over = False
        self.moved_mm = self.tension_n = 0.0
        self.tested: bool | None = None

    def begin(self, t_ns: int) -> None:
        """An ARM has been accepted."""
        self._until_ns = t_ns + AWAIT_NS
        self._anchor_mm, self.tested = None, None
        self._over = not self._settings.cylinder.brake_test

    def step(self, t_ns: int, snapshot: Snapshot, *, slack: bool) -> Step:
        """One tick; the drive may be switched on when it says READY."""
        if self._anchor_mm is not None and not self._over:
            return self._test(t_ns, snapshot)
        if awaited(snapshot, self._settings):
            return Step.LATE if t_ns >= self._until_ns else Step.WAIT
        if self._over or snapshot.brake_slip_known:
            return Step.READY
        self.tension_n, self.moved_mm = snapshot.tension_n, 0.0
        if slack:
            self.tested, self._over = False, True
            return Step.READY
        self._anchor_mm, self._test_ns = snapshot.stroke_mm, t_ns
        return Step.WAIT

    def _test(self, t_ns: int, snapshot: Snapshot) -> Step:
        """The load hangs on the closed brake, the motor has no power: the stroke must not move."""
        assert self._anchor_mm is not None
        self.moved_mm = snapshot.stroke_mm - self._anchor_mm
        if not abs(self.moved_mm) <= BRAKE_TEST_MM:
            self._over = True
            return Step.SLIPPED
        if t_ns - self._test_ns >= BRAKE_TEST_NS:
            self.tested, self._over = True, True
            self._until_ns = t_ns + AWAIT_NS
        return Step.WAIT
