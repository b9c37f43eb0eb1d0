"""The catalogue of commands: a row for each, and the settings that the gateway sends on their ring.

From a row come the payload on the wire and its checks, the fields of the ring's slot, the command line, the page's
buttons, the schema, who may give the command and for how long it is waited for. What the loop makes of a command is in
`rigctl.control`; ``modes`` names the guards there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum, IntFlag
from types import MappingProxyType
from typing import Any, NamedTuple

from rigctl.model.states import Mode, Witness


class RingField(NamedTuple):
    """A number of the ring's command slot; ``unit``: "" for none."""

    name: str
    unit: str
    meaning: str


COMMAND_S = 6.0
"""The gateway answers a command that neither moves nor measures within 4 s."""
_NO_CHOICES: Mapping[str, float] = MappingProxyType({})


class Option(NamedTuple):
    """A field of a command's payload, beside operator, lease and run id."""

    name: str
    """Its key in JSON."""
    kind: type = bool
    """bool: only true can be given; float, str."""
    form: str = "true"
    """Of its value, for the words about a payload that is not valid."""
    meaning: str = ""
    field: RingField | None = None
    """Where the loop reads it; None: the gateway alone does."""
    required: bool = False
    choices: Mapping[str, float] = _NO_CHOICES
    """Texts that it takes, with the number of each in the slot; "" is the one that is not given."""
    noun: str = ""
    """Of what a number counts, such as newtons, for an operator who types it."""
    bounds: tuple[float, float] | None = None
    """Of a number, where they are the same in every mode and for every rig."""
    positive: str = ""
    """Of a number that is above 0: what it is, for the words about another."""
    whole: bool = False
    """Of a number: 0, 1, 2 and so on."""
    metavar: str = ""
    help: str = ""
    """Of the command line, with the name of its value there."""
    label: str = ""
    """Of its field on the page."""
    shown_in: Mode | None = None
    """The field is there in this mode alone."""


class VerbTrait(IntFlag):
    """Further properties of a command."""

    MOTOR = 1
    """With the load on the brake, it first has the motor take it back."""
    CARRIES = 2
    """It is for a load that the brake does not hold."""
    TRIAL = 4
    """It measures first, and is answered at its end; see `rigctl.control.excitation.trials`."""
    FILED = 8
    """Its result is put on record before it takes effect."""
    ENDS_OTHERS = 16
    """Accepted, it ends a command that waits for the drive or for its read-back, as do all that need the motor."""
    LEAVES_DISARM = 32
    """It leaves a DISARM under way as it is."""
    FOLLOWS_DRIVE = 64
    """It may wait for the drive, and for the read-back before it, as may all that need the motor."""
    MAINTAINER = 128
    """Operators may not give it over an access list."""
    IN_FAULT = 256
    """Its button is there in FAULT alone."""


class CommandRow(NamedTuple):
    """A command, and all that is said of it."""

    number: int
    does: str
    """Its line in the schema."""
    done: str
    """Its answer when it has been carried out: a template of the names in `rigctl.wire.command_request.answer`."""
    options: tuple[Option, ...] = ()
    modes: Mapping[Mode, str] = MappingProxyType({})
    """Where it is accepted without a change of mode, or not at once, with the name of its guard in
    `rigctl.control.modes`; "" for none."""
    already: tuple[Mode, ...] = ()
    """Modes that it leads to."""
    traits: VerbTrait = VerbTrait(0)
    out_of_range: str = ""
    """Words of the refusal OUT_OF_RANGE."""
    takes_s: float = 0.0
    """Time that the loop may need beside that for taking a load from the brake."""
    answered_s: float = COMMAND_S
    """How long a client waits for the answer."""
    ends: tuple[Mode, Mode] | None = None
    """Mode in which it ends, and the mode before that, for who waits for its end."""
    help: str = ""
    """Of the command line, where its options are those of the payload; the first sentence is its line of
    ``rigctl --help``."""
    button: int = 0
    """Its place on the page, from 1; HOLD is always there."""
    effect: str = ""
    """What it would do now, for its confirmation on the page: a template of the names in
    `rigctl.page.page_commands.meaning`."""
    missing: str = ""
    """Words of the command line where a required confirmation is missing."""


