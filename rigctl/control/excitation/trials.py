"""Trials of commissioning: one object each, called every tick, bounded in time, stroke and force.

``see`` returns None while the trial goes on, then its refusal (NONE: done). A trial commands nothing by itself:
``wanted_mm_s`` passes the law's limits on its way to the drive, and the end of the trial ends the motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.excitation.frequency_trial import FrequencyTrial
from rigctl.control.snapshot import Snapshot
from rigctl.model.verbs import Refusal, Verb

AVERAGED_S = 1.0
FEWEST_SAMPLES = 10  # of a slow cell, for a meaningful mean
STILL_MM_S = 0.1
SPREAD_NOISES = 5.0
SPREAD_RANGE = 1e-3  # of the cell's range: the reading of a known weight at rest varies less

STEP_MM, STEP_N = 0.75, 10.0  # largest stroke of a step, and largest tension it adds
STRAY_MM, STRAY_N = 0.25, 15.0
FEELER_MM, FEELER_GROWTH = 0.005, 4.0  # stroke of the first step; largest growth to the next
FEELERS = 4
UNFELT_N = 4.0 * STEP_N  # bound by the rig file's stiffness while the cell, perhaps stuck, shows no change
LEG_S, SHORTEST_LEG_S, SLOWEST_MM_S = 0.25, 0.05, 0.1  # longest, shortest time of a step; least speed
REST_S = 0.15  # for the drive to settle
QUIET_S = 0.5  # at rest before the first step, to measure the noise
PAIRS = 7  # the whole trial fits into the 10 s of records that any rig file keeps
CREEP_SETTLE_S = 2.0  # after the step: a weight that was hung swings
CREEP_BINS = 40  # each longer than the one before: an exponential is as well seen in each decade of time
CREEP_STALE_NS = 1_000_000_000
STEP_WAIT_S, BEFORE_S = 120.0, 2.0  # for the weight to be hung; length of a bin before that
CREEP_SHORTEST_S, CREEP_LONGEST_S = 20.0, 14_400.0
DITHER = 0.02  # each pair is shorter than the one before, so that rounding in the drive's position averages out


class Trial(Protocol):
    """A trial under way."""

    moves: bool
    """The trial moves the stroke on purpose."""
    power_s: float
    """Longest time for which the trial needs the motor to hold; 0: in HOLD it measures with the load on the brake."""

    @property
    def wanted_mm_s(self) -> float:
        """Speed wanted now."""

    @property
    def figures(self) -> dict[str, float]:
        """Result for the reply, by the names of its fields in `rigctl.ipc.record.REPLY`."""

    def see(self, inbox: Inbox, snapshot: Snapshot) -> Refusal | None:
        """One tick."""


class Average:
    """Mean and rms of the cell's reading (before zero and scale) in N, over `AVERAGED_S`, at standstill."""

    moves = False
    power_s = 0.0

    def __init__(self, settings: RigSettings, *, largest_n: float = math.inf) -> None:
        """``largest_n``: largest sample allowed."""
        self._largest_n = largest_n
        self._left = round(AVERAGED_S * settings.loop.rate_hz)
        self._compensates = settings.compensation is not None
        self._has_second = settings.second_force is not None
        cell = settings.tension_cell
        self._spread_n = max(SPREAD_NOISES * cell.noise_n, SPREAD_RANGE * cell.range_n)
        self._first = self._sum = self._squares = self._creep = self._second = 0.0
        self._doubt_n, self._beside_n, self._cell_c = 0.0, 0.0, math.nan
        self.samples = 0
        self.wanted_mm_s = 0.0

    @property
    def figures(self) -> dict[str, float]:
        """Mean and rms about it, and what the loop took out of the tension meanwhile."""
        found = {"reading_n": self.mean_n, "rms_n": self.rms_n, "samples": float(self.samples)}
        if self.samples and self._compensates:
            found |= {"creep_n": self._creep / self.samples, "creep_doubt_n": self._doubt_n}
            found |= {"zero_drift_n": self._beside_n}
            found |= {"cell_c": self._cell_c} if math.isfinite(self._cell_c) else {}
        if self.samples and self._has_second and math.isfinite(self._second):
            found |= {"second_n": self._second / self.samples}
        return found

    @property
    def mean_n(self) -> float:
        """NaN without samples."""
        return self._first + self._sum / self.samples if self.samples else math.nan

    @property
    def rms_n(self) -> float:
        """About the mean; NaN without samples."""
        if not self.samples:
            return math.nan
        mean = self._sum / self.samples
        return math.sqrt(max(0.0, self._squares / self.samples - mean * mean))

    def see(self, inbox: Inbox, snapshot: Snapshot) -> Refusal | None:
        """Take this tick's sample, if one came."""
        if snapshot.cell_quality or not snapshot.cell_heard:
            return Refusal.NO_SAMPLES
        if abs(inbox.drive.speed_mm_s) > STILL_MM_S:
            return Refusal.UNSTEADY
        if inbox.cell_fresh:
            if abs(inbox.cell.reading_n) > self._largest_n:
                return Refusal.LOADED
            if not self.samples:
                self._first = inbox.cell.reading_n
            beyond = inbox.cell.reading_n - self._first  # sums of small numbers lose no digits
            self.samples += 1
            self._sum += beyond
            self._squares += beyond * beyond
            self._creep += inbox.cell_correction.creep_n
            if self._has_second:  # without a good sample of it the mean is NaN, and not used
                second = inbox.second
                self._second += second.reading_n if second.usable(snapshot.t_ns) else math.nan
        self._left -= 1
        if self._left > 0:
            return None
        if self.samples < FEWEST_SAMPLES:
            return Refusal.NO_SAMPLES
        cell = inbox.cell_correction
        self._doubt_n, self._cell_c = cell.doubt_n, cell.temperature_c
        self._beside_n = cell.offset_n - cell.correction.zero_n
        return Refusal.UNSTEADY if self.rms_n > self._spread_n else Refusal.NONE


