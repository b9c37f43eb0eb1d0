"""Whatever the wall clock reads, what was written first is deleted first, and a name it contradicts is a warning."""

from __future__ import annotations

import pathlib
import random
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import ACTIVE, RECORDED, Runtime
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.recorder import parts, recording
from rigctl.recorder.recorder_process import Recorder

S = 1_000_000_000
DAY = 86_400 * S
TRUE_NS = 1_795_000_000 * S  # a day in 2026
POLL_NS = S // 2
DRAWS, BLOCK = 200, 10
KEPT_MB, PART_MB, DUMPS = 0.54, 0.1, 2
"""Four or five parts, which are small without records, and the dumps of the newest trips."""
FAULTS = (Fault.RIVAL, Fault.CELL_STALE, Fault.E_STOP)
STARTS: dict[str, Callable[[random.Random], int]] = {
    "right": lambda _: 0,
    "back": lambda chance: -chance.randrange(400) * DAY,
    "ahead": lambda chance: chance.randrange(400) * DAY,
    "1970": lambda chance: 12 * S + chance.randrange(3) * 1_000_000 + chance.randrange(1_000_000) - TRUE_NS,
    "2099": lambda chance: 4_070_908_800 * S + chance.randrange(40 * DAY) - TRUE_NS,
}
"""By how much the clock is wrong. A computer without a battery takes nearly the same time to start each time."""


@dataclass
class Witness:
    """Counts files as they appear, so that it knows what was deleted while older files were kept."""

    folder: pathlib.Path
    known: dict[pathlib.Path, tuple[int, int]] = field(default_factory=dict)
    count: int = 0
    deleted: int = 0
    wrong: list[str] = field(default_factory=list)

    def look(self, after: str) -> None:
        """Look at the folder after each turn of the recorder."""
        there = {path: path.stat().st_ino for path in self.folder.glob("*.mcap")} if self.folder.is_dir() else {}
        gone = {path: written for path, (written, inode) in self.known.items() if there.get(path) != inode}
        self.deleted += len(gone)
        kept = [written for path, (written, _) in self.known.items() if path not in gone]
        for path, written in gone.items():
            if any(older < written for older in kept):
                self.wrong.append(
                    f"{after}: {path.name} deleted, {len(kept)} files kept, the oldest {min(kept)}, {written=}"
                )
            del self.known[path]
        for path in sorted(there.keys() - self.known.keys()):
            self.count += 1
            self.known[path] = self.count, there[path]


class Rig:
    """Runs of one rig after each other, in the same folders, with a recorder each that reads real rings."""

    def __init__(self, folder: pathlib.Path, settings: RigSettings) -> None:
        kept = settings.recording.model_copy(
            update={"folder": str(folder / "recordings"), "part_s": 1, "part_mb": PART_MB, "keep_mb": KEPT_MB}
        )
        audit = settings.audit.model_copy(
            update={"file": str(folder / "audit.jsonl"), "trips": str(folder / "trips"), "trips_kept": DUMPS}
        )
        self.settings = settings.model_copy(update={"recording": kept, "audit": audit, "directory": str(folder)})
        self.runtime = Runtime(folder / "run")
        self.runtime.directory.mkdir(parents=True)
        self.witnesses = [Witness(folder / "recordings"), Witness(folder / "trips")]
        self.now_ns = self.started_ns = 0

    def put(self, folder: str, rest: str) -> pathlib.Path:
        """Put in a file of the rig that no run here has written."""
        path = pathlib.Path(self.settings.directory) / folder / f"{self.settings.rig}-{rest}.mcap"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(bytes(70_000))
        self.look(rest)
        return path

    def start(self, wrong_ns: int) -> None:
        """Start a daemon, whose clock is wrong by ``wrong_ns``."""
        self.runtime.make_rings(self.settings)
        self.now_ns += 3600 * S
        self.started_ns = TRUE_NS + self.now_ns + wrong_ns
        if wrong_ns < -TRUE_NS // 2:
            self.started_ns -= self.now_ns  # that clock starts anew with the computer
        self.offset_ns = self.started_ns - self.now_ns
        settings = self.settings.model_dump(mode="json", warnings=False)
        self.runtime.write_json(ACTIVE, {"settings": settings, "started_wall_ns": self.started_ns})
        self.join()

    def join(self) -> None:
        """Start a recorder of the running daemon."""
        self.recorder = Recorder(self.runtime, self.settings, self.now_ns, self.now_ns + self.offset_ns)

    def leave(self) -> None:
        self.recorder.close(self.now_ns, self.now_ns + self.offset_ns)
        self.look("the end of a recorder")

    def turn(self) -> None:
        self.now_ns += POLL_NS
        self.recorder.poll(self.now_ns, self.now_ns + self.offset_ns)
        self.look(f"at {self.now_ns + self.offset_ns}")

    def trip(self, fault: Fault) -> None:
        """Trip, and give the recorder the time until the dump is due."""
        self.runtime.events.writer().write(self.now_ns, Kind.TRIP, fault, 0, 0.0, 0.0, b"")
        before = self.recorder.trip_dump
        for _ in range(5):
            self.turn()
        dump = self.recorder.trip_dump
        if dump == before or dump is None or not (self.witnesses[1].folder / dump).exists():
            self.witnesses[1].wrong.append(f"{dump}: deleted as it was written, or not written at all")

    def look(self, after: str) -> None:
        for witness in self.witnesses:
            witness.look(after)


