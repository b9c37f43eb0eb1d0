"""The limit of open files, sockets and pipes: with too low a limit a command fails half-way."""

from __future__ import annotations

import contextlib
import resource

LEAST = 64
"""The gateway needs about 40 with one client, every other process fewer."""
ENOUGH = 1024


def shortage() -> str | None:
    """Raise a low limit as far as allowed; returns one line if it stays too low for any command."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < ENOUGH:
        wanted = ENOUGH if hard < 0 else min(ENOUGH, hard)
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= soft < LEAST:
        return f"found a limit of {soft} open files, expected {LEAST} or more: raise it with ulimit -n {ENOUGH}"
    return None
