"""The catalogue of faults: number, name, cause in words, remedy, part to look at, and what the fault bars.

The rows of `rigctl.control.watch.safety.table` give the value watched for each, with limit and persistence.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

from rigctl.model.parts import Part


class Trait(IntFlag):
    """Further properties of a fault."""

    BLOCKS_RESET = 1
    """A reset is refused while the cause is present."""
    AGE = 2
    """Value and limit are ages in ns, shown in ms."""
    DEVICE_SILENT = 4
    """A device that was switched off or unplugged causes this fault, and the daemon must be restarted then."""
    BRAKE_FAILS = 8
    """The brake has let the stroke move."""
    MOTOR_MAY_CARRY = 16
    """It may be a brake that does not hold: the motor may carry or lower the load nevertheless."""
    LOAD_SINKS = 32
    """The load may be sinking: it is secured or lowered first."""
    STOPS_CARRYING = 64
    """It stops a motor that carries for a brake that does not hold; all else is reported, and the motor goes on."""
    CELL_DOUBTED = 128
    """A tension at rest shows nothing meanwhile; that of a cell that was silent or invalid shows it once it is back."""
    CELL_IMPLAUSIBLE = 256
    """The cell's reading is not that of a rope."""
    STROKE_DOUBTED = 512
    """A stroke at rest shows nothing meanwhile."""
    HIDES_TENSION = 1 << 10
    """No display shows the tension as a value, although its samples may arrive, and be good each by itself."""
    HIDES_DRIVE = 1 << 11
    """The same of the drive: its stroke, its speed and whether it is on."""
    HIDES_INCLINATION = 1 << 12
    HIDES_UNTIL_RESET = 1 << 13
    """Judged once, by a motion: no value is shown for as long as it is latched."""
    EMERGENCY = 1 << 14
    """A device's own emergency message; the value has its node."""
    OF_RIG_FILE = 1 << 15
    """One cause for each row of the rig file's limits."""
    SHOWN_BY_DEVICE = 1 << 16
    """A diagnosis looks which device restarted, left its state or fell silent."""
    SHOWN_BY_TENSION = 1 << 17
    """A diagnosis looks at how the tension has changed."""
    SHOWN_BY_WAY = 1 << 18
    """A diagnosis looks at the way of the stroke that the tension does not show."""
    SHOWN_BY_MOTION = 1 << 19
    """A diagnosis looks at position, speed and command of the drive."""


_NO_TRAIT = Trait(0)
_HIDES_ALL = Trait.HIDES_TENSION | Trait.HIDES_DRIVE | Trait.HIDES_INCLINATION


class FaultRow(NamedTuple):
    """A fault of the catalogue, and all that is said of it.

    ``words``: the cause in one line, a template of ``value``, ``limit`` and the names that
    `rigctl.model.fault_words.fault_text` fills in. ``meaning``: the condition, for docs/fault-list.md. ``remedy``: what
    the operator does about it. ``part``: where the operator looks first, as long as no sign of the diagnosis names one.
    """

    number: int
    words: str
    meaning: str
    remedy: str
    part: Part | None = None
    traits: Trait = _NO_TRAIT


