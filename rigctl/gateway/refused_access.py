"""What the access list and TLS refuse, for the audit log: Zenoh drops it without an answer, but logs it.

Zenoh writes each line of its log to standard output with one call. Here that is a datagram socket of loopback, which
keeps lines apart whatever a key contains, and drops what is not read in time, so that no flood makes Zenoh wait.
"""

from __future__ import annotations

import os
import re
import socket
from dataclasses import dataclass, field
from typing import TypeVar

import zenoh

from rigctl.config.one_line import on_one_line
from rigctl.ipc.notes import Note
from rigctl.model.quantity import count

FILTER = (
    "off,zenoh_link_tls::unicast=warn,zenoh_transport::unicast::establishment::accept=debug,"
    "zenoh::net::routing::interceptor=trace"
)
LINES_MAX = 400  # read in one call; at 50 calls a second this is more than 100 clients cause
REPORT_NS, REPORT_MAX_NS = 10_000_000_000, 3_600_000_000_000  # between two reports of one kind: doubled each time
ADDRESS_NS = 500_000_000  # Zenoh may write a session's address after the refusal of its first message
GROUPS_MAX, PEERS_MAX = 64, 1024
LONGEST, BUFFER_BYTES = 65_536, 4 << 20  # a session of one client is 200 lines, each of which takes 1 KiB
LOCAL, UNNAMED = "a process on the gateway's socket", "no certificate"

_JUDGED = re.compile(
    rb"(ThreadId\(\d+\)) zenoh::net::routing::interceptor::access_control: (?:Using cached result: )?([0-9a-f]+)"
    rb"(?: on (\S+))? is unauthorized to ([A-Za-z/ ]{1,40}) \(ingress\) on (.*)",
    re.DOTALL,
)
_DROPPED = re.compile(rb"(ThreadId\(\d+\)) zenoh::net::routing::interceptor: Msg intercepted!\s*\Z")
_ACCEPTED = re.compile(
    rb"unicast::establishment::accept: New transport link accepted from ([0-9a-f]+) .*? dst: ([^,]+),"
)
_HANDSHAKE = re.compile(rb" WARN .*? zenoh_link_tls::unicast: (.*)", re.DOTALL)
_HINT = re.compile(r"\.? Hint: .*", re.DOTALL)
_COMMON_NAME = re.compile(r"CertCommonName\(([^()]*)\)")
_HANDSHAKES = {
    "sent no certificates": "it has no certificate",
    "UnknownIssuer": "its certificate is of another authority",
    "BadSignature": "its certificate is of another authority",
    "certificate expired": "its certificate has expired",
    "not valid yet": "its certificate is not valid yet",
    "fatal alert": "it does not accept the certificate of this rig",
    "corrupt message": "it speaks no TLS",
}


_Some = TypeVar("_Some")


@dataclass(frozen=True)
class AccessRefusal:
    """Something refused, for a note. ``who``: name in the certificate, if there is one; ``other``: more about it."""

    note: Note
    who: str
    other: str
    text: str
    number: int
    span_ns: int

    @property
    def words(self) -> str:
        """What was refused, and how often."""
        seconds = f" in {self.span_ns / 1e9:.0f} s" if self.span_ns >= REPORT_NS else ""
        return self.text + (f" ({count(self.number, 'time')}{seconds})" if self.number > 1 else "")


@dataclass
class _Group:
    """Refusals of one kind; those after the first are reported together."""

    next_ns: int
    gap_ns: int = REPORT_NS
    since_ns: int = 0
    number: int = 0
    newest: tuple[str, str, str] = ("", "", "")
    session: bytes = b""


