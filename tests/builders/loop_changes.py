"""What tests do to the parts of a loop between two ticks, which no frame and no command does: in no other place."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from enum import StrEnum

import pytest

from hil.lockstep import Lockstep


class LoopStep(StrEnum):
    """A part of a tick, by the function that does it."""

    RECEIVE = "_receive"
    ESTIMATE = "observer.estimate"
    DECIDE = "_decide"
    WATCH = "_watch.look"
    SPEED = "_motion.speed_mm_s"
    SEND = "_send"
    RECORD = "_record"
    WRITE_RECORD = "_logbook.record"
    NOTICE = "_logbook.notice"


@contextmanager
def failing(rig: Lockstep, *steps: LoopStep) -> Iterator[None]:
    """These parts of every tick raise an exception."""

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("made up")

    with pytest.MonkeyPatch.context() as patch:
        for step in steps:
            *owner, name = step.split(".")
            patch.setattr(functools.reduce(getattr, owner, rig.loop), name, broken)
        yield


def end_time_of_trial(rig: Lockstep) -> None:
    """The time for which a trial may keep the motor on is over."""
    rig.loop._orders.powered_until_ns = rig.clock.now()


def end_time_of_carrying(rig: Lockstep) -> None:
    """The time for which the motor keeps a load that the brake does not hold is over."""
    machine = rig.loop.machine
    machine.sequence = replace(machine.sequence, carry_until_ns=rig.clock.now())


def doubt_stroke(rig: Lockstep, *, doubted: bool = True) -> None:
    """The position contradicts its speed, or no longer does: a stroke that creeps is only watched."""
    rig.loop._load.stroke._doubted = doubted


def leave_unexplained(rig: Lockstep, stretch_mm: float) -> None:
    """So much of the rope's stretch is explained by no motion."""
    rig.loop.observer._plausibility.seen.unexplained_mm = stretch_mm


def change_run_out(rig: Lockstep, slopes_mm_rad: Sequence[float]) -> None:
    """The bins of the run-out table have other slopes than the rail."""
    table = rig.loop.observer._run_out
    assert table is not None, "the rig has no run-out table"
    table.slopes_mm_rad[1:-1] = slopes_mm_rad
