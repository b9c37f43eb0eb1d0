"""CAN identifiers of CiA 301's pre-defined connection set, and the objects a rig file's settings name.

`rigctl.devices.objects` has these and all other objects.
"""

from __future__ import annotations

NMT_COB = 0x000
SYNC_COB = 0x080
EMCY_BASE = 0x080
TPDO1_BASE = 0x180
TPDO2_BASE = 0x280
RPDO1_BASE = 0x200
PDO_SPACING = 0x100  # COB-ID of the next PDO of the same kind
PDOS = 4  # PDOs of each kind with a predefined COB-ID
PDO_NOT_VALID = 1 << 31  # of a COB-ID: the PDO is switched off
PDO_NO_RTR = 1 << 30  # of a COB-ID: remote frames not allowed; fixed on some devices
SDO_TX_BASE = 0x580
SDO_RX_BASE = 0x600
HEARTBEAT_BASE = 0x700
SIMULATOR_NODE = 112

VELOCITY_ACTUAL = 0x606C  # INTEGER32, um/s or the drive's own unit
VELOCITY_ACTUAL_16 = 0x2044  # manufacturer: INTEGER16, 10 um/s, so that status, position and speed share a frame


def tpdo_base(number: int) -> int:
    """COB-ID base of the TPDO of this number, from 1 on."""
    return TPDO1_BASE + (number - 1) * PDO_SPACING
