"""The motor's current while it takes up slack: it shows that the rope gets tight where the cell does not.

On a slack rope the cell reads nothing whatever it does, so a cell that has frozen there would have the stroke go on to
its end. At a constant speed the motor's current is friction and the rope's force, so its rise above the lowest reading
since the cell last showed tension is the rope's. What was found is kept until then: a second TENSION moves nothing.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings

SHARE = 0.05  # of the target: 10 % less two status periods of the ramp, the stop, and the resolution of the current
STEADY_S = 0.02  # at constant speed until a reading that counts is taken: the drive's lag, and friction has its sign
PERIODS = 2.0  # of the drive's status, until the rope's force is read twice: as the lowest, and beyond the limit


class TakeUp:
    """``excess_n``: rope force by the motor's current beyond the limit, negative within it, 0 until it is known.

    ``rise_n`` and ``limit_n``: that force, and the limit.
    """

    def __init__(self, settings: RigSettings) -> None:
        self._n_per_a = settings.cylinder.force_per_ampere_n or math.nan
        self._slack_n, self._period_s = settings.tension.slack_n, settings.loop.period_ns * 1e-9
        self.rise_n = self.limit_n = self.excess_n = 0.0
        self._lowest_a, self._steady_s, self._speed_mm_s = math.inf, 0.0, 0.0

    def look(
        self, current_a: float, age_ns: int, command_mm_s: float, target_n: float, *, slack: bool, tensioning: bool
    ) -> None:
        """One tick; ``current_a``: newest of the motor, of ``age_ns``, NaN if not known; ``slack``: by the cell."""
        steady = slack and tensioning and command_mm_s == self._speed_mm_s != 0.0
        self._speed_mm_s = command_mm_s
        self._steady_s = self._steady_s + self._period_s if steady else 0.0
        if not slack:
            self._lowest_a, self.excess_n = math.inf, 0.0
        if self._steady_s - age_ns * 1e-9 < STEADY_S or math.isnan(current_a * self._n_per_a):
            return
        self._lowest_a = min(self._lowest_a, current_a)
        self.rise_n = (current_a - self._lowest_a) * self._n_per_a
        self.limit_n = limit_n(self._slack_n, target_n)
        self.excess_n = self.rise_n - self.limit_n


def limit_n(slack_n: float, target_n: float) -> float:
    """Rope force by the motor's current at which a rope that is slack by the cell counts as tight."""
    return slack_n + SHARE * target_n


def in_words(settings: RigSettings) -> str:
    """What shows a rope that gets tight, beside the cell."""
    rate_hz = settings.cylinder.status_rate_hz
    if settings.cylinder.force_per_ampere_n is None or rate_hz is None:
        return (
            "taking up slack: the cell alone shows that the rope gets tight; one that froze there is found at the "
            "stroke's end (cylinder.force_per_ampere_n has the motor's current show it too)"
        )
    tension = settings.tension
    bound_n = limit_n(tension.slack_n, tension.target_n) + PERIODS * tension.ramp_n_s / rate_hz
    return (
        f"taking up slack: the motor's current shows a rope that gets tight at {bound_n:.3g} N, whatever the cell reads"
    )
