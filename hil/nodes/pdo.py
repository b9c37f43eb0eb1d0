"""PDOs compiled from a device's current mapping objects (CiA 301, 7.5.2.33 to 7.5.2.38)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from hil.nodes.dictionary import STRUCT_CODES, Abort, entry, number, refuse
from hil.wire import FRAME, STANDARD_MASK
from rigctl.devices import objects

INVALID_PDO = objects.PDO_NOT_VALID
MOST_ENTRIES = 8
_MOST_SYNCS, _EVENT_DRIVEN = 240, 254  # transmission types
_DUMMY_LAST = 0x0007  # objects 0001 to 0007 fill gaps in an RPDO
_ENTRY_BITS = 0xFF

Address = tuple[int, int]


class TransmitPdo:
    """A TPDO; ``frame()`` at each SYNC gives the frame that is due, or None; ``now()`` serves event-driven TPDOs.

    Args:
        device: ``canopen.LocalNode`` whose 0x1800 + n and 0x1A00 + n are compiled.
        live: functions that give the mapped values; other objects are read from the dictionary once.
        place: n, 0 for the first TPDO.
    """

    __slots__ = ("_cob_id", "_count", "_every", "_pack", "_size", "_sources", "event_driven")

    def __init__(self, device: Any, live: Mapping[Address, Callable[[], int]], place: int = 0) -> None:
        communication = objects.TPDO1_COMMUNICATION + place
        cob_id = number(device, communication, 1)
        addresses, layout = _layout(device, objects.TPDO1_MAPPING + place)
        self._cob_id = cob_id & STANDARD_MASK
        kind = 0 if cob_id & INVALID_PDO else number(device, communication, 2)
        self.event_driven = kind >= _EVENT_DRIVEN
        self._every = kind if kind <= _MOST_SYNCS else 0
        self._count = 0
        self._pack = layout.pack
        self._size = layout.size
        self._sources = [live.get(address) or _constant(number(device, *address)) for address in addresses]

    def frame(self) -> bytes | None:
        """Count one SYNC; the frame, on every n-th (transmission type n)."""
        self._count += 1
        if self._count != self._every:
            return None
        self._count = 0
        return self.now()

    def now(self) -> bytes:
        """The frame with the present values."""
        payload = self._pack(*[source() for source in self._sources])
        return FRAME.pack(self._cob_id, self._size, payload)


class ReceivePdo:
    """An RPDO: its COB-ID, whether it waits for SYNC, and the decoding of its data into the mapped objects."""

    __slots__ = ("_sinks", "_unpack", "cob_id", "size", "synchronous", "valid")

    def __init__(self, device: Any, live: Mapping[Address, Callable[[int], None]]) -> None:
        cob_id = number(device, objects.RPDO1_COMMUNICATION, 1)
        addresses, layout = _layout(device, objects.RPDO1_MAPPING)
        self.cob_id = cob_id & STANDARD_MASK
        self.valid = not cob_id & INVALID_PDO
        self.synchronous = number(device, objects.RPDO1_COMMUNICATION, 2) <= 240
        self.size = layout.size
        self._unpack = layout.unpack_from
        self._sinks = [live.get(address) or _store(device, address) for address in addresses]

    def apply(self, data: bytes) -> None:
        """Write at least ``size`` bytes of data to the mapped objects, in their order."""
        for sink, value in zip(self._sinks, self._unpack(data), strict=True):
            sink(value)


def check_mapping_write(device: Any, index: int, subindex: int, value: int) -> None:
    """Refuse what CiA 301 refuses: sub-index 0 counts valid entries, and entries change only while it is 0."""
    if subindex == 0:
        _check_mapping(device, index, value)
    elif number(device, index, 0) != 0:
        raise refuse(Abort.UNSUPPORTED_ACCESS)
    elif value:
        _check_entry(device, index, value)


def check_cob_id_write(device: Any, index: int, value: int, *, rtr: bool = True) -> None:
    """Refuse another identifier while the PDO is in use (bit 31 clear before and after).

    A TPDO of a device without ``rtr`` always has bit 30 set.
    """
    before = number(device, index, 1)
    if value & ~(INVALID_PDO | objects.PDO_NO_RTR) > STANDARD_MASK:
        raise refuse(Abort.VALUE_RANGE)
    if not rtr and index >= objects.TPDO1_COMMUNICATION and not value & objects.PDO_NO_RTR:
        raise refuse(Abort.VALUE_RANGE)
    if not (before | value) & INVALID_PDO and (before ^ value) & STANDARD_MASK:
        raise refuse(Abort.VALUE_RANGE)


def check_inhibit_write(device: Any, index: int) -> None:
    """Refuse another inhibit time while the TPDO is in use (bit 31 clear)."""
    if index >= objects.TPDO1_COMMUNICATION and not number(device, index, 1) & INVALID_PDO:
        raise refuse(Abort.UNSUPPORTED_ACCESS)


def _check_mapping(device: Any, index: int, count: int) -> None:
    if count > MOST_ENTRIES:
        raise refuse(Abort.PDO_TOO_LONG)
    entries = [number(device, index, i) for i in range(1, count + 1)]
    for value in entries:
        _check_entry(device, index, value)
    if sum(value & _ENTRY_BITS for value in entries) > 64:
        raise refuse(Abort.PDO_TOO_LONG)


def _check_entry(device: Any, index: int, value: int) -> None:
    variable = entry(device, value >> 16, value >> 8 & 0xFF)
    transmit = index >= objects.TPDO1_COMMUNICATION
    dummy = 0 < value >> 16 <= _DUMMY_LAST
    if variable is None or variable.data_type not in STRUCT_CODES or len(variable) != value & _ENTRY_BITS:
        raise refuse(Abort.CANNOT_BE_MAPPED)
    mappable = not transmit if dummy else variable.pdo_mappable
    if not mappable or not (variable.readable if transmit else variable.writable or dummy):
        raise refuse(Abort.CANNOT_BE_MAPPED)


def _layout(device: Any, index: int) -> tuple[list[Address], struct.Struct]:
    entries = [number(device, index, i) for i in range(1, number(device, index, 0) + 1)]
    addresses = [(value >> 16, value >> 8 & 0xFF) for value in entries]
    codes = [STRUCT_CODES[entry(device, *address).data_type] for address in addresses]
    return addresses, struct.Struct("<" + "".join(codes))


def _constant(value: int) -> Callable[[], int]:
    return lambda: value


def _store(device: Any, address: Address) -> Callable[[int], None]:
    variable = entry(device, *address)
    if address[0] <= _DUMMY_LAST:
        return lambda _: None
    return lambda value: device.set_data(*address, variable.encode_raw(value))
