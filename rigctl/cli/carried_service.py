"""Whether the motor of an installed rig's running daemon carries a load, so that its services are not to be stopped."""

from __future__ import annotations

import time

from rigctl.config import layout
from rigctl.ipc.folder_places import daemon_pid
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import FolderError, Runtime
from rigctl.model.states import Flag

ALIVE_NS = 1_000_000_000
"""A loop whose newest record is older commands no motor any more."""
_OR = "or add --leave-load: the end of the daemon lowers the load, and leaves what it cannot lower"


def refusal(rig: str) -> str:
    """Why the services of the rig are not to be stopped, and what to do, in one line; empty where nothing bars it."""
    folder = layout.RUN / f"rigctl-{rig}"
    if not daemon_pid(folder):
        return ""
    try:
        runtime = Runtime.entered(folder)
        newest = runtime.records.reader().latest()
        runtime.leave()
    except (OSError, FolderError, RingError) as error:
        return f"{rig}: it cannot be read whether the motor carries a load ({error}): bring it to DISARMED first, {_OR}"
    if newest is None or time.monotonic_ns() - int(newest["t_ns"]) > ALIVE_NS:
        return ""
    if not int(newest["flags"]) & Flag.CARRIES:
        return ""
    load = f"a load of {float(newest['tension_n']):z.0f} N"
    return f"{rig}: the motor carries {load} that the brake may not hold: rigctl lower first, {_OR}"