class Excitation:
    """Small steps of speed, up and down by the same stroke, so that the stroke ends where it began.

    `rigctl.commission.identification` evaluates the records. The rig file's stiffness is not believed: short steps go
    first, each longer than the one before, and the tension gained in one bounds the stroke of the next. The trial ends
    if tension or stroke leave their bounds all the same. It goes by the loop's grid: periods that the loop skips count,
    and where they made a step too long, the step back is as long.
    """

    moves = True
    power_s = QUIET_S + 2 * (FEELERS + PAIRS) * (LEG_S + REST_S) + 1.0

    def __init__(self, settings: RigSettings, inbox: Inbox) -> None:
        self._rate = rate = settings.loop.rate_hz
        self._speed_max_mm_s = settings.tension.speed_max_mm_s
        self._noise_n = settings.tension_cell.noise_n
        self._unfelt_mm = UNFELT_N / settings.plant.stiffness_n_mm
        self._felt = False
        self._stray_n = STRAY_N + 5.0 * self._noise_n
        self._rest, self._left = round(REST_S * rate), round(QUIET_S * rate)
        self._start_n, self._start_mm = inbox.cell.tension_n, inbox.drive.stroke_mm
        cylinder = settings.cylinder
        inside = cylinder.stroke_min_mm <= self._start_mm <= cylinder.stroke_max_mm - STEP_MM
        self._fits = inside and self._start_n + self._stray_n <= settings.safety.tension_high_n
        self._steps = self._leg = 0
        self._stroke_mm = self._speed_mm_s = self._stiffest_n_mm = 0.0
        self._settled_n, self._settled = 0.0, 0  # sum and count of the tension in the second half of a rest
        self._rest_n = self._start_n
        self._period_ns = settings.loop.period_ns
        self._ticks = self._point = self._over = 0
        self.wanted_mm_s = 0.0

    @property
    def figures(self) -> dict[str, float]:
        """Time taken."""
        return {"duration_s": self._ticks / self._rate}

    def see(self, inbox: Inbox, snapshot: Snapshot) -> Refusal | None:
        """Choose this tick's speed, within the bounds."""
        strays_n, strays_mm = abs(inbox.cell.tension_n - self._start_n), abs(inbox.drive.stroke_mm - self._start_mm)
        if not (self._fits and strays_n <= self._stray_n and strays_mm <= self._stroke_mm + STRAY_MM):
            return Refusal.STRAYED
        point = snapshot.t_ns // self._period_ns
        passed = point - self._point if self._ticks else 1
        self._point = point
        self._ticks += passed
        if not self.wanted_mm_s and self._left <= self._rest // 2:
            self._settled_n += inbox.cell.tension_n
            self._settled += 1
        self._left -= passed
        if self._left > 0:
            return None
        if self.wanted_mm_s:
            self._over = -self._left
            self.wanted_mm_s, self._left = 0.0, self._rest
            return None
        if self._steps == 2 * (FEELERS + PAIRS):
            return Refusal.NONE
        self._next_step()
        return None

    def _next_step(self) -> None:
        """Step up, or down again; the pair before bounds the stroke."""
        settled_n = self._settled_n / max(1, self._settled)
        self._settled_n, self._settled = 0.0, 0
        if self._steps % 2:  # the stroke is up, so the next step goes down
            gained_n = abs(settled_n - self._rest_n)
            self._felt = gained_n > self._noise_n
            self._stiffest_n_mm = (gained_n + self._noise_n) / self._stroke_mm
            self._speed_mm_s, self._leg = -self._speed_mm_s, self._leg + self._over
        else:
            self._rest_n = settled_n
            self._stroke_mm = self._next_stroke_mm(self._steps // 2)
            leg_s = min(LEG_S, max(SHORTEST_LEG_S, self._stroke_mm / SLOWEST_MM_S))
            self._leg = round(leg_s * self._rate)
            self._speed_mm_s = min(self._stroke_mm * self._rate / self._leg, self._speed_max_mm_s)
        self._steps += 1
        self.wanted_mm_s, self._left = self._speed_mm_s, self._leg

    def _next_stroke_mm(self, pair: int) -> float:
        if pair == 0:
            return FEELER_MM
        if pair > FEELERS:
            return self._stroke_mm * (1.0 - DITHER)
        stroke_mm = min(STEP_MM, FEELER_GROWTH * self._stroke_mm, STEP_N / self._stiffest_n_mm)
        return stroke_mm if self._felt else min(stroke_mm, self._unfelt_mm)


@dataclass(frozen=True)
class LoadBin:
    """Samples of the cell's reading after the load's step: how many, their mean and rms in N, mean time in s.

    ``after_s`` is negative before the step. ``cell_c``: temperature of the cell, NaN where it is not known.
    """

    samples: int
    mean_n: float
    rms_n: float
    after_s: float
    cell_c: float


class LoadStep:
    """Records the reading after a step of the load for `rigctl.commission.creep`, in bins that grow with time.

    In DISARMED a known weight is hung on the cell, or taken off it, within `STEP_WAIT_S`. In HOLD the step is the
    tensioning that went before: then rope and spring relax too.
    """

    moves = False
    power_s = 0.0

    def __init__(self, settings: RigSettings, inbox: Inbox, seconds: float, tight_ns: int | None) -> None:
        """``seconds``: how long from the step on. ``tight_ns``: HOLD, when the tension came; None: a weight."""
        assert settings.calibration is not None  # the gateway refuses it without
        self._half_n = 0.5 * settings.calibration.reference_n
        self._seconds, self._tight_ns = seconds, tight_ns
        cell = settings.tension_cell
        self._spread_n = max(SPREAD_NOISES * cell.noise_n, SPREAD_RANGE * cell.range_n)
        self._loaded = abs(inbox.cell.tension_n) > self._half_n
        self._begun_ns = self._step_ns = -1
        self._bin_s, self._seen_before = 0.0, False
        ramp_s = abs(inbox.cell.tension_n) / settings.tension.ramp_n_s
        self._half_ramp_ns = round(0.5e9 * ramp_s) if math.isfinite(ramp_s) else 0
        self._edges_s = [
            CREEP_SETTLE_S * (seconds / CREEP_SETTLE_S) ** (i / CREEP_BINS) for i in range(1, CREEP_BINS + 1)
        ]
        self._place = 0
        self._first_n = self._sum = self._squares = self._times_s = 0.0
        self._samples = 0
        self._mean_n = self._rms_n = math.nan
        self._ended: list[LoadBin] = []
        self.wanted_mm_s = 0.0

    @property
    def figures(self) -> dict[str, float]:
        """Duration, and mean and rms of the last bin."""
        return {"duration_s": self._seconds, "reading_n": self._mean_n, "rms_n": self._rms_n}

    def take_bins(self) -> list[LoadBin]:
        """Bins that have ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def see(self, inbox: Inbox, snapshot: Snapshot) -> Refusal | None:
        """Take this tick's sample, if one came."""
        now_ns = snapshot.t_ns
        refusal = self._begin(now_ns) if self._begun_ns < 0 else None
        if refusal is not None:
            return refusal
        if snapshot.cell_quality or snapshot.cell_age_ns > CREEP_STALE_NS:
            return Refusal.NO_SAMPLES
        if abs(inbox.drive.speed_mm_s) > STILL_MM_S:
            return Refusal.UNSTEADY
        if self._step_ns < 0:
            return self._await_step(inbox, now_ns)
        after_s = (now_ns - self._step_ns) * 1e-9
        return self._record(inbox, after_s) if after_s >= CREEP_SETTLE_S else None

    def _begin(self, now_ns: int) -> Refusal | None:
        if not CREEP_SHORTEST_S <= self._seconds <= CREEP_LONGEST_S:
            return Refusal.OUT_OF_RANGE
        self._begun_ns = now_ns
        if self._tight_ns is None:
            return None
        self._step_ns = self._tight_ns + self._half_ramp_ns
        return None if self._loaded else Refusal.SLACK

    def _record(self, inbox: Inbox, after_s: float) -> Refusal | None:
        if (abs(inbox.cell.tension_n) > self._half_n) is not self._loaded:
            return Refusal.UNSTEADY
        while self._place < CREEP_BINS and after_s >= self._edges_s[self._place]:
            self._place += 1
            if self._samples:
                self._end_bin(inbox)
                if self._rms_n > self._spread_n:
                    return Refusal.UNSTEADY
        if self._place == CREEP_BINS:
            return Refusal.NONE
        if inbox.cell_fresh:
            self._add(inbox.cell.reading_n, after_s)
        return None

    def _await_step(self, inbox: Inbox, now_ns: int) -> Refusal | None:
        """Average what comes before the step, `BEFORE_S` at a time; the part that the step cuts short is left out."""
        since_s = (now_ns - self._begun_ns) * 1e-9
        if since_s > STEP_WAIT_S:
            return Refusal.NO_STEP
        if (abs(inbox.cell.tension_n) > self._half_n) is not self._loaded:
            self._loaded, self._step_ns = not self._loaded, now_ns
            self._samples = 0
            return None if self._seen_before else Refusal.NO_STEP
        if inbox.cell_fresh:
            self._add(inbox.cell.reading_n, since_s)
        if since_s >= self._bin_s + BEFORE_S:
            self._bin_s = since_s
            if self._samples:
                self._end_bin(inbox, before=True)
                self._seen_before = True
        return None

    def _add(self, reading_n: float, at_s: float) -> None:
        if not self._samples:
            self._first_n, self._sum, self._squares, self._times_s = reading_n, 0.0, 0.0, 0.0
        beyond = reading_n - self._first_n
        self._samples += 1
        self._sum += beyond
        self._squares += beyond * beyond
        self._times_s += at_s

    def _end_bin(self, inbox: Inbox, *, before: bool = False) -> None:
        mean = self._sum / self._samples
        self._mean_n = self._first_n + mean
        self._rms_n = math.sqrt(max(0.0, self._squares / self._samples - mean * mean))
        after_s = -STEP_WAIT_S if before else self._times_s / self._samples
        self._ended.append(
            LoadBin(self._samples, self._mean_n, self._rms_n, after_s, inbox.cell_correction.temperature_c)
        )
        self._samples = 0


def begin(
    verb: Verb,
    settings: RigSettings,
    inbox: Inbox,
    *,
    creep_s: float = math.nan,
    tight_ns: int | None = None,
    regulated: bool = False,
) -> Trial:
    """The trial of a command.

    ``creep_s`` and ``tight_ns``: of a CALIBRATE that records the creep, see `LoadStep`. ``regulated``: of a RESPONSE,
    while COMPENSATING.
    """
    if verb is Verb.CALIBRATE and creep_s > 0.0:
        return LoadStep(settings, inbox, creep_s, tight_ns)
    if verb is Verb.RESPONSE:
        return FrequencyTrial(settings, inbox, regulated=regulated)
    if verb is Verb.IDENTIFY:
        return Excitation(settings, inbox)
    if verb is Verb.TARE:
        return Average(settings, largest_n=settings.tare_limit_n)
    return Average(settings)
