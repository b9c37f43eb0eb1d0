"""Who may ask the page for what: no other site's page, no other name for this host, no command without the token."""

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
    """Rules of one page server. ``token``: what a command must show, None where there are no commands."""

    address: Address
    token: str | None = None

    def names_us(self, headers: Headers) -> bool:
        """Whether Host is a name of this server: another one is a foreign name that was made to point here."""
        host = _host_of(headers.get("host", ""))
        if host in {"localhost", self.address.host.lower(), *_this_host()}:
            return True
        try:
            ip = ipaddress.ip_address(host)
        except ValueError:
            return False
        return ip.is_loopback or not self.address.is_loopback

    def is_own_page(self, headers: Headers) -> bool:
        """Whether the request comes from a page of this very server, as the browser says."""
        origin = headers.get("origin", "")
        return self.names_us(headers) and origin == f"http://{headers.get('host')}"

    def may_command(self, headers: Headers) -> bool:
        """Whether it shows the token this start of the server printed."""
        shown = headers.get(TOKEN_HEADER, "").encode(errors="replace")
        return self.token is not None and secrets.compare_digest(shown, self.token.encode())


def _this_host() -> tuple[str, str, str]:
    """Whole names of this computer: its own, that without its domain, and that in the link's (RFC 6762).

    Anyone may have its first label in a domain of his own. Another name it is served under: ``--listen NAME:PORT``.
    """
    name = socket.gethostname().lower()
    label = name.partition(".")[0]
    return name, label, f"{label}.local"


def _host_of(header: str) -> str:
    """Host without port, lower case, IPv6 without brackets; empty for what is none."""
    found = re.fullmatch(r"(\[[0-9a-f:.%]+\]|[^:\[\]]+)(:[0-9]{1,5})?", header.lower())
    return found[1].strip("[]") if found else ""
