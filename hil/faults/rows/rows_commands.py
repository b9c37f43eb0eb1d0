"""Rows of the catalogue: the path from command to motor and back, in every mode and in every phase of arming."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from hil.faults import in_controller, in_device, on_bus
from hil.faults.expected import ARMED, DRIVE_MS, POWER_OFF, RIDE, Around, Expected, InjectedFault, Reaction
from hil.faults.rows.arming_phases import BRAKE_TEST, PHASES
from hil.faults.rows.rows_creep import HELD_MM
from hil.faults.stand import Injector
from rigctl.devices import objects
from rigctl.devices.objects import EmcyCode
from rigctl.model.device_states import DriveState
from rigctl.model.parts import Part
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

_SOON = ("hold.park_s", 0.5)
"""HOLD needs the drive's obedience when the brake takes the load: soon, so that a row is short."""
_SYNC_ELSEWHERE = 0x81  # an identifier that no node of the rig sends
_LOST: Expected = {
    **dict.fromkeys(ARMED, Reaction.HELD),
    Mode.DISARMED: Reaction.REFUSED,
    Mode.FAULT: Reaction.KEPT,
}
_AT_WORST: Expected = {
    **dict.fromkeys(ARMED, Reaction.EITHER),
    Mode.DISARMED: Reaction.RIDDEN,
    Mode.FAULT: Reaction.KEPT,
}
_TORQUE: Expected = {**POWER_OFF, Mode.DISARMED: Reaction.RIDDEN}
_ARMING: Expected = {Mode.DISARMED: Reaction.EITHER}

OVERCURRENT = 0x2310


_TAKES_BACK = in_controller.commanded(Verb.HOLD, Verb.TENSION, after_s=1.0)
"""The brake has the load by then."""
_WITH = {"enabling_refused": _TAKES_BACK, "torque_late": _TAKES_BACK}
"""Commands that a fault needs in a mode, beside arming."""
_FREE = "torque_lost_free"
_FROZEN = "drive_frozen"
"""Its statusword ages until the tension shows that it does, in the time of `DRIVE_MS`."""


def _and_stops(defect: Injector) -> Injector:
    """A defect that only a stop shows, and the stop; its cause is named first."""
    return replace(in_device.both(defect, on_bus.silent(on_bus.cell)), part=(Part.AMPLIFIER, Part.DRIVE))


