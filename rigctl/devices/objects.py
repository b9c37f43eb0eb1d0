"""CANopen objects the rig speaks, in one place: COB-IDs, object indices, units and PDO layouts.

Both ends read this table: the control process compiles its codecs from it, the simulated nodes map their PDOs by
it, and the tests compare both with the EDS files.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from rigctl.config.canopen import *
from rigctl.model.device_states import STATUSWORD, DriveState

# -- CiA 301: objects -------------------------------------------------------------------------------------------
DEVICE_TYPE = 0x1000
ERROR_REGISTER = 0x1001
ERROR_FIELD = 0x1003  # :00 number of errors, :01 the newest, its code in the lower half
SYNC_COB_ID = 0x1005  # bit 30: the device sends SYNC itself
CYCLE_PERIOD = 0x1006  # us between two SYNCs; 0 = not known
DEVICE_HEARTBEAT_MS = 100  # our value of every device's 0x1017
CONSUMER_HEARTBEAT = 0x1016  # :01 = node id << 16 | time in ms
PRODUCER_HEARTBEAT = 0x1017
IDENTITY = 0x1018
ERROR_BEHAVIOUR = 0x1029  # :01 of a communication error: 0 = to PRE-OPERATIONAL, 1 = the NMT state stays
NMT_STATE_STAYS = 1
RPDO1_COMMUNICATION = 0x1400  # :05 event timer = deadline in ms
RPDO1_MAPPING = 0x1600
TPDO1_COMMUNICATION = 0x1800  # :02 transmission type = every n-th SYNC; :03 inhibit time, 0.1 ms; :05 event timer, ms
TPDO1_MAPPING = 0x1A00
TPDO2_COMMUNICATION = 0x1801
TPDO2_MAPPING = 0x1A01

NMT_START = 0x01  # command: the node enters OPERATIONAL
NMT_STOP = 0x02  # command: the node enters STOPPED; a drive that is enabled then does as 0x6007 says

# -- CiA 404: tension amplifier ---------------------------------------------------------------------------------
DEVICE_TYPE_404 = 0x00020194  # analogue input device of profile 404
AI_PROCESS_VALUE = 0x9130  # :01, INTEGER32, in 10^-digits of the unit
AI_PHYSICAL_UNIT = 0x6131
AI_DECIMAL_DIGITS = 0x6132
AI_STATUS = 0x6150
SI_UNIT_NEWTON = 0x00210000  # CiA 303-2: newton, no prefix
CELL_DECIMAL_DIGITS = 3
SI_UNIT_CELSIUS = 0x002D0000  # CiA 303-2: degree Celsius, no prefix; of the second channel, the cell's temperature
CELSIUS_DECIMAL_DIGITS = 2


class AiStatus(IntFlag):
    """CiA 404 0x6150: analogue input status."""

    NOT_VALID = 1
    POSITIVE_OVERLOAD = 2
    NEGATIVE_OVERLOAD = 4


# -- CiA 410: inclinometer --------------------------------------------------------------------------------------
DEVICE_TYPE_410 = 0x0003019A  # two axes, 16 bit, profile 410
SLOPE_RESOLUTION = 0x6000  # in 0.001 deg
SLOPE_LONG = 0x6010  # INTEGER16, tangential angle of the rope
SLOPE_LATERAL = 0x6020  # INTEGER16, normal angle of the rope
SLOPE_RESOLUTION_MDEG = 10
SLOPE_INVALID = -0x8000  # value of both slopes while the sensor cannot measure

# -- CiA 406: rail encoder --------------------------------------------------------------------------------------
DEVICE_TYPE_406 = 0x00010196  # absolute rotary encoder, single turn, profile 406
ENCODER_COUNTS_PER_TURN = 0x6001  # UNSIGNED32
ENCODER_TOTAL_RANGE = 0x6002  # UNSIGNED32, counts after which the position begins at 0 again
ENCODER_POSITION = 0x6004  # UNSIGNED32, counts
DEVICE_TYPE_406_LINEAR = 0x00080196  # absolute linear encoder
ENCODER_STEP = 0x6005  # :01 UNSIGNED32, measuring step in nm
NM_PER_MM = 1_000_000

# -- CiA 401: generic I/O node ------------------------------------------------------------------------------------
DEVICE_TYPE_401 = 0x00030191  # digital inputs and outputs, profile 401
DIGITAL_INPUTS_FITTED, DIGITAL_OUTPUTS_FITTED = 1 << 16, 1 << 17  # of the device type
INPUTS_8 = 0x6000  # :01 on, UNSIGNED8: eight digital inputs each
INPUT_POLARITY_8 = 0x6002  # :01 on, UNSIGNED8: 1 = the input is inverted
INPUT_EVENTS = 0x6005  # BOOLEAN: a change of an input sends the TPDO
INPUT_EVENT_MASK_8 = 0x6006  # :01 on, UNSIGNED8: 1 = a change of this input counts
EVERY_INPUT_8 = 0xFF
OUTPUTS_8 = 0x6200  # :01 on, UNSIGNED8: eight digital outputs each
OUTPUT_POLARITY_8 = 0x6202  # :01 on, UNSIGNED8: 1 = the output is inverted
OUTPUT_ERROR_MODE_8 = 0x6206  # :01 on, UNSIGNED8: 1 = in an error the output takes its error value, 0 = it stays
OUTPUT_ERROR_VALUE_8 = 0x6207  # :01 on, UNSIGNED8
EVERY_OUTPUT_8 = 0xFF
EVENT_DRIVEN = 255  # transmission type of the device profile: here on a change and by the event timer

# -- CiA 402: cylinder drive ------------------------------------------------------------------------------------
DEVICE_TYPE_402 = 0x00020192  # servo drive of profile 402
ABORT_CONNECTION_OPTION = 0x6007
CONTROLWORD = 0x6040
QUICK_STOP_OPTION = 0x605A
SHUTDOWN_OPTION = 0x605B
DISABLE_OPERATION_OPTION = 0x605C
FAULT_REACTION_OPTION = 0x605E
MODE_OF_OPERATION = 0x6060
MODE_DISPLAY = 0x6061
POSITION_ACTUAL = 0x6064  # INTEGER32, um or the drive's own unit
DRIVE_TEMPERATURE = 0x2045  # manufacturer: INTEGER16, 0.1 deg C
MOTOR_RATED_CURRENT = 0x6075  # UNSIGNED32, mA
MOTOR_RATED_TORQUE = 0x6076  # UNSIGNED32, mNm; at the rated current
CURRENT_ACTUAL = 0x6078  # INTEGER16, per mille of the rated current
DIGITAL_INPUTS = 0x60FD  # UNSIGNED32: bit 0 lower limit switch, 1 upper, 2 home, from 16 on the manufacturer's
POLARITY = 0x607E  # UNSIGNED8, bits below: commands and reports of this quantity are multiplied by -1
POSITION_POLARITY, VELOCITY_POLARITY = 1 << 7, 1 << 6
QUICK_STOP_DECELERATION = 0x6085  # um/s2
ENCODER_RESOLUTION = 0x608F  # :01 increments per :02 revolutions of the motor
GEAR_RATIO = 0x6091  # :01 revolutions of the motor per :02 of the shaft
FEED_CONSTANT = 0x6092  # :01 position units per :02 revolutions of the shaft
SI_UNIT_POSITION = 0x60A8
SI_UNIT_VELOCITY = 0x60A9
VELOCITY_OFFSET = 0x60B1  # INTEGER32, um/s, added to the target velocity; optional in the profile
INTERPOLATION_PERIOD = 0x60C2  # :01 value, :02 power of ten of a second
TORQUE_OFFSET = 0x60B2  # INTEGER16, per mille of the rated torque, added to the motor's; optional in the profile
TARGET_VELOCITY = 0x60FF  # INTEGER32, um/s
ERROR_CODE = 0x603F
SI_MICROMETRE = 0xFA010000  # prefix 10^-6, metre
SI_MICROMETRE_PER_SECOND = 0xFA010300
CYCLIC_SYNCHRONOUS_VELOCITY = 9
ABORT_CONNECTION_QUICK_STOP = 3  # 0x6007
QUICK_STOP_RAMP_THEN_OFF = 2  # 0x605A: on the quick stop ramp 0x6085, then SWITCH ON DISABLED
SLOW_DOWN_THEN_OFF = 1  # 0x605B, 0x605C: on the slow down ramp 0x6084, then power off with the brake closed
FAULT_REACTION_QUICK_STOP = 2  # 0x605E: slow down on the quick stop ramp, then power off with the brake closed

DRIVE_OBEYS_BY = frozenset(
    {(SYNC_COB_ID, 0), (POLARITY, 0), (MODE_OF_OPERATION, 0), (MODE_DISPLAY, 0), (SI_UNIT_POSITION, 0),
     (SI_UNIT_VELOCITY, 0), (0x60B1, 0),
     *((RPDO1_COMMUNICATION, sub) for sub in (1, 2)), *((RPDO1_MAPPING, sub) for sub in (0, 1, 2))}
)  # fmt: skip
"""Objects without which the drive does not follow commands (0x60B1: velocity offset)."""
QUICK_STOPS_BY = frozenset({(QUICK_STOP_OPTION, 0), (QUICK_STOP_DECELERATION, 0)})
"""Objects without which the drive's quick stop is not the one that start-up wrote."""

