"""Alarms after ISA-18.2: one row for each cause, folded from the events and the state. Pure: time is passed in.

A row comes with the first event of its cause. It goes once the cause is gone and the row is acknowledged; a reset
acknowledges the fault it resets. Words and remedies are those of `rigctl.model.faults`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from rigctl.model.event_row import OfFault, OwnAlarm, Priority
from rigctl.model.events import EACH_SECOND, Kind
from rigctl.model.faults import Fault, Trait, lasting
from rigctl.model.quantity import Number
from rigctl.model.reactions import Action
from rigctl.model.signals import NEVER_AGE_NS, WATCHED
from rigctl.wire.trust import explained

ROWS = 256
"""Rows kept; anyone on the network may invent causes, and the oldest row makes room."""
CHATTERING_TIMES = 3
CHATTERING_NS = 60_000_000_000
"""An alarm that came ``CHATTERING_TIMES`` within this time chatters (ISA-18.2)."""
LONGEST_SHELF_S = 8 * 3600
LASTS_NS = 2_500_000_000
"""Of an event that the loop repeats each second while its cause is there: without another one it is over."""
LOOP_SILENT = "LOOP_SILENT"
NOT_WATCHED = "not watched"
ENDPOINT_TAKEN = "ENDPOINT_TAKEN"
_ENDPOINT_REMEDY = "End the program at that port; ss -ltnp names it. The sockets of this computer work meanwhile."
_PROCESS_REMEDIES = {
    "recorder": "The daemon's log has why it ended; look at disk and memory. The rings' history is made up for.",
    "gateway": "The daemon's log has why it ended. The loop ran on; HOLD of this computer needs no gateway.",
}
"""Processes whose end is an alarm of its own, ``NAME_ENDED``."""
_OF_GATEWAY = frozenset({ENDPOINT_TAKEN, "RECORDER_ENDED", "GATEWAY_ENDED"})
"""Causes that a restart of the loop does not end."""
AUDIT_LOG_CHANGED = "AUDIT_LOG_CHANGED"
_LOG_REMEDY = "Keep what is left of the file; rigctl audit verify shows where its chain breaks. Find who did it."


class AlarmAct(Enum):
    """Decisions about an alarm; the value is the key's ending."""

    ACKNOWLEDGE = "alarm_acknowledge"
    SHELVE = "alarm_shelve"
    UNSHELVE = "alarm_unshelve"


ALARM_ACTS = {act.value: act for act in AlarmAct}


@dataclass(frozen=True)
class Shelf:
    """An alarm put aside, by whom, why and until when (wall clock)."""

    operator: str
    reason: str
    until_ns: int


@dataclass(frozen=True)
class Alarm:
    """One row. Times are wall clock in ns since 1970; ``value`` and ``limit`` have their unit, "" without a number."""

    cause: str
    priority: Priority
    text: str
    remedy: str
    first_ns: int
    last_ns: int
    count: int = 1
    value: str = ""
    limit: str = ""
    stands: bool = True
    """Active; else cleared, or not ``watched``."""
    watched: bool = True
    """False: it was active when it was last looked at, and the present mode does not look, or has no value."""
    logged: bool = False
    """Of a limit that is only logged; the state does not name such causes."""
    latched: bool = False
    """Cleared, and its fault is still latched until a reset."""
    acknowledged: str = ""
    """Who has acknowledged it; "" for nobody."""
    shelf: Shelf | None = None
    onsets_ns: tuple[int, ...] = ()

    def shelved(self, now_ns: int) -> bool:
        """Whether it is put aside at ``now_ns``."""
        return self.shelf is not None and now_ns < self.shelf.until_ns

    def chatters(self, now_ns: int) -> bool:
        """Whether it came and went too often within the last minute."""
        return len(self.onsets_ns) >= CHATTERING_TIMES and now_ns - self.onsets_ns[0] <= CHATTERING_NS

    @property
    def is_open(self) -> bool:
        """Whether somebody has to look at it still."""
        return self.stands or self.latched or not self.acknowledged

    @property
    def condition(self) -> str:
        """In a word: active, latched, cleared or not watched."""
        if self.stands or self.latched:
            return "active" if self.stands else "latched"
        return "cleared" if self.watched else NOT_WATCHED


_NUMBER = r"\{%s:([^}]*)\}(?:(\{unit\})| (N|mm/s|mm|ms|ticks|times|s)\b)?"
_STEPS = re.compile(r"[:;,] (?:start the daemon anew|find who commands the drive).*", re.DOTALL)
_SHELVED = re.compile(r"(\d{1,6}) s: (.*)", re.DOTALL)


