"""Memory of the daemon's processes: the limit of each, and the order in which the kernel ends them when it runs out.

The loop is ended last. The processes on the network have limits, so that a flood ends only the process it reaches,
which is replaced, before the computer begins to swap.
"""

from __future__ import annotations

import contextlib
import pathlib
import resource
from dataclasses import dataclass

_MIB = 1 << 20


@dataclass(frozen=True)
class Share:
    """``oom_score_adj``: see proc(5), higher ends sooner. ``data_mib``: limit of private memory (RLIMIT_DATA)."""

    oom_score_adj: int
    data_mib: int | None = None


SUPERVISOR = Share(-800)
"""The loop ends with the supervisor, in order, because it gets a signal when its parent ends."""
SHARES = {
    "control": Share(-900),  # -1000 would exempt it even when nothing else is left to end
    "recorder": Share(300, 1024),
    "gateway": Share(500, 1024),  # with one client it takes 200 MiB
    "page": Share(800, 1024),
}


def apply(share: Share, pid: int) -> None:
    """Give a process its share; without CAP_SYS_RESOURCE a negative score is not set."""
    with contextlib.suppress(OSError):
        pathlib.Path(f"/proc/{pid}/oom_score_adj").write_text(str(share.oom_score_adj))
    if share.data_mib is not None:
        limit = share.data_mib * _MIB
        with contextlib.suppress(OSError, ValueError):  # a lower limit is in force, or the process has ended
            resource.prlimit(pid, resource.RLIMIT_DATA, (limit, limit))
