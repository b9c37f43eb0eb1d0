"""The state message: the newest record and values derived from it."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.control.power.drive_power import drive_shown
from rigctl.control.watch.safety import Row
from rigctl.diagnosis.diagnose import Culprit
from rigctl.ipc.ring import RingReader
from rigctl.metrics.tension_error import error_pct, percentiles_us
from rigctl.model.check_words import failed_checks, setting_words, stroke_words
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault, faults_of, lasting
from rigctl.model.loop_event import LoopEvent
from rigctl.model.parts import Part
from rigctl.model.reactions import Action
from rigctl.model.signals import ANGLES, NAMED, NEVER_AGE_NS, UNRECORDED
from rigctl.model.states import Flag, HeldBy, Mode
from rigctl.wire.meanings import Rows
from rigctl.wire.record_names import ALIVE_NS, named, quality_words

WINDOW_NS = 1_000_000_000
TEXT_BYTES = 80  # of a row's text in an event
RECORDER_SILENT_NS = 5_000_000_000


SILENT_LOOP: dict[str, Any] = {
    "parts": [str(Part.PROCESS)],
    "text": "The loop writes no records: its process has ended, or hangs.",
    "question": "",
    "first": "Keep out from under the load: the drive stops and closes its brake by itself. Then rigctl doctor, and "
    "the daemon's log.",
    "follows": ["LOOP_SILENT"],
}
"""The culprit while no record comes."""


class Recent:
    """Lateness and work of the ticks of the last second."""

    def __init__(self) -> None:
        self._parts: list[npt.NDArray[Any]] = []

    def add(self, records: npt.NDArray[Any]) -> None:
        """Take new records; forget those older than a second."""
        if not len(records):
            return
        self._parts.append(records[["t_ns", "lateness_ns", "work_ns"]].copy())
        oldest = int(records["t_ns"][-1]) - WINDOW_NS
        while int(self._parts[0]["t_ns"][-1]) < oldest:
            del self._parts[0]

    def figures(self) -> dict[str, Any]:
        """``lateness_us`` and ``work_us``, percentiles over what is held."""
        names = (("lateness_us", "lateness_ns"), ("work_us", "work_ns"))
        if not self._parts:
            return {name: None for name, _ in names}
        return {name: percentiles_us(np.concatenate([part[field] for part in self._parts])) for name, field in names}


class TripEvents:
    """Value and limit of the latched trip, from the events.

    The newest trip of each fault is kept, so that a stronger fault does not replace the one that is latched.
    """

    def __init__(self) -> None:
        self._trips: dict[int, tuple[float, float, str]] = {}

    def note(self, events: npt.NDArray[Any]) -> None:
        """Take the trips among new events."""
        for event in LoopEvent.of_slots(events[events["kind"] == Kind.TRIP]):
            found = event.fields
            self._trips[int(found["fault"])] = found["value"], found["limit"], found["seen"]

    def text(self, fault: int) -> str:
        """The latched fault in words."""
        try:
            known = Fault(fault)
        except ValueError:
            return f"unknown fault {fault}"
        if known is Fault.NONE:
            return ""
        if fault not in self._trips:  # the ring no longer holds its event
            return known.name.lower().replace("_", " ")
        return lasting(fault_text(known, *self._trips[fault]))


@dataclass(frozen=True)
class Cause:
    """A standing cause with time, value and text of its event."""

    t_ns: int
    value: float
    text: str


class Causes:
    """Causes of a fault that stand: the newest record says which, the events since when and with which value."""

    def __init__(self, rows: Sequence[Row]) -> None:
        """``rows``: of the safety table, built-in ones first."""
        self._rows = [row for row in rows if row.action is not Action.LOG]
        self._worded = {row.fault for row in rows if row.words is not None}  # their text differs from event to event
        self._since: dict[tuple[int, int, float, str], Cause] = {}

    def note(self, events: npt.NDArray[Any]) -> None:
        """Take new events."""
        for event in LoopEvent.of_slots(events[np.isin(events["kind"], _OF_CAUSES)]):
            if event.kind is Kind.STARTED:
                self._since.clear()
                continue
            fault, action, value, limit, seen = (event.fields[name] for name in _OF_CAUSE)
            key = int(fault), int(action), float(limit), "" if fault in self._worded else seen
            if event.kind is Kind.CAUSE_OVER:
                self._since.pop(key, None)
            else:
                self._since.setdefault(key, Cause(event.t_ns, float(value), seen))

    def of(self, record: np.void, wall_ns: int) -> list[dict[str, Any]]:
        """Causes that stand at a record, the strongest first, then in the table's order.

        ``wall_ns``: wall clock less CLOCK_MONOTONIC. A cause whose event was missed appears without figures.
        """
        standing, mode, t_ns = faults_of(int(record["cause_bits"])), int(record["mode"]), int(record["t_ns"])
        known = {key: cause for key, cause in self._since.items() if key[0] in standing or cause.t_ns > t_ns}
        self._since = known
        found: list[tuple[Row, Cause | None]] = []
        for fault in standing:
            rows = [row for row in self._rows if row.fault is fault]
            timed = [(row, cause) for row in rows if (cause := known.get(_key(row))) and mode in row.modes]
            found += timed or [(row, None) for row in rows[:1]]
        found.sort(key=lambda item: (-item[0].action, self._rows.index(item[0])))
        return [_cause(row, cause, wall_ns) for row, cause in found]


_OF_CAUSE = "fault", "action", "value", "limit", "seen"
_OF_CAUSES = (Kind.STARTED, Kind.TRIP, Kind.CAUSE, Kind.CAUSE_OVER)


def _key(row: Row) -> tuple[int, int, float, str]:
    text = row.text.encode()[:TEXT_BYTES].decode(errors="replace")
    return int(row.fault), int(row.action), row.sign * float(row.limit), text


def _cause(row: Row, cause: Cause | None, wall_ns: int) -> dict[str, Any]:
    limit = row.sign * float(row.limit)
    plain = row.fault.name.lower().replace("_", " ")
    return {
        "fault": row.fault.name,
        "text": plain if cause is None else lasting(fault_text(row.fault, cause.value, limit, cause.text)),
        "action": row.action.name,
        "value": None if cause is None else cause.value,
        "limit": limit,
        "since_ns": None if cause is None else cause.t_ns,
        "since_wall_ns": None if cause is None else cause.t_ns + wall_ns,
        "blocks_reset": row.blocks_reset,
    }


class CheckDetails:
    """Details of failing checks, from the loop's events on device settings and stroke; records have no texts."""

    def __init__(self, events: RingReader) -> None:
        self._events, self._lock = events, threading.Lock()
        self._words: dict[Check, str] = {}
        self._read_back: dict[str, Any] | None = None

    def read(self) -> Mapping[Check, str]:
        """The details by check; they apply only while the check fails."""
        with self._lock:
            for event in LoopEvent.of_slots(self._events.read()):
                self._note(event)
            return dict(self._words)

    @property
    def read_back(self) -> dict[str, Any] | None:
        """Time, count and duration of the last complete read-back without a difference; None before the first."""
        return self._read_back

    def _note(self, event: LoopEvent) -> None:
        found = event.fields
        if event.kind is Kind.STARTED:  # what is known belongs to the loop before
            self._words, self._read_back = {}, None
        elif event.kind is Kind.SETTING_LOST:
            self._words[Check.DRIVE_SUPERVISION] = setting_words(found["setting"])
        elif event.kind is Kind.STROKE and not found["believed"]:
            self._words[Check.STROKE_UNCONFIRMED] = stroke_words(found["stroke_mm"], found["why"])
        elif event.kind is Kind.READ_BACK:
            self._read_back = {"t_ns": event.t_ns, "settings": found["settings"], "took_s": float(found["took_s"])}


