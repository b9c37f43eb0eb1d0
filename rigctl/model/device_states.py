"""States that the standards give a device: of its network (CiA 301) and of its drive (CiA 402)."""

from __future__ import annotations

from enum import IntEnum

STATUSWORD = 0x6041
"""CiA 402: the object by which a drive reports its state."""


class NmtState(IntEnum):
    """State byte of a heartbeat, CiA 301."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


NMT_WORDS: dict[float, str] = {0: "boot-up", 4: "stopped", 5: "operational", 127: "pre-operational"}
"""By the state byte."""


class DriveState(IntEnum):
    """CiA 402 power drive states; each value is the statusword under ``DRIVE_STATE_MASK``."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08
