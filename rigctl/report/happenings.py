"""Events, commands, leases, trips and operators of a recording."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.model.states import Mode
from rigctl.recorder.enums import name_of
from rigctl.recorder.recording import Recording

Array = npt.NDArray[Any]
TOPICS = ("supervision", "events", "notes", "desk")
SEVERITIES = ("info", "warning", "error")
_GRAVE = frozenset({"daemon_refused", "process_ended", "command_refused"})
_TRIPPED = re.compile(r"trip (\w+)")
_DUMP_OF_NS = 15_000_000_000  # a dump is written within this time of its trip


@dataclass(frozen=True)
class Happening:
    """One line of the table of events."""

    t_ns: int
    severity: str
    what: str
    who: str
    text: str


@dataclass(frozen=True)
class RecordedTrip:
    """A limit that tripped, or an exception: the reason, and its trip dump."""

    t_ns: int
    name: str
    reason: str
    dump: str
    """Name of the trip dump; empty if the recording does not have it."""


@dataclass(frozen=True)
class ModeSpan:
    """A stay in one mode."""

    name: str
    start_ns: int
    end_ns: int


def happenings(recording: Recording) -> list[Happening]:
    """All entries in order of time, each ring in its own order; a command is represented by its answer."""
    found = []
    for topic in TOPICS:
        for item in recording.said.get(topic, []):
            if item.what == "command_given":
                continue
            severity = item.details.get("severity")
            if severity not in SEVERITIES:
                severity = "warning" if item.what in _GRAVE else "info"
            found.append(Happening(item.t_ns, severity, item.what.replace("_", " "), item.who, item.text))
    return sorted(found, key=lambda item: item.t_ns)


def operators(recording: Recording) -> list[str]:
    """Names of the operators who gave commands or held the lease."""
    names = {item.who for topic in (*TOPICS, "audit") for item in recording.said.get(topic, [])}
    return sorted(name for name in names if name)


def trips(recording: Recording) -> list[RecordedTrip]:
    """Every trip and every exception in the loop, each with its dump."""
    dumps = [(item.t_ns, str(item.details.get("file", ""))) for item in recording.audit if item.what == "trip_dump"]
    found = []
    for item in recording.events:
        if item.what in ("trip", "exception"):
            dump = next((name for t_ns, name in dumps if item.t_ns <= t_ns <= item.t_ns + _DUMP_OF_NS), "")
            name = _TRIPPED.match(item.text)
            found.append(RecordedTrip(item.t_ns, name[1] if name else item.what, item.text, dump))
    return found


def mode_spans(records: Array) -> list[ModeSpan]:
    """Stays in a mode, in order; a restarted control process begins a new one."""
    if not len(records):
        return []
    modes, t_ns = np.asarray(records["mode"]), records["t_ns"]
    restarted = np.diff(records["tick"].astype(np.int64)) < 0
    cuts = [0, *(np.flatnonzero((np.diff(modes.astype(np.int16)) != 0) | restarted) + 1).tolist(), len(records)]
    spans = []
    for start, after in itertools.pairwise(cuts):
        mode = int(modes[start])
        spans.append(ModeSpan(name_of(Mode, mode), int(t_ns[start]), int(t_ns[min(after, len(records) - 1)])))
    return spans
