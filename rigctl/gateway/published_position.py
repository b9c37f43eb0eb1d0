"""How far the streams have been published, kept in the runtime folder so that a new gateway continues from there.

It is written after each publication with one system call. After a gateway is killed between the two, the next one
publishes the last block again: it is repeated rather than lost, and a subscriber sees it by the sequence number.

A killed gateway takes with it what Zenoh has not sent yet. Events come one by one, and a subscriber that asks for none
would not know of the last: the position of events is written a little late, so that they are published again.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import stat
import struct
import time
import zlib

_LAYOUT = struct.Struct("<8sQQQQQQ??")
_CHECKSUM = struct.Struct("<I")
_MAGIC = b"rigcurs2"
SENT_NS = 100_000_000  # after this time what was published has left the process, or nobody takes it


class Cursor:
    """Positions of the fast stream, the events and the notes, tied to the ring they count in."""

    def __init__(self, path: pathlib.Path, ring: pathlib.Path, head: int) -> None:
        """``ring``: the records; ``head``: its last sequence number. A cursor of another ring is not used.

        Raises:
            OSError: the file can be neither read nor created.
        """
        self._fd = _open(path)
        self._ring = ring.stat().st_ino
        self.stream = time.time_ns()
        self.fast_seq = self.fast_lost = self.event_seq = self.note_seq = 0
        self.fast_listened = self.events_listened = False
        self.resumed = False
        self._sent = self._next = (0, 0)  # positions of events and notes: what has left, what will have next
        self._next_ns = 0
        raw = os.pread(self._fd, _LAYOUT.size + _CHECKSUM.size, 0)
        if raw and _sealed(raw[: _LAYOUT.size]) == raw:
            magic, inode, stream, fast_seq, lost, event_seq, note_seq, *listened = _LAYOUT.unpack_from(raw)
            if magic == _MAGIC and inode == self._ring and fast_seq <= head:
                self.stream, self.fast_seq, self.fast_lost = stream, fast_seq, lost
                self.event_seq, self.note_seq, self.resumed = event_seq, note_seq, True
                self.fast_listened, self.events_listened = listened
                self._sent = self._next = (event_seq, note_seq)
        self.save()

    def save(self) -> None:
        """Write the positions to the file, those of events and notes as they were once or twice ``SENT_NS`` ago."""
        now_ns = time.monotonic_ns()
        if now_ns >= self._next_ns:
            self._sent, self._next = self._next, (self.event_seq, self.note_seq)
            self._next_ns = now_ns + SENT_NS
        positions = (self._ring, self.stream, self.fast_seq, self.fast_lost, *self._sent)
        os.pwrite(self._fd, _sealed(_LAYOUT.pack(_MAGIC, *positions, self.fast_listened, self.events_listened)), 0)

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)


def _open(path: pathlib.Path) -> int:
    """The opened file; anything else of its name that is not a regular file is removed first."""
    with contextlib.suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if stat.S_ISDIR(mode):
            path.rmdir()
        elif not stat.S_ISREG(mode):
            path.unlink()
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def _sealed(data: bytes) -> bytes:
    """Data with its checksum, because damaged positions would skip events or repeat all of them."""
    return data + _CHECKSUM.pack(zlib.crc32(data)) if len(data) == _LAYOUT.size else b""
