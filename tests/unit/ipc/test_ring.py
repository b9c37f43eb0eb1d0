"""Rings: every slot once, in order, whole; overwritten slots are counted exactly."""

from __future__ import annotations

import pathlib
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.ipc.record import COMMAND, EVENT, RECORD, REPLY, Slot
from rigctl.ipc.ring import RingError, RingReader, RingWriter, create

DTYPE = np.dtype([("seq", "<u8"), ("a", "<u8"), ("b", "<u8")])
LAYOUT = struct.Struct("<QQ")


def ring(path: pathlib.Path, capacity: int) -> RingWriter:
    create(path, DTYPE, capacity)
    return RingWriter(path, LAYOUT)


def test_slots_come_once_in_order(tmp_path: pathlib.Path) -> None:
    writer = ring(tmp_path / "r", 8)
    reader = RingReader(tmp_path / "r", DTYPE)
    assert len(reader.read()) == 0
    assert reader.latest() is None
    for n in range(5):
        assert writer.write(n, n * n) == n + 1
    assert reader.read(2)["a"].tolist() == [0, 1]
    assert reader.read()["b"].tolist() == [4, 9, 16]
    assert len(reader.read()) == 0
    newest = reader.latest()
    assert newest is not None
    assert newest["seq"] == 5
    assert reader.lost == 0


def test_two_readers_do_not_disturb_each_other(tmp_path: pathlib.Path) -> None:
    writer = ring(tmp_path / "r", 8)
    writer.write(1, 1)
    late, early = RingReader(tmp_path / "r", DTYPE), RingReader(tmp_path / "r", DTYPE, from_start=True)
    writer.write(2, 2)
    assert late.read()["a"].tolist() == [2]
    assert early.read()["a"].tolist() == [1, 2]


def test_a_new_writer_goes_on_where_the_last_one_stopped(tmp_path: pathlib.Path) -> None:
    writer = ring(tmp_path / "r", 8)
    reader = RingReader(tmp_path / "r", DTYPE)
    writer.write(1, 1)
    writer.close()
    assert RingWriter(tmp_path / "r", LAYOUT).write(2, 2) == 2
    assert reader.read()["a"].tolist() == [1, 2]


@pytest.mark.parametrize("other", ["size", "magic", "former", "short", "cut"])
def test_another_file_is_refused(tmp_path: pathlib.Path, other: str) -> None:
    path = tmp_path / "r"
    ring(path, 8).close()
    match other:
        case "size":
            create(path, np.dtype([("seq", "<u8"), ("a", "<u8")]), 8)
        case "magic":
            path.write_bytes(b"x" * path.stat().st_size)
        case "former":  # its records have other bits for the causes
            path.write_bytes(b"rigring1" + path.read_bytes()[8:])
        case "short":
            path.write_bytes(b"x" * 10)
        case "cut":
            path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RingError):
        RingReader(path, DTYPE)
    with pytest.raises(RingError):
        RingWriter(path, LAYOUT)


def test_the_first_field_is_the_sequence_number(tmp_path: pathlib.Path) -> None:
    with pytest.raises(RingError):
        create(tmp_path / "r", np.dtype([("a", "<u8")]), 8)


@pytest.mark.parametrize("slot", [RECORD, EVENT, COMMAND, REPLY], ids=lambda slot: slot.name)
def test_layout_and_dtype_are_the_same_bytes(slot: Slot) -> None:
    assert slot.dtype.itemsize == slot.layout.size + 8


@given(
    capacity=st.integers(4, 40),
    steps=st.lists(st.tuples(st.integers(0, 100), st.none() | st.integers(1, 30)), max_size=30),
    from_start=st.booleans(),
)
def test_a_slow_reader_counts_what_it_lost(
    tmp_path_factory: pytest.TempPathFactory,
    capacity: int,
    steps: list[tuple[int, int | None]],
    from_start: bool,
) -> None:
    path = tmp_path_factory.mktemp("ring") / "r"
    writer = ring(path, capacity)
    reader = RingReader(path, DTYPE, from_start=from_start)
    seen: list[int] = []
    for writes, limit in steps:
        for _ in range(writes):
            writer.write(writer.head + 1, 3 * (writer.head + 1))
        slots = reader.read(limit)
        assert np.all(slots["a"] == slots["seq"])
        assert np.all(slots["b"] == 3 * slots["seq"])
        assert limit is None or len(slots) <= limit
        seen += slots["seq"].tolist()
        assert len(seen) + reader.lost == reader.cursor
        assert writer.head - reader.cursor == 0 or limit is not None
    assert seen == sorted(set(seen))


_WRITER = """
import pathlib, struct, sys, time
from rigctl.ipc.ring import RingWriter
writer = RingWriter(pathlib.Path(sys.argv[1]), struct.Struct("<QQ"))
for _ in range(int(sys.argv[2])):
    n = writer.head + 1
    writer.write(n, ~n & 0xFFFFFFFFFFFFFFFF)
"""


def test_no_slot_is_torn_by_a_writer_in_another_process(tmp_path: pathlib.Path) -> None:
    """A ring so small that the writer laps the reader all the time."""
    path, total = tmp_path / "r", 300_000
    create(path, DTYPE, 16)
    reader = RingReader(path, DTYPE)
    received = 0
    writer = subprocess.Popen([sys.executable, "-c", _WRITER, str(path), str(total)])
    try:
        while reader.cursor < total:
            slots = reader.read()
            assert np.all(slots["a"] == slots["seq"])
            assert np.all(slots["b"] == ~slots["seq"])
            received += len(slots)
            assert writer.poll() in (None, 0)
    finally:
        writer.kill()
        writer.wait()
    assert received + reader.lost == total