def fault_of(number: Any) -> Fault:
    """The fault of that number; NONE for an unknown one."""
    try:
        return Fault(number)
    except ValueError:
        return Fault.NONE


def figure(fault: Fault, name: str, number: Any, about: str = "") -> str:
    """``value`` or ``limit`` (``name``) of a fault with its unit, as the fault's words have it; "" if they do not."""
    found = re.search(_NUMBER % name, fault.words)
    if found is None or not isinstance(number, int | float) or not math.isfinite(number):
        return ""
    if Trait.AGE in fault.traits and number > NEVER_AGE_NS:
        return ""  # there has been no sample yet
    signal = about.partition(" ")[0]
    watched = WATCHED[signal].unit if found[2] and signal in WATCHED else ""
    unit = f"{watched}{'/s' if watched and 'per second' in about else ''}" if found[2] else found[3] or ""
    scale = 1e-6 if Trait.AGE in fault.traits else 1.0
    return f"{format(Number(number * scale), found[1])} {unit}".rstrip()


def cause_of(event: dict[str, Any]) -> str:
    """The cause that an event is about: its row; "" for an event that is no alarm's."""
    kind = _kind_of(event)
    if kind is None or kind.alarm is None:
        return ""
    if isinstance(kind.alarm, OfFault):
        fault = fault_of(event.get("a"))
        if fault is Fault.NONE:
            return ""
        return (
            f"{fault.name} {event.get('about')}"
            if Trait.OF_RIG_FILE in fault.traits and event.get("about")
            else fault.name
        )
    return f"{kind.name} node {event.get('a')}" if kind is Kind.EMERGENCY else kind.name


def _kind_of(event: dict[str, Any]) -> Kind | None:
    """The kind of an event of the loop; None for another one."""
    return Kind.__members__.get(str(event.get("kind")))


def _lasts(row: Alarm, at_ns: int) -> bool:
    """Whether a failure that the loop reports each second is there at ``at_ns``."""
    return row.cause in EACH_SECOND and at_ns - row.last_ns <= LASTS_NS


