"""Emergency messages (CiA 301, 7.2.7): error code, error register (0x1001) and the manufacturer's bytes, in words."""

from __future__ import annotations

CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current, input side",
    0x22: "current inside the device",
    0x23: "current, output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}
"""By upper byte of the error code; a code not listed has the class of its first digit."""
CODES = {
    0x8110: "CAN overrun",
    0x8120: "CAN error passive",
    0x8130: "heartbeat or life guard lost",
    0x8140: "recovered from bus off",
    0x8150: "CAN identifier collision",
    0x8210: "PDO not processed: length",
    0x8220: "PDO length exceeded",
    0x8240: "unexpected SYNC length",
    0x8250: "RPDO timeout",
    0x8700: "SYNC lost",
}
LASTING = frozenset({0x22, 0x23, 0x54, 0x71, 0x73})
"""Upper bytes of the codes (CiA 402-2, 0x603F) of a short circuit, of power stage, brake and feedback: no motor that is
to carry a load is switched on over them."""
REGISTER = (
    "generic", "current", "voltage", "temperature", "communication", "device profile", "reserved bit", "manufacturer",
)  # fmt: skip
"""Bits of the error register, from bit 0."""
_SPECIFIC = 0xFF


def stands(code: int, register: int) -> bool:
    """Whether an error is active: a code 0x00xx resets one, and the register shows whether others remain."""
    return bool(code >> 8 or register)


def code_words(code: int) -> str:
    """The error code's meaning."""
    upper = code >> 8
    return CODES.get(code) or CLASSES.get(upper) or CLASSES.get(upper & 0xF0, "class unknown to CiA 301")


def register_words(register: int) -> str:
    """``error register 0x81: generic, manufacturer``."""
    bits = ", ".join(name for i, name in enumerate(REGISTER) if register >> i & 1)
    return f"error register 0x{register:02X}: {bits or 'no bit'}"


def words(code: int, register: int, manufacturer: bytes) -> str:
    """An emergency message in one line; ``manufacturer``: its last five bytes."""
    if not stands(code, register):
        return "emergency over" if not code else f"emergency over (0x{code:04X})"
    found = register_words(register)
    if any(manufacturer) or (manufacturer and code >> 8 == _SPECIFIC):
        found += f"; manufacturer's bytes {manufacturer.hex(' ')}"
    if not code >> 8:
        return f"one emergency is over (0x{code:04X}), others are active: {found}"
    return f"emergency 0x{code:04X}, {code_words(code)}; {found}"
