"""The sequence from an accepted command to the drive's power, with the brake test (IEC 61800-5-2: SBT).

A stop ends in this order: the motor stops, the drive reports a state without power, the brake closes, the stroke
stands still. The drive is not switched on before: CiA 402 lets a controller take a drive from QUICK STOP ACTIVE or
from a closing brake back to OPERATION ENABLED, and then neither motor nor brake would carry the load for a while.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import NamedTuple

from rigctl.control.power.power_seen import STILL_NS
from rigctl.control.snapshot import Snapshot
from rigctl.model.checks import Check

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


@dataclass(frozen=True, slots=True)
class Preparation:
    """Of an accepted command, before the drive's power: the rows of `AWAITED`, then the test by ARM or BRAKE_TEST.

    ``moved_mm`` and ``tension_n``: motion of the stroke and tension on the brake in the test. ``tested``: True the
    brake has held, False the rope was too slack to test it, None no test. ``tests``: it is still to be made, or is.
    """

    until_ns: int = 0
    tests: bool = False
    lasts_ns: int = BRAKE_TEST_NS
    awaited: Check = AWAITED_CHECKS
    anchor_mm: float | None = None
    from_ns: int = 0
    moved_mm: float = 0.0
    tension_n: float = 0.0
    tested: bool | None = None


NOT_PREPARED = Preparation()


def begin(t_ns: int, *, tests: bool, at_rest: bool = True, longer: bool = False) -> Preparation:
    """A command has been accepted. Only one that ``tests`` the brake does: a load that it holds is a test already.

    ``at_rest``: the stroke has to be at rest first, as it is unless the brake slips. ``longer``: of a brake that is
    known not to hold, or by BRAKE_TEST.
    """
    awaits = AWAITED_CHECKS if at_rest else Check.SEQUENCE_RUNNING
    return Preparation(t_ns + AWAIT_NS, tests, LONG_TEST_NS if longer else BRAKE_TEST_NS, awaits)


def prepare(at: Preparation, t_ns: int, snapshot: Snapshot, *, slack: bool) -> tuple[Preparation, ArmingStep]:
    """One tick; READY lets the drive be switched on."""
    if at.anchor_mm is not None and at.tests:
        return _test(at, at.anchor_mm, t_ns, snapshot)
    if awaited(snapshot) & at.awaited:
        return at, ArmingStep.LATE if t_ns >= at.until_ns else ArmingStep.WAIT
    if not at.tests:
        return at, ArmingStep.READY
    at = replace(at, tension_n=snapshot.tension_n, moved_mm=0.0)
    if slack:
        return replace(at, tested=False, tests=False), ArmingStep.READY
    return replace(at, anchor_mm=snapshot.stroke_mm, from_ns=t_ns), ArmingStep.WAIT


def _test(at: Preparation, anchor_mm: float, t_ns: int, snapshot: Snapshot) -> tuple[Preparation, ArmingStep]:
    """The closed brake carries the load and the motor has no power, so the stroke must not move."""
    at = replace(at, moved_mm=snapshot.stroke_mm - anchor_mm)
    if not abs(at.moved_mm) <= BRAKE_TEST_MM:
        return replace(at, tests=False), ArmingStep.SLIPPED
    if t_ns - at.from_ns >= at.lasts_ns:
        at = replace(at, tested=True, tests=False, until_ns=t_ns + AWAIT_NS)
    return at, ArmingStep.WAIT