_FAULTS: tuple[tuple[str, str, Injector, Expected, str], ...] = (
    ("sync_lost", "no device receives SYNC any more, all other frames arrive", on_bus.sync_lost(), _LOST,
     "the drive goes on at its last speed: NMT stop, then silence, so that it stops by itself"),
    ("sync_unheard", "the drive takes no frame as SYNC any more", in_device.sync_unheard(on_bus.drive), _LOST,
     "the same, of the drive alone"),
    ("sync_twice", "every SYNC reaches the devices twice", on_bus.sync_twice(), _AT_WORST, ""),
    ("sync_foreign", "another node sends SYNC too", on_bus.sync_foreign(), _LOST, "a second controller"),
    ("foreign_sync_id", "another master has the drive listen for SYNC elsewhere (0x1005)",
     on_bus.sdo_write(objects.SYNC_COB_ID, 0, 4, _SYNC_ELSEWHERE), _LOST, ""),
    ("lost_sync_id", "the drive listens for SYNC elsewhere (0x1005): its own service connection wrote it",
     in_device.setting_lost(objects.SYNC_COB_ID, 0, _SYNC_ELSEWHERE), _LOST, ""),
    ("foreign_polarity", "another master reverses the drive's commands (0x607E)",
     on_bus.sdo_write(objects.POLARITY, 0, 1, objects.VELOCITY_POLARITY), _LOST, ""),
    ("lost_polarity", "the drive's commands are reversed (0x607E): its own service connection wrote it",
     in_device.setting_lost(objects.POLARITY, 0, objects.VELOCITY_POLARITY), _LOST, ""),
    ("rpdo_ignored", "the drive receives its commands and does not act on them", in_device.rpdo_ignored(), _AT_WORST,
     "seen when it is to do something else than before"),
    ("rpdo_frozen", "the drive takes the content of one command for that of every one", in_device.rpdo_frozen(),
     _AT_WORST, ""),
    ("rpdo_late", "the drive acts on every command 100 ms late", in_device.rpdo_late(100), _AT_WORST, ""),
    (_FROZEN, "the drive's samples go on with the content of one of them", on_bus.frozen(on_bus.drive),
     _AT_WORST, "its state is not known then, its motion shows in the tension alone"),
    ("controlword_slow", "the drive reads its controlword every 16 ms", in_device.controlword_every(16), RIDE, ""),
    ("controlword_slow_stop", "the same, and the cell's samples stop", _and_stops(in_device.controlword_every(16)),
     _LOST, ""),
    *((f"{state.name.lower()}_persists",
       f"every stop of the drive ends in {state.name.replace('_', ' ')}, its motor carrying; the cell's samples stop",
       _and_stops(in_device.state_persists(state)), _LOST, "disable voltage leads out of it, and is sent")
      for state in (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE)),
    ("drive_reports_off", "the drive reports SWITCH ON DISABLED, and goes on as it is commanded",
     in_device.state_reported(DriveState.SWITCH_ON_DISABLED), {**_LOST, Mode.DISARMED: Reaction.RIDDEN},
     "power off at the first tick that shows it, where the stroke moves"),
    ("enabling_refused", "the drive takes every command and does not switch its motor on; TENSION",
     in_device.enabling_refused(), {Mode.HOLD: Reaction.RIDDEN},
     "TENSION is refused, the load stays on the brake"),
    ("drive_boots", "the drive starts anew, which takes 1 s", in_device.boots_slowly(on_bus.drive, 1.0), _LOST, ""),
    ("drive_refuses_start", "the drive resets its communication and takes no NMT start",
     in_device.start_refused(on_bus.drive), _LOST, ""),
    ("drive_back_in_error", "the drive starts anew and comes back with an overcurrent",
     in_device.back_in_error(on_bus.drive, OVERCURRENT), _LOST, ""),
    ("cell_back_in_error", "the cell's amplifier starts anew and comes back with an error",
     in_device.back_in_error(on_bus.cell, EmcyCode.SENSOR_INVALID), _LOST, ""),
    ("torque_late", "the motor's torque comes 10 ms after the brake has opened; TENSION",
     in_device.torque_lost(free=True, after_s=0.01), {Mode.HOLD: Reaction.EITHER}, ""),
    ("torque_lost", "the motor has no torque any more, its windings shorted", in_device.torque_lost(free=False),
     _TORQUE, "the load turns it by 0.5 mm/s, until the brake has it"),
    (_FREE, "the motor has no torque any more, and turns freely", in_device.torque_lost(free=True), _TORQUE,
     "the load accelerates 50 kg until the brake has it: power off at the first tick that shows it"),
)  # fmt: skip


def _rows() -> Iterator[InjectedFault]:
    for id_, what, inject, expected, why in _FAULTS:
        commands = _WITH.get(id_)
        yield InjectedFault(
            id_, what, inject if commands is None else in_device.both(inject, commands), expected, seconds=1.5,
            after_s=AFTER_S, held_mm=math.inf if id_ in (_FREE, "torque_late") else HELD_MM, latency_ms=DRIVE_MS,
            around=Around(change=(_SOON,), course=commands if id_ == "torque_late" else None),
            against_cut=id_ == _FREE, why=why, shown_late_ms=DRIVE_MS if id_ == _FROZEN else 0.0,
        )  # fmt: skip
        for phase in PHASES:
            yield InjectedFault(
                f"{id_}_while_{phase}",
                f"the same in arming, while {_WORDS[phase]}",
                inject,
                _ARMING,
                seconds=_SECONDS[phase],
                after_s=AFTER_S,
                held_mm=math.inf if id_ == _FREE else HELD_MM,
                against_cut=id_ == _FREE,
                around=Around(change=(_SOON, BRAKE_TEST), phase=phase),
            )


AFTER_S = 20.0
"""A row is watched for so long after the end of the reaction."""
_WORDS = {
    "reading": "the settings are read back",
    "testing": "the brake is tested",
    "enabling": "the drive is commanded on",
    "opening": "the brake opens",
}
_SECONDS = {"reading": 6.0, "testing": 5.0, "enabling": 3.0, "opening": 3.0}
"""Brake test 2 s, time-out of the drive 2 s, its end."""
COMMANDS = tuple(_rows())
