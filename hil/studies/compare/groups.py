"""Groups of runs, seeds and ties of `python -m hil compare --shares`: fixed before a law is tuned for them.

Twelve of the 18 runs are variants of one move, so that a count of runs counts the move twelve times. Every run is in
one group, and a group counts once:

- The error of a law in a group is the geometric mean of its true rms errors over the group's runs and three seeds of
  the simulated rig (`simulation.seed`: the file's, and the two numbers after it; 1, 2 and 3 of the paper's rig). The
  law is tuned once, for the plant as identified with the file's seed.
- Its spread is the largest over the least of the three geometric means that its seeds give.
- A law is tied with the lowest where its error is at most the lowest error times the larger of both spreads.

A law that does not reach the end of a run has no error in that run's group.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rigctl.config.settings import RigSettings

GROUPS: Mapping[str, tuple[str, ...]] = {
    "move_6": ("paper_k6", "friction_x2", "mechanism_60", "mechanism_6", "delay_x2", "stiffer_20", "softer_20"),
    "move_34": ("paper_k13", "paper_k20", "paper_k27", "paper_k34"),
    "heave": ("vertical",),
    "shake_3hz": ("shake_3hz",),
    "shake_8hz": ("shake_8hz",),
    "jolt": ("jolt", "mass"),
    "run_out": ("run_out",),
    "no_spring": ("no_spring",),
}
"""Names of `compared_runs` by group: the move on a soft spring, on stiffer ones, and the other disturbances."""
SEEDS = 3
LOWEST, TIED, ABOVE = "lowest", "tied", "above"


class GroupError(NamedTuple):
    """A law in a group."""

    error_pct: float
    spread: float
    """1 where all seeds give the same."""


def seeds(rig: RigSettings) -> tuple[int, ...]:
    """Seeds of the simulated rig: that of the file, and the numbers after it."""
    assert rig.simulation is not None  # the command refuses a rig without it
    return tuple(range(rig.simulation.seed, rig.simulation.seed + SEEDS))


def group_error(by_seed: Sequence[Sequence[float | None]]) -> GroupError | None:
    """The error of a law from its rms errors in %, a row for each seed with a value for each run.

    None where a run has no error.
    """
    means = []
    for row in by_seed:
        ended = [value for value in row if value is not None]
        if len(ended) < len(row):
            return None
        means.append(statistics.geometric_mean(ended))
    return GroupError(statistics.geometric_mean(means), max(means) / min(means))


def places(errors: Mapping[str, GroupError | None]) -> dict[str, str | None]:
    """By law: `LOWEST`, `TIED` with it, or `ABOVE`; None without an error."""
    ended = {law: found for law, found in errors.items() if found is not None}
    if not ended:
        return dict.fromkeys(errors)
    first = min(ended, key=lambda law: ended[law].error_pct)
    lowest = ended[first]

    def place(law: str, found: GroupError) -> str:
        if law == first:
            return LOWEST
        within = found.error_pct <= lowest.error_pct * max(lowest.spread, found.spread)
        return TIED if within else ABOVE

    return {law: None if found is None else place(law, found) for law, found in errors.items()}
