"""Protobuf messages of fixed width as numpy arrays, by their descriptor.

A message that holds each of its fields once and in order, as `protobuf.Encoding` writes it, is a packed struct with
constant bytes between its values.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from rigctl.config.quantity import count
from rigctl.ipc.record import Slot
from rigctl.recorder.protobuf import (
    ENUM_BYTES,
    WIRE_32,
    WIRE_64,
    WIRE_BYTES,
    WIRE_VARINT,
    of_varints,
    tag,
)

_P = FieldDescriptorProto
_KINDS = {
    _P.TYPE_DOUBLE: (WIRE_64, "<f8"),
    _P.TYPE_FLOAT: (WIRE_32, "<f4"),
    _P.TYPE_SFIXED64: (WIRE_64, "<i8"),
    _P.TYPE_FIXED64: (WIRE_64, "<u8"),
    _P.TYPE_FIXED32: (WIRE_32, "<u4"),
    _P.TYPE_BYTES: (WIRE_BYTES, ""),
    _P.TYPE_ENUM: (WIRE_VARINT, "<u4"),
}
_BYTES_MAX = 8


class LayoutError(ValueError):
    """A schema or a message that is not of fixed width; ``str()`` says what is wrong."""


def _fields(descriptor: bytes, name: str) -> list[tuple[str, int, int]]:
    """Name, number and kind of each field."""
    try:
        files = FileDescriptorSet.FromString(descriptor)
    except DecodeError:
        raise LayoutError(f"the schema {name} is damaged") from None
    for file in files.file:
        for message in file.message_type:
            if f"{file.package}.{message.name}" == name:
                found = [(field.name, field.number, field.type) for field in message.field]
                bytes_before_last = any(kind == _P.TYPE_BYTES for _, _, kind in found[:-1])
                names = {field for field, _, _ in found}
                if (
                    not found
                    or len(names) < len(found)
                    or bytes_before_last
                    or any(kind not in _KINDS or not 0 < number < 2048 for _, number, kind in found)
                ):
                    break
                return found
    raise LayoutError(f"the schema {name} has fields without a fixed width")


class Layout:
    """Layout of the messages of one schema, and the array they become."""

    def __init__(self, descriptor: bytes, name: str, slot: Slot) -> None:
        """``slot``: their table; if the schema has the slot's fields, the array has its dtype.

        Raises:
            LayoutError: the schema is not of fixed width.
        """
        self._fields = _fields(descriptor, name)
        self.name = name
        known = slot.dtype
        kinds = {
            field: "<f8" if _KINDS[kind][1] == "<f4" else _KINDS[kind][1] or "S8" for field, _, kind in self._fields
        }
        same = set(kinds) == set(known.names or ())
        self.dtype = known if same else np.dtype(
            [(field, known[field] if field in (known.names or ()) else kind) for field, kind in kinds.items()]
        )  # fmt: skip
        if any(self.dtype[field].kind not in ("S" if kind == "S8" else "iuf") for field, kind in kinds.items()):
            raise LayoutError(f"the schema {name} has fields of another type")
        self._wire: dict[int, tuple[np.dtype[Any], npt.NDArray[np.intp], bytes]] = {}
        self._has_bytes = self._fields[-1][2] == _P.TYPE_BYTES

    def _wired(self, width: int) -> tuple[np.dtype[Any], npt.NDArray[np.intp], bytes]:
        """Packed struct of a message of ``width`` bytes, and the positions and values of its constant bytes."""
        if width not in self._wire:
            names, formats, offsets, at = [], [], [], 0
            constant = bytearray()
            places: list[int] = []

            def fixed(raw: bytes) -> None:
                nonlocal at
                places.extend(range(at, at + len(raw)))
                constant.extend(raw)
                at += len(raw)

            for name, number, kind in self._fields:
                wire, code = _KINDS[kind]
                fixed(tag(number, wire))
                if kind == _P.TYPE_BYTES:
                    size = width - at - 1
                    if not 0 <= size <= _BYTES_MAX:
                        raise LayoutError(f"a message of {self.name} has {count(width, 'byte')}")
                    fixed(bytes([size]))
                    if not size:
                        continue
                    code = f"S{size}"
                if kind == _P.TYPE_ENUM:
                    code = f"({ENUM_BYTES},)u1"
                names.append(name)
                formats.append(code)
                offsets.append(at)
                at += np.dtype(code).itemsize
            if at != width:
                raise LayoutError(f"a message of {self.name} has {count(width, 'byte')}, expected {at}")
            kinds = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": width})
            self._wire[width] = kinds, np.array(places, np.intp), bytes(constant)
        return self._wire[width]

    def decode(self, data: bytes, starts: Sequence[int], widths: Sequence[int]) -> npt.NDArray[np.void]:
        """The messages at offsets ``starts`` of ``data``, of ``widths`` bytes, in order.

        Raises:
            LayoutError: a message has another layout.
        """
        made = np.zeros(len(starts), self.dtype)
        at, sizes = np.asarray(starts), np.asarray(widths)
        for width in np.unique(sizes).tolist():
            which = np.flatnonzero(sizes == width)
            self._fill(made, which, _rows(data, at[which], width))
        return made

    def _fill(self, made: npt.NDArray[np.void], which: npt.NDArray[np.intp], rows: npt.NDArray[np.uint8]) -> None:
        kinds, places, constant = self._wired(rows.shape[1])
        if not np.all(rows[:, places] == np.frombuffer(constant, np.uint8)):
            raise LayoutError(f"a message of {self.name} is not laid out as it says")
        wired = rows.view(kinds)[:, 0]
        everything = len(which) == len(made)
        for name in kinds.names or ():
            values = of_varints(wired[name]) if wired[name].ndim == 2 else wired[name]
            if everything:
                made[name] = values
            else:
                made[name][which] = values


def _rows(data: bytes, starts: npt.NDArray[np.intp], width: int) -> npt.NDArray[np.uint8]:
    """Pieces of ``width`` bytes as the rows of a matrix."""
    steps = np.diff(starts)
    if len(starts) > 1 and np.all(steps == steps[0]) and steps[0] > 0:
        strided = np.ndarray((len(starts), width), np.uint8, data, int(starts[0]), (int(steps[0]), 1))
        return np.ascontiguousarray(strided)
    flat = np.frombuffer(data, np.uint8)
    rows: npt.NDArray[np.uint8] = flat[starts[:, None] + np.arange(width)]
    return rows


HEAD = struct.Struct("<HIQQ")
"""Head of a message in a chunk: channel, sequence, log time, publish time."""
