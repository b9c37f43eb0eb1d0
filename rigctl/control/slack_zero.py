"""The cell's zero as it is seen while the rope is surely slack: a check of the tare, and on request its correction.

A reading near zero proves nothing: a rope may pull with a few newtons. That it is slack is proven by the stroke. The
rope was slack while the stroke moved by `PROOF_MM` and the reading stayed within a tenth of what a tight rope would
have changed (and `BAND_N` at most), below ``tension.slack_n``. The zero is the mean of a rest of `REST_S` or more in
the same stretch: before the slack is taken up (TENSIONING), or after it has been paid out (RELEASING, then HOLD). A
rest counts only within `PROOF_AGE_S` of its proof, because the mechanism can be moved. As with the zero-tracking device
of a scale (OIML R 76-1, T.2.7.3) the correction is bounded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.control.inbox import Inbox
from rigctl.control.modes import Mode

PROOF_MM = 0.5
BAND_SHARE, BAND_N, NOISES = 0.1, 0.3, 5.0
REST_S, LONGEST_REST_S, PROOF_AGE_S = 1.0, 10.0, 30.0
STILL_MM_S = 0.1
SMOOTH_S = 0.005  # RELEASING pays out 1 mm beyond the last stretch, in 0.12 s
WATCHED_IN = frozenset({Mode.DISARMED, Mode.HOLD, Mode.TENSIONING, Mode.RELEASING})


class SlackZero(NamedTuple):
    """What one slack stretch shows: the tension that the unloaded cell still reads, and the samples in its mean."""

    tension_n: float
    samples: int


class SlackWatch:
    """Looks at every tick; gives a `SlackZero` once for each proof."""

    def __init__(self, settings: RigSettings) -> None:
        rate = settings.loop.rate_hz
        stiff_n = BAND_SHARE * PROOF_MM * settings.plant.stiffness_n_mm
        self._band_n = min(BAND_N, max(NOISES * settings.tension_cell.noise_n, stiff_n))
        self._slack_n = settings.tension.slack_n
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        self._share = -math.expm1(-1.0 / (SMOOTH_S * rate))
        self._fewest, self._most = round(REST_S * rate), round(LONGEST_REST_S * rate)
        self._smooth_n = self._level_n = math.nan
        self._low_mm = self._high_mm = 0.0
        self._proven_ns: int | None = None
        self._sum, self._count = 0.0, 0
        self._rest: SlackZero | None = None  # the last whole one
        self._rest_ns = 0

    def look(self, inbox: Inbox, mode: Mode, now_ns: int) -> SlackZero | None:
        """One tick; the zero where this tick's sample completes a rest and its proof."""
        drive_known = now_ns - inbox.drive_t_ns <= self._stale_ns
        if mode not in WATCHED_IN or inbox.cell_quality or not (drive_known and math.isfinite(inbox.stroke_mm)):
            self._begin(math.nan, 0.0)
            return None
        if not inbox.cell_fresh:
            return None
        tension_n, stroke_mm = inbox.cell_n, inbox.stroke_mm
        if math.isnan(self._level_n):
            self._smooth_n = tension_n
            self._begin(tension_n, stroke_mm)
        self._smooth_n += (tension_n - self._smooth_n) * self._share
        if abs(self._smooth_n - self._level_n) > self._band_n or self._smooth_n > self._slack_n:
            self._begin(self._smooth_n, stroke_mm)
        self._low_mm, self._high_mm = min(self._low_mm, stroke_mm), max(self._high_mm, stroke_mm)
        if self._high_mm - self._low_mm >= PROOF_MM and self._smooth_n <= self._slack_n:
            self._proven_ns = now_ns
            self._low_mm = self._high_mm = stroke_mm
        self._follow_rest(inbox, now_ns)
        return self._found(now_ns)

    def _begin(self, level_n: float, stroke_mm: float) -> None:
        """The reading has changed: what follows is another stretch."""
        self._level_n = level_n
        self._low_mm = self._high_mm = stroke_mm
        self._proven_ns, self._rest = None, None
        self._sum, self._count = 0.0, 0

    def _follow_rest(self, inbox: Inbox, now_ns: int) -> None:
        if abs(inbox.speed_mm_s) > STILL_MM_S:
            self._sum, self._count = 0.0, 0
            return
        self._sum += inbox.cell_n
        self._count += 1
        if self._count >= self._fewest:
            self._rest, self._rest_ns = SlackZero(self._sum / self._count, self._count), now_ns
        if self._count >= self._most:
            self._sum, self._count = 0.0, 0

    def _found(self, now_ns: int) -> SlackZero | None:
        proven_ns, rest = self._proven_ns, self._rest
        if proven_ns is None or rest is None:
            return None
        self._rest = None
        if max(now_ns - proven_ns, proven_ns - self._rest_ns) > PROOF_AGE_S * 1e9:
            return None
        self._proven_ns = None
        return rest
