"""Run-out of the rail against its angle: learnt during moves and fed forward in the next ones.

A rail that is not level, or whose shaft is not plumb, lifts the upper point by a height h that depends on its angle
only, so h' (mm per rad) times the rail's rate is a disturbance speed known before the cell measures it. The table
holds h' per bin of angle. The disturbance w that the Kalman filter still finds is the error of the table; a share of
it is added once a bin has been passed out and back (iterative learning):

    h'_i <- KEPT h'_i + learning_rate / 2 * (out + back),   out, back = sum(w r) / sum(r^2) of the samples on that way

with r the rail's rate, over bin i and its neighbours at half weight. Only the mean of both ways is run-out: a rail
that lags the mechanism also lets the rope down by R tan(lag) per rad in both directions, and terms that change sign
with the direction cancel. A pass is a motion without reversal or stop; the table is constant during it, so that
learning never sees its own effect on w. The table is in memory only and is empty after a start of the daemon.
"""

from __future__ import annotations

import math

from rigctl.config.rail_sections import RailEncoderSettings, RunOutSettings
from rigctl.config.settings import RigSettings

RATE_S = 0.005
"""Low-pass of the rail's rate: the rail moves in jerks, and one count of 2^20 per turn at 1 kHz is 6 mrad/s."""
FASTEST_RAD_S = math.radians(10.0)
"""No mechanism of ours turns faster (``demo.speed_deg_s``); a slipping rail may for a moment."""
JUMP_RAD_S = math.radians(60.0)
"""A higher rate is a jump of the encoder."""
STOPPED_S = 0.5
"""A rail slower than ``min_speed_deg_s`` for longer than this has ended its pass; until then it only sticks."""
KEPT = 0.9
"""Share of a slope kept at each learning: the rest decays unless w confirms it, so noise and bias do not add up."""
BINS_PER_TICK = 8
"""Bins learnt per tick after a pass, which takes 16 us."""
_LOST_SAMPLES = 3


def stale_ns(rail: RailEncoderSettings) -> int:
    """Oldest angle in use, in ns: two samples in a row may be missing."""
    return _LOST_SAMPLES * 1_000_000_000 // rail.rate_hz


class _Way:
    """Sums of the bins in one direction since they were last learnt."""

    __slots__ = ("products", "squares")

    def __init__(self, bins: int) -> None:
        self.products = [0.0] * (bins + 2)  # sum of w r
        self.squares = [0.0] * (bins + 2)  # sum of r^2

    def slope(self, i: int) -> float:
        """Disturbance per rail rate about bin i in mm/rad, with its neighbours at half weight."""
        products, squares = self.products, self.squares
        square = squares[i] + 0.5 * (squares[i - 1] + squares[i + 1])
        return (products[i] + 0.5 * (products[i - 1] + products[i + 1])) / square

    def clear(self) -> None:
        """Clear the sums."""
        for i in range(len(self.products)):
            self.products[i] = self.squares[i] = 0.0


