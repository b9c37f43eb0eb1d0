"""What a soak does and when: everything random comes from one printed seed."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from dataclasses import dataclass

VICTIMS = ("gateway", "recorder", "hold", "page", "control")
LONG_S = 1800.0
KILLS_LONG, KILLS_SHORT = 3, 1  # of each process: it lives long enough in between for the slope of its memory
SHORTEST_S = 8.0  # between two strikes: the processes are back, the recorder has caught up
ALONE_SHARE = 0.2
"""Share of the time without clients or strikes, at the beginning and at the end, for the lateness without them."""
DISK_FULL_S = 3.0
_UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


def seconds(text: str) -> float:
    """Seconds from ``120s``, ``10m``, ``8h``.

    Raises:
        ValueError: it is no such time, or less than 30 s.
    """
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(s|m|min|h)?", text.strip())
    if found is None or float(found[1]) * _UNITS[found[2] or ""] < 30.0:
        raise ValueError(f"found {text!r}, expected a time of 30 s or more, e.g. 120s, 10m, 8h")
    return float(found[1]) * _UNITS[found[2] or ""]


@dataclass(frozen=True)
class Strike:
    """One interference: a process killed, or ``disk`` filled."""

    at_s: float
    what: str


def busy(duration_s: float) -> tuple[float, float]:
    """Begin and end of the time with clients and strikes."""
    return duration_s * ALONE_SHARE / 2, duration_s * (1 - ALONE_SHARE / 2)


def strikes(duration_s: float, chance: random.Random) -> list[Strike]:
    """Every process killed and the disk filled some times each, or as many as there is time for."""
    begin, end = busy(duration_s)
    each = KILLS_LONG if duration_s >= LONG_S else KILLS_SHORT
    what = [name for _ in range(each) for name in chance.sample((*VICTIMS, "disk"), len(VICTIMS) + 1)]
    what = what[: max(1, int((end - begin) / SHORTEST_S) - 1)]
    every = (end - begin) / (len(what) + 1)
    spread = max(0.0, every - SHORTEST_S) / 2
    return [Strike(begin + every * (i + 1) + chance.uniform(-spread, spread), name) for i, name in enumerate(what)]


SENSIBLE = {
    "DISARMED": ("arm", "arm", "arm", "target"),
    "HOLD": ("tension", "tension", "target", "release", "disarm"),
    "TENSIONING": ("target", "hold"),
    "COMPENSATING": ("target", "target", "target", "hold", "release"),
    "RELEASING": ("hold",),
    "FAULT": ("reset", "disarm"),
}
"""Commands that lead on from each mode; every fifth is any command at all."""
ANY = ("arm", "tension", "target", "hold", "release", "disarm", "reset")
TARGETS_N = (55.0, 65.0)


def command(mode: str, chance: random.Random) -> tuple[str, float | None]:
    """The next command, and its value."""
    verb = chance.choice(ANY if chance.random() < 0.2 else SENSIBLE.get(mode, ANY))
    if verb != "target":
        return verb, None
    return verb, chance.uniform(*TARGETS_N) if chance.random() < 0.9 else 10_000.0


def clients(chance: random.Random) -> Iterator[int]:
    """Number of clients from one change to the next."""
    while True:
        yield chance.randrange(0, 5)
