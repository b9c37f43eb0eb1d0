"""Who may command the rig: one lease, held by one operator at a time. Pure: time and ids are passed in.

A name says who it is, an id proves it: two terminals that give the same name are two operators until one shows the id
the other was given. A lease ends by lapse, by being given back, or by an explicit takeover with a reason; none of
these ever gives the rig a command. HOLD needs no lease and takes none.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, auto

ID_BYTES = 16
_ID = re.compile(rf"[0-9a-f]{{{2 * ID_BYTES}}}")


def is_id(text: str) -> bool:
    """Whether ``text`` has the form of a lease's id."""
    return _ID.fullmatch(text) is not None


@dataclass(frozen=True)
class Lease:
    """What the holder has; times are CLOCK_MONOTONIC of the daemon's host."""

    id: str
    holder: str
    since_ns: int
    until_ns: int


class Act(Enum):
    """What may be asked of the lease itself; the value is the key's ending."""

    TAKE = "lease_take"
    RETURN = "lease_return"


ACTS = {act.value: act for act in Act}


class Denial(Enum):
    """Why somebody may not; the value is the answer's ``reason``."""

    HELD = "lease_held"  # by another operator, terminal or program
    LAPSED = "lease_lapsed"  # the id shown is not in force (any more), and nobody holds a lease
    NOT_HELD = "lease_not_held"  # nothing to give back


class Turn(Enum):
    """What can happen to a lease."""

    TAKEN = auto()
    TAKEN_OVER = auto()
    RETURNED = auto()
    LAPSED = auto()


@dataclass(frozen=True)
class Change:
    """Something that happened to the lease at ``t_ns``: by ``operator``, who took it over from ``other``."""

    t_ns: int
    turn: Turn
    operator: str
    other: str = ""
    reason: str = ""


class LeaseRegister:
    """The lease in force. Every change is told, in order; a renewal is none."""

    def __init__(
        self,
        duration_ns: int,
        tell: Callable[[Change], None],
        lease: Lease | None = None,
        make_id: Callable[[], str] = lambda: secrets.token_hex(ID_BYTES),
    ) -> None:
        """``lease``: what was in force before."""
        self._duration_ns, self._tell, self._make_id = duration_ns, tell, make_id
        self._lease = lease

    def lease(self, now_ns: int) -> Lease | None:
        """The lease in force; may be asked from any thread."""
        lease = self._lease
        return lease if lease is not None and now_ns < lease.until_ns else None

    def has_lapsed(self, now_ns: int) -> bool:
        """Whether `expire` has something to do; may be asked from any thread."""
        return self._lease is not None and self.lease(now_ns) is None

    def is_holder(self, operator: str, id_: str | None, now_ns: int) -> bool:
        """Whether both name and id are those of the lease in force."""
        lease = self.lease(now_ns)
        if lease is None or id_ is None or lease.holder != operator:
            return False
        return secrets.compare_digest(lease.id, id_)

    def expire(self, now_ns: int) -> None:
        """Strike out a lease that has lapsed."""
        if self._lease is not None and self.lease(now_ns) is None:
            lapsed, self._lease = self._lease, None
            self._tell(Change(now_ns, Turn.LAPSED, lapsed.holder))

    def admit(self, operator: str, id_: str | None, now_ns: int) -> Lease | Denial:
        """A command of ``operator``, who shows ``id_``: renews the lease, or takes the one nobody holds."""
        if (renewed := self.renew(operator, id_, now_ns)) is not None:
            return renewed
        self.expire(now_ns)
        if self._lease is not None:
            return Denial.HELD
        if id_ is not None:
            return Denial.LAPSED
        return self._grant(Turn.TAKEN, operator, now_ns)

    def renew(self, operator: str, id_: str | None, now_ns: int) -> Lease | None:
        """Begin the holder's time anew; None if it is not the holder who asks."""
        lease = self._lease
        if lease is None or not self.is_holder(operator, id_, now_ns):
            return None
        self._lease = replace(lease, until_ns=now_ns + self._duration_ns)
        return self._lease

    def take(self, operator: str, id_: str | None, reason: str, now_ns: int) -> Lease | Denial:
        """Take the lease whoever holds it; from another only with a reason."""
        if (renewed := self.renew(operator, id_, now_ns)) is not None:
            return renewed
        self.expire(now_ns)
        if self._lease is None:
            return self._grant(Turn.TAKEN, operator, now_ns, reason=reason)
        if not reason:
            return Denial.HELD
        return self._grant(Turn.TAKEN_OVER, operator, now_ns, self._lease.holder, reason)

    def give_back(self, operator: str, id_: str | None, now_ns: int) -> Denial | None:
        """End the lease before its time; None if that was done."""
        self.expire(now_ns)
        if self._lease is None:
            return Denial.NOT_HELD
        if not self.is_holder(operator, id_, now_ns):
            return Denial.HELD
        self._lease = None
        self._tell(Change(now_ns, Turn.RETURNED, operator))
        return None

    def _grant(self, turn: Turn, operator: str, now_ns: int, other: str = "", reason: str = "") -> Lease:
        lease = self._lease = Lease(self._make_id(), operator, now_ns, now_ns + self._duration_ns)
        self._tell(Change(now_ns, turn, operator, other, reason))
        return lease
