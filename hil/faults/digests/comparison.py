"""Digests of two commits, compared."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.faults.digests import name_map
from hil.faults.digests.streams import Digests

Rows = Mapping[str, Digests]


class MovedRow(NamedTuple):
    """A row whose digests differ, and the names that do, as ``stream/name``."""

    key: str
    names: tuple[str, ...]


def sums(digests: Digests) -> dict[str, str]:
    """A sum over the names of each stream."""
    return {stream: _sum(names) for stream, names in digests.items()}


def sum_of(rows: Rows) -> str:
    """One sum over all rows, in whatever order they were played."""
    return _sum({key: _sum(sums(digests)) for key, digests in rows.items()})


def moved(rows: Rows, other: Rows) -> list[MovedRow]:
    """The rows of either side that are not the same on both, in the order of the first.

    A name that only one side has is a difference, but for those that `hil.faults.digests.name_map` leaves out.
    """
    found = []
    for key in dict.fromkeys((*rows, *other)):
        here, there = _flat(rows.get(key)), _flat(other.get(key))
        there = {name: digest for name, digest in there.items() if name not in name_map.REMOVED}
        names = tuple(
            name for name in dict.fromkeys((*here, *there)) if here.get(name) != there.get(name)
        )  # fmt: skip
        if names:
            found.append(MovedRow(key, names))
    return found


def _flat(digests: Any) -> dict[str, str]:
    if digests is None:
        return {"row/played": "no"}
    named = {f"{stream}/{name}": digest for stream, names in digests.items() for name, digest in names.items()}
    return {"row/played": "yes", **named}


def _sum(names: Mapping[str, str]) -> str:
    return hashlib.sha256("\n".join(f"{name} {names[name]}" for name in sorted(names)).encode()).hexdigest()[:16]
