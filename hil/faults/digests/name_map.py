"""Names that differ between this commit and the one that it is compared with; empty where none do.

A name is written as `python -m hil faults --hash` prints it: ``records/tension_n``, ``events/TRIP.value``,
``replies/reason``, ``frames/0x182``, ``truth/stroke_mm``. The member of an enumeration is ``Fault.CELL_STALE``.
A commit that is compared with this one begins with empty tables.
"""

from __future__ import annotations

RENAMED: dict[str, str] = {}
"""The name now: the name before. What is renamed is hashed under the name before."""
<<<<<<< HEAD
ADDED: frozenset[str] = frozenset({"replies/needed_n"})
=======
ADDED: frozenset[str] = frozenset(
    {"Flag.BRAKE_FAILS", "Kind.BRAKE_FLAG", "Kind.WITNESS", "Flag.CARRIES", "Kind.ENDING", "records/end_s"}
)
>>>>>>> 1e9eb70 (Lower a load that the brake does not hold before the daemon ends)
"""Names that only this side has; they are left out. An added member of a set of bits is left out of the set, and events
of an added kind are left out."""
REMOVED: frozenset[str] = frozenset()
"""Names that only the other side has; they are left out."""
