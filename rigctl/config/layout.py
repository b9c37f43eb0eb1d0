"""Where an installed rig keeps its files, and where a rig file elsewhere does: the one place that knows both.

A rig file in ``/etc/rigctl`` belongs to the installed service, whose units let it write nowhere else than in
``/var/lib/rigctl`` (ledger, last known stroke, audit log, trip dumps, recordings), ``/var/cache/rigctl`` (results of
the design) and ``/run/rigctl`` (run-time folder). Any other rig file, as in a checkout, has its data beside it and its
run-time folder in ``/dev/shm``.
"""

from __future__ import annotations

import pathlib

SETTINGS = pathlib.Path("/etc/rigctl")
"""Rig files of the installed service, each named after its rig, with the files that they name."""
STATE = pathlib.Path("/var/lib/rigctl")
CACHE = pathlib.Path("/var/cache/rigctl")
"""Of the supervisor's user: what may be lost."""
RUN = pathlib.Path("/run/rigctl")
SHARED_MEMORY = pathlib.Path("/dev/shm")


def is_installed(folder: str | pathlib.Path) -> bool:
    """Whether the rig file in ``folder`` is the service's."""
    return pathlib.Path(folder) == SETTINGS


def state_folder(folder: str | pathlib.Path) -> pathlib.Path:
    """Folder that relative names of kept data start from, for a rig file in ``folder``."""
    return STATE if is_installed(folder) else pathlib.Path(folder)


def run_base(folder: str | pathlib.Path) -> pathlib.Path:
    """Parent of the run-time folder, for a rig file in ``folder``."""
    return RUN if is_installed(folder) else SHARED_MEMORY
