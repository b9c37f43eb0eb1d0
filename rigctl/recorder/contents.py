"""Contents of a recording in figures, for ``rigctl info``."""

from __future__ import annotations

import contextlib
import pathlib
from collections import Counter
from typing import Any

import numpy as np
from pydantic import ValidationError

from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.recorder import audit_log, part_seal
from rigctl.recorder.enums import name_of
from rigctl.recorder.file_reader import RECORDER
from rigctl.recorder.mcap_file import SEAL
from rigctl.recorder.part_seal import PartStanding
from rigctl.recorder.recording import Recording

_NOT_METADATA = ("versions", SEAL)


def moment(recording: Recording, t_ns: int) -> str:
    """A time of the recording on the wall clock, UTC."""
    try:
        return audit_log.moment(t_ns + recording.wall_offset_ns)
    except (ValueError, OverflowError, OSError):
        return "not a time"


def modes(recording: Recording) -> list[dict[str, Any]]:
    """Modes in order of time: name, start (seconds after the first record), duration, and the latched fault."""
    records = recording.records
    if not len(records):
        return []
    starts = np.union1d([0], np.flatnonzero(np.diff(records["mode"].astype(int))) + 1)
    times = (records["t_ns"] - recording.start_ns) * 1e-9
    ends = [*starts[1:].tolist(), len(records) - 1]
    found = []
    for start, end in zip(starts.tolist(), ends, strict=True):
        fault = int(records["fault"][min(start + 1, len(records) - 1)])
        found.append(
            {
                "mode": name_of(Mode, int(records["mode"][start])),
                "t_s": round(float(times[start]), 3),
                "for_s": round(float(times[end] - times[start]), 3),
                "fault": name_of(Fault, fault) if fault else None,
            }
        )
    return found


def figures(recording: Recording) -> dict[str, Any]:
    """Everything ``rigctl info --json`` prints."""
    own = recording.metadata.get("rigctl", {})
    records, sealed = recording.records, seals(recording)
    seconds = (recording.end_ns - recording.start_ns) * 1e-9
    rate_hz = float(1e9 / np.median(np.diff(records["t_ns"]))) if len(records) > 1 else None
    return {
        "rig": recording.rig,
        "run": recording.run,
        "kind": "trip dump" if "fault" in own else "recording",
        "complete": recording.complete,
        "sha256": recording.sha256,
        "files": [
            {"file": str(file.path), "bytes": file.size, "sha256": file.sha256, "complete": file.complete,
             "note": file.note, "seal": sealed[file.path].value}
            for file in recording.files
        ],
        "start": moment(recording, recording.start_ns) if len(records) else None,
        "end": moment(recording, recording.end_ns) if len(records) else None,
        "duration_s": round(seconds, 3),
        "rate_hz": None if rate_hz is None else round(rate_hz, 3),
        "records": len(records),
        "frames": len(recording.frames),
        "commands": len(recording.commands),
        "holds": len(recording.holds),
        "said": {topic: len(items) for topic, items in sorted(recording.said.items()) if topic != RECORDER},
        "events": dict(Counter(event.what for event in recording.events)),
        "modes": modes(recording),
        "control_starts_s": [round((t_ns - recording.start_ns) * 1e-9, 3) for t_ns in recording.control_starts],
        "gaps": [
            {"ring": gap.ring, "after": gap.after, "upto": gap.upto, "count": gap.count,
             "t_s": round((gap.t_ns - recording.start_ns) * 1e-9, 3)}
            for gap in recording.gaps
        ],
        "attachments": [
            {"name": item.name, "t_s": round((item.t_ns - recording.start_ns) * 1e-9, 3), "bytes": len(item.data)}
            for item in recording.generations
        ],
        "metadata": {name: words for name, words in recording.metadata.items() if name not in _NOT_METADATA},
        "versions": recording.metadata.get("versions", {}),
    }  # fmt: skip


def seals(recording: Recording) -> dict[pathlib.Path, PartStanding]:
    """What the seal of each file says. The key is where the recorded settings have the rig's ledger."""
    settings = None
    with contextlib.suppress(ValidationError):
        if found := (recording.table(ACTIVE, recording.end_ns) or {}).get("settings"):
            settings = RigSettings.model_validate(found)
    return {file.path: part_seal.standing(settings, file) for file in recording.files}


def seals_in_words(recording: Recording) -> str:
    """What the seals of a recording say, in one line."""
    found = seals(recording)
    kinds = {one: [path.name for path, standing in found.items() if standing is one] for one in PartStanding}
    if len(found) == 1 or len(kinds[PartStanding.INTACT]) == len(found):
        return max(found.values(), key=list(PartStanding).index).value
    return "; ".join(
        f"{one.value}: " + (names[0] if len(names) == 1 else f"{len(names)} parts")
        for one, names in kinds.items()
        if names
    )
