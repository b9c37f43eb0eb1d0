"""How far the streams have been published, kept in the runtime folder so that a new gateway goes on from there.

Written after each publication with one system call. A gateway killed between the two publishes its last block again:
repeated rather than lost, and a subscriber sees it by the sequence number.
"""

from __future__ import annotations

import os
import pathlib
import struct
import time

_LAYOUT = struct.Struct("<8sQQQQQQ??")
_MAGIC = b"rigcurs1"


class Cursor:
    """Positions of the fast stream, the events and the notes, tied to the ring they count in."""

    def __init__(self, path: pathlib.Path, ring: pathlib.Path, head: int) -> None:
        """``ring``: the records; ``head``: its last sequence number. A cursor of another ring is not used."""
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._ring = ring.stat().st_ino
        self.stream = time.time_ns()
        self.fast_seq = self.fast_lost = self.event_seq = self.note_seq = 0
        self.fast_listened = self.events_listened = False
        self.resumed = False
        raw = os.pread(self._fd, _LAYOUT.size, 0)
        if len(raw) == _LAYOUT.size:
            magic, inode, stream, fast_seq, lost, event_seq, note_seq, *listened = _LAYOUT.unpack(raw)
            if magic == _MAGIC and inode == self._ring and fast_seq <= head:
                self.stream, self.fast_seq, self.fast_lost = stream, fast_seq, lost
                self.event_seq, self.note_seq, self.resumed = event_seq, note_seq, True
                self.fast_listened, self.events_listened = listened
        self.save()

    def save(self) -> None:
        """Write the positions down."""
        positions = (self._ring, self.stream, self.fast_seq, self.fast_lost, self.event_seq, self.note_seq)
        os.pwrite(self._fd, _LAYOUT.pack(_MAGIC, *positions, self.fast_listened, self.events_listened), 0)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._fd)
