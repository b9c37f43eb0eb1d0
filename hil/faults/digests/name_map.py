"""Names that differ between this commit and the one that it is compared with; empty where none do.

A name is written as `python -m hil faults --hash` prints it: ``records/tension_n``, ``events/TRIP.value``,
``replies/reason``, ``frames/0x182``, ``truth/stroke_mm``. The member of an enumeration is ``Fault.CELL_STALE``.
A commit that is compared with this one begins with empty tables.
"""

from __future__ import annotations

RENAMED: dict[str, str] = {}
"""The name now: the name before. What is renamed is hashed under the name before."""
ADDED: frozenset[str] = frozenset(
    {"replies/needed_n", "Flag.CARRIES", "Kind.ENDING", "records/end_s", "records/slipped_n"}
)
"""Names that only this side has; they are left out. An added member of a set of bits is left out of the set, and events
of an added kind are left out."""
REMOVED: frozenset[str] = frozenset()
"""Names that only the other side has; they are left out."""
