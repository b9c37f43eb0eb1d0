"""What is met at a daemon's endpoint, step by step: its host, its port, TLS. Zenoh gives one error for all of them."""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import threading
from enum import Enum, auto
from typing import NamedTuple

from rigctl.config.address import NETWORK_PROTOCOLS, Address, is_address
from rigctl.identity.credentials import Credentials

LIMIT_S = 2.0
_ALERT_S = 0.5  # by then a listener has refused a certificate; TLS 1.3 does so after the handshake
_REFUSED_KEY = ("ALERT", "CERTIFICATE_REQUIRED")


class Met(Enum):
    """How far a connection gets."""

    NO_ADDRESS = auto()  # the endpoint has none: a Unix socket
    UNKNOWN_HOST = auto()
    SILENT_HOST = auto()
    NOTHING = auto()  # nothing listens at the port
    NO_TLS = auto()  # what listens there speaks something else
    OTHER_AUTHORITY = auto()  # its certificate is of another authority than the key's, or of another host
    REFUSES_KEY = auto()
    SILENT = auto()  # it takes connections, and does no handshake
    OPEN = auto()  # it has taken the connection, and the key


class Probed(NamedTuple):
    """What was met, and the system's words for it."""

    met: Met
    words: str = ""


def probe(endpoint: str, owned: Credentials | None = None) -> Probed:
    """Connect to an endpoint, each step within ``LIMIT_S``; ``owned``: the key for one ``tls/``."""
    protocol, _, where = endpoint.partition("/")
    if protocol not in NETWORK_PROTOCOLS or not is_address(where):
        return Probed(Met.NO_ADDRESS)
    address = Address.parse(where)
    if (unknown := _unknown(address)) is not None:
        return Probed(Met.UNKNOWN_HOST, unknown)
    try:
        with socket.create_connection(address, LIMIT_S) as connection:
            return _handshake(connection, address, owned) if owned is not None else Probed(Met.OPEN)
    except ConnectionRefusedError as error:
        return Probed(Met.NOTHING, _words(error))
    except OSError as error:
        return Probed(Met.SILENT_HOST, _words(error))


def _unknown(address: Address) -> str | None:
    """Why the host's name has no address; None if it has. A name server that is silent is not waited for."""
    found: list[str | None] = []

    def look_up() -> None:
        try:
            socket.getaddrinfo(*address, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            found.append(_words(error))
        else:
            found.append(None)

    thread = threading.Thread(target=look_up, name="look up", daemon=True)
    thread.start()
    thread.join(LIMIT_S)
    return found[0] if found else "no name server answers"


def _handshake(connection: socket.socket, address: Address, owned: Credentials) -> Probed:
    try:
        with _context(owned).wrap_socket(connection, server_hostname=address.host) as session:
            session.settimeout(_ALERT_S)
            with contextlib.suppress(TimeoutError):
                session.recv(1)
            return Probed(Met.OPEN)
    except ssl.SSLCertVerificationError as error:
        return Probed(Met.OTHER_AUTHORITY, error.verify_message)
    except ssl.SSLError as error:
        reason = str(error.reason or error)
        met = Met.REFUSES_KEY if any(word in reason for word in _REFUSED_KEY) else Met.NO_TLS
        return Probed(met, reason.lower().replace("_", " "))
    except TimeoutError:
        return Probed(Met.SILENT)
    except OSError as error:  # it ends the connection at once
        return Probed(Met.NO_TLS, _words(error))


def _context(owned: Credentials) -> ssl.SSLContext:
    context = ssl.create_default_context(cadata=owned.authority)
    memory = os.memfd_create("key")  # ssl takes a key from a file alone
    try:
        os.write(memory, (owned.key + owned.certificate).encode())
        context.load_cert_chain(f"/proc/self/fd/{memory}")
    finally:
        os.close(memory)
    return context


def _words(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) else ""
    return (text or str(error) or type(error).__name__).lower()
