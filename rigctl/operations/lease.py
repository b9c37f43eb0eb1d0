"""Who may command the rig: one lease, held by one operator at a time. Pure: time and ids are passed in.

The id proves the operator's name: two terminals of one name are two operators until one shows the id that the other
got. It is drawn here, sent to its taker alone and shown in the command; it is neither in the state nor on record. A
command has the lease from its admission on; one that is refused leaves it as it was before. A
lease ends when it lapses, when it is returned, or by an explicit takeover with a reason; none of these gives the rig a
command. HOLD needs no lease and takes none.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rigctl.config.built_type import built
from rigctl.ipc.notes import Note
from rigctl.model.lease_acts import ID_BYTES, Denial

_TAKE = "rigctl lease take"


@built
@dataclass(frozen=True)
class Lease:
    """A lease; times are CLOCK_MONOTONIC of the daemon's host."""

    id: str
    holder: str
    since_ns: int
    until_ns: int

    def shown(self, now_ns: int) -> dict[str, Any]:
        """As everyone may see it: without its id."""
        return {
            "holder": self.holder, "since_ns": self.since_ns, "until_ns": self.until_ns,
            "held_s": max(0.0, round((now_ns - self.since_ns) / 1e9, 1)),
            "left_s": round((self.until_ns - now_ns) / 1e9, 1),
        }  # fmt: skip


@dataclass(frozen=True)
class LeaseChange:
    """A change of the lease at ``t_ns`` by ``operator``; ``other``: who held it before a takeover."""

    t_ns: int
    kind: Note
    operator: str
    other: str = ""
    reason: str = ""


class LeaseRegister:
    """The lease in force. Every change is passed to ``on_change`` in order; a renewal is no change."""

    def __init__(
        self,
        duration_ns: int,
        on_change: Callable[[LeaseChange], None],
        lease: Lease | None = None,
        make_id: Callable[[], str] = lambda: secrets.token_hex(ID_BYTES),
    ) -> None:
        """``lease``: the one in force at the start."""
        self._duration_ns, self._on_change, self._make_id = duration_ns, on_change, make_id
        self._lease = lease
        self._kept_until_ns = None if lease is None else lease.until_ns
        """By what has been accepted; None: no command under this lease has been."""

    def lease(self, now_ns: int) -> Lease | None:
        """The lease in force; may be called from any thread."""
        lease = self._lease
        return lease if lease is not None and now_ns < lease.until_ns else None

    def has_lapsed(self, now_ns: int) -> bool:
        """Whether `expire` has something to do; may be called from any thread."""
        return self._lease is not None and self.lease(now_ns) is None

    def is_holder(self, operator: str, id_: str | None, now_ns: int) -> bool:
        """Whether both name and id are those of the lease in force."""
        lease = self.lease(now_ns)
        if lease is None or id_ is None or lease.holder != operator:
            return False
        return secrets.compare_digest(lease.id, id_)

    def expire(self, now_ns: int) -> None:
        """End a lease that has lapsed."""
        if self._lease is not None and self.lease(now_ns) is None:
            lapsed, self._lease = self._lease, None
            if self._kept_until_ns is not None:
                self._on_change(LeaseChange(now_ns, Note.LEASE_LAPSED, lapsed.holder))

    def admit(self, operator: str, id_: str | None, now_ns: int) -> Lease | Denial:
        """The lease for a command of ``operator``, who shows ``id_``, until `accept` or `refuse` is called for it."""
        if self.is_holder(operator, id_, now_ns):
            return self._extend(now_ns)
        self.expire(now_ns)
        if self._lease is not None:
            return Denial.HELD
        if id_ is not None:
            return Denial.LAPSED
        self._lease, self._kept_until_ns = self._drawn(operator, now_ns), None
        return self._lease

    def accept(self, operator: str, id_: str | None, now_ns: int) -> Lease | None:
        """Renew the lease of the holder whose command was accepted; None for anyone but the holder."""
        if not self.is_holder(operator, id_, now_ns):
            return None
        lease = self._extend(now_ns)
        self._keep(now_ns)
        return lease

    def refuse(self, operator: str, id_: str | None, now_ns: int) -> None:
        """A command was refused: the lease that it had taken or renewed is as it was before."""
        lease = self._lease
        if lease is None or not self.is_holder(operator, id_, now_ns):
            return
        kept = self._kept_until_ns
        self._lease = None if kept is None else replace(lease, until_ns=kept)

    def settle(self, operator: str, id_: str | None, now_ns: int, *, accepted: bool) -> bool:
        """A command was answered: `accept` or `refuse`; returns whether it was the holder's."""
        if not self.is_holder(operator, id_, now_ns):
            return False
        (self.accept if accepted else self.refuse)(operator, id_, now_ns)
        return True

    def _extend(self, now_ns: int) -> Lease:
        assert self._lease is not None
        self._lease = replace(self._lease, until_ns=now_ns + self._duration_ns)
        return self._lease

    def _keep(self, now_ns: int) -> None:
        """The lease is in force by what has been accepted; the first time, it has been taken."""
        lease = self._lease
        if lease is not None:
            taken, self._kept_until_ns = self._kept_until_ns is None, lease.until_ns
            if taken:
                self._on_change(LeaseChange(now_ns, Note.LEASE_TAKEN, lease.holder))

    def take(self, operator: str, id_: str | None, reason: str, now_ns: int) -> Lease | Denial:
        """Take the lease; from another holder only with a reason."""
        if (renewed := self.accept(operator, id_, now_ns)) is not None:
            return renewed
        self.expire(now_ns)
        if self._lease is None:
            return self._grant(Note.LEASE_TAKEN, operator, now_ns, reason=reason)
        if not reason:
            return Denial.HELD
        self._keep(now_ns)
        return self._grant(Note.LEASE_TAKEN_OVER, operator, now_ns, self._lease.holder, reason)

    def give_back(self, operator: str, id_: str | None, now_ns: int) -> Denial | None:
        """End the holder's lease before its time; returns None, or why not."""
        self.expire(now_ns)
        if self._lease is None:
            return Denial.NOT_HELD
        if not self.is_holder(operator, id_, now_ns):
            return Denial.HELD
        self._lease = None
        self._on_change(LeaseChange(now_ns, Note.LEASE_RETURNED, operator))
        return None

    def _grant(self, kind: Note, operator: str, now_ns: int, other: str = "", reason: str = "") -> Lease:
        lease = self._lease = self._drawn(operator, now_ns)
        self._kept_until_ns = lease.until_ns
        self._on_change(LeaseChange(now_ns, kind, operator, other, reason))
        return lease

    def _drawn(self, operator: str, now_ns: int) -> Lease:
        return Lease(self._make_id(), operator, now_ns, now_ns + self._duration_ns)


def why_not(denial: Denial, operator: str, lease: Lease | None, now_ns: int) -> str:
    """A denial as one line for the operator."""
    if denial is Denial.LAPSED:
        return f"the lease shown has lapsed or was never given, and nobody holds it now; look at the rig, then {_TAKE}"
    if denial is Denial.NOT_HELD or lease is None:
        return "nobody holds the lease"
    elsewhere = " in another terminal or program" if lease.holder == operator else ""
    since_s, left_s = (now_ns - lease.since_ns) / 1e9, (lease.until_ns - now_ns) / 1e9
    held = f"{lease.holder} holds the lease{elsewhere}, since {since_s:.0f} s, for another {left_s:.0f} s"
    return f"{held}; to take it over: {_TAKE} --reason TEXT"
