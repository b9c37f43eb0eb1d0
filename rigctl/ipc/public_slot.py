"""What every user of this computer may read of a rig without its gateway: 64 bytes in the run-time folder, mode 0644.

The supervisor writes them each 100 ms, from the newest record of the loop. It is the process that a start begins with,
and lives on while gateway or loop end or hang; without it there is no loop. The folder is its user's alone, so no
other user can have made the file; a reader opens it for reading only, so that it cannot hold up the writer.

The first field is the CRC-32 of all others. A reader that meets the writer finds another one, and reads again.
"""

from __future__ import annotations

import contextlib
import math
import os
import stat
import struct
import zlib
from typing import TYPE_CHECKING, NamedTuple

from rigctl.ipc import whole_file
from rigctl.ipc.folder_places import FolderPlaces

if TYPE_CHECKING:
    import numpy as np  # slow: a client reads the slot without it

PUBLIC_SLOT = "public.slot"
MODE = 0o644
SLOT_BYTES = 64
WORDS_BYTES = 27
"""The longest name of what a start waits for."""
_FORM = struct.Struct(f"<qqfQBBBBB{WORDS_BYTES}s")
_CRC = struct.Struct("<I")
_VERSION = 2  # begins the checksum, so that a slot of another form is refused
_TRIES = 5
_DRIVE_SHIFT = 4  # of the drive's quality beside the cell's, four bits each


class PublicSlot(NamedTuple):
    """One content. Times are of CLOCK_MONOTONIC; numbers of mode, fault and what holds are those of the record."""

    looked_ns: int
    """When the supervisor has written this."""
    t_ns: int = 0
    """Of the newest record; 0: this run has none yet."""
    tension_n: float = math.nan
    cause_bits: int = 0
    mode: int = 0
    held_by: int = 0
    fault: int = 0
    tension_quality: int = 0
    drive_quality: int = 0
    brake_fails: bool = False
    waits_for: str = ""
    """What the start of the daemon, or of a new loop, waits for; empty once all processes work."""

    def packed(self) -> bytes:
        """The 64 bytes."""
        quality = self.tension_quality & 0xF | (self.drive_quality & 0xF) << _DRIVE_SHIFT
        words = self.waits_for.encode("ascii", "replace")[:WORDS_BYTES]
        body = _FORM.pack(
            self.looked_ns, self.t_ns, self.tension_n, self.cause_bits, self.mode, self.held_by, self.fault, quality,
            self.brake_fails, words,
        )  # fmt: skip
        return _CRC.pack(zlib.crc32(body, _VERSION)) + body

    @classmethod
    def unpacked(cls, data: bytes) -> PublicSlot | None:
        """The content; None for what is torn, damaged or of another version."""
        if len(data) != SLOT_BYTES or _CRC.unpack_from(data)[0] != zlib.crc32(data[_CRC.size :], _VERSION):
            return None
        looked_ns, t_ns, tension_n, causes, mode, held_by, fault, quality, fails, words = _FORM.unpack_from(
            data, _CRC.size
        )
        waits_for = words.rstrip(b"\0").decode("ascii", "replace")
        if not waits_for.isprintable():  # it is printed, and of another user's daemon nothing is believed
            return None
        return cls(
            looked_ns, t_ns, tension_n, causes, mode, held_by, fault, quality & 0xF, quality >> _DRIVE_SHIFT,
            bool(fails), waits_for,
        )  # fmt: skip


def slot_of(record: np.void | None, now_ns: int, brake_fails: int, waits_for: str = "") -> PublicSlot:
    """The content for the newest record; ``brake_fails``: its bit in the record's flags."""
    if record is None:
        return PublicSlot(now_ns, waits_for=waits_for)
    numbers = ("cause_bits", "mode", "held_by", "fault", "tension_quality", "drive_quality")
    causes, mode, held_by, fault, tension_quality, drive_quality = (int(record[name]) for name in numbers)
    return PublicSlot(
        now_ns, int(record["t_ns"]), float(record["tension_n"]), causes, mode, held_by, fault, tension_quality,
        drive_quality, bool(int(record["flags"]) & brake_fails), waits_for,
    )  # fmt: skip


class SlotWriter:
    """The one writer: the supervisor."""

    def __init__(self, folder: FolderPlaces) -> None:
        """Make the file anew, in place of what a run before has left.

        Raises:
            OSError: there is no room, or the folder is gone.
        """
        place = folder.place(PUBLIC_SLOT)
        place.unlink(missing_ok=True)
        self._file = os.open(place, whole_file.NEW, 0o600)
        os.pwrite(self._file, PublicSlot(0).packed(), 0)  # its memory, so that no later write finds that full
        os.fchmod(self._file, MODE)

    def write(self, content: PublicSlot) -> None:
        """Write over the content; where that fails, the old one stays, whose time shows its age."""
        with contextlib.suppress(OSError):  # the load matters more than what other users see of it
            os.pwrite(self._file, content.packed(), 0)

    def close(self) -> None:
        """Close the file, which stays until the folder is deleted."""
        os.close(self._file)


def read(folder: FolderPlaces) -> PublicSlot | None:
    """The content in a run-time folder; None where there is none that can be read."""
    try:
        file = os.open(folder.place(PUBLIC_SLOT), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        if not stat.S_ISREG(os.fstat(file).st_mode):
            return None
        return next(filter(None, (PublicSlot.unpacked(os.pread(file, SLOT_BYTES + 1, 0)) for _ in range(_TRIES))), None)
    except OSError:
        return None
    finally:
        os.close(file)
