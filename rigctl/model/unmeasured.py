"""Why a minute of COMPENSATING gave no margins, in words."""

from __future__ import annotations

from enum import IntEnum


class Unmeasured(IntEnum):
    """Why a minute of COMPENSATING gave no margins."""

    OTHER = 0
    LIMITED = 1
    SKIPPED = 2
    WEAK = 3
    UNSTEADY = 4


UNMEASURED: dict[int, str] = {
    Unmeasured.OTHER: "the records do not determine them, see the gateway's log",
    Unmeasured.LIMITED: "the limits of speed or acceleration acted in too many periods, so the loop may ring: look at "
    "command_mm_s, and take gains of a lower Ms (rigctl tune, then rigctl gains FILE)",
    Unmeasured.SKIPPED: "the computer had the loop skip ticks in too many periods",
    Unmeasured.WEAK: "the multisine is too weak: a larger margins.probe_n, or rigctl identify --response",
    Unmeasured.UNSTEADY: "the multisine was not at its level for a minute",
}
