"""The second way to the rope's tension: its own zero and scale, compared with the cell's tension and fused with it.

The cell leads: it has the bandwidth. The second path moves it slowly,

    T = T_cell + o,    do/dt = (w (T_2 - T_cell) - o) / tau

with the weight ``w`` of inverse variances, so that noise and dynamics of the second path do not reach the loop. With
two paths a difference shows that one is wrong, not which: beyond ``disagree_n`` the rig holds.
"""

from __future__ import annotations

import math

from rigctl.config.second_force_section import SecondForceSettings
from rigctl.devices.objects import MM_PER_POSITION_UNIT
from rigctl.ipc.correction import Correction
from rigctl.model.samples import Quality

_NS = 1e-9
_INVALID = Quality.INVALID.value
COMPARED_S = 1.0  # low-pass of the difference
QUICK_SIGMA = 5.0  # of the two noises: a larger quick difference is none of them, and counts for no more
ROUNDED = 1.0 / math.sqrt(12.0)  # standard deviation of a rounded value over its unit
POSITION_MM = MM_PER_POSITION_UNIT * ROUNDED
STRETCH_MM_S = 1.0  # a faster stroke is not used for a stretch: the encoders' samples are up to a millisecond apart


class NoSecondForce:
    """A rig whose cell is the only way to the tension.

    ``reading_n``, ``tension_n``: of the second path, before and after zero and scale; NaN without a good sample.
    ``offset_n``: what fusion adds to the cell's tension. ``gap_n``: low-passed difference of the two tensions.
    ``known``: it has a zero. ``quality``, ``t_ns``: of the newest sample; 0 good.
    """

    reading_n = tension_n = math.nan
    offset_n = gap_n = 0.0
    known = False
    quality = 0
    t_ns = -(1 << 61)

    def usable(self, _now_ns: int) -> bool:
        """There is a good sample that is not stale."""
        return False


class SecondForce(NoSecondForce):
    """Reading, tension and offset of the second path, all in N."""

    def __init__(self, section: SecondForceSettings, cell_noise_n: float, period_s: float) -> None:
        """``cell_noise_n``, ``period_s``: rms noise of the cell and period of the loop, for ``quick_hz``."""
        self.node = section.node
        self._stretches = section.kind == "stretch"
        self._weight, self._fuse_s = section.weight, section.fuse_s
        self._n_mm = section.spring_n_mm if section.spring_n_mm is not None else 1.0
        self._largest_n = self._weight * section.disagree_n
        self._stale_ns = section.stale_ms * 1_000_000
        self._first_zero_n, self._scale = section.zero_n, 1.0
        self._zero_n, self.known = section.zero_n or 0.0, section.zero_n is not None
        self._sample = math.nan
        self._leaving = False
        self._quick = section.quick_hz is not None
        own_n = self._n_mm * math.hypot(section.noise_um * 1e-3, ROUNDED / section.counts_per_mm, POSITION_MM)
        self._quick_weight = cell_noise_n**2 / (cell_noise_n**2 + own_n**2) if self._quick else 0.0
        self._quick_share = -math.expm1(-2.0 * math.pi * (section.quick_hz or 0.0) * period_s)
        self._quick_most_n = QUICK_SIGMA * math.hypot(cell_noise_n, own_n) if self._quick else 0.0
        self._low_n = math.nan  # low-passed difference
        self.quick_n = 0.0
        self.in_error = self.restarted = False  # its device reports an error; it restarted, with unverified settings
        self._compared_ns = 0
        self.fresh = False

    def put(self, correction: Correction) -> None:
        """Put another zero and scale in force; the comparison begins anew."""
        before = self._zero_n, self._scale, self.known
        zero_n = self._first_zero_n if correction.second_zero_n is None else correction.second_zero_n
        self.known = zero_n is not None
        self._zero_n, self._scale = zero_n or 0.0, correction.second_scale
        if before != (self._zero_n, self._scale, self.known):
            self.gap_n = self.offset_n = 0.0
            self._compared_ns = 0

    def report(self, *, in_error: bool) -> None:
        """Its device reports an error, or the end of it."""
        self.in_error = in_error

    def restart(self) -> None:
        """Its device has restarted, with unverified settings."""
        self.restarted = True

    def take(self, value: float, quality: int, t_ns: int) -> None:
        """Take a sample of its device: N of a cell, mm of an encoder."""
        self.quality = _INVALID if self.in_error or self.restarted else quality
        self.t_ns, self.fresh = t_ns, not self.quality
        self._sample = value

    def look(self, cell_n: float, stroke_mm: float, speed_mm_s: float, now_ns: int) -> None:
        """Compare and fuse, once a tick; ``cell_n``: the cell's own tension."""
        self.quick_n = 0.0
        if not self.fresh:
            self._low_n = math.nan
            if now_ns - self.t_ns > self._stale_ns:
                self._leave(now_ns)
            return
        self.fresh = False
        if not self._stretches:
            self.reading_n = self._sample
        elif self._quick or abs(speed_mm_s) <= STRETCH_MM_S:
            self.reading_n = (stroke_mm - self._sample) * self._n_mm
        else:
            self._compared_ns = now_ns
            return
        self.tension_n = (self.reading_n - self._zero_n) * self._scale if self.known else math.nan
        difference_n = self.tension_n - cell_n
        if not math.isfinite(difference_n):
            self._leave(now_ns)
            return
        if self._quick:
            self._take_off_noise(difference_n)
        elapsed_s, self._leaving = self._elapsed_s(now_ns), False
        self.gap_n += (difference_n - self.gap_n) * -math.expm1(-elapsed_s / COMPARED_S)
        wanted_n = max(-self._largest_n, min(self._largest_n, self._weight * difference_n))
        self.offset_n += (wanted_n - self.offset_n) * -math.expm1(-elapsed_s / self._fuse_s)

    def _take_off_noise(self, difference_n: float) -> None:
        """What is quick in the difference is noise of both, and their weights share it."""
        if math.isnan(self._low_n):
            self._low_n = difference_n
        self._low_n += (difference_n - self._low_n) * self._quick_share
        most_n = self._quick_most_n
        self.quick_n = self._quick_weight * max(-most_n, min(most_n, difference_n - self._low_n))

    def usable(self, now_ns: int) -> bool:
        """See `NoSecondForce`."""
        return not self.quality and now_ns - self.t_ns <= self._stale_ns

    def _leave(self, now_ns: int) -> None:
        """Without the second path the cell's tension stands alone again, without a step."""
        if not self._leaving:  # the wait until it was stale is no time of the decay
            self._leaving, self._compared_ns = True, now_ns
        self.offset_n *= math.exp(-self._elapsed_s(now_ns) / self._fuse_s)
        self.gap_n = 0.0

    def _elapsed_s(self, now_ns: int) -> float:
        """Since the last comparison, at most a second: time in which nothing was compared counts for nothing."""
        elapsed_s = min(COMPARED_S, (now_ns - self._compared_ns) * _NS) if self._compared_ns else 0.0
        self._compared_ns = now_ns
        return elapsed_s
