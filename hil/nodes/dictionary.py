"""A device's object dictionary in numbers: values by index, and what CiA 301 allows to be written."""

from __future__ import annotations

from typing import Any

import canopen
from canopen.objectdictionary import datatypes

STRUCT_CODES = {
    datatypes.INTEGER8: "b",
    datatypes.INTEGER16: "h",
    datatypes.INTEGER32: "i",
    datatypes.UNSIGNED8: "B",
    datatypes.UNSIGNED16: "H",
    datatypes.UNSIGNED32: "I",
}


class Abort:
    """SDO abort codes, CiA 301 table 22."""

    COMMAND = 0x05040001
    UNSUPPORTED_ACCESS = 0x06010000
    READ_ONLY = 0x06010002
    CANNOT_BE_MAPPED = 0x06040041
    PDO_TOO_LONG = 0x06040042
    NO_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030
    VALUE_TOO_HIGH = 0x06090031
    VALUE_TOO_LOW = 0x06090032
    DEVICE_STATE = 0x08000022
    NO_DATA = 0x08000024


def refuse(code: int) -> canopen.SdoAbortedError:
    """The exception that makes canopen's SDO server answer with an abort."""
    return canopen.SdoAbortedError(code)


def entry(device: Any, index: int, subindex: int) -> Any:
    """The object at ``index:subindex`` of a ``canopen.LocalNode``, or None."""
    found = device.object_dictionary.get(index)
    if isinstance(found, canopen.objectdictionary.ODVariable):
        return found if subindex == 0 else None
    return found[subindex] if found is not None and subindex in found else None


def number(device: Any, index: int, subindex: int = 0) -> int:
    """Current value of a numeric object (written, else the EDS default)."""
    return int(entry(device, index, subindex).decode_raw(device.get_data(index, subindex)))


def check_range(variable: Any, value: int) -> None:
    """Refuse a value outside the object's limits in the EDS."""
    if variable.max is not None and value > variable.max:
        raise refuse(Abort.VALUE_TOO_HIGH)
    if variable.min is not None and value < variable.min:
        raise refuse(Abort.VALUE_TOO_LOW)
