"""Rate limits of commands: for each operator, and for all together. Pure: time is passed in.

Zenoh identifies no peer in a query (its source info is what the peer states itself, or empty), so the limit goes by the
operator's name in the command; a peer that changes its name meets the limit of all. The holder of the lease, proved by
the lease's id, has a limit beside that of all. HOLD has no limit: see `rigctl.gateway.command_server`.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

PER_OPERATOR_HZ, PER_OPERATOR_BURST = 50, 200  # a program that follows a target at 50 Hz is not refused
ALL_HZ, ALL_BURST = 100, 400
NAMES_MAX = 256  # names with a bucket; beyond that, the name whose last command is oldest is forgotten
REPORT_NS = 10_000_000_000  # between two reports of refused commands
_OTHERS = "others"


@dataclass
class Bucket:
    """Token bucket: tokens arrive at a steady rate, at most ``burst`` of them are kept."""

    rate_hz: float
    burst: float
    tokens: float
    seen_ns: int

    def fill(self, now_ns: int) -> bool:
        """Add the tokens due since the last call; returns whether there is one."""
        self.tokens = min(self.burst, self.tokens + max(0, now_ns - self.seen_ns) * 1e-9 * self.rate_hz)
        self.seen_ns = now_ns
        return self.tokens >= 1.0


@dataclass(frozen=True)
class RefusedCommands:
    """Commands of one name that were refused since the last report."""

    operator: str
    count: int
    since_ns: int


class Flow:
    """Counts commands; every method may be called from any thread."""

    def __init__(self, now_ns: int) -> None:
        self._lock = threading.Lock()
        self._all = Bucket(ALL_HZ, ALL_BURST, ALL_BURST, now_ns)
        self._of: dict[str, Bucket] = {}
        self._refused: dict[str, int] = {}
        self._since_ns = 0

    def admit(self, operator: str, now_ns: int, *, holder: bool = False) -> str:
        """Why a command is refused, empty if it is admitted; ``holder``: the lease's id proves its holder."""
        with self._lock:
            name = f"\0{operator}" if holder else operator  # a peer that only uses the holder's name shares no bucket
            own = self._of.pop(name, None) or Bucket(PER_OPERATOR_HZ, PER_OPERATOR_BURST, PER_OPERATOR_BURST, now_ns)
            self._of[name] = own  # moved to the end: the front is forgotten first
            if len(self._of) > NAMES_MAX:
                del self._of[next(iter(self._of))]
            mine, everybody = own.fill(now_ns), self._all.fill(now_ns)
            if not mine:
                return self._refuse(operator, now_ns, f"{PER_OPERATOR_HZ} a second from one operator")
            if not everybody and not holder:
                return self._refuse(operator, now_ns, f"{ALL_HZ} a second from all operators together")
            own.tokens -= 1.0
            if not holder:
                self._all.tokens -= 1.0
            return ""

    def _refuse(self, operator: str, now_ns: int, limit: str) -> str:
        if not self._refused:
            self._since_ns = now_ns
        name = operator if operator in self._refused or len(self._refused) < NAMES_MAX else _OTHERS
        self._refused[name] = self._refused.get(name, 0) + 1
        return f"too many commands: more than {limit}; it was not given; HOLD is taken all the same; ask less often"

    def due(self, now_ns: int) -> bool:
        """Whether there are refusals to report."""
        return bool(self._refused) and now_ns - self._since_ns >= REPORT_NS

    def report(self) -> list[RefusedCommands]:
        """The refusals since the last report, by name, most first; starts the counts again at 0."""
        with self._lock:
            found = [RefusedCommands(name, count, self._since_ns) for name, count in self._refused.items()]
            self._refused = {}
        return sorted(found, key=lambda one: -one.count)
