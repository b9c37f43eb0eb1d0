"""The record of a tick and the other slots that cross between processes, as tables of fields.

Each table gives the packed struct the loop writes, the numpy dtype readers see, and the schema subscribers get.
All slots are little-endian and packed, and begin with the ring's sequence number.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np


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


_AGE = "age of that sample; null before the first one (in a record: above 2^60)"

RECORD = Slot(
    "record",
    (
        Field("t_ns", "q", "ns", "grid point of the tick, CLOCK_MONOTONIC"),
        Field("tick", "Q", "", "ticks on the grid since the loop started, skipped ones included"),
        Field("skipped", "Q", "", "ticks skipped so far because the one before ran over"),
        Field("lateness_ns", "q", "ns", "wake-up after the grid point"),
        Field("work_ns", "q", "ns", "of the tick before, from its wake-up to its end"),
        Field("mode", "B", "", "mode, see modes"),
        Field("fault", "H", "", "latched fault, see faults; 0 none"),
        Field("flags", "H", "", "bits, see flags"),
        Field("tension_n", "d", "N", "tension cell, along the rope"),
        Field("reading_n", "d", "N", "the same as the cell sends it, before zero and scale"),
        Field("tension_age_ns", "q", "ns", _AGE),
        Field("tension_quality", "B", "", "bits, see quality; 0 good"),
        Field("tangential_rad", "d", "rad", "rope inclination along the move"),
        Field("normal_rad", "d", "rad", "rope inclination along the rail"),
        Field("inclination_age_ns", "q", "ns", _AGE),
        Field("inclination_quality", "B", "", "bits, see quality; 0 good"),
        Field("stroke_mm", "d", "mm", "cylinder stroke, positive shortens the rope"),
        Field("speed_mm_s", "d", "mm/s", "cylinder speed"),
        Field("drive_age_ns", "q", "ns", _AGE),
        Field("drive_quality", "B", "", "bits, see quality; 0 good"),
        Field("statusword", "H", "", "CiA 402 statusword 0x6041"),
        Field("controlword", "H", "", "CiA 402 controlword 0x6040 sent"),
        Field("command_mm_s", "d", "mm/s", "speed sent to the drive"),
        Field("target_n", "d", "N", "vertical tension the operator wants"),
        Field("setpoint_n", "d", "N", "rope tension the law holds now"),
        Field("vertical_n", "d", "N", "vertical component of the measured tension"),
        Field("estimate_n", "d", "N", "estimated tension"),
        Field("estimate_mm_s", "d", "mm/s", "estimated cylinder speed"),
        Field("disturbance_mm_s", "d", "mm/s", "estimated disturbance speed"),
        Field("integral_mm_s", "d", "mm/s", "integral action"),
        Field("innovation_n", "d", "N", "innovation of the tension"),
        Field("innovation_n2", "d", "N^2", "its variance"),
        Field("tension_verdict", "B", "", "what became of the sample, see verdicts"),
        Field("tension_nis", "d", "", "running mean of the squared innovation over its variance; 1 fits the model"),
        Field("speed_innovation_mm_s", "d", "mm/s", "innovation of the cylinder speed"),
        Field("speed_innovation_mm2_s2", "d", "mm^2/s^2", "its variance"),
        Field("speed_verdict", "B", "", "what became of the sample, see verdicts"),
        Field("speed_nis", "d", "", "running mean, as of the tension"),
        Field("tangential_estimate_rad", "d", "rad", "estimated inclination along the move"),
        Field("tangential_rate_rad_s", "d", "rad/s", "its rate"),
        Field("normal_estimate_rad", "d", "rad", "estimated inclination along the rail"),
        Field("normal_rate_rad_s", "d", "rad/s", "its rate"),
        Field("tangential_innovation_rad", "d", "rad", "innovation of the inclination along the move"),
        Field("tangential_innovation_rad2", "d", "rad^2", "its variance"),
        Field("tangential_verdict", "B", "", "what became of the sample, see verdicts"),
        Field("tangential_nis", "d", "", "running mean, as of the tension"),
        Field("normal_innovation_rad", "d", "rad", "innovation of the inclination along the rail"),
        Field("normal_innovation_rad2", "d", "rad^2", "its variance"),
        Field("normal_verdict", "B", "", "what became of the sample, see verdicts"),
        Field("normal_nis", "d", "", "running mean, as of the tension"),
        Field("stretch_mm_s", "d", "mm/s", "disturbance speed known from the inclination"),
        Field("frames_sent", "Q", "", "frames sent so far"),
        Field("frames_received", "Q", "", "frames received so far"),
        Field("frames_lost", "Q", "", "device frames that did not come, so far"),
        Field("frames_refused", "Q", "", "frames with a wrong length or a non-finite value, so far"),
        Field("send_failures", "Q", "", "unsent frames, so far: the bus did not take them"),
        Field("error_frames", "Q", "", "CAN error frames seen so far"),
        Field("rail_rad", "d", "rad", "angle of the rail's shaft, -pi up to pi"),
        Field("rail_quality", "B", "", "bits, see quality; 0 good; NEVER where no encoder is fitted"),
        Field("run_out_mm_s", "d", "mm/s", "disturbance speed known from the run-out table"),
        Field("drive_current_a", "d", "A", "motor current; NaN while it is not known"),
        Field("drive_temperature_c", "d", "deg C", "of the drive; NaN while it is not known"),
        Field("checks", "Q", "", "preflight checks that fail, bits, see checks; not looked at while armed"),
        Field("command_seq", "Q", "", "sequence number of the last slot the loop has taken from the command ring"),
        Field("hold_seq", "Q", "", "sequence number of the last slot the loop has taken from the ring of holds"),
        Field(
            "cause_bits",
            "Q",
            "",
            "causes of a fault that stand now, bits 1 << number, see faults; the state words them",
        ),
    ),
)

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
        Field("verb", "B", "", "see rigctl.control.modes.Verb and Setting; fields that it does not use are NaN"),
        Field("target_n", "d", "N", "TARGET: vertical tension"),
        Field("stroke_mm", "d", "mm", "CONFIRM_STROKE: as the operator has measured it"),
        Field("weight_n", "d", "N", "CALIBRATE: known weight, for the audit log only"),
        Field("near_end", "d", "", "ARM: 1 to drive away from an end of the stroke"),
        Field("tight", "d", "", "IDENTIFY: 1 if the rope must be tight"),
        Field("zero_n", "d", "N", "ZERO: reading of the unloaded cell"),
        Field("scale", "d", "", "SCALE: factor of the cell's reading"),
        Field("overdue", "d", "", "OVERDUE, SCALE: 1 the calibration is overdue, 0 it is not"),
        Field("k_tension", "d", "mm/(s N)", "LAW_GAINS: see rigctl.control.tension.Gains"),
        Field("k_speed", "d", "", "LAW_GAINS"),
        Field("k_integral", "d", "mm/(s^2 N)", "LAW_GAINS"),
        Field("host_checks", "d", "", "HOST_CHECKS: those that fail, bits, see rigctl.control.checks.HOST_CHECKS"),
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
        Field("tension_n", "d", "N", "tension now; of this and the fields below a reply has the one it is about"),
        Field("target_n", "d", "N", "TARGET, TENSION: the target in force"),
        Field("stroke_mm", "d", "mm", "CONFIRM_STROKE: the drive's position"),
        Field("duration_s", "d", "s", "IDENTIFY: how long it took"),
        Field("cause", "d", "", "CAUSE_PRESENT: number of the fault whose cause is there"),
        Field("moved_mm", "d", "mm", "BRAKE_SLIPPED: motion on the closed brake"),
        Field("speed_mm_s", "d", "mm/s", "STOP_RUNNING: speed of the stroke"),
        Field("reading_n", "d", "N", "TARE, CALIBRATE: mean reading of the cell; LOADED: its reading now"),
        Field("rms_n", "d", "N", "TARE, CALIBRATE: rms of the reading about its mean"),
    ),
)
_FIGURES = tuple(field.name for field in REPLY.fields if field.code == "d" and field.name != "rms_n")


def figure_of(reply: Any) -> float:
    """The figure that a ``REPLY`` slot is about, 0 for none."""
    return next((float(reply[name]) for name in _FIGURES if not math.isnan(reply[name])), 0.0)


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
