"""The layout a schema must have, so that numpy can read its messages at once."""

from __future__ import annotations

import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

from rigctl.ipc.record import EVENT
from rigctl.recorder.protobuf import Decoding, LayoutError


def schema(*kinds: int) -> bytes:
    files = FileDescriptorSet()
    message = files.file.add(name="a.proto", package="rigctl").message_type.add(name="Event")
    for number, kind in enumerate(kinds, 1):
        message.field.add(name=f"field_{number}", number=number, type=kind)
    return bytes(files.SerializeToString())


def test_no_field_may_have_bytes() -> None:
    number, data = FieldDescriptorProto.TYPE_FIXED64, FieldDescriptorProto.TYPE_BYTES
    assert Decoding(schema(number, number), "rigctl.Event", EVENT).dtype.names == ("field_1", "field_2")
    for kinds in ((data,), (data, number), (number, data)):
        with pytest.raises(LayoutError, match="fields without a fixed width"):
            Decoding(schema(*kinds), "rigctl.Event", EVENT)
