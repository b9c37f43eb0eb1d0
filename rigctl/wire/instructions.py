"""A step out of a state: a command with its values, or hands at a place with what they change there."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Hands(StrEnum):
    """What hands do at a place."""

    LOOK = "look, or keep away: nothing changes"
    MEND = "the part does what it is for again"
    SUPPORT = "the payload is supported from below"
    PRESS = "the emergency stop is pressed"
    RELEASE = "the emergency stop is released"
    START = "the daemon is started anew"


class HandsAt(StrEnum):
    """Where hands act that are not at a part of the rig (`rigctl.diagnosis.part.Part`)."""

    HALL = "hall"
    PAYLOAD = "below the payload"
    E_STOP = "emergency stop"
    COMPUTER = "the rig's computer"
    RIG = "the rig"
    """Which part is not known."""


class ReadAtRig(StrEnum):
    """What is read at the rig for the value of a command."""

    STROKE = "the stroke, measured at the cylinder"
    WITNESS = "whether the encoder or the cell shows how the load moves"


@dataclass(frozen=True)
class Instruction:
    """One thing to do next. ``verb``: the command, whose button it is; "" for a step of hands.

    ``read_at_rig``: what the command's value is. ``places``: where the hands act, one of them.
    """

    text: str
    verb: str = ""
    read_at_rig: ReadAtRig | None = None
    places: tuple[str, ...] = (HandsAt.HALL,)
    hands: Hands = Hands.LOOK