class RunOutTable:
    """The table and the pass under way.

    Each tick: ``step``, or ``lose`` where there is nothing to compensate.

    Args:
        settings: the section `run_out`.
        rig: for loop rate and speed limit.
    """

    def __init__(self, settings: RunOutSettings, rig: RigSettings) -> None:
        self._low = math.radians(settings.angle_min_deg)
        self._bins = bins = settings.bins
        self._width = math.radians(settings.angle_max_deg - settings.angle_min_deg) / bins
        self._share = settings.learning_rate
        self._slowest = math.radians(settings.min_speed_deg_s)
        self._dt = 1.0 / rig.loop.rate_hz
        self._stopped_ticks = round(STOPPED_S * rig.loop.rate_hz)
        self._speed_max = rig.tension.speed_max_mm_s
        self.slope_max_mm_rad = self._speed_max / FASTEST_RAD_S
        """Bound of every slope: at ``FASTEST_RAD_S`` it takes the law's whole speed."""
        self.slopes_mm_rad = [0.0] * (bins + 2)
        """h' at the bins' centres; the first and the last are outside the range and stay 0, so that h' fades out."""
        self._next = 0  # bin to be learnt next, 0: none
        self._learnt: list[int] = []  # bins learnt whose sums have yet to be cleared
        self._ways = _Way(bins), _Way(bins)  # out (rate positive) and back
        self._place = -1.0  # in bins; 1.0 is the centre of the first bin, below 0 is outside
        self._slow_rad: float | None = None  # angle, low-passed; None: unknown
        self._ticks = 0  # since the last sample
        self._direction = 0.0  # of the pass under way, 0: none
        self._still = 0  # ticks below ``min_speed_deg_s``
        self._slow_rad_s = 0.0  # rate, low-passed once more
        self._slow_mm_s = 0.0  # disturbance, low-passed with the same lag as the rate
        self._blend = self._dt / (self._dt + RATE_S)
        self._ahead_s = rig.plant.command_delay_s + rig.plant.cylinder_lag_s
        self._lead_s = self._ahead_s + RATE_S
        self.rate_rad_s = self.acceleration_rad_s2 = 0.0
        self.speed_mm_s = 0.0
        """Disturbance speed by the table, mm/s; positive stretches the rope."""
        self.lead_mm_s = 0.0
        """Change of ``speed_mm_s`` by the time the cylinder follows a command given now, mm/s."""

    def step(
        self, angle_rad: float, ticks: int, disturbance_mm_s: float, *, fresh: bool, known: bool, learns: bool
    ) -> float:  # fmt: skip
        """One tick; returns ``speed_mm_s``.

        Args:
            angle_rad: the newest sample.
            ticks: since the last one.
            disturbance_mm_s: found beside the table's in the tick before.
            fresh: the sample came in this tick.
            known: it is good, and not stale.
            learns: the law regulates.
        """
        if not known:
            self.lose()
            return 0.0
        self.follow(angle_rad, ticks, fresh=fresh)
        if learns:
            self.learn(disturbance_mm_s)
        else:
            self.forget_pass()
        return self.speed_mm_s

    def follow(self, angle_rad: float, ticks: int, *, fresh: bool) -> None:
        """Advance ``ticks`` periods; ``angle_rad`` is the newest sample, ``fresh`` if it came in this tick."""
        self._ticks += ticks
        if fresh:
            self._sample(angle_rad)
        rate, place = self.rate_rad_s, self._place
        acceleration = self.acceleration_rad_s2
        speed = self._slope(place) * (rate + RATE_S * acceleration)  # compensates the low-pass' lag
        then = self._slope(place + rate * self._ahead_s / self._width)
        ahead = then * (rate + self._lead_s * acceleration)
        most = self._speed_max
        self.speed_mm_s = speed = max(-most, min(most, speed))
        self.lead_mm_s = max(-most, min(most, ahead)) - speed

    def _slope(self, place: float) -> float:
        """h' by linear interpolation; 0 outside the range."""
        if not 0.0 <= place < self._bins + 1:
            return 0.0
        i = int(place)
        here = self.slopes_mm_rad[i]
        return here + (place - i) * (self.slopes_mm_rad[i + 1] - here)

    def _sample(self, angle_rad: float) -> None:
        elapsed_s = self._ticks * self._dt
        self._ticks = 0
        slow = self._slow_rad
        if slow is None:
            self._slow_rad, self.rate_rad_s, self._slow_rad_s, self.acceleration_rad_s2 = angle_rad, 0.0, 0.0, 0.0
        else:
            # Derivative by the low-pass: input less output, modulo a turn because the encoder may have wrapped.
            rate = math.remainder(angle_rad - slow, math.tau) / (elapsed_s + RATE_S)
            if abs(rate) > JUMP_RAD_S:
                self.lose()
                return
            self._slow_rad = slow + rate * elapsed_s
            self.rate_rad_s = rate
            self.acceleration_rad_s2 = acceleration = (rate - self._slow_rad_s) / (elapsed_s + RATE_S)
            self._slow_rad_s += acceleration * elapsed_s
        place = ((angle_rad - self._low + 0.5 * self._width) % math.tau) / self._width
        self._place = place if place < self._bins + 1 else -1.0

    def lose(self) -> None:
        """The angle is unknown: feed forward nothing, and learn nothing from this pass."""
        if self._slow_rad is not None:
            self._slow_rad, self._place = None, -1.0
            self.rate_rad_s = self.speed_mm_s = self.lead_mm_s = 0.0
            self._ticks = 0
            self.forget_pass()

    def learn(self, disturbance_mm_s: float) -> None:
        """Take the disturbance speed found beside the table's; call it in COMPENSATING only."""
        rate = self.rate_rad_s
        self._slow_mm_s += self._blend * (disturbance_mm_s - self._slow_mm_s)
        if self._next or self._learnt:
            self._fold()
            return
        if abs(rate) < self._slowest:
            self._still += 1
            if self._still == self._stopped_ticks:
                self._end_pass()
            return
        self._still = 0
        if rate * self._direction < 0.0:
            self._end_pass()
        self._direction = rate
        i = int(self._place - rate * RATE_S / self._width + 0.5)
        if 1 <= i <= self._bins and self._place >= 0.0:
            way = self._ways[rate < 0.0]
            way.products[i] += self._slow_mm_s * rate
            way.squares[i] += rate * rate

    def forget_pass(self) -> None:
        """Discard the pass under way: it did not end under control."""
        if self._direction:
            self._direction = 0.0
            for way in self._ways:
                way.clear()

    def _end_pass(self) -> None:
        if self._direction:
            self._direction = 0.0
            self._next = 1

    def _fold(self) -> None:
        """Learn the bins passed both out and back, `BINS_PER_TICK` at a time."""
        out, back = self._ways
        if not self._next:
            for i in self._learnt[-BINS_PER_TICK:]:
                out.products[i] = out.squares[i] = back.products[i] = back.squares[i] = 0.0
            del self._learnt[-BINS_PER_TICK:]
            return
        slopes, most, half = self.slopes_mm_rad, self.slope_max_mm_rad, 0.5 * self._share
        after = min(self._next + BINS_PER_TICK, self._bins + 1)
        for i in range(self._next, after):
            if out.squares[i] and back.squares[i]:
                slopes[i] = max(-most, min(most, KEPT * slopes[i] + half * (out.slope(i) + back.slope(i))))
                self._learnt.append(i)
        self._next = after if after <= self._bins else 0
