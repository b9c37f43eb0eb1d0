"""The catalogue of faults: number, name, cause in words, remedy, and what the fault bars.

The rows of `rigctl.control.safety.table` give the value watched for each, with limit and persistence.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import IntEnum, IntFlag


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


_NO_TRAIT = Trait(0)
_HIDES_ALL = Trait.HIDES_TENSION | Trait.HIDES_DRIVE | Trait.HIDES_INCLINATION


class Fault(IntEnum):
    """What can trip the rig; the number is latched in every record until an operator resets it.

    ``words``: the cause in one line, a template of ``value``, ``limit`` and the names that
    `rigctl.control.events.fault_text` fills in. ``remedy``: what the operator does about it.

    A new fault is the last row: ``bit`` goes by the place of its row, and recordings, rings and subscribers hold it.
    """

    bit: int
    """The bit of its cause in sets of causes, such as ``cause_bits`` of the record; NONE has no bit, 0."""
    words: str
    remedy: str
    traits: Trait

    def __new__(cls, number: int, words: str = "", remedy: str = "", traits: Trait = _NO_TRAIT) -> Fault:
        """A member with its words."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.bit = 1 << len(cls.__members__) >> 1
        member.words, member.remedy, member.traits = words, remedy, traits
        return member

    NONE = (
        0,
        "no fault",
    )
    TENSION_HIGH = (
        1,
        "tension {value:.1f} N above {limit:.1f} N",
        "Take the pull off the rope in the hall: support the payload until the cell reads less; find what pulled.",
        Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    TENSION_LOW = (
        2,
        "tension lost ({value:.1f} N, limit {limit:.1f} N)",
        "Look at rope, clamp and payload before tensioning again.",
    )
    CELL_STALE = (
        3,
        "no tension sample for {value:.0f} ms (limit {limit:.0f} ms)",
        "Check the cell amplifier's power and cable.",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.HIDES_TENSION,
    )
    CELL_INVALID = (
        4,
        "tension cell reports overload or no valid value (status {value:.0f})",
        "Unload the cell and check its cable.",
        Trait.BLOCKS_RESET | Trait.HIDES_TENSION,
    )
    INCLINATION_STALE = (
        5,
        "no inclination sample for {value:.0f} ms (limit {limit:.0f} ms)",
        "Check the inclinometer's power and cable.",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.HIDES_INCLINATION,
    )
    INCLINATION_INVALID = (
        6,
        "inclinometer reports no valid value",
        "Check the inclinometer's mounting and range.",
        Trait.BLOCKS_RESET | Trait.HIDES_INCLINATION,
    )
    DRIVE_STALE = (
        7,
        "no drive status for {value:.0f} ms (limit {limit:.0f} ms)",
        "Check the drive's power and cable.",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.STOPS_CARRYING | Trait.HIDES_DRIVE,
    )
    DRIVE_FAULT = (
        8,
        "drive reports a fault of its own",
        "Read the drive's emergency code in the events; a reset clears it once its cause is gone.",
    )
    BUS_SILENT = (
        9,
        "no frame on the bus for {value:.0f} ms (limit {limit:.0f} ms)",
        "Check CAN interface, termination, device power.",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.STOPS_CARRYING | _HIDES_ALL,
    )
    OVERRUN = (
        10,
        "{value:.0f} ticks skipped, loop cannot keep its rate (limit {limit:.0f} ticks)",
        "Run rigctl doctor: real-time rights, other load on the loop's processor.",
        Trait.BLOCKS_RESET,
    )
    LOOP_EXCEPTION = (
        11,
        "exception in the loop",
        "Keep the trip dump and report the exception; reset goes on.",
    )
    STROKE_END = (
        12,
        "stroke limit reached before the tension was",
        "Look why the stroke came to its end: the rope is too long, or the payload hangs on nothing.",
        Trait.STOPS_CARRYING,
    )
    DRIVE_NOT_FOLLOWING = (
        13,
        "drive does not do as commanded: {missed}",
        "Look at the drive's display, its enabling inputs and its tuning.",
        Trait.STOPS_CARRYING,
    )
    DEVICE_RESTARTED = (
        14,
        "a device restarted and lost its settings; start the daemon anew",
        "Start the daemon anew: it writes the device's settings again.",
        Trait.BLOCKS_RESET | Trait.DEVICE_SILENT,
    )
    # Tension or drive speed keeps contradicting the filter's prediction
    INNOVATION = (
        15,
        "tension or cylinder speed contradicts what the filter expects",
        "Look at cell, encoder and rope.",
        Trait.CELL_DOUBTED,
    )
    # A positive command does not move the stroke up
    SIGN_DRIVE = (
        16,
        "the stroke does not go where the drive is commanded: check the drive's sign and scale",
        "Correct the drive's sign or scale in the rig file.",
    )
    # A shorter rope does not pull harder, or by far more or less than the plant's stiffness
    SIGN_CELL = (
        17,
        "the tension does not follow the stroke as the plant would{found}: check signs and scales of cell and drive",
        "Correct the cell's sign, the drive's units or the plant's stiffness (mechanism_n_mm too) in the rig file.",
        Trait.CELL_DOUBTED | Trait.HIDES_TENSION | Trait.HIDES_UNTIL_RESET,
    )
    # A row of the rig file's limits; the trip's event names it
    LIMIT = (
        18,
        "{text} {limit:.10g}{unit} ({value:.4g}{unit})",
        "Look at the signal named; its limit is in the rig file.",
        Trait.OF_RIG_FILE,
    )
    # The cell keeps sending the very same value
    CELL_STUCK = (
        19,
        "tension cell has sent the very same value {value:.0f} times more (limit {limit:.0f} times)",
        "Check the cell amplifier: it repeats its last value.",
        Trait.BLOCKS_RESET | Trait.CELL_DOUBTED | Trait.CELL_IMPLAUSIBLE | Trait.HIDES_TENSION,
    )
    # The drive's reported speed is not the rate of its position
    DRIVE_CONTRADICTS = (
        20,
        "drive's position and speed contradict each other by {value:.2f} mm (limit {limit:.2f} mm)",
        "Check the drive's encoder and its scale.",
        Trait.STROKE_DOUBTED | Trait.HIDES_DRIVE,
    )
    # The stroke moves though the drive is off: the brake does not hold
    STROKE_MOVES = (
        21,
        (
            "the stroke moves though the drive is off ({value:.2f} mm/s){text}: the brake does not hold; rigctl carry: "
            "the motor holds the load, rigctl lower: it lowers it"
        ),
        "Secure the load: rigctl carry has the motor hold it, rigctl lower lowers it; have the brake repaired.",
        Trait.BLOCKS_RESET | Trait.BRAKE_FAILS | Trait.MOTOR_MAY_CARRY | Trait.LOAD_SINKS,
    )
    # Tension changed without a stroke that explains it, or did not change with the stroke
    STRETCH_UNEXPLAINED = (
        22,
        (
            "tension and stroke contradict each other by {value:.1f} mm of stretch (limit {limit:.1f} mm): rope, cell, "
            "encoder or payload"
        ),
        "Look at rope, cell, encoder and payload before a reset.",
        Trait.CELL_DOUBTED,
    )
    # The emergency stop is pressed
    E_STOP = (
        23,
        "emergency stop pressed ({seen})",
        "Release the emergency stop, then reset.",
        Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    # The reading changes far more than by the cell's noise or any motion of the payload
    CELL_NOISY = (
        24,
        "tension cell jumps by {value:.1f} N from sample to sample (limit {limit:.1f} N)",
        "Check the cell's cable, shield and amplifier.",
        Trait.BLOCKS_RESET | Trait.CELL_DOUBTED | Trait.CELL_IMPLAUSIBLE | Trait.HIDES_TENSION,
    )
    # The reading is negative, but a rope cannot push
    CELL_NEGATIVE = (
        25,
        "tension cell reads {value:.1f} N: a rope cannot push (limit {limit:.1f} N)",
        "Check the cell's mounting, and its amplifier's zero with the rope unloaded.",
        Trait.BLOCKS_RESET | Trait.CELL_DOUBTED | Trait.CELL_IMPLAUSIBLE | Trait.HIDES_TENSION,
    )
    # Cell, inclinometer or I/O node has sent an emergency message and not withdrawn it
    SENSOR_EMERGENCY = (
        26,
        "a device's emergency message is active ({emergency})",
        "Read the emergency code in the events, and the device's manual.",
        Trait.BLOCKS_RESET | Trait.CELL_DOUBTED | Trait.EMERGENCY,
    )
    # The drive has sent an emergency message and not withdrawn it
    DRIVE_EMERGENCY = (
        27,
        "the drive's emergency message is active ({emergency})",
        "Read the emergency code in the events, and the drive's manual.",
        Trait.EMERGENCY,
    )
    # Another controller commands this bus
    RIVAL = (
        28,
        "another controller {text}: find it and stop it",
        "Find the other controller on this bus and stop it.",
        Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    # The I/O node that mirrors the emergency stop is silent
    E_STOP_UNSEEN = (
        29,
        "the I/O node that mirrors the emergency stop has sent nothing for {value:.0f} ms (limit {limit:.0f} ms)",
        "Check the I/O node's power and cable.",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT,
    )
    # The stroke has left where HOLD, FAULT or DISARMED latched it
    STROKE_NOT_HELD = (
        30,
        (
            "the stroke has moved {value:.2f} mm from where it was latched (limit {limit:.2f} mm): the drive creeps or "
            "the brake slips"
        ),
        "Look at the drive's velocity offset (0x60B1) and tuning, and at the brake.",
        Trait.MOTOR_MAY_CARRY,
    )
    # The correction of a held stroke has added up to what could move the load
    POSITION_DRIFTS = (
        31,
        (
            "holding the stroke has taken {value:.2f} mm of correction (limit {limit:.2f} mm): the drive's position "
            "drifts, or the drive creeps"
        ),
        "Check the drive's encoder, and its velocity offset (0x60B1).",
        Trait.STROKE_DOUBTED,
    )
    # The drive no longer sends current, temperature and inputs
    STATUS_STALE = (
        33,
        (
            "no current, temperature and inputs of the drive for {value:.0f} ms (limit {limit:.0f} ms): neither its "
            "emergency stop's input nor its temperature is seen"
        ),
        "Check the drive's second TPDO (cylinder.status_rate_hz).",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT,
    )
    # The signal that a limit of the rig file watches is missing
    LIMIT_UNSEEN = (
        34,
        "{text} is limited by the rig file and does not come: no sample for {value:.0f} ms (limit {limit:.0f} ms)",
        "Check the device that sends the signal named.",
        Trait.AGE | Trait.OF_RIG_FILE,
    )
    # The drive is enabled, or moves under power, without our command
    DRIVE_UNASKED = (
        35,
        "{text}{not_requested}",
        "Find who commands the drive, withdraw the tool, then reset.",
        Trait.BLOCKS_RESET | Trait.STOPS_CARRYING,
    )
    # The drive reports that it does not do as commanded: statusword bits 9, 11, 12
    DRIVE_REFUSES = (
        36,
        "drive reports that {text}",
        "Withdraw the drive's panel or service tool; look at its display.",
        Trait.BLOCKS_RESET,
    )
    # A device's heartbeat has stopped, or reports another state than OPERATIONAL
    NODE_NOT_OPERATIONAL = (
        37,
        "{text} {state}",
        "Check the device's power and cable; start the daemon anew.",
        Trait.BLOCKS_RESET | Trait.DEVICE_SILENT,
    )
    # An object that safety needs is not what start-up wrote, or its device gives no answer
    SUPERVISION_LOST = (
        38,
        "a device does not keep what start-up wrote, {text}: start the daemon anew, it writes all of it again",
        "Start the daemon anew: it writes all settings.",
        Trait.BLOCKS_RESET | Trait.DEVICE_SILENT,
    )
    # The drive's position changed between two samples by more than a stroke can move
    STROKE_JUMPED = (
        39,
        (
            "the drive's position jumped by {value:.2f} mm (limit {limit:.1f} mm): it is not believed; measure the "
            "stroke at the cylinder, then rigctl confirm-stroke MM"
        ),
        "Measure the stroke at the cylinder, then rigctl confirm-stroke MM.",
        Trait.BLOCKS_RESET | Trait.STROKE_DOUBTED | Trait.HIDES_DRIVE,
    )
    # The brake let the stroke move in the brake test, or in the first second after a parking
    BRAKE_SLIPS = (
        41,
        (
            "the stroke moved by {value:.2f} mm on the closed brake (limit {limit:.2f} mm){text}; rigctl carry: the "
            "motor holds the load, rigctl lower: it lowers it; have the brake repaired"
        ),
        "Secure the load: rigctl carry has the motor hold it, rigctl lower lowers it; have the brake repaired.",
        Trait.BRAKE_FAILS | Trait.MOTOR_MAY_CARRY | Trait.LOAD_SINKS,
    )
    # The second force path and the cell differ by more than both may be wrong
    FORCES_DISAGREE = (
        46,
        "the two force paths disagree by {value:.2f} N (limit {limit:.2f} N): cell, second cell, spring or encoder",
        (
            "Support the payload until the rope is slack; rigctl disarm, then rigctl reset; find the wrong force path "
            "with a known weight, and correct it at its amplifier."
        ),
    )  # no bar of a reset: tare and calibration, its remedies, are commands of DISARMED

    # On the closed brake the tension falls
    LOAD_SINKS = (
        51,
        (
            "the tension {text}, by {value:.1f} N on the closed brake (limit {limit:.1f} N): the brake slips, or the "
            "payload or the rail was moved"
        ),
        "Secure the load: rigctl lower has the motor lower it; no reset while it sinks; have the brake repaired.",
        Trait.BLOCKS_RESET | Trait.LOAD_SINKS,
    )
    # What SYNC latches has stopped at every device, though the bus is alive
    SYNC_LOST = (
        55,
        "no device has answered SYNC for {value:.0f} ms (limit {limit:.0f} ms), though the bus is alive",
        "Find what keeps SYNC from the devices (cable, gateway, 0x1005); the drive keeps its last speed without it.",
        Trait.BLOCKS_RESET | Trait.AGE | Trait.DEVICE_SILENT | Trait.STOPS_CARRYING | _HIDES_ALL,
    )
    # The feedback at io.drive_off_input is not as io.drive_enable_output should have it
    ENABLE_IGNORED = (
        60,
        "the drive's STO feedback (io.drive_off_input) does not follow its hard-wired enable (io.drive_enable_output)",
        "Check wire, relay and feedback of the drive's enable: as it is, it may not take the motor's torque away.",
        Trait.BLOCKS_RESET,
    )
    # The cell does not answer the probe, though the stroke does
    CELL_FROZEN = (
        56,
        "the tension cell does not answer the probe: {text}; its value is not the load's",
        "Secure the load; check cell and amplifier with a known weight before a reset.",
        Trait.CELL_DOUBTED | Trait.HIDES_TENSION | Trait.HIDES_UNTIL_RESET,
    )
    # The cell answers the probe, and the drive's position does not
    ENCODER_STUCK = (
        57,
        "the drive's position does not follow the probe, the tension does ({text}): its encoder is stuck",
        "Secure the load; check the drive's encoder and its scale before a reset.",
        Trait.STROKE_DOUBTED | Trait.HIDES_DRIVE | Trait.HIDES_UNTIL_RESET,
    )
    # Neither the drive's position nor the tension answers the probe
    DRIVE_MOTIONLESS = (
        58,
        "neither stroke nor tension answers the probe ({text}): the drive does not move",
        "Look at the drive's display, its enabling inputs and its mechanics.",
        Trait.STROKE_DOUBTED,
    )
    # The stroke has moved by more than the tension shows and the declared motion of the payload explains
    LOAD_UNSEEN = (
        59,
        "the stroke has gone where the tension does not show it: {text}; a frozen, drifting or wrongly scaled cell, or "
        "a payload",
        "Check the cell with a known weight; a payload that moves so far is declared by safety.heave_mm.",
        Trait.CELL_DOUBTED,
    )
    # Tension and stroke answer the probe, and not with the stiffness of before
    ROPE_CHANGED = (
        61,
        "the tension answers the stroke's probe by {text}: rope, spring or the cell's scale has changed",
        "Secure the load; look at rope, clamp and spring, and check the cell with a known weight before a reset.",
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


EACH_SECOND = ("BUS_ERROR", "SEND_FAILED", "RECEIVE_FAILED")
"""Kinds of events by which the loop reports a bus that fails, every second while it lasts."""
