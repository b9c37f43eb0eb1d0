"""Names of the numbers of a record, and the age from which its loop does not run."""

from __future__ import annotations

from enum import IntEnum, IntFlag

from rigctl.model.samples import Quality

ALIVE_NS = 250_000_000  # a loop whose newest record is older than this does not run


def quality_words(bits: int) -> str:
    """``good``, or the names of the quality bits that are set."""
    return "+".join(q.name.lower() for q in Quality if bits & q and q.name) or "good"


def named(kind: type[IntEnum | IntFlag], number: int) -> str:
    """The name of a number of the record, also of one that this version does not know."""
    try:
        return str(kind(number).name)
    except ValueError:
        return f"UNKNOWN_{number}"
