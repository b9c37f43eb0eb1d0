"""Slots as protobuf messages: fixed-width fields only, so that numpy encodes many at once.

Any protobuf reader decodes them by the descriptor in the file (encoding: protobuf.dev, "Encoding").
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np
import numpy.typing as npt
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

from rigctl.ipc.record import FrameFlag, Slot
from rigctl.recorder.enums import enum_of

WIRE_VARINT, WIRE_64, WIRE_BYTES, WIRE_32 = 0, 1, 2, 5
ENUM = "enum"
ENUM_BYTES = 3
"""Width of a number of up to 16 bits as a varint, padded to a fixed width, which protobuf allows."""
_P = FieldDescriptorProto
_KINDS = {
    "d": (_P.TYPE_DOUBLE, WIRE_64, "<f8"),
    "f": (_P.TYPE_FLOAT, WIRE_32, "<f4"),
    "q": (_P.TYPE_SFIXED64, WIRE_64, "<i8"),
    "Q": (_P.TYPE_FIXED64, WIRE_64, "<u8"),
    "I": (_P.TYPE_FIXED32, WIRE_32, "<u4"),
    "H": (_P.TYPE_FIXED32, WIRE_32, "<u4"),
    "B": (_P.TYPE_FIXED32, WIRE_32, "<u4"),
    "8s": (_P.TYPE_BYTES, WIRE_BYTES, "S8"),
    ENUM: (_P.TYPE_ENUM, WIRE_VARINT, f"({ENUM_BYTES},)u1"),
}


class Encoding:
    """Encoding of one kind of slot. A bytes field, if there is one, is the last field."""

    def __init__(self, slot: Slot, exact: Container[str] | None = None) -> None:
        """``exact``: double fields that keep 64 bits, the other doubles get 32; None: all keep 64."""
        self.name = f"rigctl.{slot.name.capitalize()}"
        codes = [("seq", "Q"), *((field.name, field.code) for field in slot.fields)]
        self._fields = [
            (name, "f" if code == "d" and exact is not None and name not in exact else code) for name, code in codes
        ]
        self._enums = {name: found for name, _ in codes if (found := enum_of(slot, name)) is not None}
        self._fields = [(name, ENUM if name in self._enums else code) for name, code in self._fields]
        self._slot = slot
        self._has_bytes = self._fields[-1][1] == "8s"
        layout: list[tuple[str, str]] = []
        for number, (name, code) in enumerate(self._fields, 1):
            layout.append((f"tag_{name}", f"V{len(tag(number, _KINDS[code][1]))}"))
            if code == "8s":
                layout.append(("size", "u1"))
            layout.append((name, _KINDS[code][2]))
        self._dtype = np.dtype(layout)

    def descriptor(self) -> bytes:
        """A serialised ``FileDescriptorSet``: the schema."""
        files = FileDescriptorSet()
        file = files.file.add(name=f"rigctl/{self._slot.name}.proto", package="rigctl", syntax="proto3")
        message = file.message_type.add(name=self._slot.name.capitalize())
        for number, (name, code) in enumerate(self._fields, 1):
            field = message.field.add(name=name, number=number, type=_KINDS[code][0], label=_P.LABEL_OPTIONAL)
            if code == ENUM:
                field.type_name = f".rigctl.{self._enums[name][0]}"
        for kind, names in dict(self._enums.values()).items():
            enum = file.enum_type.add(name=kind)
            for value, words in sorted(names.items()):
                enum.value.add(name=f"{kind.upper()}_{words}", number=value)
        return bytes(files.SerializeToString())

    def encode(self, slots: npt.NDArray[np.void]) -> list[bytes]:
        """One message for each slot."""
        made = np.zeros(len(slots), self._dtype)
        for number, (name, code) in enumerate(self._fields, 1):
            made[f"tag_{name}"] = np.void(tag(number, _KINDS[code][1]))
            with np.errstate(over="ignore"):  # a value beyond the range of 32 bits becomes infinite
                made[name] = _varints(slots[name]) if code == ENUM else slots[name]
        width = self._dtype.itemsize
        ends = np.full(len(slots), width)
        if self._has_bytes:
            made["size"] = np.where(slots["can_id"] & FrameFlag.REMOTE.value, 0, np.minimum(slots["dlc"], 8))
            ends += made["size"].astype(int) - 8
        raw = made.tobytes()
        return [raw[start : start + int(end)] for start, end in zip(range(0, len(raw), width), ends, strict=True)]


def numbers_of(slot: Slot) -> Slot:
    """A slot without its text fields, whose width is not fixed; the texts are recorded in JSON beside it."""
    return Slot(slot.name, tuple(field for field in slot.fields if field.code in _KINDS))


def _varints(values: npt.NDArray[np.integer]) -> npt.NDArray[np.uint8]:
    """Numbers below 2^16 as varints of ``ENUM_BYTES`` bytes, shape ``(count, ENUM_BYTES)``."""
    whole = values.astype(np.uint32)[:, None] >> np.arange(0, 7 * ENUM_BYTES, 7, dtype=np.uint32)
    whole &= 0x7F
    whole[:, :-1] |= 0x80
    return whole.astype(np.uint8)


def of_varints(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint32]:
    """The inverse of `_varints`."""
    parts = (rows & 0x7F).astype(np.uint32) << np.arange(0, 7 * ENUM_BYTES, 7, dtype=np.uint32)
    return np.asarray(parts.sum(axis=1, dtype=np.uint32))


def tag(number: int, wire: int) -> bytes:
    """The tag before a field: its number and its wire type."""
    value = number << 3 | wire
    return bytes([value]) if value < 0x80 else bytes([value & 0x7F | 0x80, value >> 7])