def _is_nan(value: Any) -> bool:
    """NaN, which is null in JSON."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def _alarm_of(event: dict[str, Any], cause: str) -> Alarm:
    """The row as an event alone makes it."""
    kind, text, at = _kind_of(event), str(event.get("text", "")), int(event["wall_ns"])
    if kind is not None and isinstance(kind.alarm, OwnAlarm):
        stands = kind.alarm.lasts and event.get("severity") != "info"
        remedy = kind.alarm.remedy_of.remedy
        return Alarm(cause, kind.alarm.priority, text, remedy, at, at, stands=stands, onsets_ns=(at,))
    fault, about = fault_of(event.get("a")), str(event.get("about", ""))
    for prefix in (f"trip {fault.name}: ", f"{fault.name} is active: ", "limit: "):
        text = lasting(text.removeprefix(prefix))
    action = event.get("b")
    priority = Priority.LOW if kind is Kind.LIMIT else Priority.HIGH
    if kind is Kind.ESCALATION or (isinstance(action, int) and action >= Action.QUICK_STOP):
        priority = Priority.URGENT
    value, limit = ("" if kind is Kind.ESCALATION else figure(fault, name, event.get(name), about)
                    for name in ("value", "limit"))  # fmt: skip
    return Alarm(
        cause,
        priority,
        text,
        fault.remedy,
        at,
        at,
        value=value,
        limit=limit,
        logged=kind is Kind.LIMIT,
        onsets_ns=(at,),
    )


class Alarms:
    """The rows, kept up to date with events; the order of the calls is the order of the events."""

    def __init__(self, events: Iterable[dict[str, Any]] = ()) -> None:
        self._rows: dict[str, Alarm] = {}
        self._latched = ""
        for event in events:
            self.note(event)

    def clear(self) -> None:
        """Forget all of them, before the events are replayed."""
        self._rows.clear()
        self._latched = ""

    def note(self, event: dict[str, Any]) -> None:
        """Take one event."""
        kind = _kind_of(event)
        if event.get("source") == "gateway":
            self._decided(event)
        elif kind is Kind.STARTED:
            self._latched = ""
            for cause in self._rows.keys() - _OF_GATEWAY:
                self._change(cause, stands=False, watched=True)
        elif kind is not None and (cause := cause_of(event)):
            alarm = kind.alarm
            lasts = isinstance(alarm, OwnAlarm) and alarm.lasts
            if alarm is OfFault.ENDS or (lasts and event.get("severity") == "info"):
                self._change(cause, stands=False, watched=lasts or not _is_nan(event.get("value")))
            elif alarm is OfFault.RESET:
                self._latched = ""
                for row in [row for row in self._rows if row.partition(" ")[0] == cause.partition(" ")[0]]:
                    self._change(row, acknowledged="reset", stands=False, watched=True)  # what stands still trips anew
            else:
                self._came(_alarm_of(event, cause))
                self._latched = cause if kind is Kind.TRIP else self._latched

    def _came(self, new: Alarm) -> None:
        old = self._rows.pop(new.cause, None)  # the newest row stands last, so that the oldest makes room
        if old is not None:
            # While it stands, a cause that trips as well is no second time.
            again = not (old.stands and new.stands) and not _lasts(old, new.last_ns)
            least = old.priority if old.is_open or new.cause == self._latched else Priority.LOW
            new = replace(
                new, priority=min(least, new.priority), first_ns=old.first_ns, count=old.count + again,
                shelf=old.shelf, onsets_ns=(*old.onsets_ns, *([new.last_ns] if again else []))[-CHATTERING_TIMES:],
                acknowledged="" if again else old.acknowledged,
            )  # fmt: skip
        self._rows[new.cause] = new
        if len(self._rows) > ROWS:
            del self._rows[next(iter(self._rows))]

    def _change(self, cause: str, **fields: Any) -> None:
        if cause in self._rows:
            self._rows[cause] = replace(self._rows[cause], **fields)

    def _decided(self, note: dict[str, Any]) -> None:
        """A note of the gateway: what an operator decided, and its own cause."""
        operator, cause = str(note.get("operator", "")), str(note.get("other", ""))
        match note.get("kind"):
            case "ALARM_ACKNOWLEDGED":
                self._change(cause, acknowledged=operator)
            case "ALARM_SHELVED" if found := _SHELVED.fullmatch(str(note.get("reason", ""))):
                until_ns = int(note["wall_ns"]) + min(int(found[1]), LONGEST_SHELF_S) * 1_000_000_000
                self._change(cause, shelf=Shelf(operator, found[2], until_ns))
            case "ALARM_UNSHELVED":
                self._change(cause, shelf=None)
            case "ENDPOINT_TAKEN":
                text, at = str(note.get("text", "")), int(note["wall_ns"])
                self._came(Alarm(ENDPOINT_TAKEN, Priority.LOW, text, _ENDPOINT_REMEDY, at, at, onsets_ns=(at,)))
            case "PROCESS_LOST" if remedy := _PROCESS_REMEDIES.get(cause):
                text, at = str(note.get("text", "")), int(note["wall_ns"])
                self._came(Alarm(_ended(cause), Priority.LOW, text, remedy, at, at, onsets_ns=(at,)))
            case "PROCESS_BACK":
                self._change(_ended(cause), stands=False)
            case "AUDIT_LOG_CHANGED":
                text, at = str(note.get("text", "")), int(note["wall_ns"])
                self._came(
                    Alarm(AUDIT_LOG_CHANGED, Priority.LOW, text, _LOG_REMEDY, at, at, stands=False, onsets_ns=(at,))
                )
            case "ENDPOINT_BACK":
                self._change(ENDPOINT_TAKEN, stands=False)

    def rows(self, state: dict[str, Any] | None, now_ns: int) -> list[Alarm]:
        """Open rows at ``now_ns``; the newest state says which causes are active.

        They are sorted by priority, then by the time when they came first; what is put aside is last. Those that follow
        from the culprit of the state are together at the strongest priority among them, the latched fault first.
        """
        alive = state is not None and state.get("loop_alive")
        at_ns = int((state or {}).get("wall_ns") or 0) if alive else 0  # by the clock of the events
        looked = {cause: replace(row, stands=True) if _lasts(row, at_ns or now_ns) else row
                  for cause, row in self._rows.items()}  # fmt: skip
        rows = {cause: row for cause, row in looked.items() if row.is_open}
        if state is not None:
            rows = _as_the_state_says(rows, looked, state)
        latched = str((state or {}).get("fault") or "")
        found = [row for row in rows.values() if row.is_open]
        folded = [row.priority for row in found if follows(row, state) and not row.shelved(now_ns)]

        def order(row: Alarm) -> tuple[bool, int, bool, bool, int, int]:
            follow = follows(row, state) and not row.shelved(now_ns)
            is_first = follow and row.cause.partition(" ")[0] == latched
            return (row.shelved(now_ns), min(folded) if follow else row.priority, not follow, not is_first,
                    row.priority, row.first_ns)  # fmt: skip

        return sorted(found, key=order)


def follows(row: Alarm, state: dict[str, Any] | None) -> bool:
    """Whether an alarm is a consequence of the culprit that the state names."""
    found = (state or {}).get("culprit")
    if state is None or not isinstance(found, dict):
        return False
    return row.cause.partition(" ")[0] in found.get("follows", ()) or is_explained(row, state)


def is_explained(row: Alarm, state: dict[str, Any] | None) -> bool:
    """Whether the culprit that the state names brings an alarm about by its nature."""
    return state is not None and not explained(state).isdisjoint((row.cause, row.cause.partition(" ")[0]))


def without_steps(text: str) -> str:
    """The words of a cause without what to do about it."""
    return _STEPS.sub("", text)


def _ended(process: str) -> str:
    """The cause that the end of a process is."""
    return f"{process.upper()}_ENDED"


def _as_the_state_says(rows: dict[str, Alarm], known: dict[str, Alarm], state: dict[str, Any]) -> dict[str, Alarm]:
    """Rows with the causes that a state names, whose event may be missing; trips that it does not name are cleared.

    The row of the latched fault stays until the reset. A reaction stronger than those before raises the priority of an
    active cause; a weaker one does not lower it.
    """
    causes, wall_ns = state.get("causes"), int(state.get("wall_ns") or 0)
    if state.get("mode") is None or not state.get("loop_alive"):
        since = "" if state.get("age_ms") is None else f" for {state['age_ms'] / 1000:.1f} s"
        waits_for = state.get("waits_for")
        if waits_for and state.get("mode") is None:  # a start, which says itself what it waits for
            return rows
        remedy = (
            f"A new loop starts, and waits for: {waits_for}."
            if waits_for
            else "Run rigctl doctor; look at the daemon's log, and start it anew."
        )
        loop = Alarm(LOOP_SILENT, Priority.URGENT, f"no record from the loop{since}", remedy, wall_ns, wall_ns)
        return rows | {LOOP_SILENT: loop}
    if not isinstance(causes, list):
        return rows
    named = {str(cause.get("fault")): cause for cause in reversed(causes) if isinstance(cause, dict)}  # the strongest
    latched, why = str(state.get("fault")), str(state.get("fault_text", ""))
    result = {}
    for name, row in known.items():
        tripped, _, about = name.partition(" ")
        is_latched = tripped == latched and why.startswith(about)
        if name not in rows and not is_latched:
            continue
        if tripped in Fault.__members__ and row.priority < Priority.LOW and not row.logged:
            active = tripped in named
            result[name] = replace(
                row,
                stands=active,
                latched=is_latched and not active,
                watched=active or not row.stands,
            )
            if active and named[tripped].get("action"):
                result[name] = replace(result[name], priority=min(row.priority, _priority_of(named[tripped])))
        elif name in rows:
            result[name] = row
    for name, cause in named.items():
        if any(row.partition(" ")[0] == name for row in result):
            continue
        fault = Fault.__members__.get(name, Fault.NONE)
        at = cause.get("since_wall_ns") or wall_ns
        old = next((row for key, row in known.items() if key.partition(" ")[0] == name), None)
        value, limit = (figure(fault, key, cause.get(key)) for key in ("value", "limit"))
        result[name] = replace(old, stands=True, priority=min(old.priority, _priority_of(cause))) if old else Alarm(
            name, _priority_of(cause), str(cause.get("text", "")), fault.remedy, at, at,
            value=value, limit=limit, onsets_ns=(at,),
        )  # fmt: skip
    return result


def _priority_of(cause: dict[str, Any]) -> Priority:
    """Of a cause of the state, by its reaction."""
    return Priority.URGENT if cause.get("action") in ("QUICK_STOP", "POWER_OFF", "SILENCE") else Priority.HIGH


def as_message(row: Alarm, now_ns: int, state: dict[str, Any] | None = None) -> dict[str, Any]:
    """A row for JSON: the page, ``rigctl alarms --json``; ``follows`` from the culprit of ``state``.

    What the culprit explains has the culprit's first step as its remedy.
    """
    shelf = row.shelf if row.shelved(now_ns) else None
    own = not is_explained(row, state)
    text, remedy = (row.text, row.remedy) if own else (without_steps(row.text), (state or {})["culprit"]["first"])
    return {
        "cause": row.cause, "priority": row.priority.name.lower(), "text": text, "remedy": remedy,
        "count": row.count, "first_ns": row.first_ns, "last_ns": row.last_ns, "value": row.value, "limit": row.limit,
        "stands": row.stands, "latched": row.latched, "watched": row.watched, "follows": follows(row, state),
        "acknowledged": row.acknowledged or None,
        "chatters": row.chatters(now_ns),
        "shelved": None if shelf is None
        else {"operator": shelf.operator, "reason": shelf.reason, "until_ns": shelf.until_ns},
    }  # fmt: skip
