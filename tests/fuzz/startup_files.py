"""Every file that a process reads at its start, damaged: the process starts without it, or refuses it in one line.

`files` changes the content of a file; here a file is also replaced: by nothing, a folder, a pipe, a link.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import pathlib
import random
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

import msgspec

from rigctl.cli.lease_file import LeaseFile
from rigctl.config import rig_file as config
from rigctl.config.rig_file import ConfigError
from rigctl.config.settings import RigSettings
from rigctl.control.load import last_stroke
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.design import gain_file
from rigctl.design.gain_file import GainFileError
from rigctl.design.in_use import design_in_use
from rigctl.design.kept_results import KeptResults
from rigctl.design.margins import design_and_check
from rigctl.devices import eds_file
from rigctl.devices.process_data import wanted
from rigctl.devices.sdo import Watched
from rigctl.gateway import lease_service as lease_keeper
from rigctl.gateway import preflight_service
from rigctl.gateway.active import ActiveConfiguration
from rigctl.gateway.lease_service import LeaseService
from rigctl.gateway.published_position import Cursor
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Standing, in_force
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import ACTIVE, RECORDED, Runtime, daemons
from rigctl.recorder import audit_log
from rigctl.recorder.file_reader import RecordingError, progress_of
from rigctl.recorder.recorder_process import Recorder
from rigctl.supervisor.daemon import Supervisor
from rigctl.wire.state_message import design_of, recorder_of, warnings_of
from tests.builders.paths import ROOT
from tests.fuzz import files, mutate
from tests.fuzz.judge import Tally

_NOW_NS = 1_800_000_000 * 10**9
_TEXTS = (b"", b"\x00" * 4096, b"[" * 100_000, b'{"a":' * 100_000, b"9" * 5000, b"1e999", b"\xff\xfe", b"\xed\xa0\x80",
          b"null", b"true", b"[]", b'"x"', b"{}", b"\n", b"-1", b"99999999999999999999")  # fmt: skip
GAINS = {"k_tension": 0.5, "k_speed": 0.1, "k_integral": 1.0}
KEPT = last_stroke.KeptValues(LastStroke(52.0), KeptBrake(fails=True, slipped_n=300.0))


@dataclass(frozen=True)
class File:
    """A file: its path, content and readers. ``allowed``: exceptions that refuse it."""

    name: str
    path: pathlib.Path
    read: Callable[[], object]
    allowed: tuple[type[Exception], ...] = ()
    lines: bool = False

    def damage(self, whole: bytes, chance: random.Random) -> bytes:
        """Replace the file; returns the replacement, in bytes, for a report."""
        _clear(self.path)
        match chance.randrange(20):
            case 0:
                return b"<nothing>"
            case 1:
                self.path.mkdir()
                (self.path / "full").touch()
                return b"<folder>"
            case 2:
                os.mkfifo(self.path)
                return b"<pipe>"
            case 3:
                target = chance.choice(("/dev/zero", "/dev/full", self.path.name, "not_there", "/proc/self/mem"))
                self.path.symlink_to(target)
                return f"<link to {target}>".encode()
            case 4 | 5:
                data = chance.choice(_TEXTS)
            case 6 | 7:
                data = whole[: chance.randrange(len(whole))]
            case 8 | 9 | 10 | 11:
                data = self._other(whole, chance)
            case _:
                flipped = bytearray(whole)
                for _ in range(chance.choice((1, 1, 1, 3, 30))):
                    flipped[chance.randrange(len(flipped))] ^= 1 << chance.randrange(8)
                data = bytes(flipped)
        self.path.write_bytes(data)
        return data

    @staticmethod
    def _other(whole: bytes, chance: random.Random) -> bytes:
        """Other content under a valid SHA-256, where it is a file of the run-time folder."""
        text, _, seal = whole.rstrip(b"\n").rpartition(b"\n")
        if len(seal) != 64:
            return mutate.raw(whole, chance)
        with contextlib.suppress(RecursionError, UnicodeEncodeError, ValueError):
            from rigctl.ipc.folder_places import digest

            data = json.dumps(mutate.data(json.loads(text), chance)).encode()
            return data + b"\n" + digest(data) + b"\n"
        return mutate.raw(whole, chance)


def _clear(path: pathlib.Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def play(count: int, seed: int) -> Tally:
    """Damage each file ``count`` times."""
    tally, chance = Tally(), random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="rigctl-fuzz-", dir="/dev/shm") as name:
        for file in table(pathlib.Path(name)):
            whole = file.path.read_bytes()
            for _ in range(count):
                what = file.damage(whole, chance)
                with contextlib.redirect_stderr(io.StringIO()):
                    tally.attempt(file.name, what, file.read, file.allowed, line=not file.lines)
            _clear(file.path)
            file.path.write_bytes(whole)
    return tally


def table(base: pathlib.Path) -> list[File]:
    """All files, whole, in ``base``."""
    folder = base / "config"
    shutil.copytree(ROOT / "config", folder, ignore=shutil.ignore_patterns("calibration", "audit"))
    rig = config.load(folder / "paper_rig.yaml")
    runtime = _runtime(base / "rigctl-paper_rig", rig)
    return [*_of_the_operator(folder, rig), *_of_the_daemon(runtime, rig), *_kept(folder, runtime, rig)]


def _of_the_operator(folder: pathlib.Path, rig: RigSettings) -> list[File]:
    made = gain_file.provenance(rig, pathlib.Path("paper_rig.yaml"), datetime(2026, 11, 21, tzinfo=UTC))
    gains = folder / "gains.yaml"
    gain_file.write(gains, design_and_check(rig), made)
    eds = rig.file(rig.inclinometer.eds)
    paper, plain = folder / "paper_rig.yaml", folder / "plain_rig.yaml"
    return [
        File("rig file", paper, lambda: config.load(paper), (ConfigError,), True),
        File("DBC file", folder / "plain_sensors.dbc", lambda: config.load(plain), (ConfigError,), True),
        File("EDS file", eds, lambda: eds_file.check(rig), (eds_file.EdsError,)),
        File("gain file", gains, lambda: gain_file.read(gains), (GainFileError,)),
    ]  # fmt: skip


def _runtime(folder: pathlib.Path, rig: RigSettings) -> Runtime:
    runtime = Runtime(folder)
    os.close(runtime.claim())
    runtime.make_rings(rig)
    design = {"gains": GAINS, "verdict": "Ms 1.5", "warnings": [], "accepted": True}
    settings = rig.model_dump(mode="json")
    active = {"settings": settings, "version": "0.1.0", "started_wall_ns": _NOW_NS, "pid": 1, "run_id": "ab"}
    runtime.write_json(ACTIVE, {**active, "design": design})
    applied = {"name": "scheduler", "asked": "x", "in_force": "SCHED_FIFO 80", "ok": True, "warning": ""}
    stop = {"object": "0x6007", "name": "abort", "wanted": 2, "found": 2, "ok": True, "why": ""}
    item = Watched(4, 0x6007, 0, 2, 2, "abort connection option", 300)
    report = {"devices": [], "supervision": [stop], "process_data": wanted(rig).as_json(), "watched": [asdict(item)]}
    control = {
        "pid": 1,
        "host_checks": 0,
        "realtime": [applied],
        "warnings": [],
        "last_stroke": asdict(KEPT.stroke),
        "kept_brake": asdict(KEPT.brake),
    }
    runtime.write_json("control.json", control | report)
    recording = {"folder": "/tmp", "file": "x.mcap", "bytes": 1}
    told = {"run": _NOW_NS, "pid": os.getpid(), "audit_log": "a", "entries": 0, "head": "", "trip_dump": None}
    runtime.write_json(
        RECORDED, {**told, "recording": recording, "failures": 0, "warnings": [], "trips": "", "t_ns": 1}
    )
    runtime.write_json(last_stroke.IN_FORCE, KEPT)
    runtime.write_json("calibration.json", Standing(0.4, 1.001, "2027-01-01T00:00:00Z"))
    now = time.monotonic_ns()
    lease = {"holder": "anna", "id": "0" * 32, "since_ns": now - 10**9, "until_ns": now + 10**11}
    runtime.write_json(lease_keeper.IN_FORCE, lease)
    Cursor(runtime.gateway_cursor, runtime.records.path, 0).close()
    return runtime


def _of_the_daemon(runtime: Runtime, rig: RigSettings) -> list[File]:
    at = runtime.directory
    whole = runtime.read_json(ACTIVE)
    supervisor = Supervisor(rig, lambda _text: None)
    supervisor._runtime = runtime

    def active() -> None:
        """Gateway, recorder and page read the file; the supervisor reads it before it starts one of them."""
        design_of(ActiveConfiguration(runtime).written)
        runtime.known(ACTIVE)
        supervisor._active = whole
        supervisor._look_at_active()
        found = runtime.read_json(ACTIVE)
        assert RigSettings.model_validate(found["settings"]) is not None
        assert {k: v for k, v in found.items() if k != "design"} == {k: v for k, v in whole.items() if k != "design"}

    def control() -> None:
        supervisor._say_real_time()
        preflight_service.look(runtime, rig, Standing(), datetime.now(UTC))
        warnings_of(ActiveConfiguration(runtime).control)

    def recorded() -> None:
        told = runtime.known(RECORDED)
        msgspec.json.encode(recorder_of(told, 10**9))
        recording = told.get("recording")
        assert recording is None or pathlib.Path(recording["folder"])

    def calibration() -> None:
        standing = in_force(runtime)
        before = Standing(0.4, 1.001)
        assert in_force(runtime, before) in (standing, before)

    def lease() -> None:
        LeaseService(runtime, 300, time.monotonic_ns()).shown(time.monotonic_ns())

    def cursor() -> None:
        found = Cursor(runtime.gateway_cursor, runtime.records.path, 0)
        try:
            assert (found.fast_seq, found.event_seq, found.note_seq) == (0, 0, 0)
        finally:
            found.close()

    def lock() -> None:
        daemons(at.parent)
        again = Runtime(at)
        os.close(again.claim())

    def ring() -> None:
        records = runtime.records.reader(from_start=True)
        records.read()
        records.latest()
        records.seek(5)

    return [
        File("active.json", at / ACTIVE, active),
        File("control.json", at / "control.json", control),
        File("recorder.json", at / RECORDED, recorded),
        File("calibration.json", at / "calibration.json", calibration),
        File("stroke.json", at / last_stroke.IN_FORCE, lambda: last_stroke.in_force(runtime)),
        File("lease.json", at / lease_keeper.IN_FORCE, lease),
        File("gateway.cursor", at / "gateway.cursor", cursor, (OSError,)),
        File("lock", at / "lock", lock),
        File("ring", at / "records", ring, (RingError, OSError)),
    ]


def _kept(folder: pathlib.Path, runtime: Runtime, rig: RigSettings) -> list[File]:
    """Files kept from one run of the daemon to the next."""
    rig = rig.model_copy(update={"directory": str(folder)})
    ledger_file = rig.ledger
    assert ledger_file is not None
    new = ledger.entry(
        rig, "tare", "anna", _NOW_NS, before={}, after={"zero_n": 0.4, "scale": 1.0}, figures={"n": 0.03}
    )
    ledger.append(rig, new)
    last_stroke.write(rig, KEPT, _NOW_NS)
    log = audit_log.AuditLog(rig.audit_log, rig.rig)
    log.append(
        [audit_log.Item(i, _NOW_NS, "command", "ARM accepted", "anna") for i in range(3)],
        [{"notes": i} for i in range(3)],
    )
    log.close()
    torn = rig.audit_log.with_name(f"{rig.audit_log.name}.torn")
    torn.write_bytes(b'{"n":4,"rig":"paper')
    part = folder / "part.mcap"
    part.write_bytes(files.recorded(folder, rig))
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    mine = LeaseFile(rig.rig, "tcp/127.0.0.1:7447", "anna")
    mine.write("0" * 32)

    def design() -> None:
        """A start: it computes what it cannot read."""
        design_in_use(rig, results=KeptResults(rig.kept_results))

    results = KeptResults(rig.kept_results)
    design_in_use(rig, results=results)
    results.keep()

    def recorder() -> None:
        """A recorder that starts: it reports what it cannot continue, and goes on."""
        found = Recorder(
            runtime, rig.model_copy(update={"recording": rig.recording.model_copy(update={"enabled": False})}), 1, 1
        )
        found.log.close()
        audit_log.check(rig.audit_log, rig.rig)

    return [
        File(
            "calibration ledger",
            ledger_file,
            lambda: ledger.standing(rig, ledger.read(rig), _NOW_NS),
            (ledger.LedgerError,),
        ),
        File("results of the design", rig.kept_results, design),
        File("last stroke", rig.last_stroke, lambda: last_stroke.read(rig)),
        File("audit log", rig.audit_log, recorder, (audit_log.AuditError,)),
        File("audit log's torn line", torn, recorder, (audit_log.AuditError,)),
        File("recording", part, functools.partial(progress_of, part), (RecordingError,)),
        File("client's lease", mine.path, mine.read),
    ]