class Fault(IntEnum):
    """What can trip the rig; the number is latched in every record until an operator resets it.

    A new fault is the last row: ``bit`` goes by the place of its row, and recordings, rings and subscribers hold it.
    """

    bit: int
    """The bit of its cause in sets of causes, such as ``cause_bits`` of the record; NONE has no bit, 0."""
    words: str
    meaning: str
    remedy: str
    part: Part | None
    traits: Trait

    def __new__(cls, *of_row: Any) -> Fault:
        """A member by the fields of its `FaultRow`."""
        row = FaultRow(*of_row)
        member = int.__new__(cls, row.number)
        member._value_ = row.number
        member.bit = 1 << len(cls.__members__) >> 1
        for name in ("words", "meaning", "remedy", "part", "traits"):
            setattr(member, name, getattr(row, name))
        return member

    NONE = FaultRow(0, "no fault", "there is none", "")
    TENSION_HIGH = FaultRow(
        1,
        words="tension {value:.1f} N above {limit:.1f} N",
        meaning="the tension, corrected or as the cell reads it, is above `safety.tension_high_n`",
        remedy=(
            "Take the pull off the rope in the hall: support the payload until the cell reads less; find what pulled."
        ),
        traits=Trait.BLOCKS_RESET | Trait.STOPS_CARRYING | Trait.SHOWN_BY_TENSION,
    )
    TENSION_LOW = FaultRow(
        2,
        words="tension lost ({value:.1f} N, limit {limit:.1f} N)",
        meaning="the tension was lost: in COMPENSATING, TENSIONING, or a held load in HOLD or FAULT",
        remedy="Look at rope, clamp and payload before tensioning again.",
        traits=Trait.SHOWN_BY_TENSION,
    )
    CELL_STALE = FaultRow(
        3,
        words="no tension sample for {value:.0f} ms (limit {limit:.0f} ms)",
        meaning="no tension sample within `safety.stale_ms`; after a power loss the daemon is started anew",
        remedy="Check the cell amplifier's power and cable.",
        part=Part.AMPLIFIER,
        traits=Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.HIDES_TENSION | Trait.SHOWN_BY_DEVICE,
    )
    CELL_INVALID = FaultRow(
        4,
        words="tension cell reports overload or no valid value (status {value:.0f})",
        meaning="the amplifier reports overload or no valid value, or the reading is beyond the range",
        remedy="Unload the cell and check its cable.",
        traits=Trait.BLOCKS_RESET | Trait.HIDES_TENSION | Trait.SHOWN_BY_TENSION,
    )
    INCLINATION_STALE = FaultRow(
        5,
        words="no inclination sample for {value:.0f} ms (limit {limit:.0f} ms)",
        meaning="no inclination sample within `safety.inclination_stale_ms`",
        remedy="Check the inclinometer's power and cable.",
        part=Part.INCLINOMETER,
        traits=Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.HIDES_INCLINATION | Trait.SHOWN_BY_DEVICE,
    )
    INCLINATION_INVALID = FaultRow(
        6,
        words="inclinometer reports no valid value",
        meaning="the inclinometer reports no valid value, or one beyond its range",
        remedy="Check the inclinometer's mounting and range.",
        traits=Trait.BLOCKS_RESET | Trait.HIDES_INCLINATION,
    )
    DRIVE_STALE = FaultRow(
        7,
        words="no drive status for {value:.0f} ms (limit {limit:.0f} ms)",
        meaning="no statusword and position within `safety.stale_ms`; after a power loss the daemon is started anew",
        remedy="Check the drive's power and cable.",
        part=Part.DRIVE,
        traits=Trait.BLOCKS_RESET
        | Trait.AGE
        | Trait.DEVICE_SILENT
        | Trait.STOPS_CARRYING
        | Trait.HIDES_DRIVE
        | Trait.SHOWN_BY_DEVICE,
    )
    DRIVE_FAULT = FaultRow(
        8,
        words="drive reports a fault of its own",
        meaning="the drive is in its own fault state",
        remedy="Read the drive's emergency code in the events; a reset clears it once its cause is gone.",
    )
    BUS_SILENT = FaultRow(
        9,
        words="no frame on the bus for {value:.0f} ms (limit {limit:.0f} ms)",
        meaning="no frame on the bus for `safety.bus_silent_ms`",
        remedy="Check CAN interface, termination, device power.",
        traits=Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.STOPS_CARRYING | _HIDES_ALL,
    )
    OVERRUN = FaultRow(
        10,
        words="{value:.0f} ticks skipped, loop cannot keep its rate (limit {limit:.0f} ticks)",
        meaning="the loop skipped more ticks than `safety.overrun_ticks` allows",
        remedy="Run rigctl doctor: real-time rights, other load on the loop's processor.",
        traits=Trait.BLOCKS_RESET,
    )
    LOOP_EXCEPTION = FaultRow(
        11,
        words="exception in the loop",
        meaning="an exception in a tick; the event names the place",
        remedy="Keep the trip dump and report the exception; reset goes on.",
    )
    STROKE_END = FaultRow(
        12,
        words="stroke limit reached before the tension was",
        meaning="the stroke ended before the tension was reached",
        remedy="Look why the stroke came to its end: the rope is too long, or the payload hangs on nothing.",
        traits=Trait.STOPS_CARRYING,
    )
    DRIVE_NOT_FOLLOWING = FaultRow(
        13,
        words="drive does not do as commanded: {missed}",
        meaning=(
            "the drive is not enabled though it should be, or stroke and speed are not as commanded; it is taken "
            "off power"
        ),
        remedy="Look at the drive's display, its enabling inputs and its tuning.",
        traits=Trait.STOPS_CARRYING | Trait.SHOWN_BY_MOTION,
    )
    DEVICE_RESTARTED = FaultRow(
        14,
        words="a device restarted and lost its settings; start the daemon anew",
        meaning="a device booted and has lost its settings",
        remedy="Start the daemon anew: it writes the device's settings again.",
        traits=Trait.BLOCKS_RESET | Trait.DEVICE_SILENT | Trait.SHOWN_BY_DEVICE,
    )
    INNOVATION = FaultRow(
        15,
        words="tension or cylinder speed contradicts what the filter expects",
        meaning=(
            "tension, drive speed or inclination went on contradicting what the filter expects, or the tension "
            "stepped from one sample to the next as no payload does"
        ),
        remedy="Look at cell, encoder and rope.",
        traits=Trait.CELL_DOUBTED | Trait.SHOWN_BY_TENSION | Trait.SHOWN_BY_WAY | Trait.SHOWN_BY_MOTION,
    )
    SIGN_DRIVE = FaultRow(
        16,
        words="the stroke does not go where the drive is commanded: check the drive's sign and scale",
        meaning="a positive command does not move the stroke up",
        remedy="Correct the drive's sign or scale in the rig file.",
        traits=Trait.SHOWN_BY_MOTION,
    )
    SIGN_CELL = FaultRow(
        17,
        words=(
            "the tension does not follow the stroke as the plant would{found}: check signs and scales of cell and drive"
        ),
        meaning="a shorter rope does not pull harder, or far from what the plant says",
        remedy=(
            "Correct the cell's sign, the drive's units or the plant's stiffness (mechanism_n_mm too) in the rig file."
        ),
        traits=Trait.CELL_DOUBTED | Trait.HIDES_TENSION | Trait.HIDES_UNTIL_RESET | Trait.SHOWN_BY_TENSION,
    )
    LIMIT = FaultRow(
        18,
        words="{text} {limit:.10g}{unit} ({value:.4g}{unit})",
        meaning="a limit of the rig file is passed; the event names the signal",
        remedy="Look at the signal named; its limit is in the rig file.",
        traits=Trait.OF_RIG_FILE | Trait.SHOWN_BY_TENSION | Trait.SHOWN_BY_WAY,
    )
    CELL_STUCK = FaultRow(
        19,
        words="tension cell has sent the very same value {value:.0f} times more (limit {limit:.0f} times)",
        meaning="the cell sends the very same value for `safety.stuck_samples`",
        remedy="Check the cell amplifier: it repeats its last value.",
        traits=Trait.BLOCKS_RESET
        | Trait.CELL_DOUBTED
        | Trait.CELL_IMPLAUSIBLE
        | Trait.HIDES_TENSION
        | Trait.SHOWN_BY_TENSION,
    )
    DRIVE_CONTRADICTS = FaultRow(
        20,
        words="drive's position and speed contradict each other by {value:.2f} mm (limit {limit:.2f} mm)",
        meaning="the drive's speed is not what its position does",
        remedy="Check the drive's encoder and its scale.",
        traits=Trait.STROKE_DOUBTED | Trait.HIDES_DRIVE | Trait.SHOWN_BY_MOTION,
    )
    STROKE_MOVES = FaultRow(
        21,
        words=(
            "the stroke moves though the drive is off ({value:.2f} mm/s){text}: the brake does not hold; rigctl "
            "carry: the motor holds the load, rigctl lower: it lowers it"
        ),
        meaning="the stroke moves though the drive is off: the brake does not hold; no reset while the load sinks",
        remedy="Secure the load: rigctl carry has the motor hold it, rigctl lower lowers it; have the brake repaired.",
        traits=Trait.BLOCKS_RESET | Trait.BRAKE_FAILS | Trait.MOTOR_MAY_CARRY | Trait.LOAD_SINKS,
    )
    STRETCH_UNEXPLAINED = FaultRow(
        22,
        words=(
            "tension and stroke contradict each other by {value:.1f} mm of stretch (limit {limit:.1f} mm): rope, "
            "cell, encoder or payload"
        ),
        meaning=(
            "tension and stroke contradict each other: in motion by more stretch than a payload explains; while "
            "the motor holds, by more than `rigctl check` prints, and the drive is taken off power"
        ),
        remedy="Look at rope, cell, encoder and payload before a reset.",
        traits=Trait.CELL_DOUBTED | Trait.SHOWN_BY_TENSION | Trait.SHOWN_BY_WAY,
    )
    E_STOP = FaultRow(
        23,
        words="emergency stop pressed ({seen})",
        meaning="the emergency stop is pressed; the event says at which input",
        remedy="Release the emergency stop, then reset.",
        traits=Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    CELL_NOISY = FaultRow(
        24,
        words="tension cell jumps by {value:.1f} N from sample to sample (limit {limit:.1f} N)",
        meaning="the cell jumps from sample to sample as no payload can",
        remedy="Check the cell's cable, shield and amplifier.",
        traits=Trait.BLOCKS_RESET
        | Trait.CELL_DOUBTED
        | Trait.CELL_IMPLAUSIBLE
        | Trait.HIDES_TENSION
        | Trait.SHOWN_BY_TENSION,
    )
    CELL_NEGATIVE = FaultRow(
        25,
        words="tension cell reads {value:.1f} N: a rope cannot push (limit {limit:.1f} N)",
        meaning="the cell reads a push; a rope cannot push",
        remedy="Check the cell's mounting, and its amplifier's zero with the rope unloaded.",
        traits=Trait.BLOCKS_RESET
        | Trait.CELL_DOUBTED
        | Trait.CELL_IMPLAUSIBLE
        | Trait.HIDES_TENSION
        | Trait.SHOWN_BY_TENSION,
    )
    SENSOR_EMERGENCY = FaultRow(
        26,
        words="a device's emergency message is active ({emergency})",
        meaning="cell, inclinometer or I/O node has sent an emergency message that is active",
        remedy="Read the emergency code in the events, and the device's manual.",
        traits=Trait.BLOCKS_RESET | Trait.CELL_DOUBTED | Trait.EMERGENCY | Trait.SHOWN_BY_DEVICE,
    )
    DRIVE_EMERGENCY = FaultRow(
        27,
        words="the drive's emergency message is active ({emergency})",
        meaning="the drive has sent an emergency message that is active",
        remedy="Read the emergency code in the events, and the drive's manual.",
        part=Part.DRIVE,
        traits=Trait.EMERGENCY | Trait.SHOWN_BY_DEVICE,
    )
    RIVAL = FaultRow(
        28,
        words="another controller {text}: find it and stop it",
        meaning="another controller or master speaks on this bus",
        remedy="Find the other controller on this bus and stop it.",
        traits=Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    E_STOP_UNSEEN = FaultRow(
        29,
        words="the I/O node that mirrors the emergency stop has sent nothing for {value:.0f} ms (limit {limit:.0f} ms)",
        meaning="the I/O node that mirrors the emergency stop is silent",
        remedy="Check the I/O node's power and cable.",
        traits=Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.SHOWN_BY_DEVICE,
    )
    STROKE_NOT_HELD = FaultRow(
        30,
        words=(
            "the stroke has moved {value:.2f} mm from where it was latched (limit {limit:.2f} mm): the drive "
            "creeps or the brake slips"
        ),
        meaning="the stroke has left where it was latched; the drive is taken off power",
        remedy="Look at the drive's velocity offset (0x60B1) and tuning, and at the brake.",
        traits=Trait.MOTOR_MAY_CARRY | Trait.SHOWN_BY_TENSION,
    )
    POSITION_DRIFTS = FaultRow(
        31,
        words=(
            "holding the stroke has taken {value:.2f} mm of correction (limit {limit:.2f} mm): the drive's "
            "position drifts, or the drive creeps"
        ),
        meaning=(
            "the correction of a held stroke has added up to 0.8 mm: the position drifts or the drive creeps; the"
            " drive is taken off power"
        ),
        remedy="Check the drive's encoder, and its velocity offset (0x60B1).",
        traits=Trait.STROKE_DOUBTED,
    )
    STATUS_STALE = FaultRow(
        33,
        words=(
            "no current, temperature and inputs of the drive for {value:.0f} ms (limit {limit:.0f} ms): neither "
            "its emergency stop's input nor its temperature is seen"
        ),
        meaning="motor current, temperature and inputs of the drive do not come",
        remedy="Check the drive's second TPDO (cylinder.status_rate_hz).",
        part=Part.DRIVE,
        traits=Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.SHOWN_BY_DEVICE,
    )
    LIMIT_UNSEEN = FaultRow(
        34,
        words=(
            "{text} is limited by the rig file and does not come: no sample for {value:.0f} ms (limit {limit:.0f} ms)"
        ),
        meaning="the signal that a limit of the rig file watches does not come",
        remedy="Check the device that sends the signal named.",
        traits=Trait.AGE | Trait.OF_RIG_FILE | Trait.SHOWN_BY_DEVICE,
    )
    DRIVE_UNASKED = FaultRow(
        35,
        words="{text}{not_requested}",
        meaning=(
            "the drive is enabled, or moves under power, and the daemon has not commanded it; or its motor "
            "carries more than 5 % of `cylinder.rated_current_a` for 0.5 s while it reports off; it is taken off "
            "power"
        ),
        remedy="Find who commands the drive, withdraw the tool, then reset.",
        traits=Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    DRIVE_REFUSES = FaultRow(
        36,
        words="drive reports that {text}",
        meaning="statusword bit 9, 11 or 12: not remote, a limit of its own is active, or it does not follow",
        remedy="Withdraw the drive's panel or service tool; look at its display.",
        traits=Trait.BLOCKS_RESET,
    )
    NODE_NOT_OPERATIONAL = FaultRow(
        37,
        words="{text} {state}",
        meaning="a device's heartbeat has stopped, or says that it has left OPERATIONAL",
        remedy="Check the device's power and cable; start the daemon anew.",
        traits=Trait.BLOCKS_RESET | Trait.DEVICE_SILENT | Trait.SHOWN_BY_DEVICE,
    )
    SUPERVISION_LOST = FaultRow(
        38,
        words="a device does not keep what start-up wrote, {text}: start the daemon anew, it writes all of it again",
        meaning="an object that start-up verified reads differently, or is not answered for",
        remedy="Start the daemon anew: it writes all settings.",
        traits=Trait.BLOCKS_RESET | Trait.DEVICE_SILENT | Trait.SHOWN_BY_DEVICE,
    )
    STROKE_JUMPED = FaultRow(
        39,
        words=(
            "the drive's position jumped by {value:.2f} mm (limit {limit:.1f} mm): it is not believed; measure "
            "the stroke at the cylinder, then rigctl confirm-stroke MM"
        ),
        meaning="the drive's position jumped from one sample to the next",
        remedy="Measure the stroke at the cylinder, then rigctl confirm-stroke MM.",
        traits=Trait.BLOCKS_RESET | Trait.STROKE_DOUBTED | Trait.HIDES_DRIVE | Trait.SHOWN_BY_MOTION,
    )
    BRAKE_SLIPS = FaultRow(
        41,
        words=(
            "the stroke moved by {value:.2f} mm on the closed brake (limit {limit:.2f} mm){text}; rigctl carry: "
            "the motor holds the load, rigctl lower: it lowers it; have the brake repaired"
        ),
        meaning=(
            "the load moved on the closed brake: in the brake test, the drive stays off; right after a parking, "
            "held by the motor for 10 min, which then lowers it"
        ),
        remedy="Secure the load: rigctl carry has the motor hold it, rigctl lower lowers it; have the brake repaired.",
        traits=Trait.BRAKE_FAILS | Trait.MOTOR_MAY_CARRY | Trait.LOAD_SINKS,
    )
    FORCES_DISAGREE = FaultRow(
        46,
        words=(
            "the two force paths disagree by {value:.2f} N (limit {limit:.2f} N): cell, second cell, spring or encoder"
        ),
        meaning=(
            "cell and second force path differ by more than both may be wrong (`second_force.disagree_n`); a "
            "reset without a disarm leads to HOLD, where it trips again"
        ),
        remedy=(
            "Support the payload until the rope is slack; rigctl disarm, then rigctl reset; find the wrong force "
            "path with a known weight, and correct it at its amplifier."
        ),
        traits=Trait.SHOWN_BY_TENSION,
    )
    LOAD_SINKS = FaultRow(
        51,
        words=(
            "the tension {text}, by {value:.1f} N on the closed brake (limit {limit:.1f} N): the brake slips, or "
            "the payload or the rail was moved"
        ),
        meaning=(
            "on the closed brake the tension falls, or has fallen for 10 s: the brake slips, or payload or rail "
            "was moved; DISARMED too"
        ),
        remedy=(
            "Secure the load: rigctl lower has the motor lower it; no reset while it sinks; have the brake repaired."
        ),
        traits=Trait.BLOCKS_RESET | Trait.LOAD_SINKS | Trait.SHOWN_BY_TENSION,
    )
    SYNC_LOST = FaultRow(
        55,
        words="no device has answered SYNC for {value:.0f} ms (limit {limit:.0f} ms), though the bus is alive",
        meaning=(
            "no device answers SYNC though the bus is alive; a drive keeps its last speed without it, and is silenced"
        ),
        remedy=(
            "Find what keeps SYNC from the devices (cable, gateway, 0x1005); the drive keeps its last speed without it."
        ),
        traits=Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.STOPS_CARRYING | _HIDES_ALL,
    )
    ENABLE_IGNORED = FaultRow(
        60,
        words=(
            "the drive's STO feedback (io.drive_off_input) does not follow its hard-wired enable "
            "(io.drive_enable_output)"
        ),
        meaning="the drive's STO feedback does not follow its hard-wired enable: it may not take the torque away",
        remedy=(
            "Check wire, relay and feedback of the drive's enable: as it is, it may not take the motor's torque away."
        ),
        traits=Trait.BLOCKS_RESET,
    )
    CELL_FROZEN = FaultRow(
        56,
        words="the tension cell does not answer the probe: {text}; its value is not the load's",
        meaning="the tension cell does not answer the probe, the stroke does: its value is not the load's",
        remedy="Secure the load; check cell and amplifier with a known weight before a reset.",
        traits=Trait.CELL_DOUBTED
        | Trait.HIDES_TENSION
        | Trait.HIDES_UNTIL_RESET
        | Trait.SHOWN_BY_TENSION
        | Trait.SHOWN_BY_WAY,
    )
    ENCODER_STUCK = FaultRow(
        57,
        words="the drive's position does not follow the probe, the tension does ({text}): its encoder is stuck",
        meaning="the tension answers the probe, the drive's position does not follow its commands",
        remedy="Secure the load; check the drive's encoder and its scale before a reset.",
        traits=Trait.STROKE_DOUBTED | Trait.HIDES_DRIVE | Trait.HIDES_UNTIL_RESET,
    )
    DRIVE_MOTIONLESS = FaultRow(
        58,
        words="neither stroke nor tension answers the probe ({text}): the drive does not move",
        meaning="neither stroke nor tension answers the probe",
        remedy="Look at the drive's display, its enabling inputs and its mechanics.",
        traits=Trait.STROKE_DOUBTED,
    )
    LOAD_UNSEEN = FaultRow(
        59,
        words=(
            "the stroke has gone where the tension does not show it: {text}; a frozen, drifting or wrongly scaled"
            " cell, or a payload"
        ),
        meaning=(
            "while COMPENSATING the stroke has gone by more newtons than the tension shows, the rope's lean and "
            "`safety.heave_mm` taken off: a frozen or drifting cell, or a payload; in TENSIONING: the motor's "
            "current shows a load of which the cell shows nothing or too little (frozen, or of wrong scale); then"
            " TENSION moves nothing until the rope has been released, the cell corrected, or the daemon started "
            "anew"
        ),
        remedy="Check the cell with a known weight; a payload that moves so far is declared by safety.heave_mm.",
        traits=Trait.CELL_DOUBTED | Trait.SHOWN_BY_TENSION | Trait.SHOWN_BY_WAY,
    )
    ROPE_CHANGED = FaultRow(
        61,
        words="the tension answers the stroke's probe by {text}: rope, spring or the cell's scale has changed",
        meaning="tension and stroke answer the probe, by another stiffness than before",
        remedy=(
            "Secure the load; look at rope, clamp and spring, and check the cell with a known weight before a reset."
        ),
        traits=Trait.SHOWN_BY_TENSION,
    )

    @property
    def blocks_reset(self) -> bool:
        """A reset is refused while the cause is present."""
        return Trait.BLOCKS_RESET in self.traits


def having(trait: Trait) -> frozenset[Fault]:
    """The faults with a trait."""
    return frozenset(fault for fault in Fault if trait in fault.traits)


def bits_of(faults: Iterable[Fault]) -> int:
    """The set of causes of these faults."""
    return sum(fault.bit for fault in set(faults))


def faults_of(bits: int) -> list[Fault]:
    """The faults whose causes are in a set, in the order of the catalogue; a bit of no fault is left out."""
    return [fault for fault in Fault if bits & fault.bit]


_AT_ITS_TIME = re.compile(r", the rope is slack in about \d+ s")


def lasting(words: str) -> str:
    """Words of an event without those that are true only at its time: the state counts down until the rope is slack."""
    return _AT_ITS_TIME.sub("", words)
