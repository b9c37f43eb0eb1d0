"""Mutated files of every kind the project reads: each is accepted, or refused in plain lines that name it."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import math
import pathlib
import random
import shutil
import struct
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import msgspec
import numpy as np
import yaml
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from hil.lockstep import lockstep
from hil.scenario import case
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file as config
from rigctl.config import strict_yaml
from rigctl.config.rig_file import ConfigError
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design import gain_file
from rigctl.design.gains import DesignError
from rigctl.design.margins import design_and_check
from rigctl.devices.remote_node import StartupError
from rigctl.gateway import lease_service as lease_keeper
from rigctl.ipc import ledger
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.recorder import audit_log, chain, mcap_scan, recording
from rigctl.recorder.contents import figures
from rigctl.recorder.continuous import Continuous
from tests.builders.paths import ROOT
from tests.fuzz import mutate
from tests.fuzz.judge import Tally

RIGS = ("rig.yaml", "paper_rig.yaml", "plain_rig.yaml")
_NOW_NS = 1_800_000_000 * 10**9


@dataclass(frozen=True)
class Kind:
    """A kind of file: valid texts to begin with, and the reader of a mutated one."""

    name: str
    texts: list[bytes]
    load: Callable[[bytes], Any]  # text to plain data; for structured mutations
    dump: Callable[[Any], bytes]
    read: Callable[[bytes], object]
    allowed: tuple[type[Exception], ...]
    lines: bool = False  # a refusal has a line for each finding, else one line

    def mutant(self, chance: random.Random) -> bytes:
        """One of the texts, changed in its structure or in its bytes."""
        text = chance.choice(self.texts)
        if chance.random() < 0.75:
            try:
                return self.dump(mutate.data(self.load(text), chance))
            except (RecursionError, UnicodeEncodeError):  # nested too deeply for the writer
                pass
        return mutate.raw(text, chance)


def play(count: int, others: int, designs: int, seed: int) -> Tally:
    """Read ``count`` mutated rig files, ``others`` of other kinds; start a loop with ``designs`` of those accepted."""
    tally, chance = Tally(), random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="rigctl-fuzz-", dir="/dev/shm") as name:
        folder = pathlib.Path(name) / "config"
        shutil.copytree(ROOT / "config", folder, ignore=shutil.ignore_patterns("calibration", "audit"))
        taken = []
        for kind in kinds(folder):
            for _ in range(count if kind.name == "rig file" else others):
                text = kind.mutant(chance)
                found = tally.attempt(
                    kind.name, text, functools.partial(kind.read, text), kind.allowed, line=not kind.lines
                )
                if isinstance(found, RigSettings):
                    taken.append((text, found))
        for text, settings in chance.sample(taken, min(designs, len(taken))):
            tally.attempt(
                "loop of a rig file taken", text, functools.partial(_start, settings), (DesignError, StartupError)
            )
    return tally


def _start(settings: RigSettings) -> bool:
    """A rig file whose design is accepted gives a loop that runs and commands nothing out of bounds."""
    found = design_and_check(settings)
    if not found.accepted or settings.simulation is None:
        return False
    with lockstep(settings, found.gains) as rig:
        records = rig.run(0.2)
        assert abs(records["command_mm_s"]).max() <= settings.tension.speed_max_mm_s
    return True


def kinds(folder: pathlib.Path) -> list[Kind]:
    """All kinds; ``folder`` is a copy of config/ to write in."""
    rig = config.load(folder / "paper_rig.yaml")
    return [
        _rig_file(folder),
        _scenario(folder),
        _dbc(folder),
        _gains(rig),
        _ledger(folder, rig),
        _audit(folder),
        _recording(folder, rig),
        _lease(),
    ]


def _yaml(text: bytes) -> Any:
    return strict_yaml.load(text.decode()).data


def _as_yaml(found: Any) -> bytes:
    return yaml.dump(found, Dumper=yaml.SafeDumper, sort_keys=False, allow_unicode=True).encode()


def _as_gain_file(found: Any) -> bytes:
    """Text between quotes, as `rigctl tune` writes it: a bare version is refused before its values are read."""
    return yaml.dump(found, Dumper=gain_file._Dumper, sort_keys=False, allow_unicode=True).encode()


def _as_json(found: Any) -> bytes:
    return json.dumps(found).encode()


def _written(file: pathlib.Path, text: bytes) -> pathlib.Path:
    file.write_bytes(text)
    return file


def _rig_file(folder: pathlib.Path) -> Kind:
    texts, mutant = [(folder / name).read_bytes() for name in RIGS], folder / "mutant.yaml"
    return Kind(
        "rig file", texts, _yaml, _as_yaml, lambda text: config.load(_written(mutant, text)), (ConfigError,), True
    )


def _scenario(folder: pathlib.Path) -> Kind:
    files = sorted((folder / "scenarios").glob("*.yaml"))
    mutant = folder / "scenarios/mutant.yaml"
    texts = [file.read_bytes() for file in files]
    return Kind(
        "scenario", texts, _yaml, _as_yaml, lambda text: case.load(_written(mutant, text)), (ScenarioError,), lines=True
    )


def _dbc(folder: pathlib.Path) -> Kind:
    rig, dbc = folder / "plain_rig.yaml", folder / "plain_sensors.dbc"
    original = dbc.read_bytes()

    def read(text: bytes) -> bool:
        try:
            dbc.write_bytes(text)
            return config.load(rig) is not None
        finally:
            dbc.write_bytes(original)

    def lines(text: bytes) -> list[Any]:
        return [line.split(" ") for line in text.decode().split("\n")]

    def joined(found: Any) -> bytes:
        rows = found if isinstance(found, list) else [found]
        words = (" ".join(map(str, row)) if isinstance(row, list) else str(row) for row in rows)
        return "\n".join(words).encode()

    return Kind("DBC file", [original], lines, joined, read, (ConfigError,), lines=True)


def _gains(rig: RigSettings) -> Kind:
    with tempfile.TemporaryDirectory() as name:
        file = pathlib.Path(name) / "gains.yaml"
        made = gain_file.provenance(rig, pathlib.Path("config/paper_rig.yaml"), datetime(2026, 11, 21, tzinfo=UTC))
        gain_file.write(file, design_and_check(rig), made)
        text = file.read_bytes()

    def read(text: bytes) -> bool:
        found = gain_file.parse(text.decode(errors="replace"), "gains.yaml").gains
        return all(map(math.isfinite, Gains(**found.model_dump()).in_order))

    return Kind("gain file", [text], _yaml, _as_gain_file, read, (gain_file.GainFileError,))


def _ledger(folder: pathlib.Path, rig: RigSettings) -> Kind:
    rig = rig.model_copy(update={"directory": str(folder)})
    assert rig.ledger is not None
    made = [("tare", None, 0.4), ("calibration check", True, 0.4), ("identification", None, 0.4)]
    for i, (what, passed, zero_n) in enumerate(made):
        after: dict[str, float | None] = {"zero_n": zero_n, "scale": 1.001}
        new = ledger.entry(
            rig, what, "anna", _NOW_NS + i * 10**9, before={}, after=after, figures={"spread_n": 0.03}, passed=passed
        )
        ledger.append(rig, new)
    path = rig.ledger

    def read(text: bytes) -> ledger.Standing:
        path.write_bytes(text)
        return ledger.standing(rig, ledger.read(rig), _NOW_NS)

    return Kind("calibration ledger", [path.read_bytes()], msgspec.json.decode, _as_json, read, (ledger.LedgerError,))


def _audit(folder: pathlib.Path) -> Kind:
    path = folder / "audit.jsonl"
    log = audit_log.AuditLog(path, "paper_rig")
    for i in range(4):
        log.append([audit_log.Item(i, _NOW_NS, "command", "ARM accepted", "anna", {"n": i})], [{"notes": i}])
    log.close()

    def load(text: bytes) -> list[Any]:
        return [msgspec.json.decode(line) for line in text.splitlines()]

    def dump(found: Any) -> bytes:
        rows = found if isinstance(found, list) else [found]
        return b"".join(_rehashed(row) for row in rows)

    def read(text: bytes) -> bool:
        report = chain.verify(text.splitlines(keepends=True))
        assert report.good or report.why.isprintable()
        audit_log.check(_written(path, text), "paper_rig")
        again = audit_log.AuditLog(path, "paper_rig")
        try:
            again.append([audit_log.Item(9, _NOW_NS, "command", "HOLD accepted")], [{}])
        finally:
            again.close()
        return report.good

    return Kind("audit log", [path.read_bytes()], load, dump, read, (audit_log.AuditError,))


def _rehashed(row: Any) -> bytes:
    """A changed entry under a valid hash, so that its reader has to judge the entry itself."""
    plain = {key: value for key, value in row.items() if key != "hash"} if isinstance(row, dict) else row
    try:
        body = chain.canonical(plain)
    except (TypeError, ValueError, OverflowError):
        return repr(row).encode() + b"\n"
    if not body.endswith(b"}"):
        return body + b"\n"
    return body[:-1] + b',"hash":"' + hashlib.sha256(body).hexdigest().encode() + b'"}\n'


def _recording(folder: pathlib.Path, rig: RigSettings) -> Kind:
    """A recording with records, frames and documents; a changed chunk still has a valid checksum."""
    path = folder / "recording.mcap"
    path.write_bytes(recorded(folder, rig))

    def read(text: bytes) -> int:
        found = recording.read(_written(path, text))
        figures(found)
        assert np.all(np.diff(found.records["seq"].astype(np.int64)) > 0)
        return len(found.records)

    return Kind("recording", [path.read_bytes()], _as_pieces, _as_mcap, read, (recording.RecordingError,))


def recorded(folder: pathlib.Path, rig: RigSettings) -> bytes:
    kept = rig.recording.model_copy(update={"folder": "kept", "free_mib": 1})
    settings = rig.model_copy(update={"recording": kept})
    runtime = Runtime(folder / "runtime")
    runtime.directory.mkdir()
    runtime.make_rings(settings)
    runtime.write_json(ACTIVE, {"settings": settings.model_dump(mode="json")})
    records, frames, events = runtime.records.writer(), runtime.frames.writer(), runtime.events.writer()
    kept_by = Continuous(runtime, settings, _NOW_NS, _NOW_NS)
    for tick in range(1, 4):
        t_ns = tick * 10**9
        records.write(t_ns, *(0 for _ in RECORD.fields[1:]))
        frames.write(t_ns, 0x182, 0, 8, bytes(8))
        events.write(t_ns, 1, 2, 3, 0.0, 0.0, b"x")
        kept_by.poll(t_ns, _NOW_NS + t_ns)
    kept_by.close(4 * 10**9, _NOW_NS + 4 * 10**9)
    runtime.remove()
    (file,) = kept_by.folder.iterdir()
    return file.read_bytes()


def _as_pieces(text: bytes) -> list[list[Any]]:
    """The records of an MCAP file without their heads, chunks unpacked."""
    found = []
    for piece in mcap_scan.Scan(text).pieces():
        content = text[piece.offset + 9 : piece.end]
        if piece.opcode == Opcode.CHUNK:
            content = get_chunk_data_stream(Chunk.read(ReadDataStream(io.BytesIO(content))))[0].read(len(text) << 8)
        found.append([piece.opcode, content.decode("latin-1")])
    return found


def _as_mcap(found: Any) -> bytes:
    parts = [mcap_scan.MAGIC]
    for row in found if isinstance(found, list) else [found]:
        opcode, content = row if isinstance(row, list) and len(row) == 2 else (0, row)
        code = opcode % 256 if isinstance(opcode, int) else 0
        data = str(content).encode("latin-1", "replace")
        if code == Opcode.CHUNK:
            head = struct.pack("<QQQI", 0, 0, len(data), zlib.crc32(data))
            data = head + struct.pack("<IQ", 0, len(data)) + data
        parts.append(struct.pack("<BQ", code, len(data)) + data)
    return b"".join([*parts, mcap_scan.MAGIC])


def _lease() -> Kind:
    text = json.dumps({"holder": "anna", "id": "0" * 32, "since_ns": 10**9, "until_ns": 2 * 10**9}).encode()

    def read(text: bytes) -> bool:
        try:
            written = msgspec.json.decode(text)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return False
        return lease_keeper.valid_lease(written, 60 * 10**9, 3 * 10**9 // 2) is not None

    return Kind("lease", [text], json.loads, _as_json, read, ())
