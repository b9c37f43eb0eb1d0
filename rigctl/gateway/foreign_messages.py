"""What other sessions put on the rig's keys, and answers they offer, where no access list refuses them.

Clients of this computer do not believe it, because it has no signature of the daemon; here it is put on record.
"""

from __future__ import annotations

import zenoh

from rigctl.config.one_line import on_one_line
from rigctl.gateway.refused_access import RefusedAccess
from rigctl.ipc.notes import Note
from rigctl.wire.access_control import READ_TAILS
from rigctl.wire.keys import ROOT, Keys

KEPT = 64  # messages between two calls; of a flood the newest
CHECK_NS = 500_000_000  # between two looks for foreign answers
_REMOTE = zenoh.Locality.REMOTE


class ForeignMessages:
    """Watches the keys of one rig."""

    def __init__(self, keys: Keys, router: zenoh.Session, commands: zenoh.Session) -> None:
        """``router`` publishes and answers; ``commands`` answers commands. Messages of their own are not foreign."""
        published = [f"{ROOT}/{keys.rig}/{tail}" for tail in READ_TAILS]
        self._come = [
            router.declare_subscriber(key, zenoh.handlers.RingChannel(KEPT), allowed_origin=_REMOTE)
            for key in published
        ]
        answered = (keys.state, keys.fast, keys.events_past, keys.schema, keys.active)
        self._offers = [router.declare_querier(key, allowed_destination=_REMOTE) for key in answered]
        self._offers.append(commands.declare_querier(keys.command("*"), allowed_destination=_REMOTE))
        self._check_ns = 0
        self._offered: set[str] = set()

    def poll(self, found: RefusedAccess, now_ns: int) -> None:
        """Report what came since the last call."""
        for subscriber in self._come:
            while (sample := subscriber.try_recv()) is not None:
                key = on_one_line(str(sample.key_expr))
                found.add(Note.FOREIGN_MESSAGE, "put", ("", "", f"a message on {key}"), now_ns)
        if now_ns < self._check_ns:
            return
        self._check_ns = now_ns + CHECK_NS
        offered = {str(one.key_expr) for one in self._offers if _is_matched(one)}
        for key in sorted(offered - self._offered):
            found.add(Note.FOREIGN_MESSAGE, f"answers {key}", ("", "", f"answers to queries of {key}"), now_ns)
        self._offered = offered


def _is_matched(querier: zenoh.Querier) -> bool:
    """Whether somebody would answer. (zenoh 1.10's stub says bool; it is an object, and always true.)"""
    return bool(getattr(querier.matching_status, "matching", querier.matching_status))
