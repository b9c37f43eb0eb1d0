"""CAN error frames in words; bits as in the kernel's ``linux/can/error.h``."""

from __future__ import annotations

BUS_OFF = 0x40
PROTOCOL = 0x08
CONTROLLER = 0x04
_GRAVE = BUS_OFF | 0x01

_CLASSES = {
    BUS_OFF: "bus-off: the controller has left the bus (set the interface down and up again)",
    0x001: "transmit time-out: the controller cannot get a frame onto the bus",
    0x002: "arbitration lost",
    0x010: "transceiver error: check wiring and termination",
    0x020: "no acknowledgement: no other node on the bus answers",
    0x080: "bus error",
    0x100: "controller restarted",
}
_CONTROLLER = {
    0x01: "receive overrun, frames lost",
    0x02: "transmit overrun, frames lost",
    0x04: "error warning, receiving (error counter at 96 or above)",
    0x08: "error warning, transmitting (error counter at 96 or above)",
    0x10: "error-passive, receiving (error counter above 127)",
    0x20: "error-passive, transmitting (error counter above 127)",
    0x40: "error-active again",
}
_PROTOCOL = {
    0x01: "bit error",
    0x02: "form error",
    0x04: "stuff error",
    0x08: "dominant bit not seen",
    0x10: "recessive bit not seen",
    0x20: "overload",
    0x40: "active error announced",
    0x80: "while sending",
}


def details(data: bytes | bytearray) -> int:
    """Details in an error frame's data: controller byte, with the protocol byte above it."""
    padded = data.ljust(3, b"\0")
    return padded[1] | padded[2] << 8


def is_grave(classes: int) -> bool:
    """The controller is off the bus, or cannot send."""
    return bool(classes & _GRAVE)


def in_words(classes: int, found: int) -> str:
    """An error frame's class bits and `details`, the gravest first; bits without a name as numbers."""
    words = _words(_CLASSES, classes & BUS_OFF)
    if classes & CONTROLLER:
        words += _words(_CONTROLLER, found & 0xFF)
    words += _words(_CLASSES, classes & ~BUS_OFF)
    if classes & PROTOCOL:
        words += _words(_PROTOCOL, found >> 8 & 0xFF)
    return ", ".join(words) or f"class 0x{classes:03X}, data 0x{found:04X}"


def _words(known: dict[int, str], bits: int) -> list[str]:
    return [text for bit, text in known.items() if bits & bit]