CARRY_S = 1.0, 3600.0
"""Shortest and longest time of a CARRY."""
STROKE_SPARE_MM = 2.0
"""A RELEASE of a length leaves the cylinder so far from its end."""
_MAY_MOVE = tuple(mode for mode in Mode if mode.may_move)
_TRIAL_S = 30.0
"""A trial is answered after its end: 10 s at most, an arm after 23 s (settings read back 15 s, stop and brake 8 s)."""
_NEAR_END = Option(
    "near_end", meaning="arm at an end of the stroke, to drive away from it",
    field=RingField("near_end", "", "1 to drive away from an end of the stroke"),
    help="Arm at an end of the stroke, to drive away from it (tension, release).",
)  # fmt: skip
_BY = Option(
    "by", str, '"encoder" or "cell"', "by one witness alone: encoder or cell",
    RingField("by", "", "the witness that the operator names, see rigctl.model.states.Witness"),
    choices={"": float(Witness.BOTH), "encoder": float(Witness.ENCODER), "cell": float(Witness.CELL)},
    help="Go by this alone, where encoder and tension disagree: see at the rig which is right.",
)  # fmt: skip


class Verb(IntEnum):
    """Commands an operator may give, each by its `CommandRow`."""

    row: CommandRow

    def __new__(cls, *of_row: Any) -> Verb:
        """A member by the fields of its row."""
        found = CommandRow(*of_row)
        member = int.__new__(cls, found.number)
        member._value_ = found.number
        member.row = found
        return member

    ARM = CommandRow(
        1,
        does="drive on, stroke held",
        done="armed, {mode}, stroke {stroke}, tension {tension}",
        options=(_NEAR_END,),
        modes={Mode.DISARMED: "preflight_passed"},  # no event yet: ENABLED follows from the drive
        already=_MAY_MOVE,
        traits=VerbTrait.ENDS_OTHERS | VerbTrait.FOLLOWS_DRIVE,
        takes_s=6.5,  # standstill 2 s, brake test 2 s, the drive 2 s
        answered_s=_TRIAL_S,
        help="Drive on, brake open, stroke held: DISARMED to HOLD. Refused with everything that stands against it.",
        button=4,
        effect="drive on, brake open, stroke held at {stroke} with {now} on the rope",
    )
    TENSION = CommandRow(
        2,
        does="ramp to the target, then compensate",
        done="ramping to {target}, {mode}",
        already=(Mode.TENSIONING, Mode.COMPENSATING),
        traits=VerbTrait.MOTOR,
        answered_s=_TRIAL_S,
        ends=(Mode.COMPENSATING, Mode.TENSIONING),
        help="Ramp to the target and hold it: TENSIONING, then COMPENSATING.",
        button=5,
        effect="ramp from {now} to {target} and hold it; the stroke moves from {stroke}",
    )
    RELEASE = CommandRow(
        3,
        does="ramp to slack, then hold; a slack rope: pay out so much, then hold",
        done="ramping to slack, {mode}",
        options=(
            Option(
                "value", float, "MILLIMETRES of a slack rope", "the length of rope in mm",
                RingField("length_mm", "mm", "how far a slack rope is paid out; 0 or NaN: a ramp to slack"),
                noun="millimetres", positive="a length of rope above 0 mm",
                metavar="MM",
                help="How far a slack rope is paid out, in HOLD, at 2 mm/s; without it the tension is ramped down.",
                label="length of a slack rope to pay out in mm; empty: ramp to a slack rope", shown_in=Mode.HOLD,
            ),
        ),
        already=(Mode.RELEASING,),
        traits=VerbTrait.MOTOR,
        out_of_range=f"the length must leave the cylinder inside its stroke, {STROKE_SPARE_MM:g} mm from its end",
        answered_s=_TRIAL_S,
        ends=(Mode.HOLD, Mode.RELEASING),
        help="Ramp to a slack rope, then HOLD; or pay out MM of a slack rope.",
        button=1,
        effect="ramp from {now} down to a slack rope; the stroke moves from {stroke}",
    )  # fmt: skip
    HOLD = CommandRow(
        4,
        does="hold the stroke at once; anyone's, always, without a lease",
        done="stroke held at {stroke}, tension {tension}",
        traits=VerbTrait.ENDS_OTHERS,
    )
    DISARM = CommandRow(
        5,
        does="drive off, brake closed",
        done="drive off, brake closed, {mode}{latched}",
        modes={Mode.FAULT: ""},  # power off, brake closed; the fault stays latched
        already=(Mode.DISARMED,),
        traits=VerbTrait.ENDS_OTHERS | VerbTrait.FOLLOWS_DRIVE | VerbTrait.LEAVES_DISARM,
        help="Drive off, brake closed.",
        button=2,
        effect="drive off, brake closed; {now} stay on rope and brake",
    )
    RESET = CommandRow(
        6,
        does="acknowledge a latched fault whose cause is gone",
        done="fault cleared, {mode}",
        modes={Mode.DISARMED: "drive_at_fault"},
        traits=VerbTrait.ENDS_OTHERS | VerbTrait.FOLLOWS_DRIVE,
        help="Acknowledge a fault whose cause is gone.",
        button=3,
        effect="acknowledge {fault}: {why}",
    )
    TARGET = CommandRow(
        7,
        does="set the target of the vertical tension",
        done="{newtons}, {mode}",
        options=(
            Option(
                "value", float, "NEWTONS", "the target in N", RingField("target_n", "N", "vertical tension"),
                required=True, noun="newtons", help="Vertical tension to hold.",
                label="target in N",
            ),
        ),
        modes=dict.fromkeys(Mode, "target_in_bounds"),
        traits=VerbTrait.LEAVES_DISARM,
        help="Set the vertical tension to hold.",
        button=6,
        effect="hold {value:.1f} N instead of {target}",
    )  # fmt: skip
    TARE = CommandRow(
        8,
        does="the unloaded cell's mean over 1 s becomes its zero",
        done="the cell reads {value:z.3f} N, {mode}",
        modes=dict.fromkeys((Mode.DISARMED, Mode.HOLD), "rope_unloaded"),
        traits=VerbTrait.TRIAL | VerbTrait.FILED,
        takes_s=2.0,
        answered_s=_TRIAL_S,
    )
    CALIBRATE = CommandRow(
        9,
        does="compare the cell with a known weight or the shunt",
        done="the cell reads {value:z.3f} N, {mode}",
        options=(
            Option("value", float, "NEWTONS", "the known weight in N",
                   RingField("weight_n", "N", "known weight, for the audit log only")),
            Option("shunt", meaning="calibrate against the shunt"),
            Option("adopt", meaning="calibrate sets the scale, or with creep_s the creep"),
            Option("creep_s", float, "SECONDS", "calibrate records the cell's creep for so long after the load's step",
                   RingField("creep_s", "s", "how long the creep is recorded; NaN for a mean reading")),
        ),
        modes=dict.fromkeys((Mode.DISARMED, Mode.HOLD), ""),
        traits=VerbTrait.TRIAL | VerbTrait.FILED | VerbTrait.MAINTAINER,
        takes_s=2.0,
        answered_s=_TRIAL_S,
    )  # fmt: skip
    IDENTIFY = CommandRow(
        10,
        does="excite the plant for some seconds and measure it",
        done="excited for {value:.1f} s, {mode}, stroke {stroke}",
        options=(
            Option("tight", meaning="identify only a tight rope",
                   field=RingField("tight", "", "1 if the rope must be tight")),
        ),
        modes={Mode.HOLD: "rope_tight_if_needed"},
        traits=VerbTrait.MOTOR | VerbTrait.TRIAL | VerbTrait.FILED | VerbTrait.MAINTAINER,
        takes_s=10.0,
        answered_s=_TRIAL_S,
    )  # fmt: skip
    GAINS = CommandRow(
        11,  # the new gains follow as LAW_GAINS, once their margins have been judged
        does="put other gains in force, once judged",
        done="{mode}",
        options=(
            Option("gain_file", str, "TEXT", "text of a gain file", required=True),
            Option("name", str, '"FILE"', "its name, for the record", required=True),
        ),
        modes=dict.fromkeys(Mode, ""),
        traits=VerbTrait.FILED | VerbTrait.LEAVES_DISARM | VerbTrait.MAINTAINER,
        answered_s=65.0,  # the gateway has them judged within 60 s
    )
    CONFIRM_STROKE = CommandRow(
        12,
        does="the stroke, measured at the cylinder, is what the drive's position says",
        done="the stroke is {value:z.2f} mm, {mode}",
        options=(
            Option(
                "value", float, "MILLIMETRES", "the stroke in mm",
                RingField("stroke_mm", "mm", "as the operator has measured it"),
                required=True, noun="millimetres", metavar="MM", help="Stroke, as measured at the cylinder.",
            ),
        ),
        modes=dict.fromkeys((Mode.DISARMED, Mode.FAULT), "stroke_as_measured"),
        help="Confirm the stroke after the drive's position was lost or differs from the last one known.",
    )  # fmt: skip
    RESPONSE = CommandRow(
        13,
        does="excite the plant with a multisine and measure its frequency response",
        done="excited for {value:.0f} s, {mode}",
        options=(
            Option(
                "where", str, '"hold" or "compensating"', "response only in that mode: hold or compensating",
                RingField("regulated", "", "1 only while COMPENSATING, 0 only in HOLD"),
                choices={"": math.nan, "hold": 0.0, "compensating": 1.0},
            ),
        ),
        modes={Mode.HOLD: "held_response", Mode.COMPENSATING: "regulated_response"},
        traits=VerbTrait.MOTOR | VerbTrait.TRIAL | VerbTrait.FILED | VerbTrait.MAINTAINER,
        takes_s=90.0,
        answered_s=160.0,  # of the evaluation 60 s
    )  # fmt: skip
    MOVE = CommandRow(
        14,
        does="a move of the mechanism begins; 0: the one under way has ended",
        done="learnt from {value:.0f} moves so far, {mode}",
        options=(
            Option(
                "value", float, "NUMBER", "the number of a move",
                RingField("move", "", "its number, 0 the move under way has ended"),
                required=True, noun="moves", whole=True, metavar="N", help="Number of the move, from 1; 0 ends it.",
            ),
        ),
        modes={Mode.COMPENSATING: "move_known"},
        out_of_range="the number of a move is 1 to learning.moves of the rig file, 0 for the end of the one under way",
        help="A move of the mechanism begins now: play what was learnt from it, and learn from it; 0: it has ended.",
    )  # fmt: skip
    CARRY = CommandRow(
        15,
        does="the motor carries a load that the brake does not hold, so long",
        done="the motor carries the load for {value:.0f} s and lowers it then, {mode}",
        options=(
            Option(
                "value", float, "SECONDS", "the time in s",
                RingField("carry_s", "s", "how long the motor carries before it lowers the load"),
                required=True, noun="seconds", bounds=CARRY_S, help=f"How long, {CARRY_S[0]:g} to {CARRY_S[1]:g} s.",
                label="time to carry in s",
            ),
            _BY,
        ),
        modes={  # BRAKE_SLIPS is latched first outside FAULT
            Mode.FAULT: "motor_may_carry", Mode.DISARMED: "brake_fails_to_carry", Mode.HOLD: "brake_fails_to_carry",
        },
        traits=VerbTrait.MOTOR | VerbTrait.CARRIES | VerbTrait.IN_FAULT,
        out_of_range=f"the time must be {CARRY_S[0]:g} to {CARRY_S[1]:g} s",
        answered_s=_TRIAL_S,
        help="Where the brake does not hold: the motor holds the load for SECONDS, then lowers it.",
        button=7,
        effect="drive on; the motor holds {now} for {value:.0f} s, then lowers it",
    )  # fmt: skip
    LOWER = CommandRow(
        16,
        does="the motor lowers such a load until the rope is slack",
        done="the motor lowers the load until the rope is slack, {mode}",
        options=(_BY,),
        modes=dict.fromkeys((Mode.DISARMED, Mode.HOLD), "brake_fails_to_lower"),
        traits=VerbTrait.MOTOR | VerbTrait.CARRIES | VerbTrait.IN_FAULT,
        answered_s=_TRIAL_S,
        help="Where the brake does not hold: the motor lowers the load to a slack rope.",
        button=8,
        effect="drive on; the motor lowers {now} until the rope is slack; the stroke moves from {stroke}",
    )
    BRAKE_TEST = CommandRow(
        17,
        does="the brake has the load for 10 s, which clears that it fails; then the motor",
        done="the brake has held {value:.0f} N for 10 s, the motor has it, {mode}",
        options=(
            Option(
                "supported", meaning="brake_test: the payload is supported from below; required", required=True,
                help="Confirm that the payload is supported from below. Required.",
            ),
        ),
        modes={Mode.HOLD: "brake_testable"},
        traits=VerbTrait.MOTOR,
        takes_s=12.0,
        answered_s=_TRIAL_S,
        help="Where the brake is known not to hold: it has the load for 10 s, then the motor; shows that it holds.\n\n"
        "In HOLD on a tight rope. If the load moves by 0.05 mm the motor takes it back.",
        missing="support the payload from below first, the brake may let it go; then give --supported",
    )  # fmt: skip


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