@pytest.fixture
def folder() -> Iterator[pathlib.Path]:
    """A folder in memory: of the disk's speed nothing here depends, and its syncs would take most of the time."""
    with tempfile.TemporaryDirectory(prefix="rigctl-clocks-", dir="/dev/shm") as name:
        yield pathlib.Path(name)


@pytest.fixture
def rig(folder: pathlib.Path, settings: RigSettings) -> Rig:
    return Rig(folder, settings)


def play(rig: Rig, chance: random.Random) -> None:
    """Files without a number, then runs with drawn clocks, steps of the clock in service, recorders that end, trips."""
    for start in ("20250101T000000.000Z", "20990101T000000.000Z"):
        rig.put("recordings", f"{start}-0001")
        rig.put("trips", f"{start}-E_STOP")
    for _ in range(chance.randrange(2, 5)):
        rig.start(STARTS[chance.choice(list(STARTS))](chance))
        for _ in range(chance.randrange(2, 5)):
            match chance.randrange(5):
                case 0 | 1:
                    rig.trip(chance.choice(FAULTS))
                case 2:
                    rig.offset_ns = TRUE_NS + STARTS[chance.choice(list(STARTS))](chance)
                case 3:
                    rig.leave()
                    rig.join()
            for _ in range(chance.randrange(1, 3)):
                rig.turn()
        rig.leave()


@pytest.mark.gate("0")
@pytest.mark.parametrize("block", range(DRAWS // BLOCK))
def test_no_evidence_is_deleted_before_older_evidence(block: int, folder: pathlib.Path, settings: RigSettings) -> None:
    wrong, deleted = [], [0, 0]
    for draw in range(block * BLOCK, (block + 1) * BLOCK):
        rig = Rig(folder / str(draw), settings)
        play(rig, random.Random(draw))
        for which, witness in enumerate(rig.witnesses):
            wrong += [f"draw {draw}: {found}" for found in witness.wrong]
            deleted[which] += witness.deleted
    assert not wrong
    assert min(deleted) > 0, "the folders were not full"


def test_a_run_that_started_in_the_millisecond_of_another_is_another_run(rig: Rig) -> None:
    for run in (1, 2):
        rig.start(12 * S + run - TRUE_NS)
        rig.turn()
        rig.leave()
        rig.join()
        rig.turn()
        rig.leave()
    names = [part.path.name for part in parts.parts(rig.witnesses[0].folder, "paper_rig")]
    assert names == [f"paper_rig-{run:06d}-19700101T000012.000Z-{part:04d}.mcap" for run in (1, 2) for part in (1, 2)]
    for at in (0, 2):
        own = [rig.witnesses[0].folder / name for name in names[at : at + 2]]
        assert recording.parts_of(own[1]) == tuple(own)
        assert len(recording.read(*own).files) == 2


def test_a_name_in_the_future_is_a_warning_while_it_is_there(rig: Rig, capfd: pytest.CaptureFixture[str]) -> None:
    part, dump = rig.put("recordings", "20990101T000000.000Z-0001"), rig.put("trips", "20990101T000000.000Z-RIVAL")
    rig.start(0)
    for _ in range(3):
        rig.turn()
    shown = rig.runtime.read_json(RECORDED)
    assert [why for why in shown["warnings"] if "20990101" in why] == [
        f"recorder: {path.name} is dated after the computer's clock, which reads 2026-11-18 (such files: 1); files are "
        "deleted in the order of their numbers; set the clock"
        for path in (dump, part)
    ]
    assert shown["failures"] == 0
    assert capfd.readouterr().err.count("WARNING: paper_rig-20990101T000000") == 2
    part.unlink()
    dump.unlink()
    for _ in range(3):
        rig.turn()
    assert rig.runtime.read_json(RECORDED)["warnings"] == []
    rig.leave()
    assert rig.settings.audit_log.read_text().count('"what":"misordered"') == 2


def test_a_run_newer_than_the_running_one_is_a_warning_and_goes_first(rig: Rig) -> None:
    rig.start(0)
    rig.turn()
    put = rig.put("recordings", "000009-20250101T000000.000Z-0001")
    for _ in range(3):
        rig.turn()
    (why,) = rig.runtime.read_json(RECORDED)["warnings"]
    assert why.startswith(f"recorder: {put.name} is of run 9, the running one is 1: the file was put there since; ")
    for _ in range(12):
        rig.turn()
    assert not put.exists()
    assert len(parts.parts(rig.witnesses[0].folder, "paper_rig")) >= 3
    rig.leave()
