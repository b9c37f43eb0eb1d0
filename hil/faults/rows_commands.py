"""Rows of the catalogue: the path from command to motor and back, in every mode and in every phase of arming."""

from __future__ import annotations

from collections.abc import Iterator

from hil.faults import in_device, on_bus
from hil.faults.arming_phases import BRAKE_TEST, PHASES
from hil.faults.expected import ARMED, DRIVE_MS, Around, Expected, InjectedFault, Reaction
from hil.faults.rows_creep import HELD_MM
from hil.faults.stand import Injector
from rigctl.control.modes import Mode
from rigctl.devices import objects

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
_ARMING: Expected = {Mode.DISARMED: Reaction.EITHER}

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
    ("drive_frozen", "the drive's samples go on with the content of one of them", on_bus.frozen(on_bus.drive),
     _AT_WORST, "its state is not known then, its motion shows in the tension alone"),
)  # fmt: skip


def _rows() -> Iterator[InjectedFault]:
    for id_, what, inject, expected, why in _FAULTS:
        yield InjectedFault(
            id_, what, inject, expected, seconds=1.5, held_mm=HELD_MM, latency_ms=DRIVE_MS,
            around=Around(change=(_SOON,)), why=why,
        )  # fmt: skip
        for phase in PHASES:
            yield InjectedFault(
                f"{id_}_while_{phase}",
                f"the same in arming, while {_WORDS[phase]}",
                inject,
                _ARMING,
                seconds=_SECONDS[phase],
                held_mm=HELD_MM,
                around=Around(change=(_SOON, BRAKE_TEST), phase=phase),
            )


_WORDS = {
    "reading": "the settings are read back",
    "testing": "the brake is tested",
    "enabling": "the drive is commanded on",
    "opening": "the brake opens",
}
_SECONDS = {"reading": 6.0, "testing": 5.0, "enabling": 3.0, "opening": 3.0}
"""Brake test 2 s, time-out of the drive 2 s, its end."""
COMMANDS = tuple(_rows())
