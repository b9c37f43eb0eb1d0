"""The rings that go into the audit log, each with the wording of its slots."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rigctl.ipc import supervision
from rigctl.ipc.notes import note_message
from rigctl.ipc.record import figure_of
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model import quantity
from rigctl.model.check_words import failed_checks
from rigctl.model.quantity import significant
from rigctl.model.states import Mode
from rigctl.model.verbs import VALUES, Refusal, Setting, Verb
from rigctl.recorder.audit_log import Item
from rigctl.recorder.enums import name_of
from rigctl.wire.event_message import event_message
from rigctl.wire.user_name import user_name, with_user

BATCH = 1000  # slots read from a ring at once
Words = tuple[str, str, str, dict[str, Any]]  # what, who, text, details


def _text(slot: np.void, name: str) -> str:
    return bytes(slot[name]).decode(errors="replace")


def _number(slot: np.void, name: str) -> float | None:
    value = float(slot[name])
    return value if math.isfinite(value) else None


def _event(slot: np.void) -> Words:
    severity, message = event_message(slot, 0)
    numbers = {name: _number(slot, name) for name in ("value", "limit")}
    details = {"severity": severity, "a": message["a"], "b": message["b"], **numbers, "about": message["about"]}
    return message["kind"].lower(), "", message["text"], details | message["fields"]


def _note(slot: np.void) -> Words:
    severity, message = note_message(slot, 0)
    details = {"severity": severity, "other": message["other"], "reason": message["reason"]}
    return message["kind"].lower(), message["operator"], message["text"], details


def _request(slot: np.void) -> Words:
    verb, value = _text(slot, "verb"), _number(slot, "value")
    command: dict[str, Any] = {
        "id": int(slot["id"]), "verb": verb, "value": value, "holder": _text(slot, "holder"),
    }  # fmt: skip
    who = _text(slot, "operator")
    if giver := _text(slot, "giver"):
        command["giver"] = giver
    if not slot["answered"]:
        return "command_given", who, verb + (f" {significant(value)}" if value is not None else ""), command
    accepted = bool(slot["accepted"])
    details = {**command, "accepted": accepted, "reason": _text(slot, "reason"), "ledger_entry": _text(slot, "entry")}
    return "command_accepted" if accepted else "command_refused", who, _text(slot, "text"), details


def _order(slot: np.void) -> Words:
    code = int(slot["verb"])
    name = name_of(Verb if code in Verb._value2member_map_ else Setting, code)
    values = {field: value for field in VALUES.get(code, ()) if (value := _number(slot, field)) is not None}
    text = " ".join((name, *map(significant, values.values())))
    more = values if len(values) > 1 else {}
    return "order", "", text, {"id": int(slot["id"]), "verb": code, "value": next(iter(values.values()), None), **more}


def _hold(slot: np.void) -> Words:
    uid, pid = int(slot["uid"]), int(slot["pid"])
    user = user_name(uid)
    who, text = with_user(_text(slot, "operator"), user), f"HOLD via the local socket, from process {pid} of {user}"
    return "local_hold_given", who, text, {"id": int(slot["id"]), "uid": uid, "pid": pid}


def _reply(slot: np.void) -> Words:
    accepted, reason = bool(slot["accepted"]), name_of(Refusal, int(slot["reason"]))
    mode, checks = name_of(Mode, int(slot["mode"])), failed_checks(int(slot["checks"]))
    text = f"carried out, {mode}" if accepted else f"not carried out: {reason}, {mode}"
    details = {"id": int(slot["id"]), "accepted": accepted, "reason": reason, "mode": mode, "checks": checks}
    return "reply", "", text, {**details, "value": figure_of(slot), "spread": _number(slot, "rms_n") or 0.0}


def _doing(slot: np.void) -> Words:
    process, reason = _text(slot, "other"), _text(slot, "reason")
    what, text = supervision.worded(int(slot["kind"]), process, reason)
    return what, "", text, {"process": process, "reason": reason}


@dataclass(frozen=True)
class AuditedRing:
    """A ring of the audit log."""

    name: str
    open: Callable[[Runtime], RingReader]
    words: Callable[[np.void], Words]

    def item(self, slot: np.void, wall_offset_ns: int) -> Item:
        """One slot in words; a slot that cannot be worded goes into the log as hexadecimal bytes."""
        t_ns = int(slot["t_ns"])
        try:
            what, who, text, details = self.words(slot)
        except (ValueError, KeyError, OverflowError) as error:
            raw = slot.tobytes().rstrip(b"\0").hex()
            what, who, text = "unworded", "", f"a slot of the ring {self.name}: {type(error).__name__}: {error}"
            details = {"slot": raw}
        return Item(t_ns, t_ns + wall_offset_ns, what, text, who, details, self.name, int(slot["seq"]))


SOURCES = (
    AuditedRing("supervision", lambda runtime: runtime.supervision.reader(from_start=True), _doing),
    AuditedRing("commands", lambda runtime: runtime.commands.reader(from_start=True), _order),
    AuditedRing("holds", lambda runtime: runtime.holds.reader(from_start=True), _hold),
    AuditedRing("events", lambda runtime: runtime.events.reader(from_start=True), _event),
    AuditedRing("replies", lambda runtime: runtime.replies.reader(from_start=True), _reply),
    AuditedRing("notes", lambda runtime: runtime.notes.reader(from_start=True), _note),
    AuditedRing("desk", lambda runtime: runtime.requests.reader(from_start=True), _request),
)


class AuditedRings:
    """Every source with its read position. Slots overwritten before they were read become an item too."""

    def __init__(self, runtime: Runtime, read: dict[str, int]) -> None:
        """``read``: number of the last slot of each ring that is already in the log."""
        self._readers = [(source, source.open(runtime)) for source in SOURCES]
        self._lost = dict.fromkeys((source.name for source in SOURCES), 0)
        self.go_back(read)

    @property
    def position(self) -> dict[str, int]:
        """Number of the last slot taken from each ring."""
        return {source.name: reader.cursor for source, reader in self._readers}

    def go_back(self, position: Mapping[str, int]) -> None:
        """Set the read positions back to ``position``."""
        for source, reader in self._readers:
            reader.cursor = min(position.get(source.name, 0), reader.head)

    def take(self, wall_offset_ns: int) -> list[Item]:
        """New items in order of time; each ring keeps its own order."""
        parts = [self._new(source, reader, wall_offset_ns) for source, reader in self._readers]
        return list(heapq.merge(*parts, key=lambda item: item.t_ns))

    def take_all(self, wall_offset_ns: int) -> list[Item]:
        """Every item after the read positions."""
        items = self.take(wall_offset_ns)
        while new := self.take(wall_offset_ns):
            items += new
        return items

    def _new(self, source: AuditedRing, reader: RingReader, wall_offset_ns: int) -> list[Item]:
        before = reader.cursor
        items = [source.item(slot, wall_offset_ns) for slot in reader.read(BATCH)]
        count, self._lost[source.name] = reader.lost - self._lost[source.name], reader.lost
        if not count:
            return items
        t_ns = items[0].t_ns if items else 0
        slots = quantity.count(count, "slot")
        text = f"{slots} of the ring {source.name} {'was' if count == 1 else 'were'} overwritten before being read"
        details = {
            "count": count,
            "ring": source.name,
            "after": before,
            "up_to": items[0].seq - 1 if items else reader.cursor,
        }
        return [Item(t_ns, t_ns + wall_offset_ns, "lost", text, details=details), *items]


def sourced(items: list[Item], read: dict[str, int]) -> list[dict[str, int]]:
    """For each item, the position of each ring in the log after it."""
    states, state = [], dict(read)
    for item in items:
        if item.seq:
            state = {**state, item.source: item.seq}
        states.append(state)
    return states
