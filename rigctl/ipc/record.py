"""The record of a tick and the other slots that cross between processes, as tables of fields.

Each table gives the packed struct the loop writes, the numpy dtype readers see, and the schema subscribers get.
All slots are little-endian and packed, and begin with the ring's sequence number.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntFlag
from operator import attrgetter
from typing import Any

import numpy as np

from rigctl.model.signals import RECORDED
from rigctl.model.verbs import RING_FIELDS, RingField, Setting, Verb


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

    def by_name(self) -> tuple[Any, Callable[[Any], tuple[Any, ...]]]:
        """An object with an attribute per field, and the function that gives their values in order, for `layout`."""
        names = tuple(field.name for field in self.fields)
        return type(self.name, (), {"__slots__": names})(), attrgetter(*names)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Packed dtype with ``seq``, for a ``RingReader``; also the wire format of a fast block."""
        kinds = {"d": "<f8", "q": "<i8", "Q": "<u8", "I": "<u4", "H": "<u2", "B": "u1"}
        return np.dtype(
            [("seq", "<u8"), *((field.name, kinds.get(field.code) or f"S{field.code[:-1]}") for field in self.fields)]
        )

    def values(self, **given: Any) -> tuple[Any, ...]:
        """Values for a ``RingWriter``, in the order of the fields; a double that is not given is NaN.

        Raises:
            KeyError: a value of another kind is missing, or the slot has no such field.
        """
        found = tuple(given.pop(field.name, math.nan) if field.code == "d" else given.pop(field.name)
                      for field in self.fields)  # fmt: skip
        if given:
            raise KeyError(*given)
        return found


RECORD = Slot("record", tuple(Field(row.name, row.code, row.unit, row.meaning) for row in RECORDED))

EVENT = Slot(
    "event",
    (
        Field("t_ns", "q", "ns", "when, CLOCK_MONOTONIC"),
        Field("kind", "H", "", "see rigctl.model.events.Kind"),
        Field("a", "I", "", "meaning depends on kind"),
        Field("b", "I", "", "meaning depends on kind"),
        Field("value", "d", "", "what was found"),
        Field("limit", "d", "", "what is allowed"),
        Field("text", "80s", "", "where words are needed: an exception and its place"),
    ),
)


def _of_commands() -> Iterator[Field]:
    """The fields that commands and settings use, each once, with whose it is."""
    users: dict[str, list[str]] = {}
    fields: dict[str, RingField] = {}
    names = {int(code): code.name for code in (*Verb, *Setting)}
    for code, used in RING_FIELDS.items():
        for field in used:
            users.setdefault(field.name, []).append(names[code])
            fields.setdefault(field.name, field)
    for name, field in fields.items():
        whose = ", ".join(users[name])
        yield Field(name, "d", field.unit, f"{whose}: {field.meaning}" if field.meaning else whose)


COMMAND = Slot(
    "command",
    (
        Field("t_ns", "q", "ns", "when it was given; an old one is not carried out"),
        Field("id", "Q", "", "comes back in the reply"),
        Field("verb", "B", "", "see rigctl.model.verbs.Verb and Setting; fields that it does not use are NaN"),
        *_of_commands(),
    ),
)

HOLD = Slot(
    "hold",
    (
        Field("t_ns", "q", "ns", "when it was given; an old one is not carried out"),
        Field("id", "Q", "", "comes back in the reply; never one of a command's, see HOLD_ID"),
        Field("uid", "I", "", "user of the process that gave it, as the kernel says (SO_PEERCRED)"),
        Field("pid", "I", "", "that process"),
        Field("operator", "1024s", "", "who gave it, in that process's words"),
    ),
)

HOLD_ID = 1 << 62  # set in the id of every hold; ids of commands are CLOCK_MONOTONIC times, far below it

