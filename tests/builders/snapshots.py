"""Snapshots with some values changed, also those in groups of findings."""

from __future__ import annotations

import copy
from collections.abc import Mapping

from rigctl.control.snapshot import Snapshot


def put(snapshot: Snapshot, values: Mapping[str, object]) -> None:
    """Set these values, by the fields' names, as ``sinking.speed_mm_s`` in a group."""
    for name, value in values.items():
        group, _, field = name.rpartition(".")
        owner = snapshot
        for part in group.split(".") if group else ():
            owner = getattr(owner, part)
        setattr(owner, field, value)


def changed(snapshot: Snapshot, values: Mapping[str, object]) -> Snapshot:
    """A copy with these values, which shares no group with the original."""
    found = copy.deepcopy(snapshot)
    put(found, values)
    return found
