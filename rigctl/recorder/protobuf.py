"""Slots as protobuf messages of fixed width, so that numpy encodes and decodes many at once.

A message that holds each field once and in order is a packed struct with constant tags between its values. Any protobuf
reader decodes it by the descriptor in the file (encoding: protobuf.dev, "Encoding").
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from rigctl.ipc.record import Slot
from rigctl.model.quantity import count
from rigctl.recorder.enums import enum_of

WIRE_VARINT, WIRE_64, WIRE_BYTES, WIRE_32 = 0, 1, 2, 5
ENUM_BYTES = 3
"""Width of a number of up to 16 bits as a varint, padded to a fixed width, which protobuf allows."""
_P = FieldDescriptorProto
_WIRE = {
    _P.TYPE_DOUBLE: (WIRE_64, "<f8"),
    _P.TYPE_FLOAT: (WIRE_32, "<f4"),
    _P.TYPE_SFIXED64: (WIRE_64, "<i8"),
    _P.TYPE_FIXED64: (WIRE_64, "<u8"),
    _P.TYPE_FIXED32: (WIRE_32, "<u4"),
    _P.TYPE_ENUM: (WIRE_VARINT, f"({ENUM_BYTES},)u1"),
}
"""Wire type and numpy type of each protobuf type."""
_TYPES = {
    "d": _P.TYPE_DOUBLE, "q": _P.TYPE_SFIXED64, "Q": _P.TYPE_FIXED64, "I": _P.TYPE_FIXED32, "H": _P.TYPE_FIXED32,
    "B": _P.TYPE_FIXED32,
}  # fmt: skip
"""Protobuf type of each struct code."""
_Fields = Sequence[tuple[str, int, int]]  # name, number, protobuf type


class LayoutError(ValueError):
    """A schema or a message that is not of fixed width; ``str()`` says what is wrong."""


class Encoding:
    """Encoding of one kind of slot, which has numbers alone."""

    def __init__(self, slot: Slot, exact: Container[str] | None = None) -> None:
        """``exact``: double fields that keep 64 bits, the other doubles get 32; None: all keep 64."""
        self.name = f"rigctl.{slot.name.capitalize()}"
        codes = [("seq", "Q"), *((field.name, field.code) for field in slot.fields)]
        self._enums = {name: found for name, _ in codes if (found := enum_of(slot, name)) is not None}
        self._fields = []
        for number, (name, code) in enumerate(codes, 1):
            kind = _P.TYPE_ENUM if name in self._enums else _TYPES[code]
            short = code == "d" and exact is not None and name not in exact
            self._fields.append((name, number, _P.TYPE_FLOAT if short else kind))
        self._slot = slot
        self._packed, self._template, _ = _packed(self._fields)

    def descriptor(self) -> bytes:
        """A serialised ``FileDescriptorSet``: the schema."""
        files = FileDescriptorSet()
        file = files.file.add(name=f"rigctl/{self._slot.name}.proto", package="rigctl", syntax="proto3")
        message = file.message_type.add(name=self._slot.name.capitalize())
        for name, number, kind in self._fields:
            field = message.field.add(name=name, number=number, type=kind, label=_P.LABEL_OPTIONAL)
            if name in self._enums:
                field.type_name = f".rigctl.{self._enums[name][0]}"
        for enum, names in dict(self._enums.values()).items():
            described = file.enum_type.add(name=enum)
            for value, words in sorted(names.items()):
                described.value.add(name=f"{enum.upper()}_{words}", number=value)
        return bytes(files.SerializeToString())

    def encode(self, slots: npt.NDArray[np.void]) -> list[bytes]:
        """One message for each slot."""
        made = np.tile(self._template, len(slots)).view(self._packed)
        with np.errstate(over="ignore"):  # a value beyond the range of 32 bits becomes infinite
            for name, _, kind in self._fields:
                made[name] = _varints(slots[name]) if kind == _P.TYPE_ENUM else slots[name]
        raw, width = made.tobytes(), self._packed.itemsize
        return [raw[start : start + width] for start in range(0, len(raw), width)]


class Decoding:
    """Decoding of the messages of one schema into an array."""

    def __init__(self, descriptor: bytes, name: str, slot: Slot) -> None:
        """``slot``: their table; if the schema has the slot's fields, the array has its dtype.

        Raises:
            LayoutError: the schema is not of fixed width.
        """
        self._fields = _fields(descriptor, name)
        self.name = name
        known, kinds = slot.dtype, {field: _WIRE[kind][1] for field, _, kind in self._fields}
        kinds = {field: {"<f4": "<f8", _WIRE[_P.TYPE_ENUM][1]: "<u4"}.get(kind, kind) for field, kind in kinds.items()}
        same = set(kinds) == set(known.names or ())
        self.dtype = known if same else np.dtype(
            [(field, known[field] if field in (known.names or ()) else kind) for field, kind in kinds.items()]
        )  # fmt: skip
        if any(self.dtype[field].kind not in "iuf" for field in kinds):
            raise LayoutError(f"the schema {name} has fields of another type")
        self._packed, self._template, self._constant = _packed(self._fields)

    def decode(self, messages: Sequence[bytes]) -> npt.NDArray[np.void]:
        """The messages in order.

        Raises:
            LayoutError: a message has another layout.
        """
        width = self._packed.itemsize
        for other in (len(message) for message in messages if len(message) != width):
            raise LayoutError(f"a message of {self.name} has {count(other, 'byte')}, expected {width}")
        raw = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, width)
        if not np.all(raw[:, self._constant] == self._template[self._constant]):
            raise LayoutError(f"a message of {self.name} is not laid out as it says")
        made, values = np.zeros(len(messages), self.dtype), raw.reshape(-1).view(self._packed)
        for name, _, kind in self._fields:
            made[name] = _of_varints(values[name]) if kind == _P.TYPE_ENUM else values[name]
        return made


def _fields(descriptor: bytes, name: str) -> _Fields:
    """The fields of a message of fixed width."""
    try:
        files = FileDescriptorSet.FromString(descriptor)
    except DecodeError:
        raise LayoutError(f"the schema {name} is damaged") from None
    messages = [(file.package, message) for file in files.file for message in file.message_type]
    for package, message in messages:
        if f"{package}.{message.name}" == name:
            found = [(field.name, field.number, field.type) for field in message.field]
            if (
                found
                and len({field for field, _, _ in found}) == len(found)
                and all(kind in _WIRE and 0 < number < 2048 for _, number, kind in found)
            ):
                return found
            break
    raise LayoutError(f"the schema {name} has fields without a fixed width")


def _packed(fields: _Fields) -> tuple[np.dtype[Any], npt.NDArray[np.uint8], npt.NDArray[np.intp]]:
    """Struct of a message; an empty message; the places of its constant bytes."""
    layout: list[tuple[str, str]] = []
    tags = {}
    for name, number, kind in fields:
        wire, code = _WIRE[kind]
        tags[f"tag_{name}"] = tag(number, wire)
        layout += [(f"tag_{name}", f"V{len(tags[f'tag_{name}'])}"), (name, code)]
    packed = np.dtype(layout)
    empty, constant = np.zeros(1, packed), np.zeros(1, packed)
    for name, content in tags.items():
        empty[name], constant[name] = np.void(content), np.void(b"\xff" * len(content))
    return packed, empty.view(np.uint8), np.flatnonzero(constant.view(np.uint8))


def numbers_of(slot: Slot) -> Slot:
    """A slot without its text fields, whose width is not fixed; the texts are recorded in JSON beside it."""
    return Slot(slot.name, tuple(field for field in slot.fields if field.code in _TYPES))


def _varints(values: npt.NDArray[np.integer]) -> npt.NDArray[np.uint8]:
    """Numbers below 2^16 as varints of ``ENUM_BYTES`` bytes, shape ``(count, ENUM_BYTES)``."""
    whole = values.astype(np.uint32)[:, None] >> np.arange(0, 7 * ENUM_BYTES, 7, dtype=np.uint32)
    whole &= 0x7F
    whole[:, :-1] |= 0x80
    return whole.astype(np.uint8)


def _of_varints(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint32]:
    """The inverse of `_varints`."""
    parts = (rows & 0x7F).astype(np.uint32) << np.arange(0, 7 * ENUM_BYTES, 7, dtype=np.uint32)
    return np.asarray(parts.sum(axis=1, dtype=np.uint32))


def tag(number: int, wire: int) -> bytes:
    """The tag before a field: its number and its wire type."""
    value = number << 3 | wire
    return bytes([value]) if value < 0x80 else bytes([value & 0x7F | 0x80, value >> 7])
