"""Read-back by SDO of the device settings that safety needs: all before arming, one by one while armed.

At most one request is under way, one per `sdo.every_ticks`, so the bus load is bounded. Bytes in, bytes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.control.findings import ReadbackSeen
from rigctl.devices import sdo
from rigctl.devices.objects import QUICK_STOPS_BY
from rigctl.devices.sdo import Watched

TRIES = 3  # requests without an answer before a device counts as silent
LIMIT_NS = 15_000_000_000  # for all objects before arming: 75 of them at 200 ms each
FOREIGN_AFTER_NS = 1_000_000_000  # until then an answer may still be to start-up's last requests


@dataclass(frozen=True)
class Lost:
    """An object that differs from start-up; ``found`` is None where the device gave no value, ``why`` is the reason."""

    item: Watched
    found: int | None
    why: str = ""

    @property
    def words(self) -> str:
        """Object, found and wanted."""
        wanted = self._shown(self.item.wanted)
        if self.found is None:
            return f"{self.item.words}: {self.why} (wanted {wanted})"
        return f"{self.item.words}: found {self._shown(self.found)}, wanted {wanted}"

    def _shown(self, value: int) -> str:
        """COB-IDs and mappings are read in hexadecimal."""
        return f"{value:#x}" if self.item.index < 0x2000 and value >= 0x180 else str(value)


class Readback:
    """An SDO client that never blocks. ``lost``: objects whose last reading was not the wanted value.

    ``seen``: the same, as it was last shown.
    """

    def __init__(self, table: Sequence[Watched], settings: RigSettings, started_ns: int) -> None:
        """``table``: from start-up, the most important first. ``started_ns``: when the loop began."""
        self._foreign_ns = started_ns + FOREIGN_AFTER_NS
        self._drive_node = settings.cylinder.node
        self._table = tuple(table)
        self._every, self._left = sdo.every_ticks(settings), 0
        self._place = 0  # index of the next object
        self._under_way: Watched | None = None
        self._sent_ns = self._tries = 0
        self._recent: dict[int, tuple[tuple[int, int], tuple[int, int]]] = {}  # last two objects requested, by node
        self._all_since_ns = 0  # 0: no ARM waits
        self._unread = 0
        self.lost: dict[Watched, Lost] = {}
        self.seen = ReadbackSeen()
        self._newest: Lost | None = None  # until it is reported
        self.read = 0  # objects read so far

    @property
    def size(self) -> int:
        """Objects watched."""
        return len(self._table)

    @property
    def reading_all(self) -> bool:
        """An ARM waits for every object to be read."""
        return self._unread > 0

    def show(self) -> None:
        """Put into ``seen`` what is lost now."""
        seen, changed = self.seen, [item for item, lost in self.lost.items() if lost.found is not None]
        of_drive = [item for item in changed if item.node == self._drive_node]
        stops_by = any((item.index, item.sub) in QUICK_STOPS_BY for item in of_drive)
        seen.lost, seen.disobeys = len(self.lost), any(item.obeys for item in changed)
        seen.unsupervised = 0 if stops_by else len(of_drive)
        seen.words = next(iter(self.lost.values())).words if self.lost else ""

    def report(self) -> Lost | None:
        """The newest lost object that has not been reported."""
        newest, self._newest = self._newest, None
        return newest

    def begin_all(self, t_ns: int) -> None:
        """Read every object, from now on."""
        self.lost.clear()
        self._place, self._unread, self._all_since_ns = 0, len(self._table), t_ns
        self._under_way, self._left = None, 0

    def give_up(self) -> None:
        """No ARM waits any more."""
        self._unread = self._all_since_ns = 0

    def verdict(self, t_ns: int) -> bool | None:
        """Whether every object is as wanted; None while they are being read. A silent device makes it False."""
        silent = any(lost.found is None for lost in self.lost.values())
        if self._unread and not silent and t_ns - self._all_since_ns < LIMIT_NS:
            return None
        if self._unread and not silent:
            self._lose(self._table[self._place], None, f"not read within {LIMIT_NS // 1_000_000_000} s")
        self.give_up()
        return not self.lost

    def request(self, t_ns: int, *, armed: bool) -> tuple[int, bytes] | None:
        """Request to send now, as node and data, or None. A DISARMED rig reads only after `begin_all`.

        A technician's tool uses the same SDO channel of a device, so a DISARMED rig leaves it free.
        """
        self._left = max(0, self._left - 1)
        if not (self._table and (armed or self._unread)):
            self._under_way = None
            return None
        item = self._under_way
        if item is not None:
            if t_ns - self._sent_ns < item.timeout_ms * 1_000_000:
                return None
            if self._tries >= TRIES:
                self._lose(item, None, f"no answer to {TRIES} requests")
                self._done()
        if self._left:
            return None
        self._left = self._every
        return self._send(t_ns)

    def unsent(self) -> None:
        """The request just given could not be sent: it is no try of the device, and follows again."""
        self._tries -= 1
        self._sent_ns = 0

    def take(self, node: int, data: bytes | bytearray, t_ns: int) -> bool:
        """Take an SDO answer; returns whether it is to one of our requests. A late or repeated answer is."""
        where = sdo.answered(data)
        if where is None or where not in self._recent.get(node, ()):
            return t_ns < self._foreign_ns
        item = self._under_way
        if item is None or (item.node, item.index, item.sub) != (node, *where):
            return True
        answer = sdo.upload_answer(data, item.size)
        if answer.abort:
            self._lose(item, None, f"refused, abort code 0x{answer.abort:08X}")
        elif not answer.expedited:
            self._lose(item, None, "answered in several frames")
        elif answer.value != item.wanted:
            self._lose(item, answer.value)
        else:
            self.lost.pop(item, None)
        self.read += 1
        self._done()
        return True

    def wrote(self, node: int, where: tuple[int, int]) -> None:
        """Expect the answer to a write of ours; nothing is read after it."""
        self._under_way, self._recent[node] = None, (where, where)

    def forget(self) -> None:
        """Acknowledge lost settings; ARM reads every object again."""
        self.lost.clear()

    def suspect(self, node: int, where: tuple[int, int] | None) -> None:
        """Another master has accessed this object: read it next."""
        for i, item in enumerate(self._table):
            if not self._unread and (item.node, item.index, item.sub) == (node, *(where or ())):
                self._place = i - (self._under_way is not None)  # the answer under way will move it by one

    def _send(self, t_ns: int) -> tuple[int, bytes]:
        if self._under_way is None:
            self._under_way, self._tries = self._table[self._place], 0
        item = self._under_way
        self._tries += 1
        self._sent_ns = t_ns
        now, before = (item.index, item.sub), self._recent.get(item.node)
        if before is None or before[0] != now:
            self._recent[item.node] = now, (before[0] if before else now)
        return item.node, sdo.upload_request(item.index, item.sub)

    def _done(self) -> None:
        self._under_way = None
        self._place = (self._place + 1) % len(self._table)
        self._unread = max(0, self._unread - 1)

    def _lose(self, item: Watched, found: int | None, why: str = "") -> None:
        known, lost = self.lost.get(item), Lost(item, found, why)
        known_silent = any(other.found is None and other.item.node == item.node for other in self.lost.values())
        self.lost[item] = lost
        if lost != known and not (found is None and known_silent):  # a silent device is reported once
            self._newest = lost
