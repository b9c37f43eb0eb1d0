"""Lock-free rings in shared memory: one writer, any number of readers, each with its own cursor.

A ring is a file in a memory-backed directory, mapped by every process. Slots are fixed little-endian structs that
begin with their own sequence number (from 1). The writer stores the payload, then the slot's number, then the head;
a reader copies and then reads the head again, so that a slot overwritten meanwhile is counted as lost, never
returned torn. (Stores become visible in program order on x86-64; on other machines the check on the slot's number
still refuses a torn slot, one poll later.)
"""

from __future__ import annotations

import mmap
import os
import pathlib
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

_HEADER = struct.Struct("<8sIIQ")  # magic, slot size, capacity, head (sequence number last written)
_HEAD = struct.Struct("<Q")
_HEAD_OFFSET = 16
_DATA_OFFSET = 64
_MAGIC = b"rigring2"
_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class RingError(ValueError):
    """The file is not the ring that was expected."""


def create(
    path: pathlib.Path,
    dtype: np.dtype[Any],
    capacity: int,
    *,
    mode: int = 0o600,
    group: int = -1,
) -> None:
    """Make an empty ring of ``capacity`` slots of ``dtype``, whose first field is ``seq`` (u64).

    Its memory is allocated now: a page allocated when it is first written ends the writer with SIGBUS if the
    memory-backed disk is full by then. ``group``: of the file, else this process's.

    Raises:
        OSError: there is no room, or the folder is gone.
    """
    if dtype.names is None or dtype.names[0] != "seq":
        raise RingError(f"{path.name}: the first field of a slot is its sequence number")
    size = _DATA_OFFSET + capacity * dtype.itemsize
    part = path.with_suffix(".new")
    part.unlink(missing_ok=True)
    fd = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    with open(fd, "wb") as file:  # noqa: PTH123 - a descriptor
        if group >= 0:
            os.fchown(fd, -1, group)
        os.fchmod(fd, mode)
        file.truncate(size)
        os.posix_fallocate(fd, 0, size)
        file.write(_HEADER.pack(_MAGIC, dtype.itemsize, capacity, 0))
    part.rename(path)


def in_own_memory(dtype: np.dtype[Any], capacity: int) -> mmap.mmap:
    """An empty ring in memory of this process alone, which needs no room of a memory-backed disk."""
    memory = mmap.mmap(-1, _DATA_OFFSET + capacity * dtype.itemsize)
    memory[: _HEADER.size] = _HEADER.pack(_MAGIC, dtype.itemsize, capacity, 0)
    return memory


def identity(path: pathlib.Path) -> tuple[int, bytes]:
    """The parts of a ring that never change: its inode, and its header without the head.

    Raises:
        OSError: the ring does not exist or cannot be read.
    """
    fd = os.open(path, _FLAGS | os.O_RDONLY)
    try:
        return os.fstat(fd).st_ino, os.pread(fd, _HEAD_OFFSET, 0)
    finally:
        os.close(fd)


def _map(place: pathlib.Path | mmap.mmap, slot_size: int, *, writable: bool) -> tuple[mmap.mmap, int]:
    if isinstance(place, mmap.mmap):
        return place, int(_HEADER.unpack_from(place, 0)[2])
    path = place
    fd = os.open(path, _FLAGS | (os.O_RDWR if writable else os.O_RDONLY))
    try:
        access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
        memory = mmap.mmap(fd, 0, access=access)
    except ValueError:
        raise RingError(f"{path.name}: empty, no ring") from None
    finally:
        os.close(fd)
    if len(memory) < _DATA_OFFSET:
        raise RingError(f"{path.name}: too short to be a ring")
    magic, size, capacity, _ = _HEADER.unpack_from(memory, 0)
    if magic != _MAGIC or not capacity or size != slot_size or len(memory) != _DATA_OFFSET + capacity * size:
        raise RingError(f"{path.name}: made by another version")
    return memory, capacity


