"""The promises of a soak: one line for each that was broken."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import theilslopes

from tests.soak.pauses import Pause
from tests.soak.sampling import Life

WARM_UP_S = 60.0  # of a process, and again of the load: imports, first clients, rings once around
JUDGED_S = 120.0  # a shorter life shows no slope
GROWTH_MIB = 1.0  # within a life
GROWTH_SHARE = 0.03
HANDLES = 4.0  # a client more, and a runtime of Zenoh, which opens three at the first end of a link
EXPLAINED_S = 30.0
"""Time after a strike against control within which its drive's own stop may trip the next loop."""
GATEWAY = "the gateway"
WAITED_S, RESTART_S = 5.0, 20.0
"""A gateway that waited so long for a processor in one restart may come back when the ring of 16 s is written over."""
PAUSED_BEFORE_S = 1.0
"""A pause that ended so long before a trip explains it: the drive follows half a second after the bus."""


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


def slope(life: Life, busy: tuple[float, float] = (0.0, math.inf)) -> Slope | None:
    """The fit of one life under the load, which begins and ends at ``busy`` (s); None if it was too short."""
    table = life.table
    if not len(table):
        return None
    table = table[(table[:, 0] >= max(table[0, 0], busy[0]) + WARM_UP_S) & (table[:, 0] <= busy[1])]
    if not len(table) or table[-1, 0] - table[0, 0] < JUDGED_S:
        return None
    t_s, memory, handles = table.T
    grows, noise = _growth(t_s, memory)
    level = float(np.median(memory[: max(3, len(memory) // 10)]))
    return Slope(
        life.name, life.pid, float(t_s[-1] - t_s[0]) / 60.0, level, grows,
        max(GROWTH_MIB, GROWTH_SHARE * level, min(3.0 * noise, 2.0 * GROWTH_MIB)),
        float(np.median(handles[: max(3, len(handles) // 10)])), _growth(t_s, handles)[0],
    )  # fmt: skip


def cause_of(trip: dict[str, Any], struck_ns: list[int], pauses: list[Pause]) -> str:
    """What made the rig trip, by what the soak did or saw; empty if it is not known.

    Args:
        trip: event with ``t_ns`` and ``text``.
        struck_ns: instants at which control was killed.
        pauses: of the computer.
    """
    t_ns = int(trip["t_ns"])
    for at in struck_ns:
        if 0 <= t_ns - at <= EXPLAINED_S * 1e9:
            return f"control was killed {(t_ns - at) / 1e9:.1f} s before"
    near = [
        one
        for one in pauses
        if not one.what.startswith(GATEWAY) and -PAUSED_BEFORE_S * 1e9 <= one.t_ns - t_ns <= one.ms * 1e6 + 1e8
    ]
    return str(max(near, key=lambda one: one.ms)) if near else ""


def lost(listener: int, overwritten: int, pauses: list[Pause]) -> int:
    """Records that a client lost, less those overwritten while a killed gateway's successor waited for a processor."""
    waits = [one for one in pauses if one.what.startswith(GATEWAY)]
    in_one_restart = (sum(one.ms for one in waits if 0 <= one.t_ns - first.t_ns <= RESTART_S * 1e9) for first in waits)
    return max(0, listener - overwritten) if max(in_one_restart, default=0.0) >= 1000.0 * WAITED_S else listener


def explained(trips: list[dict[str, Any]], struck_ns: list[int], pauses: list[Pause]) -> list[dict[str, str]]:
    """Text and cause of every trip; both have to be there."""
    return [
        {"text": str(trip.get("text") or f"event {trip.get('seq')} without a text"),
         "cause": cause_of(trip, struck_ns, pauses) if trip.get("text") else ""}
        for trip in trips
    ]  # fmt: skip


def broken(results: dict[str, Any], slopes: list[Slope]) -> list[str]:
    """One line for each broken promise."""
    found = [finding for fit in slopes for finding in fit.findings]
    found += [f"a trip without a cause: {trip['text']}" for trip in results["trips"] if not trip["cause"]]
    found += [f"the {name} ended early: {error}" for name, error in results["workers"].items()]
    found += [f"the browser reports: {error}" for error in results["browser"]["errors"]]
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
    if results["browser"]["open_s"] > JUDGED_S and not results["browser"]["draws"]:
        found.append(f"the browser drew nothing in {results['browser']['open_s']:.0f} s")
    return found
