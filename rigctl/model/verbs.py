"""Commands and settings of the loop, their values, and why a command is refused."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from rigctl.model.states import Mode


class Verb(IntEnum):
    """Commands an operator may give."""

    ARM = 1
    TENSION = 2
    RELEASE = 3
    HOLD = 4
    DISARM = 5
    RESET = 6
    TARGET = 7
    TARE = 8  # TARE, CALIBRATE and IDENTIFY measure first and answer at their end, see rigctl.control.trials
    CALIBRATE = 9
    IDENTIFY = 10
    GAINS = 11  # the new gains follow as LAW_GAINS, once their margins have been judged
    CONFIRM_STROKE = 12  # the measured stroke agrees with the drive's position
    RESPONSE = 13  # frequency response by a multisine; a trial, as IDENTIFY
    MOVE = 14  # a move of the mechanism begins, or the one under way has ended
    CARRY = 15  # the motor holds a load that the brake does not hold
    LOWER = 16  # the motor lowers such a load until the rope is slack
    BRAKE_TEST = 17  # the brake has the load for 10 s, then the motor again


class Setting(IntEnum):
    """Settings the gateway sends once they are on record; on the ring of the verbs, but not for operators."""

    ZERO = 128
    SCALE = 129
    OVERDUE = 130
    HOST_CHECKS = 134  # sent before every ARM; 131 to 133 had other meanings
    LAW_GAINS = 135
    MARGINS = 140  # the loop's sensitivity peak as measured while COMPENSATING
    CREEP = 144
    DIFFERS = 145  # |S| as measured and the nearest that the design's family has, where the two differ


VALUES: dict[int, tuple[str, ...]] = {
    Verb.ARM: ("near_end",),
    Verb.RELEASE: ("length_mm",),
    Verb.TARGET: ("target_n",),
    Verb.CALIBRATE: ("weight_n", "creep_s"),
    Verb.IDENTIFY: ("tight",),
    Verb.CONFIRM_STROKE: ("stroke_mm",),
    Verb.RESPONSE: ("regulated",),
    Verb.MOVE: ("move",),
    Verb.CARRY: ("carry_s", "by"),
    Verb.LOWER: ("by",),
    Setting.ZERO: ("zero_n", "zero_c", "zero_n_k", "second_zero_n"),
    Setting.SCALE: ("scale", "overdue", "second_scale"),
    Setting.OVERDUE: ("overdue",),
    Setting.HOST_CHECKS: ("host_checks",),
    Setting.LAW_GAINS: ("k_tension", "k_speed", "k_integral"),
    Setting.MARGINS: ("sensitivity_peak", "sensitivity_peak_error"),
    Setting.DIFFERS: ("sensitivity_peak", "sensitivity_peak_error"),
    Setting.CREEP: ("creep_1", "creep_1_s", "creep_2", "creep_2_s", "creep_held_s"),
}
"""Fields of a ``COMMAND`` slot that a command or setting uses, beside time and id."""


CARRY_S = 1.0, 3600.0
"""Shortest and longest time of a CARRY."""
STROKE_SPARE_MM = 2.0
"""A RELEASE of a length leaves the cylinder so far from its end."""
STROKE_TOLERANCE_MM = 0.5
"""The drive's position is the stroke that was last known, or that an operator has measured, within this."""
OFF_LIMIT_NS = 3_000_000_000
"""Time a drive has to stop, to close its brake and to go off after a DISARM."""
TRIED_IN = {
    Verb.TARE: (Mode.DISARMED, Mode.HOLD),
    Verb.CALIBRATE: (Mode.DISARMED, Mode.HOLD),
    Verb.IDENTIFY: (Mode.HOLD,),
    Verb.RESPONSE: (Mode.HOLD, Mode.COMPENSATING),
}
"""Commands that measure first and answer at their end, with the modes in which they do."""


class SettingOrder(NamedTuple):
    """A setting with the values for its fields, in the order of `VALUES`."""

    setting: Setting
    values: tuple[float, ...]


class Refusal(IntEnum):
    """Why a command was not carried out."""

    NONE = 0
    WRONG_MODE = 1
    PREFLIGHT = 2  # the reply's ``checks`` name the failures
    OUT_OF_RANGE = 3
    CAUSE_PRESENT = 4  # the fault's cause is still present
    ALREADY = 5
    EXPIRED = 6
    UNKNOWN = 7
    STOPPING = 8
    DRIVE_TIMEOUT = 9  # the drive did not follow
    ABORTED = 10  # a command, a trip or a change of mode came in between
    LOADED = 11  # the rope is not unloaded
    UNSTEADY = 12  # the stroke moves, or the reading does
    NO_SAMPLES = 13  # the cell gives no good samples
    SLACK = 14  # a slack rope shows nothing to identify
    STRAYED = 15  # tension or stroke left the bounds of the excitation
    FAULT_LATCHED = 16  # a limit ramps the tension down; only HOLD stops that
    NO_STEP = 30  # neither was a weight hung on the cell nor taken off it
    STROKE_DIFFERS = 19  # the measured stroke is not the drive's position
    STOP_RUNNING = 21  # the drive is still stopping, or its brake is closing
    BRAKE_SLIPPED = 22  # the brake did not hold the load while the drive was off; value: mm
    UNFELT = 23  # the cell does not show the motion of the stroke
    NO_LEARNING = 24  # the rig file has no section learning
    CARRIED = 100  # the motor carries a load that the brake does not hold; value: time left in s
    DRIVE_STATE = 102  # the drive has not left its fault state; value: its state, see DriveState
    OFF_UNSEEN = 103  # the drive was commanded off, and has not been seen to be; value: its state
    TIGHT = 104  # a length is paid out on a slack rope only
    NO_BRAKE = 106  # the rig file has none to test
    LITTLE_LOAD = 105  # too little for a brake test to show anything; value: load that it needs in N
    SUNK = 107  # each ARM of a tight rope had the load sink, and it is no motion on purpose; value: by how much in mm
    DISAGREE = 101  # encoder and tension do not show the same motion; value: difference in mm
