"""Numbers that are stored: recordings, dumps, the audit log and the rings of every version hold them."""

from __future__ import annotations

from enum import IntEnum, IntFlag

import pytest

from rigctl.control.checks import Check
from rigctl.control.events import Kind
from rigctl.control.faults import Fault
from rigctl.control.modes import Event, Mode, Refusal, Setting, Verb
from rigctl.control.safety import Action
from rigctl.ipc.notes import Note
from rigctl.ipc.supervision import Doing

NUMBERS: dict[type[IntEnum] | type[IntFlag], str] = {
    Mode: ("DISARMED=0 HOLD=1 TENSIONING=2 COMPENSATING=3 RELEASING=4 FAULT=5"),
    Event: (
        "ENABLED=0 TENSION=1 TENSIONED=2 RELEASE=3 SLACK=4 HOLD=5 DISARM=6 TRIP=7 RESET_HELD=8 RESET_OFF=9 STOP=10 "
        "RAMP_DOWN=11"
    ),
    Verb: (
        "ARM=1 TENSION=2 RELEASE=3 HOLD=4 DISARM=5 RESET=6 TARGET=7 TARE=8 CALIBRATE=9 IDENTIFY=10 GAINS=11 "
        "CONFIRM_STROKE=12"
    ),
    Setting: ("ZERO=128 SCALE=129 OVERDUE=130 HOST_CHECKS=134 LAW_GAINS=135"),
    Refusal: (
        "NONE=0 WRONG_MODE=1 PREFLIGHT=2 OUT_OF_RANGE=3 CAUSE_PRESENT=4 ALREADY=5 EXPIRED=6 UNKNOWN=7 STOPPING=8 "
        "DRIVE_TIMEOUT=9 ABORTED=10 LOADED=11 UNSTEADY=12 NO_SAMPLES=13 SLACK=14 STRAYED=15 FAULT_LATCHED=16 "
        "STROKE_DIFFERS=19 STOP_RUNNING=21 BRAKE_SLIPPED=22"
    ),
    Fault: (
        "NONE=0 TENSION_HIGH=1 TENSION_LOW=2 CELL_STALE=3 CELL_INVALID=4 INCLINATION_STALE=5 "
        "INCLINATION_INVALID=6 DRIVE_STALE=7 DRIVE_FAULT=8 BUS_SILENT=9 OVERRUN=10 LOOP_EXCEPTION=11 "
        "STROKE_END=12 DRIVE_NOT_FOLLOWING=13 DEVICE_RESTARTED=14 INNOVATION=15 SIGN_DRIVE=16 SIGN_CELL=17 "
        "LIMIT=18 CELL_STUCK=19 DRIVE_CONTRADICTS=20 STROKE_MOVES=21 STRETCH_UNEXPLAINED=22 E_STOP=23 "
        "CELL_NOISY=24 CELL_NEGATIVE=25 SENSOR_EMERGENCY=26 DRIVE_EMERGENCY=27 RIVAL=28 E_STOP_UNSEEN=29 "
        "STROKE_NOT_HELD=30 POSITION_DRIFTS=31 STATUS_STALE=33 LIMIT_UNSEEN=34 DRIVE_UNASKED=35 DRIVE_REFUSES=36 "
        "NODE_NOT_OPERATIONAL=37 SUPERVISION_LOST=38 STROKE_JUMPED=39 BRAKE_SLIPS=41"
    ),
    Action: ("LOG=0 RAMP_DOWN=1 HOLD=2 QUICK_STOP=3 POWER_OFF=4"),
    Kind: (
        "MODE=1 TRIP=2 RESET=3 EMERGENCY=4 NODE_STATE=5 EXCEPTION=6 BUS_ERROR=7 SEND_FAILED=8 STARTED=9 "
        "STOPPED=10 CLOCK=11 CORRECTION=12 SIGNS=13 GAINS=14 LIMIT=15 LIMIT_OVER=16 RECEIVE_FAILED=17 "
        "STROKE_LEFT=40 DRIVE_CREEPS=41 ESCALATION=42 CAUSE=45 CAUSE_OVER=46 FOREIGN_SDO=50 SETTING_LOST=51 "
        "READ_BACK=52 STROKE=53 BRAKE_TEST=55 LOCAL_HOLD=65"
    ),
    Note: (
        "LEASE_TAKEN=1 LEASE_TAKEN_OVER=2 LEASE_RETURNED=3 LEASE_LAPSED=4 HOLD_WITHOUT_LEASE=5 "
        "LEASE_NOT_BELIEVED=6 TOO_MANY_COMMANDS=65"
    ),
    Doing: (
        "DAEMON_STARTED=1 DAEMON_DESIGNED=2 DAEMON_REFUSED=3 DAEMON_STOPPED=4 PROCESS_STARTED=5 PROCESS_ENDED=6 "
        "FOLDER_LOST=60"
    ),
    Check: (
        "CELL_STALE=0 CELL_INVALID=1 INCLINATION_STALE=2 INCLINATION_INVALID=3 DRIVE_STALE=4 DRIVE_FAULT=5 "
        "TENSION_HIGH=6 STROKE_RANGE=7 DRIVE_SUPERVISION=8 CALIBRATION=9 E_STOP=10 CELL_IMPLAUSIBLE=11 "
        "EMERGENCY=12 LIMIT=13 E_STOP_UNSEEN=14 STROKE_NEAR_END=15 TARE=16 MARGINS=17 REALTIME=18 DISK=19 HOST=20 "
        "RIVAL=21 E_STOP_IO=22 E_STOP_IO_UNSEEN=23 STATUS_STALE=24 DRIVE_REFUSES=25 NODE_NOT_OPERATIONAL=26 "
        "STROKE_UNCONFIRMED=27 NOT_AT_STANDSTILL=29 SEQUENCE_RUNNING=30"
    ),
}
"""A changed number would change the meaning of an old recording; of `Check` it is the bit."""


@pytest.mark.parametrize("kind", NUMBERS, ids=lambda kind: kind.__name__)
def test_a_number_in_a_file_keeps_its_meaning(kind: type[IntEnum] | type[IntFlag]) -> None:
    known = {name: int(number) for name, number in (word.split("=") for word in NUMBERS[kind].split())}
    found = {member.name: int(member).bit_length() - 1 if kind is Check else int(member) for member in kind}
    assert found == known
