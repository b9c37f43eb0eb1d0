"""Which connections of the gateway's router are closed, so that nobody's connections take another's places.

Each identity has a share of its own: a certificate, a user of this computer, an address. Beyond the share its own
oldest session is closed for its newest: who holds many sessions, or whose key is abused, still gets a new one for HOLD.
A refusal of the newest would let the abuser keep the owner out. Identities that may command share nothing; all others
have a pool, in which the one with the most sessions loses first. Pure functions of values.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from enum import StrEnum

SHARE = 16  # sessions of one identity; an operator's terminals, page and bridge are five
POOL = 96  # sessions of all identities together that have no places of their own; each costs 50 states a second
OPENING_OF_SOURCE, OPENING = 64, 256  # connections that have not become a session: of one source, and of all
OPENING_S = 2.0  # a client gives up after 1.5 s


class Why(StrEnum):
    """Why a connection is closed, in the words of the note."""

    UNKNOWN = "its certificate is revoked, expired or not known"
    SHARE = f"more than {SHARE} sessions of one identity; its oldest is closed for its newest"
    POOL = f"more than {POOL} sessions without places of their own; the oldest of the identity with the most is closed"
    LATE = f"no session within {OPENING_S:g} s"
    OPENING_OF_SOURCE = f"more than {OPENING_OF_SOURCE} connections of one source without a session; its oldest goes"
    OPENING = f"more than {OPENING} connections without a session; the oldest of the source with the most is closed"


@dataclass(frozen=True)
class Connection:
    """An accepted connection. ``number``: rises with each; ``source``: user or address that it comes from.

    ``identity``: whose session it is, None while it is none.
    """

    number: int
    since_s: float
    source: str
    identity: str | None = None


@dataclass(frozen=True)
class Rules:
    """``reserved``: identities with places of their own. ``known``: the only ones that may stay; None: everyone may."""

    reserved: Collection[str] = ()
    known: Collection[str] | None = None


def closed(connections: Iterable[Connection], rules: Rules, now_s: float) -> list[tuple[Connection, Why]]:
    """The connections to close now, with the reason; ``now_s``: on the clock of ``since_s``, s."""
    found: list[tuple[Connection, Why]] = []
    sessions, opening = defaultdict[str, list[Connection]](list), defaultdict[str, list[Connection]](list)
    for one in sorted(connections, key=lambda one: one.number):
        if one.identity is None:
            if now_s - one.since_s > OPENING_S:
                found.append((one, Why.LATE))
            else:
                opening[one.source].append(one)
        elif rules.known is not None and one.identity not in rules.known:
            found.append((one, Why.UNKNOWN))
        else:
            sessions[one.identity].append(one)
    found += _beyond_share(sessions, SHARE, Why.SHARE)
    pool = {identity: kept for identity, kept in sessions.items() if identity not in rules.reserved}
    found += _beyond_total(pool, POOL, Why.POOL)
    found += _beyond_share(opening, OPENING_OF_SOURCE, Why.OPENING_OF_SOURCE)
    return found + _beyond_total(opening, OPENING, Why.OPENING)


def _beyond_share(of: dict[str, list[Connection]], share: int, why: Why) -> list[tuple[Connection, Why]]:
    found = []
    for kept in of.values():
        found += [(one, why) for one in kept[:-share]]
        del kept[:-share]
    return found


def _beyond_total(of: dict[str, list[Connection]], total: int, why: Why) -> list[tuple[Connection, Why]]:
    """Take from whoever has the most, oldest first: who has few loses none."""
    found = []
    for _ in range(sum(map(len, of.values())) - total):
        most = max(of.values(), key=lambda kept: (len(kept), -kept[0].number))
        found.append((most.pop(0), why))
    return found