MM_PER_POSITION_UNIT = 1e-3
MM_S_PER_VELOCITY_UNIT = 1e-3
MM_S_PER_VELOCITY_16_UNIT = 1e-2
C_PER_TEMPERATURE_UNIT = 0.1
A_PER_RATED_CURRENT_UNIT = 1e-3
PER_CURRENT_UNIT = 1e-3  # of the rated current
PER_TORQUE_UNIT = 1e-3  # of the rated torque
N_PER_CELL_UNIT = 10.0**-CELL_DECIMAL_DIGITS
C_PER_CELL_UNIT = 10.0**-CELSIUS_DECIMAL_DIGITS


class Controlword(IntEnum):
    """CiA 402 0x6040: the device control commands."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


OFF_STATES = frozenset({DriveState.READY_TO_SWITCH_ON, DriveState.SWITCH_ON_DISABLED})
"""No power, brake closed or closing."""
UNPOWERED_STATES = OFF_STATES | {DriveState.FAULT}
STOPPING_STATES = frozenset({DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE, DriveState.NOT_READY})
"""States that end without power by themselves."""
DRIVE_STATE_MASK = 0x6F
_WIDE_STATES = frozenset({DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED,
                          DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT})  # fmt: skip
STATUS_WARNING = 0x0080
STATUS_REMOTE = 0x0200  # bit 9: the drive takes the controlword; off while a panel or service tool controls it
STATUS_INTERNAL_LIMIT = 0x0800  # bit 11: a limit inside the drive acts on our command
STATUS_FOLLOWS = 0x1000  # bit 12 in CSV, OPERATION ENABLED: the drive follows the target velocity


def drive_state(statusword: int) -> DriveState:
    """State in a statusword (CiA 402 table: bit 5 does not count in four of the states)."""
    return _STATES[statusword & DRIVE_STATE_MASK]


def _state_of(narrow: int) -> DriveState:
    wide = narrow & 0x4F
    if wide in _WIDE_STATES:
        return DriveState(wide)
    return DriveState(narrow) if narrow in DriveState._value2member_map_ else DriveState.NOT_READY


_STATES = tuple(map(_state_of, range(DRIVE_STATE_MASK + 1)))
"""State of every statusword under the mask, as a table: the loop needs it three times a tick."""


class EmcyCode(IntEnum):
    """CiA 301 emergency error codes the rig's devices send."""

    NO_ERROR = 0x0000
    COMMUNICATION = 0x8100
    HEARTBEAT_LOST = 0x8130
    RPDO_TIMEOUT = 0x8250
    SYNC_LOST = 0x8700
    SENSOR_INVALID = 0x5010
    EXTERNAL = 0x9000  # of the drive: its emergency stop input has opened


