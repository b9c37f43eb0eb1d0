"""Rings filled with random bits, and a recording made of them."""

from __future__ import annotations

import pathlib
import random
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc.record import COMMAND, FRAME, RECORD
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.model.signals import RECORDED
from rigctl.recorder.continuous import BATCH_NS, Continuous
from tests.builders.paths import ROOT

TICK_NS = 1_000_000
START_NS = 5_000_000_000
OFFSET_NS = 1_700_000_000_000_000_000
_BITS = {"Q": 64, "I": 32, "H": 16, "B": 8}


class Tape:
    """A runtime folder whose rings the test writes, and the recording of it."""

    def __init__(self, folder: pathlib.Path, seed: int = 1, **recording: Any) -> None:
        settings = config.load(ROOT / "config/paper_rig.yaml")
        own = settings.recording.model_copy(update={"folder": str(folder / "recordings"), "free_mib": 1, **recording})
        kept = settings.audit.model_copy(update={"file": str(folder / "audit.jsonl"), "trips": str(folder / "trips")})
        preflight = settings.preflight.model_copy(update={"disk_free_mib": 1})
        safety = settings.safety.model_copy(update={"waiver": "the small disk of a test"})
        self.settings: RigSettings = settings.model_copy(
            update={
                "recording": own, "audit": kept, "preflight": preflight, "safety": safety, "directory": str(folder),
            }
        )  # fmt: skip
        self.folder = folder / "recordings"
        self.runtime = Runtime(folder / "runtime")
        self.runtime.directory.mkdir()
        self.runtime.make_rings(self.settings)
        self.runtime.write_json(ACTIVE, {"settings": self.settings.model_dump(mode="json"), "started_wall_ns": 7})
        self.chance = random.Random(seed)
        self.now_ns = START_NS
        self.records: list[Any] = []
        self.frames: list[Any] = []
        self._writers = (
            self.runtime.records.writer(), self.runtime.frames.writer(), self.runtime.commands.writer(),
            self.runtime.events.writer(),
        )  # fmt: skip
        self._readers = (
            self.runtime.records.reader(from_start=True), self.runtime.frames.reader(from_start=True),
            self.runtime.commands.reader(from_start=True),
        )  # fmt: skip
        self.recording = self.start()

    def start(self, run: int = OFFSET_NS) -> Continuous:
        """Start a recording of this run, as a new recorder does."""
        self.recording = Continuous(self.runtime, self.settings, run, self.now_ns + OFFSET_NS)
        return self.recording

    def tick(self, count: int = 1) -> None:
        """Write records of random bits and the frames of each, and an occasional command and event."""
        records, frames, commands, events = self._writers
        for _ in range(count):
            self.now_ns += TICK_NS
            records.write(*self._values(RECORD.fields, self.now_ns))
            for _ in range(4):
                data = self.chance.randbytes(self.chance.randrange(9))
                jitter = self.chance.randrange(-200_000, 200_000)
                frames.write(self.now_ns + jitter, self.chance.getrandbits(32), self.chance.randrange(2),
                             len(data), data)  # fmt: skip
            if self.chance.random() < 0.01:
                commands.write(*self._values(COMMAND.fields, self.now_ns))
                events.write(self.now_ns, 9, self.chance.getrandbits(32), 2, self.chance.random(), 1.0, b"words")

    def _values(self, fields: tuple[Any, ...], t_ns: int) -> list[Any]:
        return [t_ns if field.name == "t_ns" else self._value(field.code) for field in fields]

    def _value(self, code: str) -> Any:
        if code == "d":
            odd = (float("nan"), float("inf"), -0.0, 1e300, 5e-324)
            return self.chance.choice(odd) if self.chance.random() < 0.05 else self.chance.gauss(0.0, 300.0)
        if code == "q":
            return struct.unpack("<q", self.chance.randbytes(8))[0]
        return self.chance.getrandbits(_BITS[code])

    def run(self, ticks: int) -> None:
        """Write ticks, and let the recorder read the rings as often as it really does."""
        step = BATCH_NS // TICK_NS
        for done in range(0, ticks, step):
            self.tick(min(step, ticks - done))
            self.poll()

    def poll(self) -> None:
        self.recording.poll(self.now_ns, self.now_ns + OFFSET_NS)

    def close(self) -> None:
        self.recording.close(self.now_ns, self.now_ns + OFFSET_NS)

    def held(self) -> tuple[npt.NDArray[np.void], npt.NDArray[np.void], npt.NDArray[np.void]]:
        """Records, frames and commands in the rings since the last call."""
        records, frames, commands = (reader.read() for reader in self._readers)
        return records, frames, commands

    def files(self) -> list[pathlib.Path]:
        return sorted(self.folder.iterdir())


def as_recorded(records: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Records as a recording keeps them: doubles with the precision of 32 bits, except for the command."""
    kept = records.copy()
    for field in RECORDED:
        if field.code == "d" and not field.exact:
            with np.errstate(over="ignore"):
                kept[field.name] = records[field.name].astype(np.float32)
    return kept


def same(left: npt.NDArray[np.void], right: npt.NDArray[np.void]) -> bool:
    """Whether both are the same bit for bit, any NaN equal to any other."""
    if left.dtype != right.dtype or len(left) != len(right):
        return False
    names = left.dtype.names or ()
    return all(np.array_equal(left[name], right[name], equal_nan=left[name].dtype.kind == "f") for name in names)


__all__ = ["FRAME", "Tape", "as_recorded", "same"]
