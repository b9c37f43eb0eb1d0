"""Memory of the daemon's processes: how much each may take, and which the kernel ends first when there is none left.

The loop goes last. What serves the network has a limit of its own, so that a flood ends the process it came to, which
is replaced, before the computer begins to swap.
"""

from __future__ import annotations

import contextlib
import pathlib
import resource
from dataclasses import dataclass

_MIB = 1 << 20


@dataclass(frozen=True)
class Share:
    """``oom_score_adj``: see proc(5), higher goes sooner. ``data_mib``: private memory at most (RLIMIT_DATA)."""

    oom_score_adj: int
    data_mib: int | None = None


SUPERVISOR = Share(-800)
"""With it goes the loop, in order: it is told to end with its parent."""
SHARES = {
    "hold": Share(-850, 512),  # the operator's last way in
    "control": Share(-900),  # -1000 would have it go on when nothing else is left to end
    "recorder": Share(300, 1024),
    "gateway": Share(500, 1024),  # with one client it takes 200 MiB
    "page": Share(800, 1024),
}


def apply(share: Share, pid: int) -> None:
    """Give a process its share; less than zero needs CAP_SYS_RESOURCE, without which the score stays as it is."""
    with contextlib.suppress(OSError):
        pathlib.Path(f"/proc/{pid}/oom_score_adj").write_text(str(share.oom_score_adj))
    if share.data_mib is not None:
        limit = share.data_mib * _MIB
        with contextlib.suppress(OSError, ValueError):  # a lower one is in force, or the process has ended
            resource.prlimit(pid, resource.RLIMIT_DATA, (limit, limit))
