"""Reads one file of a recording or a trip dump, whole or up to where it was cut off or damaged."""

from __future__ import annotations

import contextlib
import hashlib
import io
import mmap
import pathlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from rigctl.config.built_type import built
from rigctl.config.one_line import printable
from rigctl.ipc.record import COMMAND, FRAME, HOLD, RECORD, Slot
from rigctl.recorder import frame_block
from rigctl.recorder.mcap_file import FORMAT, SEAL
from rigctl.recorder.mcap_scan import READ, DamageError, Piece, Scan, ScanError
from rigctl.recorder.protobuf import Decoding, LayoutError, numbers_of

SLOTS: dict[str, Slot] = {"records": RECORD, "frames": FRAME, "commands": COMMAND, "holds": numbers_of(HOLD)}
RECORDER = "recorder"
_NO_FILE = "not a recording of rigctl"
Decoder = Callable[[list[bytes]], npt.NDArray[np.void]]


class RecordingError(ValueError):
    """Not a recording, or parts that do not belong together; ``str()`` is one line."""


@dataclass(frozen=True)
class FoundSeal:
    """The seal in a file: what it says of the SHA-256 before it, and what that is."""

    sha256: str
    seal: str
    found_sha256: str


@dataclass(frozen=True)
class ReadFile:
    """A file that was read. ``note``: why it is not ``complete``; ``seal``: None without one."""

    path: pathlib.Path
    size: int
    sha256: str
    complete: bool
    note: str
    seal: FoundSeal | None = None


@built
class Said(msgspec.Struct):
    """An event, reply, note or entry of the audit log. ``seq``: its number in its ring, or in the audit log."""

    seq: int
    t_ns: int
    what: str
    who: str
    text: str
    details: dict[str, Any]
    n: int | None = None
    """Number of an entry of the audit log, whose ``seq`` is that of its source."""


@dataclass(frozen=True)
class AttachedDocument:
    """A document and the time it came into force: ``t_ns`` on CLOCK_MONOTONIC, ``wall_ns`` on the wall clock."""

    name: str
    t_ns: int
    wall_ns: int
    data: bytes


