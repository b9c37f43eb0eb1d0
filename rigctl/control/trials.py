"""What commissioning has the loop do: one object per trial, shown every tick, bounded in time, stroke and force.

``see`` returns None while the trial goes on, then its refusal (NONE: it is done). It commands nothing by itself:
``wanted_mm_s`` passes the law's limits on its way to the drive, and whatever ends the trial ends the motion.
"""

from __future__ import annotations

import math
from typing import Protocol

from rigctl.config import RigSettings
from rigctl.control.correction import tare_limit_n
from rigctl.control.inbox import Inbox
from rigctl.control.modes import Refusal, Verb
from rigctl.control.safety import Sight

AVERAGED_S = 1.0
FEWEST_SAMPLES = 10  # of a slow cell, for its mean to mean anything
STILL_MM_S = 0.1
SPREAD_NOISES = 5.0
SPREAD_RANGE = 1e-3  # of the cell's range: a known weight that has stopped swinging reads steadier than this

STEP_MM, STEP_N = 0.75, 8.0  # stroke of a step, and what it may add to the tension
STRAY_MM, STRAY_N = 0.25, 10.0
LEG_S, SHORTEST_LEG_S, SLOWEST_MM_S = 0.25, 0.05, 0.5  # a step lasts; shorter where the stroke is, to stay above this
REST_S = 0.15  # for the drive to settle
QUIET_S = 0.5  # at rest before the first step: what there is then is noise
PAIRS = 8


class Trial(Protocol):
    """A trial under way; ``value`` and ``spread`` go into its answer."""

    @property
    def wanted_mm_s(self) -> float:
        """Speed it asks for now."""

    @property
    def value(self) -> float:
        """What it has found."""

    @property
    def spread(self) -> float:
        """How much that varied."""

    def see(self, inbox: Inbox, sight: Sight) -> Refusal | None:
        """One tick."""


class Average:
    """Mean and rms of what the cell reads (before zero and scale) in N, over `AVERAGED_S`, at standstill."""

    def __init__(self, settings: RigSettings, *, largest_n: float = math.inf) -> None:
        """``largest_n``: no sample may be larger."""
        self._largest_n = largest_n
        self._left = round(AVERAGED_S * settings.loop.rate_hz)
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        cell = settings.tension_cell
        self._spread_n = max(SPREAD_NOISES * cell.noise_n, SPREAD_RANGE * cell.range_n)
        self._first = self._sum = self._squares = 0.0
        self.samples = 0
        self.wanted_mm_s = 0.0

    @property
    def value(self) -> float:
        """Mean in N; NaN of nothing."""
        return self._first + self._sum / self.samples if self.samples else math.nan

    @property
    def spread(self) -> float:
        """Rms about the mean in N; NaN of nothing."""
        if not self.samples:
            return math.nan
        mean = self._sum / self.samples
        return math.sqrt(max(0.0, self._squares / self.samples - mean * mean))

    def see(self, inbox: Inbox, sight: Sight) -> Refusal | None:
        """Take the tick's sample, if there is one."""
        if sight.cell_quality or sight.cell_age_ns > self._stale_ns:
            return Refusal.NO_SAMPLES
        if abs(inbox.speed_mm_s) > STILL_MM_S:
            return Refusal.UNSTEADY
        if inbox.cell_fresh:
            if abs(inbox.reading_n) > self._largest_n:
                return Refusal.LOADED
            if not self.samples:
                self._first = inbox.reading_n
            beyond = inbox.reading_n - self._first  # sums of small numbers keep their digits
            self.samples += 1
            self._sum += beyond
            self._squares += beyond * beyond
        self._left -= 1
        if self._left > 0:
            return None
        if self.samples < FEWEST_SAMPLES:
            return Refusal.NO_SAMPLES
        return Refusal.UNSTEADY if self.spread > self._spread_n else Refusal.NONE


class Excitation:
    """Small steps of speed, up and down by the same stroke: it ends where it began.

    What comes of it is for `rigctl.commission.identification` to say. Bounded by its amplitude, and ended should
    tension or stroke stray all the same.
    """

    def __init__(self, settings: RigSettings, inbox: Inbox) -> None:
        stiffness = settings.plant.stiffness_n_mm
        slack = inbox.tension_n < settings.tension.slack_n
        stroke_mm = STEP_MM if slack else min(STEP_MM, STEP_N / stiffness)
        leg_s = min(LEG_S, max(SHORTEST_LEG_S, stroke_mm / SLOWEST_MM_S))
        rate = settings.loop.rate_hz
        self._speed_mm_s = min(stroke_mm / leg_s, settings.tension.speed_max_mm_s)
        self._leg, self._rest = round(leg_s * rate), round(REST_S * rate)
        self._before = round(QUIET_S * rate)
        self._pair = 2 * (self._leg + self._rest)
        self._end = self._before + PAIRS * self._pair
        self._start_n, self._start_mm = inbox.tension_n, inbox.stroke_mm
        self._stray_mm = stroke_mm + STRAY_MM
        self._fits = self._start_mm + stroke_mm <= settings.cylinder.stroke_max_mm
        self._tick = 0
        self._period_s = 1.0 / rate
        self.wanted_mm_s = 0.0
        self.spread = 0.0

    @property
    def value(self) -> float:
        """How long it has taken, in s."""
        return self._tick * self._period_s

    def see(self, inbox: Inbox, _sight: Sight) -> Refusal | None:
        """Choose this tick's speed, within the bounds."""
        strays_n, strays_mm = abs(inbox.tension_n - self._start_n), abs(inbox.stroke_mm - self._start_mm)
        if not (self._fits and strays_n <= STRAY_N and strays_mm <= self._stray_mm):
            return Refusal.STRAYED
        since = self._tick - self._before
        self._tick += 1
        if self._tick > self._end:
            return Refusal.NONE
        leg, at = divmod(max(since, 0) % self._pair, self._leg + self._rest)
        moves = since >= 0 and at < self._leg
        self.wanted_mm_s = (self._speed_mm_s if leg == 0 else -self._speed_mm_s) if moves else 0.0
        return None


def begin(verb: Verb, settings: RigSettings, inbox: Inbox) -> Trial:
    """The trial a command asks for."""
    if verb is Verb.IDENTIFY:
        return Excitation(settings, inbox)
    if verb is Verb.TARE:
        return Average(settings, largest_n=tare_limit_n(settings))
    return Average(settings)
