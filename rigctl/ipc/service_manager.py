"""Notifies the service manager that started this process (sd_notify protocol)."""

from __future__ import annotations

import contextlib
import os
import socket
import time

WATCHDOG_PERIOD_S = 0.5


def notify(state: str) -> None:
    """Send one state, as ``READY=1``; nothing happens without a service manager, or with one that does not read."""
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
            sock.connect("\0" + address[1:] if address.startswith("@") else address)
            sock.send(state.encode(), socket.MSG_DONTWAIT)  # never wait for a manager that does not read


def unnotified() -> dict[str, str]:
    """Environment of a process that must not feed the watchdog of its parent's service."""
    return {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}


class Watchdog:
    """Feeds the service's watchdog, at most twice a second."""

    def __init__(self) -> None:
        self._feed_at = 0.0

    def feed(self) -> None:
        """The process makes progress."""
        if (now := time.monotonic()) >= self._feed_at:
            self._feed_at = now + WATCHDOG_PERIOD_S
            notify("WATCHDOG=1")
