"""Keeps this process off the loop's processor."""

from __future__ import annotations

import contextlib
import os
import pathlib


def keep_off(cpu: int | None) -> None:
    """Keep every thread of this process off a processor, where there is another; None: no processor."""
    others = os.sched_getaffinity(0) - {cpu}
    if cpu is not None and others:
        for thread in pathlib.Path("/proc/self/task").iterdir():
            with contextlib.suppress(OSError):  # it has ended
                os.sched_setaffinity(int(thread.name), others)
