"""Run-out of the rail against its angle: learnt from the moves themselves, and fed forward in those that follow.

A rail that is not level, or whose shaft is not plumb, lifts the upper point by a height h that depends on its angle
only, so that h' (mm per rad) times the rail's rate is a disturbance speed that can be known before the cell feels it.
The table holds h' per bin of angle. What the Kalman filter still finds as disturbance w beside it is what the table
lacks, and once a bin has been passed out and back a share of that is added (iterative learning):

    h'_i <- KEPT h'_i + learning_rate / 2 * (out + back),   out, back = sum(w r) / sum(r^2) of the samples on that way

with r the rail's rate, over bin i and its neighbours at half weight. Only the mean of both ways is run-out: a rail
that jerks after the mechanism also lets the rope down by R tan(lag) per rad, whichever way it goes, and what changes
sign with the way cancels. A pass is a way without reversal or stop; the table stands still during it, so that learning
never meets its own effect on w. It is memory only: after a start of the daemon it is empty.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RailEncoderSettings, RigSettings, RunOutSettings

RATE_S = 0.005
"""Low-pass of the rail's rate. The rail goes in jerks; a count of 2^20 in a turn at 1 kHz is 6 mrad/s by itself."""
FASTEST_RAD_S = math.radians(10.0)
"""No mechanism of ours turns faster (``demo.speed_deg_s``); a rail that slips may, for a moment."""
JUMP_RAD_S = math.radians(60.0)
"""A rate beyond this is none, but a jump of the encoder."""
STOPPED_S = 0.5
"""A rail slower than ``min_speed_deg_s`` for longer has ended its pass; for less, it only sticks."""
KEPT = 0.9
"""Of a slope, each time it is learnt anew: what w does not confirm goes, so that neither noise nor bias piles up."""
BINS_PER_TICK = 8
"""Learnt per tick after a pass, so that no tick is long: 16 us."""
_LOST_SAMPLES = 3


def stale_ns(rail: RailEncoderSettings) -> int:
    """Oldest angle that is used: two samples may be missing, the third may not."""
    return _LOST_SAMPLES * 1_000_000_000 // rail.rate_hz


class _Way:
    """What was seen of the bins in one direction since they were last learnt."""

    __slots__ = ("products", "squares")

    def __init__(self, bins: int) -> None:
        self.products = [0.0] * (bins + 2)  # sum of w r
        self.squares = [0.0] * (bins + 2)  # sum of r^2

    def slope(self, i: int) -> float:
        """Disturbance per rail rate about bin i, mm/rad, its neighbours at half weight."""
        products, squares = self.products, self.squares
        square = squares[i] + 0.5 * (squares[i - 1] + squares[i + 1])
        return (products[i] + 0.5 * (products[i - 1] + products[i + 1])) / square

    def clear(self) -> None:
        """Forget it."""
        for i in range(len(self.products)):
            self.products[i] = self.squares[i] = 0.0


class RunOutTable:
    """The table and the pass under way.

    Each tick: ``follow`` with the newest angle or ``lose`` without one, then read ``speed_mm_s``, then ``learn``.

    Args:
        settings: the section `run_out`.
        rig: whose loop rate and speed limit count.
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
        """Bound of every slope: at ``FASTEST_RAD_S`` it asks for the law's whole speed."""
        self.slopes_mm_rad = [0.0] * (bins + 2)
        """h' at the bins' centres; the first and the last, outside the range, stay 0 so that it fades out there."""
        self._next = 0  # bin to be learnt next, 0: none
        self._learnt: list[int] = []  # bins learnt of whose sums are to be cleared
        self._ways = _Way(bins), _Way(bins)  # out (rate positive) and back
        self._place = -1.0  # in bins, 1.0 is the first one's centre; below 0: outside
        self._slow_rad: float | None = None  # the angle, low-passed; None: none known
        self._ticks = 0  # since the last sample
        self._direction = 0.0  # of the pass under way, 0: none
        self._still = 0  # ticks slower than the slowest
        self._slow_rad_s = 0.0  # the rate, low-passed once more
        self._slow_mm_s = 0.0  # the disturbance found, low-passed as the rate is: what is compared lags alike
        self._blend = self._dt / (self._dt + RATE_S)
        self._ahead_s = rig.plant.command_delay_s + rig.plant.cylinder_lag_s
        self._lead_s = self._ahead_s + RATE_S
        self.rate_rad_s = self.acceleration_rad_s2 = 0.0
        self.speed_mm_s = 0.0
        """Disturbance speed by the table, mm/s, positive stretches the rope."""
        self.lead_mm_s = 0.0
        """What is to come on top of it by the time the cylinder follows a command given now, mm/s."""

    def follow(self, angle_rad: float, ticks: int, *, fresh: bool) -> None:
        """``ticks`` periods on; ``angle_rad`` is a new sample, or between two samples the one before."""
        self._ticks += ticks
        if fresh:
            self._sample(angle_rad)
        rate, place = self.rate_rad_s, self._place
        acceleration = self.acceleration_rad_s2
        speed = self._slope(place) * (rate + RATE_S * acceleration)  # the low-pass' lag made good
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
            # The low-pass' own input less its output: the encoder may have gone through the end of its turn between.
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
        """The angle is not known: nothing is fed forward, and nothing learnt of the pass it is lost in."""
        if self._slow_rad is not None:
            self._slow_rad, self._place = None, -1.0
            self.rate_rad_s = self.speed_mm_s = self.lead_mm_s = 0.0
            self._ticks = 0
            self.forget_pass()

    def learn(self, disturbance_mm_s: float) -> None:
        """Take in the disturbance speed found beside the table's; while COMPENSATING only."""
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
        """Nothing is learnt of the pass under way: it did not end under control."""
        if self._direction:
            self._direction = 0.0
            for way in self._ways:
                way.clear()

    def _end_pass(self) -> None:
        if self._direction:
            self._direction = 0.0
            self._next = 1

    def _fold(self) -> None:
        """Where both ways have been seen, add a share of what was found beside the table; some bins at a time."""
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
