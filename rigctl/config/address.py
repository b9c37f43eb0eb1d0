"""Addresses, ``HOST:PORT``, of the page and of Zenoh endpoints, ``PROTOCOL/HOST:PORT``; who reaches them."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass

_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")
NETWORK_PROTOCOLS = ("tcp", "tls")
"""Protocols of endpoints that have an address."""
EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Hosts that stand for every interface, and a host of this computer for each."""
ALLOWED = "HOST:PORT, e.g. 127.0.0.1:8080 or [::1]:8080"


class AddressError(ValueError):
    """Text that is no address; ``str()`` is one line."""

    def __init__(self, found: str) -> None:
        super().__init__(f"found {found!r}, expected {ALLOWED}")


class CannotListenError(RuntimeError):
    """The socket cannot be opened; ``str()`` is one line."""


@dataclass(frozen=True)
class Address:
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