_PEAK = RingField("sensitivity_peak", "", "see the record")
_PEAK_ERROR = RingField("sensitivity_peak_error", "", "")
_SETTING_FIELDS: dict[int, tuple[RingField, ...]] = {
    Setting.ZERO: (
        RingField("zero_n", "N", "reading of the unloaded cell"),
        RingField("zero_c", "deg C", "the cell's temperature then; NaN where it is not known"),
        RingField("zero_n_k", "N/K", "change of zero per kelvin from there on"),
        RingField("second_zero_n", "N", "of the second force path; NaN where there is none"),
    ),
    Setting.SCALE: (
        RingField("scale", "", "factor of the cell's reading"),
        RingField("overdue", "", "1 the calibration is overdue, 0 it is not"),
        RingField("second_scale", "", "of the second force path; NaN: as it is"),
    ),
    Setting.OVERDUE: (RingField("overdue", "", "1 the calibration is overdue, 0 it is not"),),
    Setting.HOST_CHECKS: (RingField("host_checks", "", "those that fail, bits, see rigctl.model.checks.HOST_CHECKS"),),
    Setting.LAW_GAINS: (
        RingField("k_tension", "mm/(s N)", "see rigctl.control.law.tension.Gains"),
        RingField("k_speed", "", ""),
        RingField("k_integral", "mm/(s^2 N)", ""),
    ),
    Setting.MARGINS: (_PEAK, _PEAK_ERROR),
    Setting.DIFFERS: (_PEAK, _PEAK_ERROR),
    Setting.CREEP: (
        RingField("creep_1", "", "share of the load, see rigctl.ipc.correction.CreepTerm; 0 and 0 for none"),
        RingField("creep_1_s", "s", "its time constant"),
        RingField("creep_2", "", "the second share"),
        RingField("creep_2_s", "s", "its time constant"),
        RingField("creep_held_s", "s", "time since the load came on a cell at rest; NaN: it was always there"),
    ),
}
RING_FIELDS: dict[int, tuple[RingField, ...]] = {
    **{verb: tuple(option.field for option in verb.row.options if option.field is not None) for verb in Verb},
    **_SETTING_FIELDS,
}
"""Fields of a ``COMMAND`` slot that a command or setting uses, beside time and id."""
VALUES: dict[int, tuple[str, ...]] = {
    code: tuple(field.name for field in fields) for code, fields in RING_FIELDS.items() if fields
}
"""Their names."""


def having(trait: VerbTrait) -> frozenset[Verb]:
    """The commands with a trait."""
    return frozenset(verb for verb in Verb if trait in verb.row.traits)


STROKE_TOLERANCE_MM = 0.5
"""The drive's position is the stroke that was last known, or that an operator has measured, within this."""
OFF_LIMIT_NS = 3_000_000_000
"""Time a drive has to stop, to close its brake and to go off after a DISARM."""


TRIED_IN = having(VerbTrait.TRIAL)


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
