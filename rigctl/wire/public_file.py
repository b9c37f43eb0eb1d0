"""The public file of a daemon's run-time folder: by it a client finds the daemon of an endpoint on this computer."""

from __future__ import annotations

import msgspec

from rigctl.config.built_type import built
from rigctl.ipc.folder_places import PUBLIC

__all__ = ["PUBLIC", "PublicFile"]


@built
class PublicFile(msgspec.Struct):
    """``listen``, ``join``: as in the rig file; ``run_id``: of the daemon that runs."""

    rig: str
    listen: str
    run_id: str
    join: list[str] = []
