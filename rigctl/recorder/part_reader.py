"""Reads one file of a recording or a trip dump, whole or up to where it was cut off or damaged."""

from __future__ import annotations

import hashlib
import io
import mmap
import pathlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import mcap.exceptions
import mcap.records
import msgspec
import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream

from rigctl.ipc.record import COMMAND, FRAME, HOLD, RECORD, Slot
from rigctl.recorder import frame_block, mcap_scan
from rigctl.recorder.layout import HEAD, Layout, LayoutError
from rigctl.recorder.mcap_scan import Buffer, DamageError, Scan, ScanError
from rigctl.recorder.protobuf import numbers_of

SLOTS: dict[str, Slot] = {"records": RECORD, "frames": FRAME, "commands": COMMAND, "holds": numbers_of(HOLD)}
RECORDER = "recorder"
_WRITTEN = "written"
_DAMAGED = (struct.error, UnicodeDecodeError, ValueError, mcap.exceptions.McapError)
_NO_FILE = "not a recording of rigctl"


class RecordingError(ValueError):
    """Not a recording, or parts that do not belong together; ``str()`` is one line."""


@dataclass(frozen=True)
class File:
    """A file that was read. ``note``: why it is not ``complete``."""

    path: pathlib.Path
    size: int
    sha256: str
    complete: bool
    note: str


@dataclass(frozen=True)
class Said:
    """An event, reply, note or entry of the audit log. ``seq``: its number in its ring, or in the audit log."""

    seq: int
    t_ns: int
    what: str
    who: str
    text: str
    details: dict[str, Any]


@dataclass(frozen=True)
class Attachment:
    """A document and the time it came into force: ``t_ns`` on CLOCK_MONOTONIC, ``wall_ns`` on the wall clock."""

    name: str
    t_ns: int
    wall_ns: int
    data: bytes


@dataclass
class _Channel:
    topic: str
    encoding: str
    layout: Layout | None
    blocks: bool
    wanted: bool = True
    starts: list[int] = field(default_factory=list)
    widths: list[int] = field(default_factory=list)


class Part:
    """One file, read."""

    def __init__(self, path: pathlib.Path, frames: bool) -> None:
        self.path, self._frames = path, frames
        self.metadata: dict[str, dict[str, str]] = {}
        self.said: dict[str, list[Said]] = {}
        self.attachments: list[Attachment] = []
        self._raw: list[mcap.records.Attachment] = []
        self._schemas: dict[int, mcap.records.Schema] = {}
        self._channels: dict[int, _Channel] = {}
        self._made: dict[str, list[npt.NDArray[np.void]]] = {name: [] for name in SLOTS}
        self._damage = ""
        with _mapped(path) as data:
            try:
                self._scan(data)
            finally:
                data.release()
        self._settle()
        self.slots = {name: _whole(made, SLOTS[name], path) for name, made in self._made.items()}

    def _scan(self, data: Buffer) -> None:
        try:
            scan = Scan(data)
        except ScanError as error:
            raise RecordingError(f"{self.path}: {error}") from None
        for piece in scan.pieces():
            try:
                self._take(piece)
            except LayoutError as error:
                raise RecordingError(f"{self.path}: {error}") from None
            except _DAMAGED as error:
                why = str(error) if isinstance(error, DamageError) else "a record is damaged"
                self._damage = self._damage or f"at byte {piece.offset}: {why}"
            finally:
                piece.content.release()
        note = "; ".join(filter(None, (self._damage, scan.note)))
        self.file = File(self.path, len(data), hashlib.sha256(data).hexdigest(), not note, note)

    def _take(self, piece: mcap_scan.Piece) -> None:
        match piece.opcode:
            case mcap_scan.CHUNK:
                self._chunk(mcap_scan.unpacked(piece.content))
            case mcap_scan.METADATA:
                found = mcap.records.Metadata.read(_stream(piece))
                self.metadata.setdefault(found.name, found.metadata)
            case mcap_scan.ATTACHMENT:
                self._raw.append(mcap.records.Attachment.read(_stream(piece)))
            case mcap_scan.SCHEMA | mcap_scan.CHANNEL:
                self._register(piece)

    def _register(self, piece: mcap_scan.Piece) -> None:
        if piece.opcode == mcap_scan.SCHEMA:
            schema = mcap.records.Schema.read(_stream(piece))
            self._schemas.setdefault(schema.id, schema)
            return
        channel = mcap.records.Channel.read(_stream(piece))
        if channel.id in self._channels:
            return
        topic, own = channel.topic.removeprefix("/"), self._schemas.get(channel.schema_id)
        layout, blocks = None, False
        if channel.message_encoding == "protobuf":
            if own is None or topic not in SLOTS:
                return
            blocks = own.name == frame_block.NAME
            layout = None if blocks else Layout(own.data, own.name, SLOTS[topic])
        wanted = self._frames or topic != "frames"
        self._channels[channel.id] = _Channel(topic, channel.message_encoding, layout, blocks, wanted)

    def _chunk(self, data: bytes) -> None:
        view = memoryview(data)
        head, size = HEAD.size, len(data)
        at = 0
        unpack, of_message = struct.Struct("<BQH").unpack_from, mcap_scan.MESSAGE
        channels = self._channels
        flat = np.frombuffer(data, np.uint8)
        for known in channels.values():  # messages left over from a damaged chunk
            known.starts, known.widths = [], []
        while at + 9 <= size:
            if data[at] != of_message:
                length = int.from_bytes(data[at + 1 : at + 9], "little")
                if at + 9 + length > size:
                    raise DamageError("a chunk ends within a record")
                self._register_in_chunk(data[at], view[at + 9 : at + 9 + length], at)
                at += 9 + length
                continue
            _, length, number = unpack(data, at) if at + 11 <= size else (0, size, 0)
            if length < head or at + 9 + length > size:
                raise DamageError("a chunk ends within a record")
            channel = channels.get(number)
            step = 9 + length
            alone = channel is None or channel.layout is None or data[at : at + 11] != data[at + step : at + step + 11]
            count = 1 if alone else _alike(flat, at, step)
            if channel is not None and channel.wanted:
                channel.starts += range(at + 9 + head, at + 9 + head + count * step, step)
                channel.widths += [length - head] * count
            at += count * step
        for known in channels.values():
            if known.starts:
                self._messages(known, data, view, known.starts, known.widths)
                known.starts, known.widths = [], []

    def _register_in_chunk(self, opcode: int, content: Buffer, at: int) -> None:
        if opcode in (mcap_scan.SCHEMA, mcap_scan.CHANNEL):
            self._register(mcap_scan.Piece(opcode, content, at))

    def _messages(
        self, channel: _Channel, data: bytes, view: Buffer, starts: list[int], widths: list[int]
    ) -> None:  # fmt: skip
        if channel.layout is not None:
            self._made[channel.topic].append(channel.layout.decode(data, starts, widths))
        elif channel.blocks:
            for start, width in zip(starts, widths, strict=True):
                self._made[channel.topic].append(frame_block.decode(view[start : start + width]))
        elif channel.encoding == "json":
            own = self.said.setdefault(channel.topic, [])
            for start, width in zip(starts, widths, strict=True):
                own.append(_item(data[start : start + width]))

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
        for found in self._raw:
            t_ns = found.create_time - self.offset_ns
            self.attachments.append(Attachment(found.name, t_ns, found.create_time, found.data))


