"""What two files of results have in common, in words."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence

from rigctl.model.quantity import count

_NAMES_SHOWN = 6


def conclude(what: str, found: Collection[str], other: Collection[str], differing: Sequence[str]) -> int:
    """Print what only one file has and how many differ; 0 when both have the same and all are equal, else 1.

    Args:
        what: one of the results, for a person.
        found: names in this file.
        other: names in the other file.
        differing: those of both that differ.
    """
    here, there = [name for name in found if name not in other], [name for name in other if name not in found]
    for side, names in (("this", here), ("the other", there)):
        if names:
            print_line(f"only {side} file has {count(len(names), what)}: {listed(names)}")
    common = len(found) - len(here)
    if differing:
        print_line(f"{len(differing)} of {common} {what}s differ; the first: {differing[0]}")
    elif here or there:
        print_line(f"{count(common, what)} in both files: equal")
    else:
        print_line("equal")
        return 0
    return 1


def listed(names: Sequence[str]) -> str:
    """The first of them, and how many more there are."""
    more = f" and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    return ", ".join(names[:_NAMES_SHOWN]) + more


def print_line(text: str) -> None:
    """One line on standard output."""
    sys.stdout.write(text + "\n")