class RingWriter:
    """The one writer. ``write`` packs straight into shared memory: no allocation, no lock, no system call."""

    def __init__(self, place: pathlib.Path | mmap.mmap, layout: struct.Struct) -> None:
        """``place``: a file, or see `in_own_memory`. ``layout``: the slot without its leading sequence number."""
        self._pack_into = struct.Struct("<Q" + layout.format.removeprefix("<")).pack_into
        self._slot_size = layout.size + 8
        self._memory, self._capacity = _map(place, self._slot_size, writable=True)
        (self.head,) = _HEAD.unpack_from(self._memory, _HEAD_OFFSET)
        # One aligned store, because pack_into clears the bytes first and a reader would find a head of 0 in between.
        self._head_word = memoryview(self._memory)[_HEAD_OFFSET : _HEAD_OFFSET + _HEAD.size].cast("Q")

    def write(self, *values: Any) -> int:
        """Append one slot; returns its sequence number."""
        seq: int = self.head + 1
        offset = _DATA_OFFSET + (seq % self._capacity) * self._slot_size
        memory = self._memory
        self._pack_into(memory, offset, 0, *values)  # the number first: 0, no slot, until the values are in
        _HEAD.pack_into(memory, offset, seq)
        self._head_word[0] = seq
        self.head = seq
        return seq

    def close(self) -> None:
        """Unmap."""
        self._head_word.release()
        self._memory.close()


class RingReader:
    """A reader with its own cursor; ``lost`` counts the slots overwritten before they were read."""

    def __init__(self, place: pathlib.Path | mmap.mmap, dtype: np.dtype[Any], *, from_start: bool = False) -> None:
        """``place``: a file, or see `in_own_memory`.

        ``from_start``: begin with the oldest slot still held, else with the next one written.
        """
        self._memory, self._capacity = _map(place, dtype.itemsize, writable=False)
        self._slots: npt.NDArray[Any] = np.ndarray((self._capacity,), dtype, self._memory, _DATA_OFFSET)
        self._head_word = memoryview(self._memory)[_HEAD_OFFSET : _HEAD_OFFSET + _HEAD.size].cast("Q")
        self._none = np.empty(0, dtype)
        self.lost = 0
        self.cursor = self._oldest(self.head) - 1 if from_start else self.head

    @property
    def head(self) -> int:
        """Sequence number written last (0: none yet)."""
        return self._head_word[0]

    @property
    def waits(self) -> bool:
        """A slot waits after the cursor."""
        return self._head_word[0] > self.cursor

    def _oldest(self, head: int) -> int:
        # One slot short of the capacity: the writer may be filling the next one.
        return max(1, head - self._capacity + 2)

    def read(self, limit: int | None = None) -> npt.NDArray[Any]:
        """Slots after the cursor, oldest first, at most ``limit``; moves the cursor."""
        head = self.head
        if self.cursor >= head:
            return self._none
        first = max(self.cursor + 1, self._oldest(head))
        last = head if limit is None else min(head, first + limit - 1)
        numbers = np.arange(first, last + 1, dtype=np.uint64)
        slots: npt.NDArray[Any] = self._slots[numbers % np.uint64(self._capacity)]
        intact = slots["seq"] == numbers
        intact &= numbers >= self._oldest(self.head)
        slots = slots[intact]
        self.lost += (last - self.cursor) - len(slots)
        self.cursor = last
        return slots

    def seek(self, t_ns: int) -> None:
        """Move the cursor before the first slot held not older than ``t_ns``; the ring's times must not fall."""
        low, high = self._oldest(self.head), self.head + 1
        while low < high:
            middle = (low + high) // 2
            slot = self._slots[middle % self._capacity]
            if slot["seq"] != middle or slot["t_ns"] < t_ns:  # a slot overwritten meanwhile was older
                low = middle + 1
            else:
                high = middle
        self.cursor = low - 1

    def latest(self) -> np.void | None:
        """The newest whole slot, without moving the cursor; None while there is none."""
        for _ in range(3):
            head = self.head
            if not head:
                return None
            slot = self._slots[head % self._capacity].copy()
            if slot["seq"] == head:
                return slot  # type: ignore[no-any-return]
        return None

    def close(self) -> None:
        """Release the mapping; it ends with the last array that refers to it."""
        del self._slots
