"""The motor's current while the rope is tensioned: it shows a rope force that the cell does not show, or not all of.

On a slack rope the cell reads nothing whatever it does, so a cell that has frozen there would have the stroke go on to
its end. A cell whose scale is wrong would have the tension go on beyond `safety.tension_high_n`. While the stroke goes
up, the motor's current is friction and the rope's force, so its rise above a first reading is the rope's, and the
tension by the cell has to rise with it:

    K (I - I_0) - (T - T_0) <= slack_n + SHARE target + FACTOR_SHARE K (I - I_0)

The first reading is the lowest on the slack rope, else the first of this TENSIONING. An excess that was found is kept
until the rope is slack or the cell is corrected: a second TENSION moves nothing.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.findings import TakeUpSeen
from rigctl.control.watch.signs import WARNED_SHARE, unchecked

SHARE = 0.05  # of the target: 10 % less two status periods of the ramp, the stop, and the resolution of the current
FACTOR_SHARE = 0.1  # of the force by current: a warm motor's magnets, and a screw whose efficiency is not that measured
UPWARD = 0.25  # of the ramp's speed: slower, the friction need not be that of a motion
STEADY_S = 0.02  # at constant speed, or upward, until a reading that counts is taken: the drive's lag, and the friction
PERIODS = 2.0  # of the drive's status, until the rope's force is read twice: as the lowest, and beyond the limit


class TakeUp:
    """Call ``look`` every tick; ``seen``: what the current shows of the rope's force."""

    def __init__(self, settings: RigSettings) -> None:
        tension = settings.tension
        self._n_per_a = settings.cylinder.force_per_ampere_n or math.nan
        self._slack_n, self._period_s = tension.slack_n, settings.loop.period_ns * 1e-9
        ramp_mm_s = tension.ramp_n_s / settings.plant.stiffness_n_mm
        self._least_mm_s = UPWARD * min(tension.speed_max_mm_s, ramp_mm_s)
        self._steady_s, self._speed_mm_s, self._age_ns = 0.0, 0.0, 0
        self._slack, self._tensioning = True, False
        self._corrected = False
        self.seen = TakeUpSeen()
        self._begin_anew()

    def forget(self) -> None:
        """The cell has been corrected: nothing read before counts, from the next tick on."""
        self._corrected = True

    def _begin_anew(self) -> None:
        seen = self.seen
        seen.rise_n = seen.shown_n = seen.limit_n = seen.excess_n = 0.0
        self._lowest_a, self._from_n = math.inf, 0.0

    def look(
        self, current_a: float, age_ns: int, command_mm_s: float, tension_n: float, target_n: float, *,
        slack: bool, tensioning: bool,
    ) -> None:  # fmt: skip
        """One tick; ``current_a``: newest of the motor, of ``age_ns``, NaN if not known; ``slack``: by the cell."""
        seen = self.seen
        if self._corrected:
            self._corrected = False
            self._begin_anew()
        begins, was_slack, fresh = tensioning and not self._tensioning, self._slack, age_ns < self._age_ns
        self._tensioning, self._slack, self._age_ns = tensioning, slack, age_ns
        if slack:
            steady = tensioning and command_mm_s == self._speed_mm_s != 0.0
            if not was_slack:
                self._begin_anew()
        else:
            steady = tensioning and command_mm_s >= self._least_mm_s
            if was_slack:
                seen.excess_n = 0.0
            elif begins and seen.excess_n <= 0.0:
                self._begin_anew()
        self._speed_mm_s = command_mm_s
        self._steady_s = self._steady_s + self._period_s if steady else 0.0
        # A tension that rises is compared when its current is new.
        if not (slack or fresh) or self._steady_s - age_ns * 1e-9 < STEADY_S or math.isnan(current_a * self._n_per_a):
            return
        if current_a < self._lowest_a and (slack or self._lowest_a == math.inf):
            self._lowest_a, self._from_n = current_a, tension_n
        seen.rise_n = (current_a - self._lowest_a) * self._n_per_a
        seen.limit_n = limit_n(self._slack_n, target_n)
        if not slack:
            seen.shown_n = tension_n - self._from_n
            seen.limit_n += FACTOR_SHARE * max(0.0, seen.rise_n)
        seen.excess_n = seen.rise_n - seen.shown_n - seen.limit_n


def limit_n(slack_n: float, target_n: float) -> float:
    """Rope force by the motor's current at which a rope that is slack by the cell counts as tight."""
    return slack_n + SHARE * target_n


def smallest_scale(slack_n: float, target_n: float) -> float:
    """Reading over tension of a cell of wrong scale; one that reads less is found on the way to the target."""
    return (1.0 - FACTOR_SHARE) / (1.0 + limit_n(slack_n, target_n) / target_n)


def in_words(settings: RigSettings) -> str:
    """What shows a rope that gets tight, and a wrong scale of the cell, beside the cell."""
    rate_hz = settings.cylinder.status_rate_hz
    if settings.cylinder.force_per_ampere_n is None or rate_hz is None:
        return (
            "taking up slack: the cell alone shows that the rope gets tight; one that froze there is found at the "
            "stroke's end, and a wrong scale "
            + (
                f"only as a stiffness that is {WARNED_SHARE:.0%} off, a warning"
                if unchecked(settings)
                else "by no trip"
            )
            + " (cylinder.force_per_ampere_n has the motor's current show both)"
        )
    tension = settings.tension
    bound_n = limit_n(tension.slack_n, tension.target_n) + PERIODS * tension.ramp_n_s / rate_hz
    scale = smallest_scale(tension.slack_n, tension.target_n)
    return (
        f"taking up slack: the motor's current shows a rope that gets tight at {bound_n:.3g} N, whatever the cell "
        f"reads, and a cell that reads less than {scale:.0%} of the tension, before that is "
        f"{tension.target_n / scale:.3g} N"
    )