def state_of(record: np.void | None, trip: TripEvents, recent: Recent, now_ns: int, wall_ns: int) -> dict[str, Any]:
    """The state from the newest record; ``now_ns`` and ``wall_ns`` are the same instant on the two clocks."""
    if record is None:
        return {"loop_alive": False, "age_ms": None, "wall_ns": wall_ns, "mode": None}
    values: dict[str, Any] = {name: record[name].item() for name in record.dtype.names or ()}
    age_ns = now_ns - values["t_ns"]
    never = {name: None for name in values if name.endswith("_age_ns") and values[name] > NEVER_AGE_NS}
    compensating = values["mode"] == Mode.COMPENSATING and values["target_n"] > 0
    error_n = values["vertical_n"] - values["target_n"] if compensating else None
    return {
        **values,
        **never,
        "wall_ns": wall_ns - age_ns,
        "age_ms": max(0.0, round(age_ns / 1e6, 3)),
        "loop_alive": age_ns < ALIVE_NS,
        "mode": named(Mode, values["mode"]),
        "mode_code": values["mode"],
        **dict(_names(values)),
        **_drive_of(values),
        "fault_text": trip.text(values["fault"]),
        "flag_names": [f.name.lower() for f in Flag if values["flags"] & f and f.name],
        "error_n": error_n,
        "error_pct": None if error_n is None else abs(error_pct(values["vertical_n"], values["target_n"])),
        **{row.degrees: math.degrees(values[row.name]) for row in ANGLES},
        "quality": {name: quality_words(values[f"{name}_quality"]) for name in ("tension", "inclination", "drive")},
        **recent.figures(),
    }


