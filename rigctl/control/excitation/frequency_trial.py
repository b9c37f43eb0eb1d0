"""The trial behind ``rigctl identify --response``: a multisine on the speed command, in HOLD or while COMPENSATING.

The rig file's stiffness is not believed. After a rest, which shows how restless the tension is, the level grows from a
few micrometres, doubling every half second, until it has reached a quarter of what the rig file allows or the tension
has answered with half of its bound. One period at that level shows the answer to all frequencies; it sets the level of
the measurement. Each tick is watched all the same.

In HOLD the stroke follows the multisine and ends where it began. While COMPENSATING the multisine is added to the law's
command and the filter is not told, so that it acts on the loop as a disturbance of the plant's input: then the whole
command over the multisine is the sensitivity there, whatever the law does (see `rigctl.commission.frequency_response`).
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.excitation.multisine import Band, Multisine, multisine
from rigctl.control.snapshot import Snapshot
from rigctl.model.verbs import Refusal

PERIOD_S, HIGHEST_HZ, RATIO = 4.0, 60.0, 1.25
PERIODS = 12
CORNERS = 5.0  # highest frequency in corner frequencies of the drive's lag; beyond it the tension answers too little
TICKS_PER_SINE = 16  # at least
TAIL_HZ, TAIL_TICKS, TAIL = 100.0, 8, 0.12  # where the sensitivity has its peak, and the plant answers too little
QUIET_S, GROW_S, CHANGE_S = 1.0, 0.5, 0.5  # rest, time of a doubling, time of a change of level
FIRST_MM = 0.005  # peak stroke at the first level: 10 N on a rope of 2000 N/mm
FEEL_SHARE = 0.25  # of the level that the rig file allows: where growing ends
GROWN_SHARE, USED_SHARE = 0.5, 0.8  # of the bound of tension: where growing ends; for the measurement
CALM_RESTS, CALMER = 10, 0.8  # rests at most; from one to the next a swinging payload calms to this share
FELT_RESTS = 1.5  # an answer is felt if its standard deviation is larger than this many times that at rest
GROWTH = 4.0  # largest growth from the level that was felt to that of the measurement
STRAY_MM, STRAY_N = 0.25, 5.0  # beyond the bounds of stroke and tension


class Reach(NamedTuple):
    """Lowest frequency, bounds of the excitation and ``floor`` of its spectrum in one mode."""

    lowest_hz: float
    stroke_mm: float
    tension_n: float
    share: float
    """Of the rig file's speed and acceleration."""
    floor: float
    corner_hz: float
    """Slower stretch is taken away by the loop: any that a design accepts does so below this."""


POWER = 0.5  # of the spectrum, see `rigctl.control.excitation.multisine.multisine`
SLOW_SHARE = 0.1  # of the speed limit
HELD = Reach(0.25, 0.75, 8.0, 0.8, 0.0, 0.0)
REGULATED = Reach(0.75, 0.75, 3.0, 0.45, 0.45, 1.0)  # the loop takes away what is slow, and keeps half of its limits
LONGEST_S = 90.0
"""No measurement takes as long."""
TARGET_SHARE = 0.1  # of the tension at the start: a larger answer would slacken a weakly tensioned rope


def band(settings: RigSettings, *, regulated: bool) -> Band:
    """Frequencies that this rig's drive can answer at."""
    corner_hz = 1.0 / (2.0 * math.pi * settings.plant.cylinder_lag_s)
    rate_hz = settings.loop.rate_hz
    highest_hz = min(HIGHEST_HZ, CORNERS * corner_hz, rate_hz / TICKS_PER_SINE)
    if not regulated:
        return Band(PERIOD_S, HELD.lowest_hz, highest_hz, RATIO)
    return Band(PERIOD_S, REGULATED.lowest_hz, highest_hz, RATIO, min(TAIL_HZ, rate_hz / TAIL_TICKS), TAIL)


def signal(settings: RigSettings, *, regulated: bool) -> Multisine:
    """The multisine of a mode; made once for each rig, which takes some 20 ms.

    Where the tension bounds the excitation to a small speed, as on a rope without a spring, the tension answers evenly:
    then the speed is as large as it can be, and the drive's dead band matters least.
    """
    reach, found = REGULATED if regulated else HELD, band(settings, regulated=regulated)
    lag_s = settings.plant.cylinder_lag_s
    usual = multisine(found, settings.loop.rate_hz, lag_s, POWER, reach.floor)
    stretched = reach.tension_n / (settings.plant.stiffness_n_mm * usual.peak_above_mm(reach.corner_hz))
    if stretched * usual.peak_mm_s >= SLOW_SHARE * settings.tension.speed_max_mm_s:
        return usual
    return multisine(found, settings.loop.rate_hz, lag_s, 1.0)


def prepare(settings: RigSettings) -> None:
    """Make the multisines before the first tick."""
    signal(settings, regulated=False)
    signal(settings, regulated=True)


def measured_ticks(settings: RigSettings) -> tuple[int, int]:
    """Ticks of the measured periods, and those after them up to the trial's end."""
    rate = settings.loop.rate_hz
    return PERIODS * round(PERIOD_S * rate), round(CHANGE_S * rate)


