"""What is wrong with a signal, and what the filter has made of its sample; the numbers are in the record."""

from __future__ import annotations

from enum import IntEnum, IntFlag


class Quality(IntFlag):
    """Why a signal is not good; 0 is good."""

    STALE = 1
    INVALID = 2
    SATURATED = 4
    NEVER = 8


class Verdict(IntEnum):
    """What became of a sensor's sample in a tick."""

    ABSENT = 0  # no sample came, or it was not a number
    USED = 1
    REJECTED = 2  # outside the gate
    IDLE = 3  # the rope is slack, so nothing can be estimated