def _alike(flat: npt.NDArray[np.uint8], at: int, step: int) -> int:
    """Number of consecutive messages of the same channel and length, the first at ``at``."""
    count, look = 1, 4
    while True:
        most = min((len(flat) - at) // step, look)
        heads = flat[at : at + most * step].reshape(most, step)[:, :11]
        differ = np.flatnonzero(np.any(heads[count:] != heads[0], axis=1))
        if len(differ):
            return count + int(differ[0])
        if most < look:
            return most
        count, look = most, 8 * look


def _whole(made: list[npt.NDArray[np.void]], slot: Slot, path: pathlib.Path) -> npt.NDArray[np.void]:
    if any(array.dtype != made[0].dtype for array in made):
        raise RecordingError(f"{path}: one topic in two layouts")
    return np.concatenate(made) if made else np.empty(0, slot.dtype)


def _item(data: bytes) -> Said:
    found = msgspec.json.decode(data)
    try:
        number = found["seq"] if found.get("n") is None else found["n"]
        item = Said(number, found["t_ns"], found["what"], found["who"], found["text"], found["details"])
    except (KeyError, TypeError, AttributeError):
        raise DamageError("a message is not what its schema says") from None
    if not isinstance(item.seq, int) or not isinstance(item.t_ns, int) or not isinstance(item.details, dict):
        raise DamageError("a message is not what its schema says")
    return item


def _stream(piece: mcap_scan.Piece) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(piece.content))


class _mapped:  # noqa: N801
    """A file's bytes, mapped into memory instead of read."""

    def __init__(self, path: pathlib.Path) -> None:
        self._path = path

    def __enter__(self) -> Buffer:
        try:
            if not self._path.is_file():
                missing = not self._path.exists()
                raise RecordingError(f"{self._path} cannot be read: {'no such file' if missing else 'not a file'}")
            with self._path.open("rb") as stream:
                size = stream.seek(0, io.SEEK_END)
                if not size:
                    raise RecordingError(f"{self._path}: found an empty file, expected a recording")
                self._map = mmap.mmap(stream.fileno(), size, access=mmap.ACCESS_READ)
        except OSError as error:
            raise RecordingError(f"{self._path} cannot be read: {error.strerror}") from None
        return memoryview(self._map)

    def __exit__(self, *_: object) -> None:
        self._map.close()


def progress_of(path: pathlib.Path) -> dict[str, int]:
    """Position of each ring in a file, from the last whole chunk that has it; empty if none has.

    Raises:
        RecordingError: the file cannot be read.
    """
    with _mapped(path) as data:
        try:
            scan = Scan(data)
        except ScanError as error:
            data.release()
            raise RecordingError(f"{path}: {error}") from None
        chunks = []
        for piece in scan.pieces():
            if piece.opcode == mcap_scan.CHUNK:
                chunks.append(piece.content)
            else:
                piece.content.release()
        found: dict[str, int] = {}
        for chunk in reversed(chunks):
            if not found:
                found = _progress(chunk)
            chunk.release()
        data.release()
    return found


def _progress(chunk: Buffer) -> dict[str, int]:
    try:
        for message in reversed(list(_messages(mcap_scan.unpacked(chunk)))):
            if message[:1] == b"{" and b'"what":"written"' in message:
                read = msgspec.json.decode(message)["details"]["read"]
                return msgspec.convert(read, dict[str, int])
    except (DamageError, KeyError, TypeError, msgspec.MsgspecError):
        pass
    return {}


def _messages(data: bytes) -> Iterator[bytes]:
    for piece in mcap_scan.records(memoryview(data)):
        if piece.opcode == mcap_scan.MESSAGE:
            yield bytes(piece.content[HEAD.size :])
