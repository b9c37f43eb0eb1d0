"""How many commands are let through: of each operator, and of all together. Pure: time is passed in.

Zenoh names no peer in a query (its source info is what the peer says of itself, or nothing), so that a peer is known by
the operator's name it gives; who changes the name meets the limit of all. The holder of the lease, whom the lease's id
proves, has a limit of his own beside it, and HOLD none: see `rigctl.gateway.command_server`.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

PER_OPERATOR_HZ, PER_OPERATOR_BURST = 50, 200  # a program that follows a target at 50 Hz is not refused
ALL_HZ, ALL_BURST = 100, 400
NAMES_MAX = 256  # whose limits are remembered; beyond, those who have asked nothing for longest start anew
TOLD_NS = 10_000_000_000  # how often the refusals are told
_OTHERS = "others"


@dataclass
class Bucket:
    """Tokens that come at a steady rate, at most ``burst`` of them."""

    rate_hz: float
    burst: float
    tokens: float
    seen_ns: int

    def fill(self, now_ns: int) -> bool:
        """Add what has come since; whether there is a token."""
        self.tokens = min(self.burst, self.tokens + max(0, now_ns - self.seen_ns) * 1e-9 * self.rate_hz)
        self.seen_ns = now_ns
        return self.tokens >= 1.0


@dataclass(frozen=True)
class Crowd:
    """Commands of one name that were refused since the last time this was told."""

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
        """Why a command is refused, empty if it is let through; ``holder``: of the lease, as its id proves."""
        with self._lock:
            name = f"\0{operator}" if holder else operator  # who only uses the holder's name has another's limit
            own = self._of.pop(name, None) or Bucket(PER_OPERATOR_HZ, PER_OPERATOR_BURST, PER_OPERATOR_BURST, now_ns)
            self._of[name] = own  # the last to ask is the last to be forgotten
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
        """Whether there are refusals to be told."""
        return bool(self._refused) and now_ns - self._since_ns >= TOLD_NS

    def told(self) -> list[Crowd]:
        """The refusals since the last time, by name, most first; counts begin anew."""
        with self._lock:
            found = [Crowd(name, count, self._since_ns) for name, count in self._refused.items()]
            self._refused = {}
        return sorted(found, key=lambda crowd: -crowd.count)
