"""How many files, sockets and pipes a process may have open: too few, and any of its steps fails half-way."""

from __future__ import annotations

import contextlib
import resource

LEAST = 64
"""The gateway has about 40 open with one client, every other process fewer."""
ENOUGH = 1024


def shortage() -> str | None:
    """Raise a low limit as far as it may be; one line if it stays too low for any command to begin."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < ENOUGH:
        wanted = ENOUGH if hard < 0 else min(ENOUGH, hard)
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= soft < LEAST:
        return f"found a limit of {soft} open files, expected {LEAST} or more: raise it with ulimit -n {ENOUGH}"
    return None
