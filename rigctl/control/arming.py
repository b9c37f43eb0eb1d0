"""The sequence from an accepted command to the drive's power, with the brake test (IEC 61800-5-2: SBT).

A stop ends in this order: the motor stops, the drive reports a state without power, the brake closes, the stroke
stands still. The drive is not switched on before: CiA 402 lets a controller take a drive from QUICK STOP ACTIVE or
from a closing brake back to OPERATION ENABLED, and then neither motor nor brake would carry the load for a while.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.control.checks import Check
from rigctl.control.power_seen import STILL_NS
from rigctl.control.snapshot import Snapshot

AWAIT_NS = 2_000_000_000
"""Longest wait of an accepted ARM; the longest stop a rig file may have is shorter."""
BRAKE_TEST_NS = 2_000_000_000
LONG_TEST_NS = 10_000_000_000
"""Of a brake that is known not to hold: at 0.005 mm/s it slips by `BRAKE_TEST_MM` then."""
BRAKE_TEST_MM = 0.05
"""A brake holds without creep: its play and wind-up are taken up while it closes, before the test begins."""
TEST_TEXT = " in the brake test, the drive stays off"


class Awaited(NamedTuple):
    """One row: a check and its condition."""

    check: Check
    met: Callable[[Snapshot], bool]


AWAITED = (
    Awaited(Check.SEQUENCE_RUNNING, lambda x: x.power.brake_time_over),
    Awaited(Check.NOT_AT_STANDSTILL, lambda x: x.still_ns >= STILL_NS),
)
"""In order. They pass by themselves, so they are awaited, and named only if they do not pass in time."""
AWAITED_CHECKS = Check.SEQUENCE_RUNNING | Check.NOT_AT_STANDSTILL


def awaited(snapshot: Snapshot) -> Check:
    """Checks of the rows that are not met now."""
    found = Check(0)
    for row in AWAITED:
        if not row.met(snapshot):
            found |= row.check
    return found


def stop_running(snapshot: Snapshot) -> bool:
    """A stop is under way: the drive has power, its brake is closing, or the stroke is not at rest yet."""
    return not snapshot.power.stop_over and bool(awaited(snapshot))


class ArmingStep(Enum):
    """State of the sequence before the drive's power."""

    WAIT = auto()
    READY = auto()
    LATE = auto()  # a row was not met in time
    SLIPPED = auto()  # the brake test has failed


class Sequence:
    """From an accepted command to the drive's power: the rows of `AWAITED`, then the test of an ARM or BRAKE_TEST.

    ``moved_mm`` and ``tension_n``: motion of the stroke and tension on the brake in the last test. ``tested``: True the
    brake has held, False the rope was too slack to test it, None no test.
    """

    def __init__(self, settings: RigSettings) -> None:
        self._settings = settings
        self._until_ns = self._test_ns = 0
        self._anchor_mm: float | None = None
        self._over = False
        self._lasts_ns = BRAKE_TEST_NS
        self._awaited = AWAITED_CHECKS
        self.moved_mm = self.tension_n = 0.0
        self.tested: bool | None = None

    def begin(self, t_ns: int, *, tests: bool, at_rest: bool = True, longer: bool = False) -> None:
        """A command has been accepted. Only one that ``tests`` the brake does: a load that it holds is a test already.

        ``at_rest``: the stroke has to stand still first, as it does unless the brake slips. ``longer``: the test is
        made on every rig, and is longer.
        """
        self._lasts_ns = LONG_TEST_NS if longer else BRAKE_TEST_NS
        self._awaited = AWAITED_CHECKS if at_rest else Check.SEQUENCE_RUNNING
        self._until_ns = t_ns + AWAIT_NS
        self._anchor_mm, self.tested = None, None
        self._over = not (tests and (longer or self._settings.cylinder.brake_test))

    def note_slip(self, moved_mm: float) -> None:
        """The load has moved by so much on the closed brake, before the test under way began."""
        self.moved_mm = moved_mm

    def step(self, t_ns: int, snapshot: Snapshot, *, slack: bool) -> ArmingStep:
        """One tick; READY lets the drive be switched on."""
        if self._anchor_mm is not None and not self._over:
            return self._test(t_ns, snapshot)
        if awaited(snapshot) & self._awaited:
            return ArmingStep.LATE if t_ns >= self._until_ns else ArmingStep.WAIT
        if self._over:
            return ArmingStep.READY
        self.tension_n, self.moved_mm = snapshot.tension_n, 0.0
        if slack:
            self.tested, self._over = False, True
            return ArmingStep.READY
        self._anchor_mm, self._test_ns = snapshot.stroke_mm, t_ns
        return ArmingStep.WAIT

    def _test(self, t_ns: int, snapshot: Snapshot) -> ArmingStep:
        """The closed brake carries the load and the motor has no power, so the stroke must not move."""
        assert self._anchor_mm is not None
        self.moved_mm = snapshot.stroke_mm - self._anchor_mm
        if not abs(self.moved_mm) <= BRAKE_TEST_MM:
            self._over = True
            return ArmingStep.SLIPPED
        if t_ns - self._test_ns >= self._lasts_ns:
            self.tested, self._over = True, True
            self._until_ns = t_ns + AWAIT_NS
        return ArmingStep.WAIT
