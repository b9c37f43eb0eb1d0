"""Notifies the service manager that started this process (sd_notify protocol)."""

from __future__ import annotations

import contextlib
import os
import socket


def notify(state: str) -> None:
    """Send one state, as ``READY=1``; nothing happens without a service manager, or with one that does not read."""
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
            sock.connect("\0" + address[1:] if address.startswith("@") else address)
            sock.send(state.encode(), socket.MSG_DONTWAIT)  # never wait for a manager that does not read
