"""Recordings with an exactly known error, written by the recorder's own writer."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterable
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from rigctl.config import rig_file as config
from rigctl.ipc.record import COMMAND, FRAME, HOLD, RECORD
from rigctl.model.states import Mode
from rigctl.recorder.appender import Appender
from rigctl.recorder.audit_log import Item
from rigctl.recorder.part_file import PartFile
from tests.builders import daemons
from tests.builders.waiting import patience_s

RATE_HZ = 1000
START_NS, OFFSET_NS = 5_000_000_000, 1_700_000_000_000_000_000
TARGET_N = 300.0
BEFORE_S, AFTER_S = 2.0, 1.0
GAINS = {"k_tension": 1.34, "k_speed": 0.149, "k_integral": 1.03}
_BATCH = 400
Floats = npt.NDArray[np.float64]
ErrorOf = Callable[[Floats], Floats]


def no_error(t_s: Floats) -> Floats:
    return np.zeros_like(t_s)


def stay(mode: Mode, seconds: float, error: ErrorOf = no_error, target_n: float = TARGET_N) -> npt.NDArray[np.void]:
    """Records of a stay in one mode; ``error``: N of the vertical tension, by the time since its start."""
    made = np.zeros(round(seconds * RATE_HZ), RECORD.dtype)
    t_s = np.arange(len(made)) / RATE_HZ
    made["mode"] = mode
    made["target_n"] = made["setpoint_n"] = target_n
    tight = mode in (Mode.COMPENSATING, Mode.FAULT)
    made["vertical_n"] = made["tension_n"] = target_n + error(t_s) if tight else 0.0
    made["stroke_mm"] = 50.0 if tight else 0.0
    made["lateness_ns"], made["work_ns"] = 20_000, 150_000
    return made


def run(*stays: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Stays one after the other, numbered and timed as by a loop."""
    made = np.concatenate(stays)
    ticks = np.arange(1, len(made) + 1)
    made["seq"] = made["tick"] = ticks
    made["t_ns"] = START_NS + ticks * (1_000_000_000 // RATE_HZ)
    made["frames_sent"], made["frames_received"] = 2 * ticks, 2 * ticks
    return made


def compensating(error: ErrorOf, seconds: float = 20.0) -> npt.NDArray[np.void]:
    """HOLD, COMPENSATING with that error, HOLD."""
    return run(stay(Mode.HOLD, BEFORE_S), stay(Mode.COMPENSATING, seconds, error), stay(Mode.HOLD, AFTER_S))


def frames(records: npt.NDArray[np.void], first: int) -> npt.NDArray[np.void]:
    """SYNC, command, tension and drive status of each tick."""
    made = np.zeros(4 * len(records), FRAME.dtype)
    made["seq"] = first + np.arange(len(made))
    made["t_ns"] = np.repeat(records["t_ns"], 4)
    made["can_id"] = np.tile([0x80, 0x204, 0x182, 0x184], len(records))
    made["sent"], made["dlc"] = np.tile([1, 1, 0, 0], len(records)), np.tile([0, 6, 4, 8], len(records))
    tension = np.round(np.repeat(records["tension_n"], 4) * 1000).astype("<i4")
    made["data"] = np.where(made["dlc"] == 4, tension.view("S4"), b"")
    return made


def mode_events(records: npt.NDArray[np.void]) -> list[Item]:
    """The loop's events of the changes of mode."""
    found: list[Item] = []
    for at in np.flatnonzero(np.diff(records["mode"].astype(int))).tolist():
        before, after = Mode(int(records["mode"][at])), Mode(int(records["mode"][at + 1]))
        t_ns = int(records["t_ns"][at + 1])
        details = {"severity": "info", "a": int(before), "b": int(after), "value": 0.0, "limit": 0.0}
        text = f"{before.name} -> {after.name}: made up"
        found.append(Item(t_ns, t_ns + OFFSET_NS, "mode", text, "", details, "events", len(found) + 1))
    return found


def active(**changes: Any) -> dict[str, Any]:
    """``active.json`` of the paper's rig; ``changes`` to its settings, by section."""
    settings = config.load(daemons.PAPER).model_dump(mode="json")
    settings["directory"] = "."
    design = {"gains": GAINS, "margins": [], "verdict": "made up", "warnings": []}
    return {"settings": {**settings, **changes}, "design": design, "version": "0"}


def write(
    file: pathlib.Path,
    records: npt.NDArray[np.void],
    said: Iterable[Item] | None = None,
    *,
    document: dict[str, Any] | None = None,
    with_frames: bool = False,
    attached: Iterable[tuple[str, Any, int]] = (),
) -> pathlib.Path:
    """One complete part of a recording; ``attached``: further documents by name, each with the time it takes effect."""
    disk = Appender(file)
    words = {"rig": "synthetic", "run": str(OFFSET_NS), "part": 1, "version": "0", "host": "nowhere", "kernel": "0"}
    part = PartFile(disk, OFFSET_NS, START_NS, {**words, "rate_hz": RATE_HZ})
    part.attach("active.json", msgspec.json.encode(document if document is not None else active()), START_NS, 0)
    for name, content, t_ns in attached:
        part.attach(name, msgspec.json.encode(content), t_ns, 0)
    waiting = mode_events(records) if said is None else list(said)
    sent = 1
    for at in range(0, max(len(records), 1), _BATCH):
        batch = records[at : at + _BATCH]
        shown = frames(batch, sent) if with_frames else np.empty(0, FRAME.dtype)
        sent += len(shown)
        slots = {"records": batch, "frames": shown, "commands": np.empty(0, COMMAND.dtype)}
        part.write({**slots, "holds": np.empty(0, HOLD.dtype)}, waiting, [])
        waiting = []
    part.finish()
    assert disk.join(patience_s()), disk.error
    return file