# -- simulator node: not a device of the rig --------------------------------------------------------------------
SIM_MOTION_START = 0x2000  # UNSIGNED8: 1 starts the move of the rig file's demo section
SIM_MOTION_STATE = 0x2001  # UNSIGNED8: 1 while the mechanism moves
SIM_E_STOP = 0x2002  # UNSIGNED8: 1 = the emergency stop is pressed: both of its contacts open
SIM_IO_E_STOP = 0x2003  # UNSIGNED8: 1 = the I/O node's contact is open
SIM_TOOL_UM_S = 0x2004  # INTEGER32, um/s: a service tool enables the drive and moves it; 0 = no tool
SIM_TRUE_VERTICAL_MN = 0x2100  # INTEGER32, mN: the plant's true vertical tension
SIM_TRUE_STROKE_UM = 0x2101  # INTEGER32, um


LONGEST_FRAME = 8
_PADDING = "x"
_DUMMY_LAST = 0x0007  # objects 0001 to 0007 fill gaps in an RPDO


@dataclass(frozen=True)
class PdoLayout:
    """One PDO: its COB-ID base and the objects mapped, in order, as (index, subindex, struct code)."""

    cob_base: int
    fields: tuple[tuple[int, int, str], ...]

    @property
    def transmitted(self) -> bool:
        """Whether the device sends it, as a TPDO."""
        return self.cob_base % PDO_SPACING == TPDO1_BASE % PDO_SPACING

    @property
    def place(self) -> int:
        """Index of the PDO among its kind, from 0; it is added to 0x1800, 0x1A00, 0x1400 and 0x1600."""
        return (self.cob_base - (TPDO1_BASE if self.transmitted else RPDO1_BASE)) // PDO_SPACING

    @property
    def communication(self) -> int:
        """Its communication parameter."""
        return (TPDO1_COMMUNICATION if self.transmitted else RPDO1_COMMUNICATION) + self.place

    @property
    def mapping_object(self) -> int:
        """Its mapping parameter."""
        return (TPDO1_MAPPING if self.transmitted else RPDO1_MAPPING) + self.place

    @property
    def codec(self) -> struct.Struct:
        """Little-endian struct of the payload."""
        return struct.Struct("<" + "".join(code for _, _, code in self.fields))

    @property
    def size(self) -> int:
        """Payload in bytes."""
        return self.codec.size

    @property
    def mapping(self) -> tuple[int, ...]:
        """Values of the mapping object: index << 16 | subindex << 8 | bits."""
        return tuple(i << 16 | s << 8 | struct.calcsize("<" + c) * 8 for i, s, c in self.fields)

    @property
    def objects(self) -> tuple[tuple[int, int], ...]:
        """Index and sub-index of the values in it, in order, without padding."""
        return tuple((index, sub) for index, sub, code in self.fields if not code.endswith(_PADDING))

    def as_mapped(self, entries: Iterable[int]) -> PdoLayout:
        """This PDO in the order of a device's mapping ``entries``, with other objects as padding.

        An RPDO may have no other objects but gaps (0001 to 0007) and the mode of operation, whose value we know: the
        controller must not write any other object.

        Raises:
            ValueError: it names the object that is missing, or cannot be read or written.
        """
        codes = {(index, sub): code for index, sub, code in self.fields}
        if not self.transmitted:
            codes.setdefault((MODE_OF_OPERATION, 0), "b")
        missing = {(index, sub) for index, sub, _ in self.fields}
        fields = []
        for entry in entries:
            index, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
            code = codes.pop((index, sub), None)
            missing.discard((index, sub))
            if code is not None and struct.calcsize("<" + code) * 8 != bits:
                wide = struct.calcsize("<" + code) * 8
                raise ValueError(f"object 0x{index:04X}:{sub:02X} with {bits} bits, expected {wide}")
            if bits % 8:
                raise ValueError(f"object 0x{index:04X}:{sub:02X} with {bits} bits, expected whole bytes")
            if code is None and not self.transmitted and index > _DUMMY_LAST:
                raise ValueError(f"object 0x{index:04X}:{sub:02X}, which we do not write")
            fields.append((index, sub, f"{bits // 8}{_PADDING}" if code is None else code))
        for index, sub in sorted(missing):
            raise ValueError(f"no object 0x{index:04X}:{sub:02X}")
        layout = PdoLayout(self.cob_base, tuple(fields))
        if layout.size > LONGEST_FRAME:
            raise ValueError(f"{layout.size} bytes, expected at most {LONGEST_FRAME}")
        return layout

    def reader(self, *wanted: tuple[int, int]) -> Callable[[bytes | bytearray], tuple[int, ...]]:
        """Function from a payload to the values of these objects, in this order; ``ValueError`` at another length."""
        size, unpack = self.size, self.codec.unpack
        places = [self.objects.index(each) for each in wanted]
        as_it_is = places == list(range(len(self.objects)))

        def read(data: bytes | bytearray) -> tuple[int, ...]:
            if len(data) != size:
                raise ValueError("length")
            values = unpack(data)
            return values if as_it_is else tuple([values[place] for place in places])

        return read


