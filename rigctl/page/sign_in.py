"""Sign-in of the page: a one-time link makes a session, which a cookie and a key prove together.

Browsers send a cookie to every port of a host, so that a server of another user on this computer could read it; scripts
of another port cannot read what this page stores. A request therefore needs the cookie, which no script can read, and
the key, which no other server gets.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers

LINK_S = 600.0
"""Time in which a link can be used, in seconds."""
SESSION_S = 12 * 3600.0
"""Time after which a session ends, in seconds: a shift."""
LINKS, SESSIONS = 8, 64  # the oldest makes room
KEY_HEADER = "x-rigctl-key"
PROTOCOL = "rigctl"
_KEY_PROTOCOL = "rigctl.key."  # a browser's web socket can send no header but its subprotocols


@dataclass(frozen=True)
class Session:
    """What a browser gets when it has signed in."""

    cookie: str
    key: str


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode(errors="replace")).digest()


class SignIn:
    """Links and sessions of one page server; a server that is started anew knows none."""

    def __init__(self, now_s: Callable[[], float], cookie_name: str = "rigctl", *, secure: bool = False) -> None:
        """``now_s``: a monotonic clock. ``secure``: the page is served by HTTPS."""
        self._now_s, self._secure = now_s, secure
        # The prefix makes browsers refuse a cookie of this name that plain HTTP or another path sets.
        self._name = f"__Host-{cookie_name}" if secure else cookie_name
        self._links: dict[bytes, float] = {}
        self._sessions: dict[bytes, tuple[bytes, float]] = {}

    def link(self) -> str:
        """A new one-time code, to be used within ``LINK_S``."""
        code = secrets.token_urlsafe(24)
        while len(self._links) >= LINKS:
            del self._links[next(iter(self._links))]
        self._links[_digest(code)] = self._now_s() + LINK_S
        return code

    def enter(self, code: str) -> Session | None:
        """A session for a code that was not used before and is not too old; else None."""
        until = self._links.pop(_digest(code), None)
        if until is None or self._now_s() > until:
            return None
        session = Session(secrets.token_urlsafe(32), secrets.token_urlsafe(32))
        while len(self._sessions) >= SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        self._sessions[_digest(session.cookie)] = _digest(session.key), self._now_s() + SESSION_S
        return session

    def knows(self, headers: Headers) -> bool:
        """Whether a request has cookie and key of a session in force."""
        key, until = self._sessions.get(_digest(self._cookie_of(headers)), (b"", 0.0))
        return self._now_s() <= until and secrets.compare_digest(key, _digest(_key_of(headers)))

    def leave(self, headers: Headers) -> None:
        """End the session of a request."""
        if self.knows(headers):
            del self._sessions[_digest(self._cookie_of(headers))]

    def set_cookie(self, cookie: str) -> str:
        """The Set-Cookie header of a session; an empty one deletes it."""
        gone = "" if cookie else "; Max-Age=0"
        return f"{self._name}={cookie}; Path=/; HttpOnly; SameSite=Strict{'; Secure' if self._secure else ''}{gone}"

    def _cookie_of(self, headers: Headers) -> str:
        try:
            found = SimpleCookie("; ".join(headers.getlist("cookie"))).get(self._name)
        except CookieError:
            return ""
        return found.value if found is not None else ""


def _key_of(headers: Headers) -> str:
    for offered in protocols_of(headers):
        if offered.startswith(_KEY_PROTOCOL):
            return offered.removeprefix(_KEY_PROTOCOL)
    return headers.get(KEY_HEADER, "")


def protocols_of(headers: Headers) -> list[str]:
    """Subprotocols that a web socket offers."""
    return [name.strip() for line in headers.getlist("sec-websocket-protocol") for name in line.split(",")]