@dataclass
class RefusedAccess:
    """Reads lines of Zenoh's log. Pure: time is passed in."""

    _judged: dict[bytes, re.Match[bytes]] = field(default_factory=dict)  # thread: its last judgement
    _names: dict[bytes, tuple[str, str]] = field(default_factory=dict)  # session: common name, and what it came by
    _peers: dict[bytes, str] = field(default_factory=dict)  # session: address
    _groups: dict[tuple[Note, str], _Group] = field(default_factory=dict)

    def take(self, line: bytes, now_ns: int) -> None:
        """Take one line."""
        if b"zenoh::net::routing" in line:
            if b" is unauthorized to " in line and (judged := _JUDGED.search(line)):
                self._judged[judged[1]] = judged
                if judged[3] is not None:
                    _remember(self._names, judged[2], _came_by(judged[3].decode(errors="replace")))
            elif (dropped := _DROPPED.search(line)) and (message := self._judged.pop(dropped[1], None)):
                self._drop(message, now_ns)
            return
        if accepted := _ACCEPTED.search(line):
            address = accepted[2].decode(errors="replace")
            _remember(self._peers, accepted[1], "" if address.startswith("unixsock") else address)
        elif failed := _HANDSHAKE.search(line):
            why = _HINT.sub("", failed[1].decode(errors="replace")).strip()
            known = next((text for part, text in _HANDSHAKES.items() if part in why), "")
            self.add(Note.CONNECTION_REFUSED, known, ("", "", known or f"TLS failed: {on_one_line(why)}"), now_ns)

    def _drop(self, message: re.Match[bytes], now_ns: int) -> None:
        """A message was judged and dropped; without the drop, Zenoh only looked ahead at what it would refuse."""
        session, what = message[2], message[4].decode()
        certificate, other = self._names.get(session, ("", UNNAMED))
        name = certificate.rpartition(".")[0]
        key = on_one_line(message[5].decode(errors="replace").removesuffix("\n"))
        newest = (name, other, f"{what.lower()} of {key}")
        self.add(Note.MESSAGE_REFUSED, f"{what} of {other}", newest, now_ns, session)

    def add(self, note: Note, what: str, newest: tuple[str, str, str], now_ns: int, session: bytes = b"") -> None:
        """Take one of the kind ``what``; ``newest``: who, other and text of its note; ``session``: whose it was."""
        kind = (note, what)
        kind = kind if kind in self._groups or len(self._groups) < GROUPS_MAX else (note, "others")
        group = self._groups.setdefault(kind, _Group(now_ns))
        if not group.number:
            group.since_ns = now_ns
        group.number, group.newest, group.session = group.number + 1, newest, session

    def due(self, now_ns: int) -> list[AccessRefusal]:
        """What is to be put on record now: the first of a kind at once, more of it together and ever less often."""
        found = []
        for kind, group in list(self._groups.items()):
            if now_ns < group.next_ns:
                continue
            unknown = group.session and group.session not in self._peers
            if group.number and unknown and now_ns - group.since_ns < ADDRESS_NS:
                continue
            if group.number:
                who, other, text = group.newest
                other = ", ".join(filter(None, (other, self._peers.get(group.session, ""))))
                found.append(AccessRefusal(kind[0], who, other, text, group.number, now_ns - group.since_ns))
                group.next_ns, group.number = now_ns + group.gap_ns, 0
                group.gap_ns = min(2 * group.gap_ns, REPORT_MAX_NS)
            elif now_ns - group.next_ns > REPORT_MAX_NS:
                del self._groups[kind]
        return found


def _came_by(subject: str) -> tuple[str, str]:
    """The certificate of a session in Zenoh's words of it, empty without one; and the certificate or link in ours."""
    if found := _COMMON_NAME.search(subject):
        return found[1], f"certificate {found[1]}"
    return "", LOCAL if "Transport(UnixsockStream)" in subject else UNNAMED


def _remember(known: dict[bytes, _Some], session: bytes, value: _Some) -> None:
    known.pop(session, None)
    known[session] = value
    if len(known) > PEERS_MAX:
        del known[next(iter(known))]


class ZenohLog:
    """Zenoh's log of this process."""

    def __init__(self) -> None:
        """Begin it: before the first session, once in a process, which prints nothing itself from then on."""
        self._reading = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as writing:
            for one in (self._reading, writing):
                one.bind(("127.0.0.1", 0))
            self._reading.connect(writing.getsockname())  # from then on no other socket's datagrams arrive
            writing.connect(self._reading.getsockname())
            self._reading.setblocking(False)
            self._reading.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)  # at most what the host allows
            self.lines()
            os.dup2(writing.fileno(), 1)
        os.environ.pop("RUST_LOG", None)  # it would replace the filter
        os.environ["NO_COLOR"] = "1"
        zenoh.init_log_from_env_or(FILTER)

    def lines(self) -> list[bytes]:
        """The lines written since the last call, at most ``LINES_MAX``."""
        found: list[bytes] = []
        try:
            while len(found) < LINES_MAX:
                found.append(self._reading.recv(LONGEST))
        except OSError:
            return found
        return found