CELL_TPDO = PdoLayout(TPDO1_BASE, ((AI_PROCESS_VALUE, 1, "i"), (AI_STATUS, 1, "B")))
CELL_TPDO2 = PdoLayout(TPDO2_BASE, ((AI_PROCESS_VALUE, 2, "i"),))
SLOPE_TPDO = PdoLayout(TPDO1_BASE, ((SLOPE_LONG, 0, "h"), (SLOPE_LATERAL, 0, "h")))
ENCODER_TPDO = PdoLayout(TPDO1_BASE, ((ENCODER_POSITION, 0, "I"),))
DRIVE_TPDO = PdoLayout(TPDO1_BASE, ((STATUSWORD, 0, "H"), (POSITION_ACTUAL, 0, "i"), (VELOCITY_ACTUAL_16, 0, "h")))
DRIVE_TPDO2 = PdoLayout(TPDO2_BASE, ((CURRENT_ACTUAL, 0, "h"), (DRIVE_TEMPERATURE, 0, "h"), (DIGITAL_INPUTS, 0, "I")))
DRIVE_RPDO = PdoLayout(RPDO1_BASE, ((CONTROLWORD, 0, "H"), (TARGET_VELOCITY, 0, "i")))
DRIVE_RPDO_PRELOAD = PdoLayout(RPDO1_BASE, (*DRIVE_RPDO.fields, (TORQUE_OFFSET, 0, "h")))


def inputs_tpdo(block: int) -> PdoLayout:
    """The I/O node's TPDO with eight inputs, those of sub-index ``block`` of 0x6000."""
    return PdoLayout(TPDO1_BASE, ((INPUTS_8, block, "B"),))


def outputs_rpdo(block: int) -> PdoLayout:
    """The I/O node's RPDO with eight outputs, those of sub-index ``block`` of 0x6200."""
    return PdoLayout(RPDO1_BASE, ((OUTPUTS_8, block, "B"),))


def frame_bits(size: int) -> int:
    """Longest classic frame of ``size`` data bytes on the wire, stuffing and inter-frame space included (bits)."""
    return 8 * size + 47 + (34 + 8 * size - 1) // 4