def _names(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The names of an enumeration's numbers in their place, and the numbers under names of their own."""
    for name, enum in NAMED.items():
        number = values[name]
        yield name, None if enum.none and not number else named(enum.kind, number)
        yield f"{name}_code", number


def _drive_of(values: Mapping[str, Any]) -> dict[str, str | None]:
    """``drive_state`` and ``drive_power``, which are not assumed where the drive is not heard."""
    if values["drive_quality"]:
        return {"drive_state": None, "drive_power": None}
    off, taking = bool(values["flags"] & Flag.DRIVE_OFF), values["held_by"] == HeldBy.TAKING
    state, power = drive_shown(values["statusword"], off=off, taking=taking)
    return {"drive_state": state.name, "drive_power": power.name}


def culprit_of(
    found: Culprit | None, causes: Sequence[Mapping[str, Any]], state: Mapping[str, Any]
) -> dict[str, Any] | None:
    """The part that a latched fault is about, or the loop's own silence; None where nothing is to be named.

    ``causes``: those that stand; they follow from the culprit too.
    """
    if not state.get("loop_alive"):
        return None if state.get("mode") is None else SILENT_LOOP
    if found is None or not found.parts:
        return None
    message = found.as_message()
    message["follows"] = list(dict.fromkeys([*message["follows"], *(str(cause["fault"]) for cause in causes)]))
    return message


def warnings_of(file: dict[str, Any]) -> list[str]:
    """Warnings in another process's file, whose content may be anything."""
    found = file.get("warnings")
    return [str(item) for item in found] if isinstance(found, Sequence) and not isinstance(found, str) else []


def design_of(active: dict[str, Any]) -> tuple[str | None, list[str]]:
    """Verdict on the design in use, None without one, and its warnings, which include the words of a waiver."""
    design = active.get("design")
    if not isinstance(design, dict):
        return None, []
    verdict = design.get("verdict")
    return (verdict if isinstance(verdict, str) else None), warnings_of(design)


def recorder_of(status: dict[str, Any], now_ns: int) -> tuple[dict[str, Any], list[str]]:
    """The recorder's figures and its warnings, with one more if its file is older than ``RECORDER_SILENT_NS``."""
    if not status:  # the recorder has not written its file yet
        return {"audit": None, "trip_dump": None, "recording": None}, []
    audit = {name: status.get(name) for name in ("entries", "head", "failures")}
    t_ns, warnings = status.get("t_ns"), warnings_of(status)
    if not isinstance(t_ns, int) or now_ns - t_ns > RECORDER_SILENT_NS:
        warnings.append("recorder: it does not run; nothing is put on record at the moment")
    return {"audit": audit, **{name: status.get(name) for name in ("trip_dump", "recording")}}, warnings


def preflight_of(
    record: np.void | None, failing: Mapping[Check, str], waived: Mapping[Check, str]
) -> dict[str, dict[str, str]] | None:
    """Checks that fail in the newest record, and those that a waiver lets pass, in words; None without a record.

    ``failing``: details of failing checks.
    """
    if record is None:
        return None
    bits = int(record["checks"])
    return {
        "failing": {check.name: failed_checks(check, failing)[0] for check in Check if bits & check and check.name},
        "waived": {check.name: words for check, words in waived.items() if check.name},
    }


_NAMED_ROWS: Rows = tuple(
    row
    for name, enum in NAMED.items()
    for row in (
        (name, "string?" if enum.none else "string", "", enum.named),
        (f"{name}_code", "integer", "", "its number, as in the record" + ("; 0 none" if enum.none else "")),
    )
)
DERIVED: Rows = (
    ("rig", "string", "", "name of the rig"),
    ("wall_ns", "integer", "ns", "t_ns on the wall clock, since 1970 UTC"),
    ("age_ms", "number?", "ms", "age of this record when the message was made, 0 at least; null without a record"),
    ("loop_alive", "boolean", "", f"the record is younger than {ALIVE_NS // 1_000_000} ms"),
    (
        "waits_for",
        "string?",
        "",
        "while no record comes: what the start of the daemon, or of a new loop, waits for, in words; else null",
    ),
    ("mode", "string?", "", "mode's name; null without a record, whose fields are then not there"),
    ("mode_code", "integer", "", "its number, as in the record"),
    *_NAMED_ROWS,
    ("drive_state", "string?", "", "CiA 402 state that the statusword reports; null where the drive is not heard"),
    (
        "drive_power",
        "string?",
        "",
        "OFF: the drive has reported a state without power (SWITCH_ON_DISABLED, READY_TO_SWITCH_ON, FAULT) for its "
        "brake's time; else STOPPING or NOT_OFF; null where the drive is not heard",
    ),
    ("fault_text", "string", "", "why it tripped, in words; empty without a fault"),
    (
        "causes",
        "array",
        "",
        "causes of a fault that stand now, the strongest first: fault, text, action, value and limit in the fault's "
        "unit, since_ns (as t_ns), since_wall_ns, blocks_reset; value and since are null where that is not known",
    ),
    (
        "culprit",
        "object?",
        "",
        "of a latched fault or a silent loop: parts (one or two, in words), text, question (that decides between two, "
        "else empty), first (the safe first step), follows (names of the causes that follow); null where nothing is "
        "named",
    ),
    ("flag_names", "array", "", "flags in words"),
    *((row.name, "number?", row.unit, row.meaning) for row in UNRECORDED),
    *((row.degrees, "number?", row.field_unit, f"{row.name} for people") for row in ANGLES),
    ("quality", "object", "", "tension, inclination, drive: good, or what is wrong"),
    ("lateness_us", "object?", "us", "p50, p99, p999 and max over the last second"),
    ("work_us", "object?", "us", "p50, p99, p999 and max over the last second"),
    ("samples_lost", "integer", "", "records overwritten before a gateway could publish them, so far"),
    ("design", "string?", "", "how robust the law in use is, and where its gains come from; null before there is one"),
    (
        "calibration",
        "object",
        "",
        "of the tension cell: zero_n, scale, due (null without a valid check), overdue, tared, waiver",
    ),
    ("lease", "object?", "", "holder, since_ns, until_ns (as t_ns), held_s, left_s; null while nobody holds it"),
    (
        "offers",
        "object?",
        "",
        "what each command would be answered: refused (by verb why, empty where it is accepted), bounds of its value, "
        "age_ms; null before the loop runs",
    ),
    (
        "preflight",
        "object?",
        "",
        "failing: checks that arming would fail now, in words; waived: those that may, and why",
    ),
    (
        "read_back",
        "object?",
        "",
        "t_ns, settings, took_s: when the devices' settings were last all as start-up wrote them; null before",
    ),
    ("audit", "object?", "", "audit log: entries, head (hash of the last), failures; null before the recorder runs"),
    ("trip_dump", "string?", "", "file about the newest trip since the daemon's start, null for none"),
    ("recording", "object?", "", "folder, file, bytes, records and frames, those lost, failures; null without one"),
    ("warnings", "array", "", "what the operator should know: real-time settings refused, a design waived and why"),
    ("gateway_wall_ns", "integer", "ns", "when this gateway started; changes when it was restarted"),
    ("stream", "integer", "", "as in the header of tele/fast: changes when the daemon is started anew"),
    ("event_seq", "integer", "", "number of the loop's event published last; 0 none"),
    ("note_seq", "integer", "", "number of the gateway's note published last; 0 none"),
)
