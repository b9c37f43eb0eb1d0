"""Numbers that are stored: recordings, dumps, the audit log and the rings of every version hold them."""

from __future__ import annotations

from enum import IntEnum, IntFlag

import pytest

from rigctl.ipc.notes import Note
from rigctl.ipc.supervision import Doing
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault, bits_of, faults_of
from rigctl.model.reactions import Action
from rigctl.model.states import EndStep, Event, HeldBy, LoadAtRest, Mode, PowerOff
from rigctl.model.verbs import Refusal, Setting, Verb

NUMBERS: dict[type[IntEnum] | type[IntFlag], str] = {
    Mode: ("DISARMED=0 HOLD=1 TENSIONING=2 COMPENSATING=3 RELEASING=4 FAULT=5"),
    HeldBy: ("NOTHING=0 MOTOR=1 CLOSING=2 BRAKE=3 TAKING=4 UNKNOWN=5"),
    PowerOff: ("NONE=0 AWAITED=1 INPUT=2 TENSION=4 STROKE=5 UNCONFIRMED=6"),
    LoadAtRest: ("UNKNOWN=0 MOVES=1 TENSION=2 STROKE=3 BOTH=4"),
    Event: (
        "ENABLED=0 TENSION=1 TENSIONED=2 RELEASE=3 SLACK=4 HOLD=5 DISARM=6 TRIP=7 RESET_HELD=8 RESET_OFF=9 STOP=10 "
        "RAMP_DOWN=11 LOWER=12 UNTESTED=13 PAY_OUT=14 RAMP_ENDS=15"
    ),
    Verb: (
        "ARM=1 TENSION=2 RELEASE=3 HOLD=4 DISARM=5 RESET=6 TARGET=7 TARE=8 CALIBRATE=9 IDENTIFY=10 GAINS=11 "
        "CONFIRM_STROKE=12 RESPONSE=13 MOVE=14 CARRY=15 LOWER=16 BRAKE_TEST=17"
    ),
    Setting: ("ZERO=128 SCALE=129 OVERDUE=130 HOST_CHECKS=134 LAW_GAINS=135 MARGINS=140 CREEP=144 DIFFERS=145"),
    Refusal: (
        "NONE=0 WRONG_MODE=1 PREFLIGHT=2 OUT_OF_RANGE=3 CAUSE_PRESENT=4 ALREADY=5 EXPIRED=6 UNKNOWN=7 STOPPING=8 "
        "DRIVE_TIMEOUT=9 ABORTED=10 LOADED=11 UNSTEADY=12 NO_SAMPLES=13 SLACK=14 STRAYED=15 FAULT_LATCHED=16 "
        "STROKE_DIFFERS=19 STOP_RUNNING=21 BRAKE_SLIPPED=22 UNFELT=23 NO_LEARNING=24 NO_STEP=30 CARRIED=100 "
        "DISAGREE=101 DRIVE_STATE=102 OFF_UNSEEN=103 TIGHT=104 LITTLE_LOAD=105 NO_BRAKE=106 SUNK=107"
    ),
    Fault: (
        "NONE=0 TENSION_HIGH=1 TENSION_LOW=2 CELL_STALE=3 CELL_INVALID=4 INCLINATION_STALE=5 "
        "INCLINATION_INVALID=6 DRIVE_STALE=7 DRIVE_FAULT=8 BUS_SILENT=9 OVERRUN=10 LOOP_EXCEPTION=11 "
        "STROKE_END=12 DRIVE_NOT_FOLLOWING=13 DEVICE_RESTARTED=14 INNOVATION=15 SIGN_DRIVE=16 SIGN_CELL=17 "
        "LIMIT=18 CELL_STUCK=19 DRIVE_CONTRADICTS=20 STROKE_MOVES=21 STRETCH_UNEXPLAINED=22 E_STOP=23 "
        "CELL_NOISY=24 CELL_NEGATIVE=25 SENSOR_EMERGENCY=26 DRIVE_EMERGENCY=27 RIVAL=28 E_STOP_UNSEEN=29 "
        "STROKE_NOT_HELD=30 POSITION_DRIFTS=31 STATUS_STALE=33 LIMIT_UNSEEN=34 DRIVE_UNASKED=35 DRIVE_REFUSES=36 "
        "NODE_NOT_OPERATIONAL=37 SUPERVISION_LOST=38 STROKE_JUMPED=39 BRAKE_SLIPS=41 "
        "FORCES_DISAGREE=46 LOAD_SINKS=51 SYNC_LOST=55 CELL_FROZEN=56 ENCODER_STUCK=57 DRIVE_MOTIONLESS=58 "
        "LOAD_UNSEEN=59 ENABLE_IGNORED=60 ROPE_CHANGED=61"
    ),
    Action: ("LOG=0 RAMP_DOWN=1 HOLD=2 QUICK_STOP=3 POWER_OFF=4 SILENCE=5"),
    Kind: (
        "MODE=1 TRIP=2 RESET=3 EMERGENCY=4 NODE_STATE=5 EXCEPTION=6 BUS_ERROR=7 SEND_FAILED=8 STARTED=9 "
        "STOPPED=10 CLOCK=11 CORRECTION=12 SIGNS=13 GAINS=14 LIMIT=15 LIMIT_OVER=16 RECEIVE_FAILED=17 "
        "STROKE_LEFT=40 DRIVE_CREEPS=41 ESCALATION=42 CAUSE=45 CAUSE_OVER=46 FOREIGN_SDO=50 SETTING_LOST=51 "
        "READ_BACK=52 STROKE=53 BRAKE_TEST=55 BRAKE_FLAG=56 WITNESS=57 ENDING=58 LOCAL_HOLD=65 HOLD_SOCKET_CLOSED=66 "
        "CREEP=70 LOAD_STEP=71 SECOND_FORCE=73 "
        "MOVE=80 LEARNT=81 NOT_LEARNT=82 HELD=100 NO_MARGINS=101 MARGINS_DIFFER=104 POWER_OFF=102 "
        "LOAD_AT_REST=103 START_ANEW=120 FOUND_AT_START=121"
    ),
    EndStep: ("WAITS=1 LOWERS=2 LOWERED=3 LEFT=4 GONE=5 LATE=6"),
    Note: (
        "LEASE_TAKEN=1 LEASE_TAKEN_OVER=2 LEASE_RETURNED=3 LEASE_LAPSED=4 HOLD_WITHOUT_LEASE=5 "
        "LEASE_NOT_BELIEVED=6 ALARM_ACKNOWLEDGED=7 ALARM_SHELVED=8 ALARM_UNSHELVED=9 OPERATOR_NOTE=10 "
        "TOO_MANY_COMMANDS=65 MESSAGE_REFUSED=66 CONNECTION_REFUSED=67 "
        "CONNECTION_CLOSED=69 ENDPOINT_TAKEN=70 ENDPOINT_BACK=71 "
        "PROCESS_LOST=72 PROCESS_BACK=73 AUDIT_LOG_CHANGED=74"
    ),
    Doing: (
        "DAEMON_STARTED=1 DAEMON_DESIGNED=2 DAEMON_REFUSED=3 DAEMON_STOPPED=4 PROCESS_STARTED=5 PROCESS_ENDED=6 "
        "PROCESS_STALLED=7 PROCESS_RESUMED=8 "
        "FOLDER_LOST=60"
    ),
    Check: (
        "CELL_STALE=0 CELL_INVALID=1 INCLINATION_STALE=2 INCLINATION_INVALID=3 DRIVE_STALE=4 DRIVE_FAULT=5 "
        "TENSION_HIGH=6 STROKE_RANGE=7 DRIVE_SUPERVISION=8 CALIBRATION=9 E_STOP=10 CELL_IMPLAUSIBLE=11 "
        "EMERGENCY=12 LIMIT=13 E_STOP_UNSEEN=14 STROKE_NEAR_END=15 TARE=16 MARGINS=17 REALTIME=18 DISK=19 HOST=20 "
        "RIVAL=21 E_STOP_IO=22 E_STOP_IO_UNSEEN=23 STATUS_STALE=24 DRIVE_REFUSES=25 NODE_NOT_OPERATIONAL=26 "
        "STROKE_UNCONFIRMED=27 NOT_AT_STANDSTILL=29 SEQUENCE_RUNNING=30 SECOND_FORCE=34 "
        "FORCES_DISAGREE=35 ENABLE_IGNORED=36"
    ),
}
"""A changed number would change the meaning of an old recording; of `Check` it is the bit. A release adds its own."""
GONE: dict[type[IntEnum] | type[IntFlag], set[int]] = {
    PowerOff: {3}, Note: {68}, Setting: {131, 132, 133}, Kind: {72}, Check: {33},
}  # fmt: skip
"""Numbers of members that are no more: none is used again."""
CAUSE_BITS = (
    "TENSION_HIGH=0 TENSION_LOW=1 CELL_STALE=2 CELL_INVALID=3 INCLINATION_STALE=4 INCLINATION_INVALID=5 "
    "DRIVE_STALE=6 DRIVE_FAULT=7 BUS_SILENT=8 OVERRUN=9 LOOP_EXCEPTION=10 STROKE_END=11 DRIVE_NOT_FOLLOWING=12 "
    "DEVICE_RESTARTED=13 INNOVATION=14 SIGN_DRIVE=15 SIGN_CELL=16 LIMIT=17 CELL_STUCK=18 DRIVE_CONTRADICTS=19 "
    "STROKE_MOVES=20 STRETCH_UNEXPLAINED=21 E_STOP=22 CELL_NOISY=23 CELL_NEGATIVE=24 SENSOR_EMERGENCY=25 "
    "DRIVE_EMERGENCY=26 RIVAL=27 E_STOP_UNSEEN=28 STROKE_NOT_HELD=29 POSITION_DRIFTS=30 STATUS_STALE=31 "
    "LIMIT_UNSEEN=32 DRIVE_UNASKED=33 DRIVE_REFUSES=34 NODE_NOT_OPERATIONAL=35 SUPERVISION_LOST=36 STROKE_JUMPED=37 "
    "BRAKE_SLIPS=38 FORCES_DISAGREE=39 LOAD_SINKS=40 SYNC_LOST=41 ENABLE_IGNORED=42 CELL_FROZEN=43 ENCODER_STUCK=44 "
    "DRIVE_MOTIONLESS=45 LOAD_UNSEEN=46 ROPE_CHANGED=47"
)
"""Places of the bits of causes in ``cause_bits``, in the order of the catalogue; a new fault is the last."""


