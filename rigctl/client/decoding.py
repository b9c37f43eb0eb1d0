"""Decodes the fast stream by the schema the daemon serves; this client has no built-in layout of the record."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from rigctl.client.shapes import Line, MessageRefusedError, document
from rigctl.config.built_type import built
from rigctl.wire.block import Block

KNOWN_VERSIONS = (2,)
RECORD_BYTES = 16_384
_FIELDS = 1024
_KNOWN_TYPE = re.compile(r"[<>|=]?([?]|[iu][1248]|f[248]|c8|c16|[bB]|[SV][0-9]{1,4})")


class SchemaError(MessageRefusedError):
    """A schema this client does not know or cannot use; ``str()`` is one line."""


@dataclass(frozen=True)
class SampleField:
    """One value of a sample: unit ("" for none), meaning, numpy type and shape (() for a number)."""

    name: str
    unit: str
    description: str
    type: str
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class SampleLayout:
    """Layout of a record; ``fields`` are in the record's order."""

    fields: Mapping[str, SampleField]
    dtype: np.dtype[Any]

    def decode(self, block: Block) -> npt.NDArray[Any]:
        """The records of a block, shape ``(count,)``, read-only and without a copy.

        Raises:
            SchemaError: the records do not have this layout.
        """
        if block.record_size != self.dtype.itemsize:
            raise SchemaError(f"a record has {block.record_size} bytes, the schema says {self.dtype.itemsize}")
        return np.frombuffer(block.data, self.dtype, block.count)


_Bytes = Annotated[int, Meta(ge=0, le=RECORD_BYTES)]
_Shape = Annotated[tuple[Annotated[int, Meta(ge=1, le=RECORD_BYTES)], ...], Meta(max_length=4)]


class _Field(msgspec.Struct):
    name: Annotated[str, Meta(pattern="^[A-Za-z_][A-Za-z0-9_]{0,63}$")]
    type: Line
    offset: _Bytes
    size: _Bytes
    unit: Line = ""
    description: Line = ""
    shape: _Shape = ()


class _Record(msgspec.Struct):
    size: Annotated[int, Meta(ge=8, le=RECORD_BYTES)]
    fields: Annotated[list[_Field], Meta(min_length=1, max_length=_FIELDS)]


class _Fast(msgspec.Struct):
    record: _Record


@built
class _Schema(msgspec.Struct):
    version: int
    fast: _Fast


def layout_of(schema: Mapping[str, Any]) -> SampleLayout:
    """The layout a schema describes; additions of a newer daemon and fields of unknown type are ignored.

    Raises:
        SchemaError: the version is another, or the document is not a schema.
    """
    version = schema.get("version")
    if version not in KNOWN_VERSIONS:
        known = ", ".join(map(str, KNOWN_VERSIONS))
        raise SchemaError(f"found schema version {version!r}, this client knows {known}: use that daemon's own client")
    try:
        record = msgspec.convert(dict(schema), _Schema).fast.record
        if objects := [field.name for field in record.fields if "O" in field.type]:
            raise SchemaError(f"meta/schema cannot be used: found objects in {objects[0]}, expected plain numbers")
        known_types = [field for field in record.fields if _is_known(field)]
        dtype = np.dtype(
            {
                "names": [field.name for field in known_types],
                "formats": [(field.type, field.shape) for field in known_types],
                "offsets": [field.offset for field in known_types],
                "itemsize": record.size,
            }
        )
    except (msgspec.ValidationError, ValueError, TypeError) as error:
        raise SchemaError(f"meta/schema cannot be used: {' '.join(str(error).split())}") from None
    fields = {f.name: SampleField(f.name, f.unit, f.description, f.type, f.shape) for f in known_types}
    return SampleLayout(MappingProxyType(fields), dtype)


def _is_known(field: _Field) -> bool:
    """Whether the type is a plain one. An unknown type leaves the others readable and never reaches numpy."""
    if not _KNOWN_TYPE.fullmatch(field.type) or math.prod(field.shape) > RECORD_BYTES:
        return False
    return np.dtype((field.type, field.shape)).itemsize == field.size


def usable_schema(payload: bytes) -> dict[str, Any]:
    """The answer of ``meta/schema``, checked.

    Raises:
        MessageRefusedError: it is not a JSON object.
        SchemaError: it cannot be used, or has another version.
    """
    found = document(payload)
    layout_of(found)
    return found