class FileReader:
    """The content of one file."""

    def __init__(self, path: pathlib.Path, frames: bool) -> None:
        """Read it; ``frames``: with its CAN frames.

        Raises:
            RecordingError: it is not a file of a recording, or one of another format.
        """
        self.path = path
        self._topics = tuple(topic for topic in SLOTS if frames or topic != "frames")
        self.metadata: dict[str, dict[str, str]] = {}
        self.said: dict[str, list[Said]] = {}
        self._attached: list[Attachment] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._decoders: dict[int, Decoder] = {}
        self._decoded: dict[str, list[npt.NDArray[np.void]]] = {name: [] for name in SLOTS}
        with _mapped(path) as data:
            self.file = self._read(data)
        self._settle()
        self.slots = {name: _whole(decoded, SLOTS[name], path) for name, decoded in self._decoded.items()}

    def _read(self, data: mmap.mmap) -> ReadFile:
        scan, damage, seal = _scan(data, self.path), "", None
        for piece in scan.pieces():
            if piece.opcode in READ:
                # What follows a seal is not sealed, so that it is none of this file any more.
                seal = replace(seal, found_sha256="") if seal is not None else _seal(data, scan, piece)
                try:
                    self._take(scan.content(piece))
                except LayoutError as error:
                    raise RecordingError(f"{self.path}: {error}") from None
                except ValueError as error:
                    why = str(error) if isinstance(error, DamageError) else "a record is damaged"
                    damage = damage or f"at byte {piece.offset}: {why}"
                if piece.opcode == Opcode.METADATA:
                    self._refuse_other_format()
        note = "; ".join(filter(None, (damage, scan.note)))
        return ReadFile(self.path, len(data), hashlib.sha256(data).hexdigest(), not note, note, seal)

    def _refuse_other_format(self) -> None:
        """Refuse a file whose numbers have another meaning, as its head says it, before the rest is read."""
        own = self.metadata.get("rigctl", {})
        if "rig" in own and (found := own.get("format")) != FORMAT:
            by = f"rigctl {own['version']}" if "version" in own else "a rigctl that it does not name"
            why = (
                f"found {f'format {found}' if found else 'no format'}, expected format {FORMAT}: it was made by {by} "
                "with other bits for the causes; read it with the build that made it"
            )
            raise RecordingError(f"{self.path}: {printable(why)}")

    def _take(self, records: list[Any]) -> None:
        messages: dict[int, list[bytes]] = {}
        for record in records:
            match record:
                case Message():
                    messages.setdefault(record.channel_id, []).append(record.data)
                case Schema():
                    self._schemas.setdefault(record.id, record)
                case Channel():
                    self._register(record)
                case Metadata():
                    self.metadata.setdefault(record.name, record.metadata)
                case Attachment():
                    self._attached.append(record)
        for number, channel in self._channels.items():
            if number in messages:
                self._decode(channel, messages[number])

    def _register(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return
        topic, schema = channel.topic.removeprefix("/"), self._schemas.get(channel.schema_id)
        if channel.message_encoding == "protobuf":
            if schema is None or topic not in SLOTS:
                return
            blocks = topic == "frames"
            decode = frame_block.decode if blocks else Decoding(schema.data, schema.name, SLOTS[topic]).decode
            self._decoders[channel.id] = decode
        self._channels[channel.id] = channel

    def _decode(self, channel: Channel, messages: list[bytes]) -> None:
        topic = channel.topic.removeprefix("/")
        if (decoder := self._decoders.get(channel.id)) is not None:
            if topic in self._topics:
                self._decoded[topic].append(decoder(messages))
        elif channel.message_encoding == "json":
            said = self.said.setdefault(topic, [])
            for message in messages:
                said.append(_said(message))

    def _settle(self) -> None:
        """Take the figures from the metadata."""
        own = self.metadata.get("rigctl")
        if own is None or "rig" not in own:
            raise RecordingError(f"{self.path}: {_NO_FILE}: {self.file.note or 'it does not say of which rig'}")
        self.rig = own["rig"]
        self.run = own.get("run") or own.get("started_wall_ns", "")
        try:
            self.offset_ns = int(own.get("wall_offset_ns", "0"))
            self.number = int(own.get("part", "0"))
        except ValueError:
            raise RecordingError(f"{self.path}: {_NO_FILE}: its metadata are damaged") from None
        self.documents = [
            AttachedDocument(found.name, found.create_time - self.offset_ns, found.create_time, found.data)
            for found in self._attached
        ]


def _whole(decoded: list[npt.NDArray[np.void]], slot: Slot, path: pathlib.Path) -> npt.NDArray[np.void]:
    if any(array.dtype != decoded[0].dtype for array in decoded):
        raise RecordingError(f"{path}: one topic in two layouts")
    return np.concatenate(decoded) if decoded else np.empty(0, slot.dtype)


def _said(data: bytes) -> Said:
    try:
        found = msgspec.json.decode(data, type=Said)
    except msgspec.ValidationError:
        raise DamageError("a message is not what its schema says") from None
    found.seq = found.seq if found.n is None else found.n
    return found


@contextlib.contextmanager
def _mapped(path: pathlib.Path) -> Iterator[mmap.mmap]:
    """A file's bytes, mapped into memory instead of read."""
    try:
        if not path.is_file():
            missing = not path.exists()
            raise RecordingError(f"{path} cannot be read: {'no such file' if missing else 'not a file'}")
        with path.open("rb") as stream:
            if not stream.seek(0, io.SEEK_END):
                raise RecordingError(f"{path}: found an empty file, expected a recording")
            mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from None
    with mapped:
        yield mapped


def _scan(data: mmap.mmap, path: pathlib.Path) -> Scan:
    try:
        return Scan(data)
    except ScanError as error:
        raise RecordingError(f"{path}: {error}") from None


def _seal(data: mmap.mmap, scan: Scan, piece: Piece) -> FoundSeal | None:
    """The seal that a record is, None for any other record."""
    if piece.opcode != Opcode.METADATA:
        return None
    with contextlib.suppress(DamageError, StopIteration):
        found = next(one for one in scan.content(piece) if isinstance(one, Metadata) and one.name == SEAL)
        sha256 = hashlib.sha256(memoryview(data)[: piece.offset]).hexdigest()
        return FoundSeal(found.metadata.get("sha256", ""), found.metadata.get("seal", ""), sha256)
    return None


def run_of(path: pathlib.Path) -> int | None:
    """Wall clock in ns at the start of the run of a file, from its head; None if the file cannot be read."""
    with contextlib.suppress(RecordingError, DamageError, StopIteration, KeyError, ValueError), _mapped(path) as data:
        scan = _scan(data, path)
        head = next(piece for piece in scan.pieces() if piece.opcode == Opcode.METADATA)
        return int(scan.content(head)[0].metadata["run"])
    return None


def progress_of(path: pathlib.Path) -> dict[str, int]:
    """Position of each ring in a file, from the last whole chunk that has it; empty if none has.

    Raises:
        RecordingError: the file cannot be read.
    """
    with _mapped(path) as data:
        scan = _scan(data, path)
        for chunk in reversed([piece for piece in scan.pieces() if piece.opcode == Opcode.CHUNK]):
            with contextlib.suppress(DamageError, KeyError, TypeError, msgspec.MsgspecError):
                for record in reversed(scan.content(chunk)):
                    if isinstance(record, Message) and b'"what":"written"' in record.data:
                        return msgspec.convert(msgspec.json.decode(record.data)["details"]["read"], dict[str, int])
    return {}
