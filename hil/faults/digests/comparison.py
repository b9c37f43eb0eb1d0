"""Digests of two commits, compared."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import NamedTuple

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
    """The rows of both sides that are not the same, in the order of the first.

    A name that only one side has is a difference, but for those that `hil.faults.digests.name_map` leaves out.
    """
    found = []
    for key in (key for key in rows if key in other):
        here, there = _flat(rows[key]), _flat(other[key])
        there = {name: digest for name, digest in there.items() if name not in name_map.REMOVED}
        names = tuple(
            name for name in dict.fromkeys((*here, *there)) if here.get(name) != there.get(name)
        )  # fmt: skip
        if names:
            found.append(MovedRow(key, names))
    return found


def _flat(digests: Digests) -> dict[str, str]:
    return {f"{stream}/{name}": digest for stream, names in digests.items() for name, digest in names.items()}


def _sum(names: Mapping[str, str]) -> str:
    return hashlib.sha256("\n".join(f"{name} {names[name]}" for name in sorted(names)).encode()).hexdigest()[:16]
