"""HOLD to a daemon of this computer, without the network: any user may, and gives it to the loop itself."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from typing import Any

from rigctl.client.local_daemons import LocalDaemon, local_daemons, meant
from rigctl.ipc import hold_socket
from rigctl.wire.user_name import user_name, with_user

ANSWER_S = 1.0  # sending included; the loop answers in the tick that takes it, so longer is for a busy computer
VIA = "local socket"
_NO_SOCKET = (
    "has no socket for HOLD: it is about to start, or of another version; that version's page and rigctl give it HOLD"
)


def held_here(endpoint: str, rig: str | None) -> list[LocalDaemon]:
    """The daemons of this computer that a HOLD for ``rig``, or for any, at ``endpoint`` goes to.

    A HOLD meant for a daemon elsewhere never reaches another one here. One that this user may believe is the only one;
    of other users' daemons, where anybody can claim to be the one meant, it goes to each.
    """
    own = [one for one in meant(local_daemons(), endpoint, rig) if one.runs]
    return own[:1] or [one for one in meant(local_daemons(of_others=True), endpoint, rig) if one.runs]


def hold(endpoint: str, rig: str | None, operator: str, answer_s: float = ANSWER_S) -> dict[str, Any] | None:
    """Give HOLD on a local socket; returns the answer, or None where no daemon of this computer is meant.

    Of several answers it is one of a loop that does not hold, if there is one. ``operator``: beside this user, may be
    empty. ``answer_s``: limit for the loop's.
    """
    answers = [_given(one, operator, answer_s) for one in held_here(endpoint, rig)]
    return min(answers, key=lambda answer: bool(answer["accepted"]), default=None)


def _given(daemon: LocalDaemon, operator: str, answer_s: float) -> dict[str, Any]:
    until, answer, why = time.monotonic() + answer_s, None, "does not answer"
    is_own = daemon.place.is_shared or daemon.owner == os.geteuid()
    for uid in _own_numbers():
        place, left_s = daemon.place.place(hold_socket.socket_name(uid)), max(0.0, until - time.monotonic())
        try:
            given = hold_socket.give(place, operator, left_s, daemon.owner)
        except OSError as error:  # this user has no socket of his own, or the loop is just being replaced
            if uid is None and not isinstance(error, PermissionError):
                why = _NO_SOCKET if isinstance(error, FileNotFoundError) else why
                break
            continue
        full = _full(operator, uid)
        answer = _not_held(daemon, full, why) if given is None else _worded(given, full)
        break
    answer = answer or _not_held(daemon, _full(operator), why)
    return answer if is_own else answer | {"text": f"{answer['text']} (the daemon is of {user_name(daemon.owner)})"}


def _own_numbers() -> Iterator[int | None]:
    """The users whose socket may be this one's, None for that of the others.

    In a user namespace (``unshare -Ur``) a process finds another number than the kernel gives the loop. Which socket it
    may open, the kernel decides by its own; at most one of them is his.
    """
    yield from (os.geteuid(), None)
    import pwd  # a directory of very many users is asked last, and only there

    for entry in pwd.getpwall():
        yield entry.pw_uid


def _full(operator: str, uid: int | None = None) -> str:
    """The operator's name with this user's, which is looked up only after HOLD has been given."""
    return with_user(operator, user_name(os.geteuid() if uid is None else uid))


def _not_held(daemon: LocalDaemon, operator: str, why: str) -> dict[str, Any]:
    text = f"HOLD: the loop of {daemon.rig} {why}; the emergency stop needs no program"
    return {"accepted": False, "verb": "hold", "operator": operator, "reason": "no_answer", "text": text, "via": VIA}


def _worded(given: hold_socket.HoldAnswer, operator: str) -> dict[str, Any]:
    """The answer as the gateway gives it."""
    value = given.tension_n if math.isfinite(given.tension_n) else None
    about = {"mode": given.mode, "t_ns": given.t_ns, "value": value, "via": VIA}
    if given.accepted:
        done = hold_socket.HELD.format(stroke=f"{given.stroke_mm:z.2f} mm", tension=f"{given.tension_n:z.1f} N")
        return {"accepted": True, "verb": "hold", "operator": operator, "text": f"HOLD: {done}", **about}
    from rigctl.wire.command_request import hold_refused  # slow: a refusal has time

    return hold_refused(given, operator) | about
