"""An end in order while the motor has a load that the brake does not hold: the motor lowers the load first.

For `WAITS_NS` after the request nothing changes, so that the payload can be supported. Then the motor lowers the load
until the rope is slack, and the loop ends. A second request leaves the load to the brake at once.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.load.carried_load import longest_lowering_s
from rigctl.model.states import EndStep

WAITS_NS = 10_000_000_000
"""From the request, or from a HOLD that stops the lowering, until the motor lowers the load."""
TOGETHER_NS = 1_000_000_000
"""A terminal that closes and a session that ends send several signals at once: they are one request."""
LIMIT_S = 120.0
"""From the request until the loop ends in any case, for every rig whose longest lowering it covers twice.

The supervisor waits for so long, and ``TimeoutStopSec`` of ``deploy/systemd/rigctl@.service`` is longer.
"""
_ROOM = 2.0  # for a lowering that HOLD stops and that begins anew


def limit_s(settings: RigSettings) -> float:
    """Longest time in s from the request until the loop ends."""
    return max(LIMIT_S, _ROOM * (WAITS_NS * 1e-9 + longest_lowering_s(settings)))


class Ending:
    """``step``: None before a request, and where no load delays the end; ``delayed``: the loop goes on, for the load.

    ``left_s``: time until the motor lowers the load, 0 while it does, NaN where nothing delays an end.
    """

    def __init__(self, settings: RigSettings) -> None:
        self._limit_ns = round(limit_s(settings) * 1e9)
        self.step: EndStep | None = None
        self.delayed = False
        self.left_s = math.nan
        self.since_ns = self._until_ns = 0
        self._repeats = 0

    @property
    def due(self) -> bool:
        """The motor is to lower the load now."""
        return self.step is EndStep.WAITS and self.left_s == 0.0

    def look(self, t_ns: int, repeats: int, *, carries: bool, lowers: bool, lowered: bool) -> None:
        """One tick from the request on, until nothing delays the end.

        Args:
            t_ns: now.
            repeats: requests after the first so far.
            carries: the motor has a load that the brake does not hold.
            lowers: the motor lowers it.
            lowered: a lowering that is over has ended by itself.
        """
        before, first = self.step, not self.since_ns
        if first:
            self.since_ns, self._until_ns = t_ns, t_ns + WAITS_NS
        again, self._repeats = repeats > self._repeats and t_ns - self.since_ns >= TOGETHER_NS, repeats
        if first and not carries:
            return
        if not carries:
            self.step = EndStep.LOWERED if before is EndStep.LOWERS and lowered else EndStep.GONE
        elif again:
            self.step = EndStep.LEFT
        elif t_ns - self.since_ns >= self._limit_ns:
            self.step = EndStep.LATE
        elif lowers:
            self.step = EndStep.LOWERS
        else:
            if before is EndStep.LOWERS:
                self._until_ns = t_ns + WAITS_NS
            self.step = EndStep.WAITS
        self.delayed = self.step in (EndStep.WAITS, EndStep.LOWERS)
        self.left_s = math.nan if not self.delayed else 0.0 if lowers else max(0, self._until_ns - t_ns) * 1e-9