@pytest.mark.parametrize("kind", NUMBERS, ids=lambda kind: kind.__name__)
def test_a_number_in_a_file_keeps_its_meaning(kind: type[IntEnum] | type[IntFlag]) -> None:
    known = {name: int(number) for name, number in (word.split("=") for word in NUMBERS[kind].split())}
    found = {member.name: int(member).bit_length() - 1 if kind is Check else int(member) for member in kind}
    assert {name: found.get(name) for name in known} == known
    assert GONE.get(kind, set()).isdisjoint(found.values())


def test_faults_and_checks_fit_the_64_bits_that_records_and_replies_have_for_them() -> None:
    """``cause_bits`` and ``checks`` are one bit a member: one too many would fail the record of the tick."""
    free_causes, free_checks = 64 - max(fault.bit for fault in Fault).bit_length(), 64 - max(Check).bit_length()
    assert min(free_causes, free_checks) >= 8


def test_a_cause_keeps_its_bit_and_no_fault_has_none() -> None:
    places = {name: int(place) for name, place in (word.split("=") for word in CAUSE_BITS.split())}
    assert {name: Fault[name].bit for name in places} == {name: 1 << at for name, at in places.items()}
    assert [fault.bit for fault in Fault] == [0, *(1 << at for at in range(len(Fault) - 1))]


def test_a_set_of_causes_holds_each_once_and_gives_them_in_the_order_of_the_catalogue() -> None:
    given = [Fault.ROPE_CHANGED, Fault.E_STOP, Fault.NONE, Fault.E_STOP]
    assert bits_of(given) == Fault.ROPE_CHANGED.bit | Fault.E_STOP.bit
    assert faults_of(bits_of(given)) == [Fault.E_STOP, Fault.ROPE_CHANGED]
    assert faults_of(bits_of(Fault)) == list(Fault)[1:]
    assert faults_of(1 << 63) == []
