"""Limits the growth of the audit log: repeats become one entry, entries beyond the rate are counted.

Accepted commands, trips, changes of mode, the supervisor's actions and kinds not named here are always written; only
repeats of HOLD and of lease commands become one entry. Repeats that go on are counted once a minute. All others are
limited to ``RATE_HZ`` entries and ``RATE_BYTES`` a second, after ``BURST`` entries or ``BURST_BYTES`` at once, and to
``DAY_BYTES`` in 24 hours; an entry gives the count of those left out. HOLD, which needs neither lease nor key, has
limits of its own with all its entries (order, reply, event): once for the local sockets, which every user of this
computer can flood, and once for HOLD as a command. No flood of the one keeps entries of the others off the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from rigctl.ipc.record import HOLD_ID
from rigctl.model import quantity
from rigctl.model.verbs import Verb
from rigctl.recorder.audit_log import Item

WINDOW_NS, NEXT_WINDOW_NS = 10_000_000_000, 60_000_000_000
"""Time in which repeats are counted: the first, and each that follows while they go on."""
WRITTEN_FIRST = 3  # equal items written within a window before the others are only counted
RATE_HZ, BURST = 20, 2_000
RATE_BYTES, BURST_BYTES = 16_384, 1 << 20
DAY_BYTES, DAY_S = 32 << 20, 86_400
"""At most of one share, in any 24 hours: half of it at once, the other half as it is refilled."""
SAME_MAX = 512  # keys of one share watched for repeats at a time
ENTRY_BYTES = 420  # of an entry without its texts: hashes, times, positions of the rings

_SAME: dict[str, tuple[str, ...]] = {
    "command_refused": ("verb", "reason"),
    "limit": ("a",),
    "limit_over": ("text",),
    "local_hold_given": ("uid",),
    "local_hold": ("a",),
    "lease_taken": (),
    "lease_taken_over": ("other",),
    "lease_returned": (),
    "alarm_acknowledged": ("other",),
    "alarm_shelved": ("other",),
    "alarm_unshelved": ("other",),
    "operator_note": ("reason",),
    "hold_without_lease": ("other",),
    "too_many_commands": (),
    "clock": (),
    "foreign_sdo": ("a",),
    "bus_error": ("a", "b"),
    "send_failed": ("text",),
    "receive_failed": ("text",),
    "cause": ("a",),
    "cause_over": ("a",),
    "stroke_left": ("a",),
    "drive_creeps": (),
}
"""Kinds whose repeats become one entry, with the details that repeats share beside kind and operator."""
_REPEATED_VERBS = frozenset(
    {"hold", "lease_take", "lease_return", "alarm_acknowledge", "alarm_shelve", "alarm_unshelve", "note"}
)
_COUNTED = frozenset({
    *_SAME, "setting_lost", "command_given", "order", "reply", "emergency", "node_state", "message_refused",
    "connection_refused", "connection_closed",
})  # fmt: skip
"""Kinds that are counted instead of written beyond the rate."""


@dataclass
class _Same:
    first: Item
    last: Item
    count: int = 0  # not written
    written: int = 1
    window_ns: int = WINDOW_NS


class _Of(Enum):
    """Whose limits an entry counts against."""

    LOCAL_HOLD = auto()
    HOLD = auto()
    OTHERS = auto()


_LOCAL = frozenset({"local_hold_given", "local_hold"})
_HOLD_VERBS = ("hold", Verb.HOLD)  # as a command has it, and as the loop's order


def _is_local_hold(item: Item) -> bool:
    return item.what in _LOCAL or (item.what == "reply" and bool(item.details.get("id", 0) & HOLD_ID))


def _is_counted(item: Item) -> bool:
    """Whether it is counted instead of written beyond the limits."""
    return item.what in _COUNTED or _key(item) is not None


class _Share:
    """Entries and bytes that may be written now: in a burst, in the long run, in a day; and the repeats watched for."""

    def __init__(self) -> None:
        self.same: dict[tuple[Any, ...], _Same] = {}
        self._entries, self._bytes, self._day = float(BURST), float(BURST_BYTES), DAY_BYTES / 2
        self._seen_ns = 0

    def takes(self, size: int, now_ns: int, *, always: bool) -> bool:
        """Take an entry of ``size`` bytes off; False, and nothing is taken, where it is beyond the limits."""
        passed_s = max(0, now_ns - self._seen_ns) * 1e-9 if self._seen_ns else 0.0
        self._seen_ns = now_ns
        self._entries = min(BURST, self._entries + passed_s * RATE_HZ)
        self._bytes = min(BURST_BYTES, self._bytes + passed_s * RATE_BYTES)
        self._day = min(DAY_BYTES / 2, self._day + passed_s * DAY_BYTES / 2 / DAY_S)
        if not always and (self._entries < 1.0 or min(self._bytes, self._day) < size):
            return False
        self._entries = max(0.0, self._entries - 1.0)
        self._bytes, self._day = max(0.0, self._bytes - size), max(0.0, self._day - size)
        return True


def _key(item: Item) -> tuple[Any, ...] | None:
    """Key that repeats of an item share; None if each is written."""
    if _is_local_hold(item):  # whatever name the sender gives: it would be a new one each time
        return (item.what, *map(item.details.get, _SAME.get(item.what, ("accepted", "reason", "mode"))))
    if item.what in _SAME:
        about = tuple(item.text if name == "text" else item.details.get(name) for name in _SAME[item.what])
        return (item.source, item.what, item.who, *about)
    if item.what == "command_accepted" and item.details.get("verb") in _REPEATED_VERBS:
        return (item.source, item.what, item.who, item.details["verb"])
    return None


def size_of(item: Item) -> int:
    """Approximate size of its entry in bytes."""
    return ENTRY_BYTES + len(item.text) + len(item.who) + len(str(item.details))


class Thinning:
    """Selects the items to write and counts the others."""

    def __init__(self) -> None:
        self._shares = {of: _Share() for of in _Of}
        self._holds: set[int] = set()  # ids of orders of HOLD without a reply yet
        self._left_out: Counter[str] = Counter()
        self._left_out_ns = 0

    def thin(self, items: Iterable[Item], now_ns: int, wall_ns: int, *, final: bool = False) -> list[Item]:
        """The items to write, and an item for each count that is due; ``final``: for all counts."""
        kept = []
        for item in items:
            share = self._shares[self._of(item)]
            if not _repeats(item, share.same) and self._affords(item, share, now_ns):
                kept.append(item)
        return [*kept, *self._counts(now_ns, wall_ns, final=final)]

    def _of(self, item: Item) -> _Of:
        if _is_local_hold(item):
            return _Of.LOCAL_HOLD
        if item.what == "reply":
            replied = item.details.get("id") in self._holds
            self._holds.discard(item.details.get("id", 0))
            return _Of.HOLD if replied else _Of.OTHERS
        if item.what == "hold_without_lease":
            return _Of.HOLD
        if item.details.get("verb") not in _HOLD_VERBS:
            return _Of.OTHERS
        if item.what == "order":
            if len(self._holds) >= SAME_MAX:  # of loops that ended without a reply
                self._holds.clear()
            self._holds.add(item.details["id"])
        return _Of.HOLD

    def _affords(self, item: Item, share: _Share, now_ns: int) -> bool:
        if share.takes(size_of(item), now_ns, always=not _is_counted(item)):
            return True
        self._leave_out(item.what, 1, item.t_ns)
        return False

    def _leave_out(self, what: str, count: int, t_ns: int) -> None:
        self._left_out[what] += count
        self._left_out_ns = self._left_out_ns or t_ns

    def _counts(self, now_ns: int, wall_ns: int, *, final: bool) -> list[Item]:
        found = []
        for share in self._shares.values():
            for key, same in list(share.same.items()):
                if not final and now_ns - same.first.t_ns < same.window_ns:
                    continue
                if not same.count:
                    del share.same[key]
                    continue
                share.same[key] = _Same(same.last, same.last, written=WRITTEN_FIRST, window_ns=NEXT_WINDOW_NS)
                repeated = _repeated(same, now_ns, wall_ns)
                if final or share.takes(size_of(repeated), now_ns, always=False):
                    found.append(repeated)
                else:
                    self._leave_out(same.last.what, same.count, same.first.t_ns)
        if self._left_out and (final or now_ns - self._left_out_ns >= WINDOW_NS):
            entries = quantity.count(self._left_out.total(), "entry", "entries")
            seconds = (now_ns - self._left_out_ns) * 1e-9
            kinds = ", ".join(f"{what} {number}" for what, number in self._left_out.most_common())
            text = (
                f"{entries} left out in {seconds:.0f} s, more than {RATE_HZ} entries or {RATE_BYTES >> 10} KiB "
                f"a second, or {DAY_BYTES >> 20} MiB a day: {kinds}"
            )
            found.append(Item(now_ns, wall_ns, "left_out", text, details=dict(self._left_out)))
            self._left_out, self._left_out_ns = Counter(), 0
        return found


def _repeats(item: Item, watched: dict[tuple[Any, ...], _Same]) -> bool:
    """Whether it repeats an item enough times to be counted alone."""
    key = _key(item)
    if key is None:
        return False
    same = watched.get(key)
    if same is None:
        if len(watched) < SAME_MAX:
            watched[key] = _Same(item, item)
        return False
    if same.written < WRITTEN_FIRST:
        same.written += 1
        return False
    same.count += 1
    same.last = item
    return True


def _repeated(same: _Same, now_ns: int, wall_ns: int) -> Item:
    last, seconds = same.last, (same.last.t_ns - same.first.t_ns) * 1e-9
    kind = "refusal" if last.what == "command_refused" else last.what.replace("_", " ")
    text = f"the same {kind} {quantity.count(same.count, 'time')} more in {seconds:.0f} s: {last.text}"
    details = {"count": same.count, "what": last.what, "source": last.source, "up_to": last.seq}
    return Item(now_ns, wall_ns, "repeated", text, last.who, details)
