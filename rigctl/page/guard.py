"""Checks of a request: no page of another site, no foreign name for this host, nothing of value without a session."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass

from starlette.datastructures import Headers

from rigctl.config.address import Address, names_server
from rigctl.page.sign_in import SignIn

PLAIN_HTTP = "without a certificate, whoever listens on the network can read along and take over a session"
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-cache",
}
DOCS_HEADERS = {
    **HEADERS,
    "content-security-policy": HEADERS["content-security-policy"].replace("img-src 'self'", "img-src 'self' data:"),
}
"""Headers of the documentation, whose style sheets carry their icons."""


@dataclass(frozen=True)
class Guard:
    """Rules of one page server.

    ``operator``: name under which it commands, None for a read-only page. ``sign_in``: sessions are needed for reading
    too. ``tls``: it is served by HTTPS.
    """

    address: Address
    sessions: SignIn
    operator: str | None = None
    sign_in: bool = False
    tls: bool = False

    @classmethod
    def of(cls, address: Address, *, operator: str | None = None, sign_in: bool = False, tls: bool = False) -> Guard:
        """Rules of a server at ``address``; beyond loopback reading always needs a session."""
        sessions = SignIn(time.monotonic, f"rigctl-{address.port}", secure=tls)  # browsers mix the ports' cookies
        return cls(address, sessions, operator, sign_in or not address.is_loopback, tls)

    @property
    def needs_links(self) -> bool:
        """Whether anything here needs a session."""
        return self.sign_in or self.operator is not None

    def names_us(self, headers: Headers) -> bool:
        """Whether Host is a name of this server, not a foreign name made to point here (DNS rebinding)."""
        return names_server(headers.get("host", ""), self.address)

    def is_own_page(self, headers: Headers) -> bool:
        """Whether the request comes from a page of this server, by the browser's Origin header."""
        return self.names_us(headers) and headers.get("origin", "") == f"{self.scheme}://{headers.get('host')}"

    def is_foreign_page(self, headers: Headers) -> bool:
        """Whether the browser says that another site's page makes the request; navigation sends no Origin."""
        return "origin" in headers and not self.is_own_page(headers)

    def may_read(self, headers: Headers) -> bool:
        """Whether the request may see the rig."""
        return not self.sign_in or self.sessions.knows(headers)

    def may_command(self, headers: Headers) -> bool:
        """Whether the request may command the rig."""
        return self.operator is not None and self.sessions.knows(headers)

    @property
    def scheme(self) -> str:
        """``http`` or ``https``."""
        return "https" if self.tls else "http"

    @property
    def url(self) -> str:
        """Address to open; another computer reaches a server that listens everywhere by this computer's name."""
        everywhere = self.address.host in ("0.0.0.0", "::")
        return f"{self.scheme}://{Address(socket.gethostname(), self.address.port) if everywhere else self.address}/"

    def link(self) -> str:
        """A new one-time link. What follows ``#`` stays in the browser: no server or proxy logs it."""
        return f"{self.url}#link={self.sessions.link()}"
