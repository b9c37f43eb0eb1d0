"""One part of a recording being written: encodes its content and passes the bytes to the disk's thread."""

from __future__ import annotations

import functools
import platform
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from typing import IO, Any, cast

import numpy as np
import numpy.typing as npt

from rigctl import __version__
from rigctl.model.signals import RECORDED
from rigctl.recorder.appender import Appender
from rigctl.recorder.audit_log import Item
from rigctl.recorder.mcap_file import FORMAT, McapFile, Message

AUDIT_SCHEMA = {"title": "rigctl.AuditEntry", "type": "object", "description": "a line of the audit log, see its chain"}
_LIBRARIES = (
    "numpy", "python-can", "canopen", "cantools", "control", "scipy", "eclipse-zenoh", "msgspec",
    "pydantic", "mcap", "protobuf", "zstandard",
)  # fmt: skip


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the installed libraries."""
    found = {"rigctl": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


class _Taken:
    """A stream that buffers what is written until `take`."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def write(self, data: bytes) -> int:
        self._parts.append(bytes(data))
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        pass

    def take(self) -> bytes:
        taken = b"".join(self._parts)
        self._parts.clear()
        return taken


class PartFile:
    """A part: an MCAP file being written and the thread that writes it to the disk."""

    def __init__(self, disk: Appender, wall_offset_ns: int, opened_ns: int, words: dict[str, Any]) -> None:
        """``words``: metadata of this part."""
        self.disk, self.opened_ns, self.offset_ns = disk, opened_ns, wall_offset_ns
        self._stream = _Taken()
        exact = {row.name for row in RECORDED if row.exact}
        self._file = McapFile(cast("IO[bytes]", self._stream), wall_offset_ns, exact)
        self._audit = self._file.json_channel("audit", AUDIT_SCHEMA)
        self._file.describe("rigctl", {**words, "format": FORMAT, "wall_offset_ns": wall_offset_ns})
        self._file.describe("versions", dict(versions()))

    @property
    def size(self) -> int:
        """Bytes so far, including those not yet on the disk."""
        return self._stream.tell()

    def attach(self, name: str, data: bytes, now_ns: int, age_ns: int) -> None:
        """Add a JSON document that was written ``age_ns`` ago."""
        wall_ns = now_ns + self.offset_ns
        self._file.attach(name, data, wall_ns, wall_ns - age_ns)

    def write(
        self, slots: Mapping[str, npt.NDArray[np.void]], said: Iterable[Item], audit: Iterable[tuple[int, int, bytes]]
    ) -> None:
        """Write new content as one chunk and pass it to the disk.

        Args:
            slots: new slots by topic.
            said: new items of the other rings.
            audit: number, time and line of each new entry of the audit log.
        """
        for topic in ("records", "commands", "holds", "frames"):
            self._file.add(self._file.slots(topic, slots[topic]))
        self._file.add(Message(t_ns + self.offset_ns, self._audit, n, line) for n, t_ns, line in audit)
        self._file.add(self._file.said(said))
        self._file.flush()
        self.disk.append(self._stream.take())

    def finish(self, sealer: Callable[[str], str] | None = None) -> None:
        """Write the seal and the index; the thread ends when all is written."""
        self._file.finish(sealer)
        self.disk.append(self._stream.take())
        self.disk.end()
