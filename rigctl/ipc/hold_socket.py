"""HOLD from a program of this computer to the loop, past the network: the loop's sockets and the datagrams on them.

The loop owns datagram sockets in its run-time folder (`rigctl.control.bus.hold_sockets`), one for each user of the
computer, because the kernel's queue of a socket is short and whoever floods it shuts out all its other senders. A
request is one datagram with the operator's name; the kernel adds user and process. The answer goes to the abstract
address that the sender has bound, and the kernel adds the loop's user to it.
"""

from __future__ import annotations

import contextlib
import pathlib
import socket
import struct
import time
from typing import NamedTuple

HOLD_SOCKETS = "hold."
"""The names of the sockets in the folder begin with this, and end with the user's number or with ``OTHERS``."""
OTHERS = "others"
NAME_BYTES = 1024
HELD = "stroke held at {stroke}, tension {tension}"
"""What an accepted HOLD has done, in words."""
CREDENTIALS = struct.Struct("iII")
"""struct ucred: pid, uid, gid."""
CREDENTIALS_ROOM = socket.CMSG_SPACE(CREDENTIALS.size)
_ANSWER = struct.Struct("<8sqBHQHdd16s")
_MARK = b"HOLD-1"
ANSWER_BYTES = _ANSWER.size


def socket_name(uid: int | None) -> str:
    """Name of the socket of a user; None: of those without one of their own."""
    return f"{HOLD_SOCKETS}{OTHERS if uid is None else uid}"


class HoldAnswer(NamedTuple):
    """The loop's answer: ``t_ns`` of the tick that has taken the HOLD, and the state after it."""

    t_ns: int
    accepted: bool
    reason: int  # see rigctl.model.verbs.Refusal
    checks: int
    fault: int
    stroke_mm: float
    tension_n: float
    mode: str

    def packed(self) -> bytes:
        """The datagram."""
        *numbers, mode = self
        return _ANSWER.pack(_MARK, *numbers, mode.encode())

    @classmethod
    def unpacked(cls, data: bytes) -> HoldAnswer | None:
        """The answer in a datagram; None for any other."""
        if len(data) != _ANSWER.size:
            return None
        mark, t_ns, accepted, reason, checks, fault, stroke_mm, tension_n, mode = _ANSWER.unpack(data)
        if mark.rstrip(b"\0") != _MARK:
            return None
        name = mode.rstrip(b"\0").decode(errors="replace")
        if not name.isidentifier():  # anything else would be printed
            return None
        return cls(t_ns, bool(accepted), reason, checks, fault, stroke_mm, tension_n, name)


def give(place: pathlib.Path, operator: str, limit_s: float, owner: int) -> HoldAnswer | None:
    """Give HOLD on a socket of the loop; returns its answer, None without one of ``owner`` within ``limit_s``.

    Raises:
        OSError: the socket did not take it: it is not there, not this user's, or its queue stays full.
    """
    until = time.monotonic() + limit_s
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        own.bind("")  # an abstract address of its own; once connected, it takes datagrams of the loop alone
        own.connect(str(place))
        own.settimeout(limit_s)
        own.send(operator.encode(errors="replace")[:NAME_BYTES])
        own.settimeout(max(0.0, until - time.monotonic()))
        with contextlib.suppress(OSError):
            data, ancillary, *_ = own.recvmsg(ANSWER_BYTES + 1, CREDENTIALS_ROOM)
            if CREDENTIALS.unpack(ancillary[0][2])[1] == owner:
                return HoldAnswer.unpacked(data)
    return None
