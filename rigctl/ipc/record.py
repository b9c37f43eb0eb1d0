"""The record of a tick and the other slots that cross between processes, as tables of fields.

Each table gives the packed struct the loop writes, the numpy dtype readers see, and the schema subscribers get.
All slots are little-endian and packed, and begin with the ring's sequence number.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np

from rigctl.config.signals import RECORDED


@dataclass(frozen=True)
class Field:
    """One value of a slot: its struct code, unit ("" for none) and meaning."""

    name: str
    code: str
    unit: str
    description: str


@dataclass(frozen=True)
class Slot:
    """A slot's fields without the leading ``seq``, and the layouts derived from them."""

    name: str
    fields: tuple[Field, ...]

    @property
    def layout(self) -> struct.Struct:
        """Struct of the fields without ``seq``, for a ``RingWriter``."""
        return struct.Struct("<" + "".join(field.code for field in self.fields))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Packed dtype with ``seq``, for a ``RingReader``; also the wire format of a fast block."""
        kinds = {"d": "<f8", "q": "<i8", "Q": "<u8", "I": "<u4", "H": "<u2", "B": "u1"}
        return np.dtype(
            [("seq", "<u8"), *((field.name, kinds.get(field.code) or f"S{field.code[:-1]}") for field in self.fields)]
        )


NEVER_AGE_NS = 1 << 60
"""A larger age means that no sample has come yet; messages and exports have null in its place."""


class Quality(IntFlag):
    """Why a signal is not good; 0 is good."""

    STALE = 1
    INVALID = 2
    SATURATED = 4
    NEVER = 8


class Flag(IntFlag):
    """States of a tick."""

    LIMITED_SPEED = 1
    LIMITED_ACCELERATION = 2
    LIMITED_STROKE = 4
    ARMING = 16
    DRIVE_ENABLED = 32
    STOPPING = 64
    STROKE_UNCONFIRMED = 4096  # the drive's position is not confirmed as the stroke, see control.homed


RECORD = Slot("record", tuple(Field(row.name, row.code, row.unit, row.meaning) for row in RECORDED))

EVENT = Slot(
    "event",
    (
        Field("t_ns", "q", "ns", "when, CLOCK_MONOTONIC"),
        Field("kind", "H", "", "see rigctl.control.events.Kind"),
        Field("a", "I", "", "meaning depends on kind"),
        Field("b", "I", "", "meaning depends on kind"),
        Field("value", "d", "", "what was found"),
        Field("limit", "d", "", "what is allowed"),
        Field("text", "80s", "", "where words are needed: an exception and its place"),
    ),
)

COMMAND = Slot(
    "command",
    (
        Field("t_ns", "q", "ns", "when it was given; an old one is not carried out"),
        Field("id", "Q", "", "comes back in the reply"),
        Field("verb", "B", "", "see rigctl.control.modes.Verb and Setting"),
        Field(
            "value",
            "d",
            "",
            "TARGET: newtons; IDENTIFY: 1 if the rope must be tight; ARM: 1 to drive away from an end; see Setting",
        ),
    ),
)

HOLD = Slot(
    "hold",
    (
        Field("t_ns", "q", "ns", "when it was given; an old one is not carried out"),
        Field("id", "Q", "", "comes back in the reply; never one of a command's, see HOLD_ID"),
        Field("uid", "I", "", "user of the process that gave it, as the kernel says (SO_PEERCRED)"),
        Field("pid", "I", "", "that process"),
        Field("operator", "256s", "", "who gave it, in that process's words"),
    ),
)

HOLD_ID = 1 << 62  # set in the id of every hold; ids of commands are CLOCK_MONOTONIC times, far below it

REPLY = Slot(
    "reply",
    (
        Field("t_ns", "q", "ns", "when"),
        Field("id", "Q", "", "of the command"),
        Field("accepted", "B", "", "1 carried out, 0 refused"),
        Field("reason", "H", "", "why refused, see rigctl.control.modes.Refusal"),
        Field(
            "checks",
            "Q",
            "",
            "preflight checks that failed, bits, see rigctl.control.checks.Check; CAUSE_PRESENT: "
            "the faults whose causes are there, bits 1 << number",
        ),
        Field("mode", "B", "", "mode after the command"),
        Field(
            "value",
            "d",
            "",
            "what the reply is about: target or tension; CAUSE_PRESENT: the fault whose cause is there; TARE, "
            "CALIBRATE: mean reading of the cell in N; IDENTIFY: how long it took in s",
        ),
        Field("spread", "d", "N", "TARE, CALIBRATE: rms of the reading about its mean; else 0"),
    ),
)

NOTE = Slot(
    "note",
    (
        Field("t_ns", "q", "ns", "when, CLOCK_MONOTONIC"),
        Field("kind", "H", "", "see rigctl.ipc.notes.Note"),
        Field("operator", "256s", "", "who"),
        Field("other", "256s", "", "whom it concerns beside the operator"),
        Field("reason", "480s", "", "why, in the operator's words"),
    ),
)

REQUEST = Slot(
    "desk",
    (
        Field("t_ns", "q", "ns", "when, CLOCK_MONOTONIC"),
        Field("answered", "B", "", "0 given to the loop, 1 answered"),
        Field("id", "Q", "", "of the command in the loop's ring; 0 where it did not get there"),
        Field("verb", "32s", "", "the command"),
        Field("value", "d", "", "of the command, NaN for none"),
        Field("operator", "256s", "", "who"),
        Field("holder", "256s", "", "who holds the lease"),
        Field("accepted", "B", "", "1 carried out, 0 refused"),
        Field("reason", "32s", "", "why refused, the answer's reason"),
        Field("text", "480s", "", "the answer's line"),
        Field("entry", "64s", "", "SHA-256 of what the calibration ledger got, hexadecimal; empty for nothing"),
    ),
)

FRAME = Slot(
    "frame",
    (
        Field("t_ns", "q", "ns", "when the loop took or sent it, CLOCK_MONOTONIC"),
        Field("can_id", "I", "", "identifier, with the flags of Linux: see FrameFlag"),
        Field("sent", "B", "", "1 sent, 0 received"),
        Field("dlc", "B", "", "bytes of data"),
        Field("data", "8s", "", "the bytes, the rest is 0"),
    ),
)


class FrameFlag(IntFlag):
    """Kind of a frame, in the upper bits of ``can_id`` as in Linux's ``struct can_frame``."""

    ERROR = 1 << 29
    REMOTE = 1 << 30
    EXTENDED = 1 << 31


COMMAND_LIFETIME_NS = 1_000_000_000
