"""Whether the brake is known not to hold: a flag of record, state and display, neither a mode nor a fault.

A fault is reset, the flag is not: only a brake test clears it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings
from rigctl.control.load.held_tension import fall_limit_n
from rigctl.control.load.load_at_rest import STROKE_BITS
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.load.sinking import JUMP_MM
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Fault, Trait, bits_of, having

MOVED_MM = 0.2
"""Net motion on the closed brake since the last commanded motion: more than play, wind-up and a toggling count make."""
GAP_NS = 50_000_000  # after which the motor has had the load
FALLS, FALLS_NS = 2.0, 5_000_000_000
"""Limits of LOAD_SINKS that the tension has to have lost, and for how long, while the encoder is in doubt."""
TESTED_SHARE = 0.8
"""Of the load at which the brake slipped: a test with less shows nothing."""
_SLIP_BITS = bits_of(having(Trait.BRAKE_FAILS))
_SINK_BIT = Fault.LOAD_SINKS.bit
_KNOWN_BEFORE = "known before this start"


@built
@dataclass(frozen=True)
class KeptBrake:
    """The flag as it is kept from loop to loop. ``slipped_n``: the load at which the brake slipped, None not known.

    ``why``: why the flag could not be read; it then counts as set.
    """

    fails: bool = False
    slipped_n: float | None = None
    why: str = ""


class BrakeFlag:
    """``fails``: the brake does not hold; ``why``: what has set it. ``slipped_n``: the load then, NaN not known.

    ``assumed``: whether it holds is not known, so that it counts as one that does not. ``changed``: the flag has been
    set or cleared since the loop last took note, ``shown``: as it was then.
    """

    def __init__(self, settings: RigSettings, rope: RopeMemory, kept: KeptBrake = KeptBrake()) -> None:
        if settings.cylinder.brake_waiver is not None:
            kept = KeptBrake()  # there is no brake that a test could show to hold again
        self._rope = rope
        self._brake = settings.cylinder.brake_waiver is None
        self._most_n = settings.tension.target_max_n
        self._fall_n = FALLS * fall_limit_n(settings)
        self.fails = self.changed = kept.fails
        self.shown = False
        self.why, self.assumed = kept.why or _KNOWN_BEFORE, bool(kept.why)
        self.slipped_n = math.nan if kept.slipped_n is None else kept.slipped_n
        # A load that hangs on the brake at a start is not the one at which it slipped in a loop before.
        self._weighs = not kept.fails or kept.slipped_n is not None
        self._moved_mm, self._last_mm, self._seen_ns = 0.0, math.nan, 0
        self._falls_since_ns: int | None = None

    def follow(self) -> None:
        """The stroke is commanded to move: what it moved on the brake before is of no account."""
        self._moved_mm = 0.0

    def look(self, standing: int, snapshot: Snapshot, *, braked: bool) -> None:
        """One tick in which the motor has no power, or a cause is active.

        Args:
            standing: causes that are active, see `Fault.bit`.
            snapshot: of this tick.
            braked: the drive is off and its brake closed.
        """
        if snapshot.t_ns - self._seen_ns > GAP_NS:
            self._last_mm = math.nan
        self._seen_ns = snapshot.t_ns
        if not braked:
            self._last_mm = math.nan
            if not standing & _SLIP_BITS:
                return
        elif not standing & STROKE_BITS:
            step_mm = snapshot.stroke_mm - self._last_mm
            if abs(step_mm) <= JUMP_MM:  # False for NaN
                self._moved_mm += step_mm
            self._last_mm = snapshot.stroke_mm
        if standing & _SLIP_BITS:
            self.set("the stroke has moved on the closed brake")
        elif abs(self._moved_mm) > MOVED_MM:
            self.set(f"the stroke has moved {self._moved_mm:.2f} mm on the closed brake")
        elif self._falls(standing, snapshot):
            self.set("the tension falls on the closed brake, and the encoder is in doubt")
        if self.fails and self._weighs and self._rope.tension_n == snapshot.tension_n:
            self.slipped_n = max(snapshot.tension_n, self.slipped_n)  # the first one of them for NaN

    def _falls(self, standing: int, snapshot: Snapshot) -> bool:
        doubted = standing & STROKE_BITS or snapshot.sinking.apart_mm > 0.0
        held = snapshot.held_tension
        falls = standing & _SINK_BIT and doubted and max(held.fallen_n, held.sinks_n) > self._fall_n
        if not falls:
            self._falls_since_ns = None
            return False
        if self._falls_since_ns is None:
            self._falls_since_ns = snapshot.t_ns
        return snapshot.t_ns - self._falls_since_ns >= FALLS_NS

    def noted(self) -> None:
        """The loop has taken note of the change."""
        self.shown, self.changed = self.fails, False

    def set(self, why: str) -> None:
        """The brake does not hold."""
        if not self.fails:
            self.fails = self.changed = self._weighs = True
            self.why, self.slipped_n = why, math.nan

    def tested(self, tension_n: float) -> None:
        """A brake test has passed with this tension on the closed brake; with enough of it the brake holds."""
        if self.fails and tension_n >= self.wanted_n:
            self.fails, self.changed, self.assumed = False, True, False
            self._moved_mm, self.slipped_n = 0.0, math.nan
            self.why = f"a brake test with {tension_n:.0f} N has passed"

    @property
    def wants_test(self) -> bool:
        """It is known not to hold, and there is a brake that a test could show to hold again."""
        return self.fails and self._brake

    @property
    def wanted_n(self) -> float:
        """Least load of a test that shows that the brake holds."""
        return TESTED_SHARE * (self._most_n if math.isnan(self.slipped_n) else self.slipped_n)
