"""The promises of a soak: one line for each that was broken."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import theilslopes

from tests.soak.sampling import Life

WARM_UP_S = 60.0  # of a process: imports, first clients, rings once around
JUDGED_S = 120.0  # a shorter life shows no slope
GROWTH_MIB = 1.0  # within a life; an allocator's arenas are larger than a leak that matters in an hour
GROWTH_SHARE = 0.03
HANDLES = 2.0  # a client more at the end than at the beginning
EXPLAINED_S = 30.0
"""Time after a strike against control within which its drive's own stop may trip the next loop."""
PAUSED_MS = 100.0
"""A pause of the computer above this explains a trip at that instant."""


@dataclass(frozen=True)
class Slope:
    """A robust fit through one life: growth over it, at least so much at 95 % confidence, and what is allowed."""

    name: str
    pid: int
    minutes: float
    memory_mib: float
    memory_grows_mib: float
    memory_allowed_mib: float
    handles: float
    handles_grow: float

    @property
    def findings(self) -> Iterator[str]:
        """One line for each quantity that grows."""
        who = f"{self.name} (process {self.pid})"
        if self.memory_grows_mib > self.memory_allowed_mib:
            yield (
                f"{who}: memory grew by {self.memory_grows_mib:.1f} MiB or more in {self.minutes:.0f} min from "
                f"{self.memory_mib:.0f} MiB, allowed {self.memory_allowed_mib:.1f} MiB"
            )
        if self.handles_grow > HANDLES:
            yield (
                f"{who}: file handles grew by {self.handles_grow:.1f} or more in {self.minutes:.0f} min from "
                f"{self.handles:.0f}, allowed {HANDLES:.0f}"
            )


def _growth(t_s: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Growth over ``t_s`` at the lower 95 % bound of the Theil-Sen slope (Sen 1968), and the noise about the line.

    Outliers move neither; the noise is that of the residuals, or a leak would excuse itself.
    """
    if np.ptp(y) == 0.0:
        return 0.0, 0.0
    every = max(1, len(t_s) // 600)  # the fit takes every pair
    slope_per_s, offset, low, _ = theilslopes(y[::every], t_s[::every], 0.95)
    residuals = y - (offset + slope_per_s * t_s)
    return float(low) * float(t_s[-1] - t_s[0]), 1.4826 * float(np.median(np.abs(residuals)))


def slope(life: Life) -> Slope | None:
    """The fit of one life; None if it was too short."""
    table = life.table
    if not len(table) or table[-1, 0] - table[0, 0] < WARM_UP_S + JUDGED_S:
        return None
    table = table[table[:, 0] >= table[0, 0] + WARM_UP_S]
    t_s, memory, handles = table.T
    grows, noise = _growth(t_s, memory)
    level = float(np.median(memory[: max(3, len(memory) // 10)]))
    return Slope(
        life.name, life.pid, float(t_s[-1] - t_s[0]) / 60.0, level, grows,
        max(GROWTH_MIB, GROWTH_SHARE * level, min(3.0 * noise, 4.0 * GROWTH_MIB)),
        float(np.median(handles[: max(3, len(handles) // 10)])), _growth(t_s, handles)[0],
    )  # fmt: skip


def unexplained(trips: list[dict[str, Any]], struck_ns: list[int], pauses: list[tuple[int, float]]) -> list[str]:
    """Trips that neither name a cause nor follow a strike against control or a pause of the computer.

    Args:
        trips: events with ``t_ns`` and ``text``.
        struck_ns: instants at which control was killed.
        pauses: instants and milliseconds of the computer's pauses.
    """
    found = []
    for trip in trips:
        t_ns, text = int(trip["t_ns"]), str(trip.get("text", ""))
        after = any(0 <= t_ns - at <= EXPLAINED_S * 1e9 for at in struck_ns)
        paused = any(abs(t_ns - at) <= 2e9 and ms >= PAUSED_MS for at, ms in pauses)
        if not text or not (after or paused):
            found.append(text or f"event {trip.get('seq')} without a text")
    return found


def broken(results: dict[str, Any], slopes: list[Slope]) -> list[str]:
    """One line for each broken promise."""
    found = [finding for fit in slopes for finding in fit.findings]
    found += [f"a trip without a cause: {text}" for text in results["trips"]["unexplained"]]
    for what, count in results["lost"].items():
        if count:
            found.append(f"{count} {what.replace('_', ' ')}, expected 0")
    if results["daemon_exit"] != 0:
        found.append(f"the daemon ended with code {results['daemon_exit']}, expected 0 (stroke held, brake closed)")
    found += [f"the {name} was killed and did not come back" for name in results["not_back"]]
    if not results["commands"]["accepted"]:
        found.append("no command was accepted")
    if not results["page"]["frames"]:
        found.append("the page sent no frame")
    return found
