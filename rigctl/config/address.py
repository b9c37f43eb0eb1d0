"""Addresses, ``HOST:PORT``, of the page and of Zenoh endpoints, ``PROTOCOL/HOST:PORT``; who reaches them."""

from __future__ import annotations

import ipaddress
import os
import re
import socket
from typing import NamedTuple

_LABEL = r"[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")
_HOST_NAME = re.compile(rf"(?=.{{1,253}}\Z){_LABEL}(?:\.{_LABEL})*")
_HEADER = re.compile(r"(\[[0-9a-f:.%]+\]|[^:\[\]]+)(:[0-9]{1,5})?")  # Host, lower case: the host, and a port
NETWORK_PROTOCOLS = ("tcp", "tls")
"""Protocols of endpoints that have an address."""
LONGEST_PATH_BYTES = 107
"""Of a Unix socket's path: ``sun_path`` of Linux, without the zero at its end."""
EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Hosts that stand for every interface, and a host of this computer for each."""
PATH_ALLOWED = f"a socket's path of at most {LONGEST_PATH_BYTES} bytes"
HOST_ALLOWED = "a host name (letters, digits, - and .) or an IP address, without port"
ALLOWED = "HOST:PORT, e.g. 127.0.0.1:8080 or [::1]:8080"


class AddressError(ValueError):
    """Text that is no address; ``str()`` is one line."""

    def __init__(self, found: str) -> None:
        super().__init__(f"found {found!r}, expected {ALLOWED}")


class CannotListenError(RuntimeError):
    """The socket cannot be opened; ``str()`` is one line."""


class Address(NamedTuple):
    """A host (name or IP address, IPv6 without brackets) and a TCP port; port 0 means any free port."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Address:
        """An address from ``HOST:PORT``.

        Raises:
            AddressError: the text is no address.
        """
        host, colon, port = text.rpartition(":")
        bracketed = host.startswith("[") and host.endswith("]")
        host = host[1:-1] if bracketed else host
        if not colon or not port.isascii() or not port.isdigit() or len(port) > 5 or int(port) > 65535:
            raise AddressError(text)
        if bracketed:
            try:
                ipaddress.IPv6Address(host)
            except ValueError:
                raise AddressError(text) from None
        elif not _HOST.fullmatch(host) or (re.fullmatch(r"[0-9.]+", host) and not _is_ip(host)):
            raise AddressError(text)
        return cls(host, int(port))

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def is_ip(self) -> bool:
        """Whether the host is an IP address, no name that has to be looked up."""
        return _is_ip(self.host)

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer can connect."""
        return self.host == "localhost" or (self.is_ip and ipaddress.ip_address(self.host).is_loopback)

    def listen(self) -> socket.socket:
        """A socket that listens here.

        Raises:
            CannotListenError: the port is in use, may not be used, or the host is not this computer's.
        """
        try:
            family, _, _, _, where = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)[0]
            return socket.create_server(where[:2], family=family, backlog=64)
        except OSError as error:
            reason = "it is in use" if "in use" in str(error) else error.strerror or str(error)
            raise CannotListenError(f"cannot listen on {self}: {reason}") from None


def is_address(text: str) -> bool:
    """Whether `Address.parse` takes it."""
    try:
        Address.parse(text)
    except AddressError:
        return False
    return True


def is_socket_path(text: str) -> bool:
    """Whether the path of a Unix socket is short enough."""
    return len(os.fsencode(text)) <= LONGEST_PATH_BYTES


def is_host(text: str) -> bool:
    """Whether it is an IP address or a host name (RFC 1123) that a certificate can name; no pattern, no endpoint."""
    digits = re.fullmatch(r"[0-9.]+", text) is not None
    return _is_ip(text) or (not digits and _HOST_NAME.fullmatch(text) is not None)


def names_server(header: str, address: Address) -> bool:
    """Whether an HTTP Host header names a server that listens at ``address``, not a name made to point here.

    A browser's page of a foreign name that resolves to this computer (DNS rebinding) sends that name. Allowed are the
    host that was listened on, this computer's names, and IP addresses: only loopback ones if it listens there alone.
    """
    found = _HEADER.fullmatch(header.lower())
    host = found[1].strip("[]") if found else ""
    if host in {"localhost", address.host.lower(), *_this_host()}:
        return True
    return _is_ip(host) and (not address.is_loopback or ipaddress.ip_address(host).is_loopback)


def _this_host() -> tuple[str, str, str]:
    """Names of this computer: its full name, that without the domain, and that in the link's domain (RFC 6762).

    The first label in any other domain may belong to anyone. ``--listen NAME:PORT`` allows another name.
    """
    name = socket.gethostname().lower()
    label = name.partition(".")[0]
    return name, label, f"{label}.local"


def is_local(endpoint: str) -> bool:
    """Whether only this computer reaches an endpoint."""
    protocol, _, where = endpoint.partition("/")
    return protocol not in NETWORK_PROTOCOLS or (is_address(where) and Address.parse(where).is_loopback)


def here(endpoint: str) -> str:
    """What a client on this computer connects to: an endpoint on every interface at a host of this computer."""
    protocol, _, where = endpoint.partition("/")
    if protocol in NETWORK_PROTOCOLS and (address := Address.parse(where)).host in EVERY_ADDRESS:
        return f"{protocol}/{Address(EVERY_ADDRESS[address.host], address.port)}"
    return endpoint


def _is_ip(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


DEFAULT = Address("127.0.0.1", 8080)
