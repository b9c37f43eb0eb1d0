"""Checks of a request: no page of another site, no foreign name for this host, no command without the token."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass

from starlette.datastructures import Headers

from rigctl.config.page_address import Address

TOKEN_HEADER = "x-rigctl-token"
HEADERS = {
    "content-security-policy": "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache",
}


@dataclass(frozen=True)
class Guard:
    """Rules of one page server. ``token``: needed for a command, None for a read-only page."""

    address: Address
    token: str | None = None

    def names_us(self, headers: Headers) -> bool:
        """Whether Host is a name of this server, not a foreign name made to point here (DNS rebinding)."""
        host = _host_of(headers.get("host", ""))
        if host in {"localhost", self.address.host.lower(), *_this_host()}:
            return True
        try:
            ip = ipaddress.ip_address(host)
        except ValueError:
            return False
        return ip.is_loopback or not self.address.is_loopback

    def is_own_page(self, headers: Headers) -> bool:
        """Whether the request comes from a page of this server, by the browser's Origin header."""
        origin = headers.get("origin", "")
        return self.names_us(headers) and origin == f"http://{headers.get('host')}"

    def may_command(self, headers: Headers) -> bool:
        """Whether the request has the token that this server printed at its start."""
        shown = headers.get(TOKEN_HEADER, "").encode(errors="replace")
        return self.token is not None and secrets.compare_digest(shown, self.token.encode())


def _this_host() -> tuple[str, str, str]:
    """Names of this computer: its full name, that without the domain, and that in the link's domain (RFC 6762).

    The first label in any other domain may belong to anyone. ``--listen NAME:PORT`` allows another name.
    """
    name = socket.gethostname().lower()
    label = name.partition(".")[0]
    return name, label, f"{label}.local"


def _host_of(header: str) -> str:
    """Host without port, lower case, IPv6 without brackets; empty if it is not valid."""
    found = re.fullmatch(r"(\[[0-9a-f:.%]+\]|[^:\[\]]+)(:[0-9]{1,5})?", header.lower())
    return found[1].strip("[]") if found else ""