class FrequencyTrial:
    """One measurement. ``see`` returns None while it goes on, then its refusal (NONE: done)."""

    moves = True
    power_s = LONGEST_S

    def __init__(self, settings: RigSettings, inbox: Inbox, *, regulated: bool) -> None:
        """``regulated``: while COMPENSATING, else in HOLD."""
        self._rate = rate = settings.loop.rate_hz
        self._settings, self._regulated = settings, regulated
        shape = signal(settings, regulated=regulated)
        self._stroke = shape.stroke_mm
        reach, tension, cylinder = REGULATED if regulated else HELD, settings.tension, settings.cylinder
        self._start_n, self._start_mm = inbox.cell.tension_n, inbox.drive.stroke_mm
        self._bound_n = bound_n = min(reach.tension_n, TARGET_SHARE * (inbox.cell.tension_n - tension.slack_n))
        self._stray_n = bound_n + STRAY_N + 5.0 * settings.tension_cell.noise_n
        self._most = most = min(
            reach.stroke_mm / shape.peak_mm,
            bound_n / (settings.plant.stiffness_n_mm * shape.peak_above_mm(reach.corner_hz)),
            reach.share * tension.speed_max_mm_s / shape.peak_mm_s,
            reach.share * tension.acceleration_max_mm_s2 / shape.peak_mm_s2,
        )
        self._first = min(most, FIRST_MM / shape.peak_mm)
        self._peak_mm = peak_mm = most * shape.peak_mm
        inside = cylinder.stroke_min_mm + peak_mm <= self._start_mm <= cylinder.stroke_max_mm - peak_mm
        self._fits = inside and bound_n > 0.0 and self._start_n + self._stray_n <= settings.safety.tension_high_n
        self._growth = 2.0 ** (1.0 / (GROW_S * rate))
        self._at = self._ticks = self._left = 0
        self._level = self._goal = self._step = self._wanted_mm = 0.0  # ``step``: change of level per tick
        self._sum_n = self._square_n2 = self._peak_n = 0.0  # of the tension's deviations since they were last cleared
        self._course = self._run()
        self.wanted_mm_s = 0.0

    @property
    def figures(self) -> dict[str, float]:
        """Time taken."""
        return {"duration_s": self._ticks / self._rate}

    def see(self, inbox: Inbox, snapshot: Snapshot) -> Refusal | None:
        """Choose this tick's speed, within the bounds."""
        if self._regulated:
            strays_n, held = snapshot.vertical_error_n, True
        else:
            strays_n = inbox.cell.tension_n - self._start_n
            held = abs(inbox.drive.stroke_mm - self._start_mm) <= self._peak_mm + STRAY_MM
        if not (self._fits and held and abs(strays_n) <= self._stray_n):
            return Refusal.STRAYED
        self._ticks += 1
        self._sum_n += strays_n
        self._square_n2 += strays_n * strays_n
        self._peak_n = max(self._peak_n, abs(strays_n))
        if self._left <= 0:
            try:
                self._left = next(self._course)
            except StopIteration as over:
                ended: Refusal = over.value
                return ended
        self._left -= 1
        self._move()
        return None

    def _run(self) -> Generator[int, None, Refusal]:
        """The course of the trial: yields the ticks until its next decision."""
        change, period = round(CHANGE_S * self._rate), len(self._stroke)
        quiet = round(QUIET_S * self._rate)
        rest_n2 = math.inf
        for _ in range(CALM_RESTS):
            self._sum_n = self._square_n2 = 0.0
            yield quiet
            before_n2, rest_n2 = rest_n2, self._variance_n2(quiet)
            if rest_n2 > CALMER**2 * before_n2:
                break
        if not self._regulated:
            self._start_n += self._sum_n / quiet
        self._change(self._first)
        yield change
        while self._level < FEEL_SHARE * self._most and 2.0 * self._peak_n < GROWN_SHARE * self._bound_n:
            self._goal = min(2.0 * self._level, self._most)
            self._peak_n = 0.0
            yield round(GROW_S * self._rate)
        level = self._level
        self._sum_n = self._square_n2 = self._peak_n = 0.0
        yield period
        felt = self._variance_n2(period) > FELT_RESTS**2 * rest_n2
        if not (felt or self._regulated):
            return Refusal.UNFELT
        bound = USED_SHARE * self._bound_n / self._peak_n * level if felt else self._most
        self._change(min(self._most, GROWTH * level, bound))
        yield period  # in which the change dies away
        measured, after = measured_ticks(self._settings)
        yield measured
        self._change(0.0)
        yield after
        return Refusal.NONE

    def _variance_n2(self, ticks: int) -> float:
        """Variance of the tension over the last ``ticks``, since the sums were cleared."""
        mean_n = self._sum_n / ticks
        return self._square_n2 / ticks - mean_n * mean_n

    def _change(self, level: float) -> None:
        """Change the level to this within `CHANGE_S`."""
        self._goal, self._step = level, (level - self._level) / (CHANGE_S * self._rate)
        self._peak_n = 0.0

    def _move(self) -> None:
        """Level and stroke of the next tick; the change of the stroke is the speed."""
        if self._step:
            self._level += self._step
            if (self._level - self._goal) * self._step > -0.5 * self._step**2:
                self._level, self._step = self._goal, 0.0
        elif self._level < self._goal:
            self._level = min(self._goal, self._level * self._growth)
        self._at = self._at + 1 if self._at + 1 < len(self._stroke) else 0
        stroke_mm = self._level * self._stroke[self._at]
        self.wanted_mm_s = (stroke_mm - self._wanted_mm) * self._rate
        self._wanted_mm = stroke_mm
