"""What a shell completes at the Tab key beside names of commands and options."""

from __future__ import annotations

import glob
import time

RIG_FILES = (".yaml", ".yml")


def rig_files(begin: str) -> list[str]:
    """YAML files that begin so; where there are none the shell completes folders and files itself."""
    return sorted(name for end in RIG_FILES for name in glob.glob(f"{glob.escape(begin)}*{end}"))  # noqa: PTH207 - as typed


def causes(begin: str) -> list[str]:
    """Causes of the alarms of the daemon that answers by default; none without one."""
    from rigctl.client.connection import ChoiceError, Client, NoDaemonError
    from rigctl.wire.alarms import Alarms

    try:
        with Client() as client:
            names = [row.cause for row in Alarms(client.past_events()).rows(client.state(), time.time_ns())]
    except (NoDaemonError, ChoiceError):
        return []
    return [name for name in names if name.startswith(begin)]