REPLY = Slot(
    "reply",
    (
        Field("t_ns", "q", "ns", "when"),
        Field("id", "Q", "", "of the command"),
        Field("accepted", "B", "", "1 carried out, 0 refused"),
        Field("reason", "H", "", "why refused, see rigctl.model.verbs.Refusal"),
        Field(
            "checks",
            "Q",
            "",
            "preflight checks that failed, bits, see rigctl.model.checks.Check; CAUSE_PRESENT: "
            "the faults whose causes are there, bits, see rigctl.model.faults.Fault.bit",
        ),
        Field("mode", "B", "", "mode after the command"),
        Field("tension_n", "d", "N", "tension now; of this and the fields below a reply has the one it is about"),
        Field("target_n", "d", "N", "TARGET, TENSION: the target in force"),
        Field("stroke_mm", "d", "mm", "CONFIRM_STROKE: the drive's position"),
        Field("taught", "d", "", "MOVE: moves that its table was learnt from"),
        Field("duration_s", "d", "s", "IDENTIFY, RESPONSE: how long it took"),
        Field("cause", "d", "", "CAUSE_PRESENT: number of the fault whose cause is there"),
        Field("moved_mm", "d", "mm", "BRAKE_SLIPPED: motion on the closed brake; SUNK: by the arms before"),
        Field("speed_mm_s", "d", "mm/s", "STOP_RUNNING: speed of the stroke"),
        Field(
            "drive_state",
            "d",
            "",
            "DRIVE_STATE, DRIVE_TIMEOUT, OFF_UNSEEN: the drive's state, see rigctl.devices.objects",
        ),
        Field("needed_n", "d", "N", "LITTLE_LOAD: least load of a brake test that shows something"),
        Field("apart_mm", "d", "mm", "DISAGREE: motion by the encoder less that by the tension"),
        Field("carried_s", "d", "s", "CARRY, LOWER, CARRIED: how long the motor still carries"),
        Field("reading_n", "d", "N", "TARE, CALIBRATE: mean reading of the cell; LOADED: its reading now"),
        Field("rms_n", "d", "N", "TARE, CALIBRATE: rms of the reading about its mean"),
        Field("samples", "d", "", "TARE, CALIBRATE: samples in the mean"),
        Field("creep_n", "d", "N", "TARE, CALIBRATE: mean of the creep taken out meanwhile"),
        Field("creep_doubt_n", "d", "N", "TARE, CALIBRATE: most of it that an unknown history may have wrong"),
        Field("zero_drift_n", "d", "N", "TARE, CALIBRATE: zero's drift with temperature and slack zero in force"),
        Field("cell_c", "d", "deg C", "TARE, CALIBRATE: the cell's temperature"),
        Field("second_n", "d", "N", "TARE, CALIBRATE: mean reading of the second force path"),
        Field("taken_s", "d", "s", "from the command until the motor had taken the load from the brake for it"),
    ),
)
_BESIDE = frozenset({"rms_n", "taken_s"})  # figures beside the one that a reply is about
_FIGURES = tuple(field.name for field in REPLY.fields if field.code == "d" and field.name not in _BESIDE)


def figure_of(reply: Any) -> float:
    """The figure that a ``REPLY`` slot is about, 0 for none."""
    return next((float(reply[name]) for name in _FIGURES if not math.isnan(reply[name])), 0.0)


SITUATION = Slot(
    "situation",
    (
        Field("t_ns", "q", "ns", "when, CLOCK_MONOTONIC"),
        Field("mode", "B", "", "see rigctl.model.states.Mode; the fields below: see rigctl.control.commands.situation"),
        *(Field(name, code, "", "") for code, names in (
            ("Q", "failed_checks causes fault moves witness pending drive_state"),
            ("B", "stop_running armed e_stop brake_fails strays no_brake at_rest drive_faulted drive_unfit slack "
                  "slack_doubted unloaded ends silent left_alone powered disarming tries read_at_arm read_at_motor"),
            ("d", "carried_s apart_mm sunk_mm needed_n room_mm stroke_mm target_min_n target_max_n speed_mm_s "
                  "reading_n"),
        ) for name in names.split()),
    ),
)  # fmt: skip
"""What the answer to every command depends on now."""

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
        Field("verb", "32s", "", "the command's verb"),
        Field("value", "d", "", "of the command, NaN for none"),
        Field("operator", "256s", "", "who"),
        Field("holder", "256s", "", "who holds the lease"),
        Field("accepted", "B", "", "1 carried out, 0 refused"),
        Field("reason", "32s", "", "why refused, the answer's reason"),
        Field("text", "480s", "", "the answer's line"),
        Field("entry", "64s", "", "SHA-256 of what the calibration ledger got, hexadecimal; empty for nothing"),
        Field("giver", "80s", "", "user and process that gave it, as the kernel says; empty over the network"),
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
