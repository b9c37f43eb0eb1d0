"""The tension of a held stroke, latched with it: encoder and cell check each other, and no slow change is forgotten.

While the motor holds, the stretch by the tension has to follow the stroke,

    d = (T - T_0) / k - (k_slow / k) (s - s_0)

from the latch on, without a memory that leaks: a stuck encoder hides a creep of any speed, and a drifting one has the
correction move the load. Whichever of the two is wrong, nothing may be moved by them.

On the brake the stroke cannot rise, and a change of tension is the payload's, the rail's or the brake's. The tension is
compared with the highest that has lasted: a fall that goes on is a load that sinks. A rise endangers nothing below
`safety.tension_high_n`. A rope that carried and is slack has lost its load, however fast.

A bump of the payload and a hand on it change the tension too, in a step. So what goes on has the lower limit; what has
ended has to be `SHARE` of the load as well.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from rigctl.config.settings import RigSettings
from rigctl.control.findings import HeldTensionSeen
from rigctl.control.snapshot import Snapshot

GROWS_MM, GROWS_NS = 0.5, 600_000_000  # a disagreement that goes on while the motor holds; a step in 0.1 s does not
STRETCH_MM, STRETCH_NS = 0.8, 15_000_000  # any disagreement, if it is SHARE of the load as well; not a single sample
SHARE = 0.026  # of 3 %: the rest is the drive's until it stands
STIFF_SHARE, LEAST_MM = 0.1, 0.1  # bound in mm on a stiff spring, of the target; play, dead zone, resolution
FALL_MM, FALL_SHARE = 0.2, 0.03  # a fall on the brake that goes on: of stretch, or of the target if that is less
SINKS_NS, FALLEN_NS = 1_500_000_000, 10_000_000_000  # a fall that goes on; one in jerks, or that has ended
SLOW_MARK_S, SLOW_MARKS, SLOW_MM_S = 5.0, 7, 0.004  # a fall of half a minute, each 5 s of it lower than the last
SINKS_MM_S, UNLOADED_MM_S = 0.01, 5.0  # slower is the cell's, faster is a load that is lifted off
LINGERS = 2.0  # limits below which a fall that is no longer seen is one still
GROWS_MM_S = 0.02
DRIFT_OF_RANGE_H = 2e-5  # of the cell's zero: class C3, 0.02 % in 10 K, 1 K an hour
CREEP_OF_LOAD = 2.45e-4  # OIML R 60, class C3
SHIFT_H = 24.0  # hours on the brake for which the cell's own change has to stay far below the limit
NOISES = 10.0
SMOOTH_S = 0.05  # low-pass on the brake
MARK_S, MARKS = 0.1, 5  # a fall is judged over so many marks of the low-passed tension
GROWTH_S, GROWTH_MARK_S, GROWTH_MARKS = 0.02, 0.05, 4  # the same of the disagreement while the motor holds
LASTS_S = 10.0  # a rise that lasts so long is the load's
SETTLES_S = 0.5  # from a stop, or from a rope that gets tight, to a tension to compare with
BOUNCES = 3.0  # time constant on a flexible mechanism, in 1/omega of the payload on it: a stop makes it bounce ...
BOUNCED = 3.0  # ... and so many time constants until the mean is latched


def cell_n(settings: RigSettings) -> float:
    """Change in N that the cell's class explains within `SHIFT_H`: drift of the zero, creep under the load, noise."""
    cell = settings.tension_cell
    drift_n = DRIFT_OF_RANGE_H * cell.range_n * SHIFT_H
    return drift_n + CREEP_OF_LOAD * settings.tension.target_max_n + NOISES * cell.noise_n


def stretch_limit_mm(settings: RigSettings, wanted_mm: float = STRETCH_MM) -> float:
    """Disagreement of encoder and tension while the motor holds, as stretch."""
    stiffness = settings.plant.stiffness_n_mm
    stiff_mm = STIFF_SHARE * settings.tension.target_n / stiffness
    return max(min(wanted_mm, stiff_mm), LEAST_MM, cell_n(settings) / stiffness)


def fall_limit_n(settings: RigSettings) -> float:
    """Fall of the tension on the brake."""
    wanted_n = min(FALL_MM * settings.plant.stiffness_n_mm, FALL_SHARE * settings.tension.target_n)
    return max(wanted_n, cell_n(settings))


def smallest_creep_mm_s(settings: RigSettings) -> float:
    """Smallest creep of a motor whose encoder has stuck that the tension shows before ``hold.park_s`` is over."""
    plant, park_s = settings.plant, settings.hold.park_s
    share = plant.slow_stiffness_n_mm / plant.stiffness_n_mm
    least_n = SHARE * settings.tension.target_n
    sudden_mm = max(stretch_limit_mm(settings), least_n / plant.stiffness_n_mm)
    rows = (
        (stretch_limit_mm(settings, GROWS_MM), GROWS_NS * 1e-9, GROWS_MM_S),
        (sudden_mm, STRETCH_NS * 1e-9, 0.0),
    )
    return min(
        max(limit_mm / (park_s - lasts_s), least) / share for limit_mm, lasts_s, least in rows if park_s > lasts_s
    )


def in_words(settings: RigSettings) -> str:
    """The limits of a held load, and what the cell itself may take of them."""
    stiffness = settings.plant.stiffness_n_mm
    grows_mm, stretch_mm = stretch_limit_mm(settings, GROWS_MM), stretch_limit_mm(settings)
    fall_n = fall_limit_n(settings)
    park_s, creep_mm_s = settings.hold.park_s, smallest_creep_mm_s(settings)
    braked_s = park_s + settings.cylinder.brake_delay_ms * 1e-3
    return (
        f"held load: by the motor, stroke and tension may disagree by {grows_mm:.2g} mm "
        f"({grows_mm * stiffness:.3g} N) if that grows, else by {stretch_mm:.2g} mm ({stretch_mm * stiffness:.3g} N) "
        f"or {SHARE:.1%} of the load. The smallest creep that this sees behind a stuck encoder, before the brake takes "
        f"the load after {park_s:g} s, is {creep_mm_s:.2g} mm/s; a slower one moves the load by "
        f"{creep_mm_s * braked_s:.2g} mm at most until then. On the brake, the tension may fall by {fall_n:.3g} N "
        f"({fall_n / stiffness:.2g} mm) if it goes on, else by {SHARE:.1%} of the load for {FALLEN_NS * 1e-9:g} s. "
        f"The cell makes up to {cell_n(settings):.2g} N of it in {SHIFT_H:g} h (class C3); more from the rail or from "
        f"the payload cannot be distinguished from a drive or a brake that gives way"
    )


class HeldTension:
    """Call ``watch`` every tick of a mode that keeps the stroke, ``follow`` while the stroke moves.

    While the cell is silent, invalid or repeats itself, the references stay. ``lost``: the rope has carried a load and
    is slack.
    """

    def __init__(self, settings: RigSettings) -> None:
        plant = settings.plant
        self._dt = 1.0 / settings.loop.rate_hz
        self._stiffness, self._share = plant.stiffness_n_mm, plant.slow_stiffness_n_mm / plant.stiffness_n_mm
        self._slack_n = settings.tension.slack_n
        self._stuck = settings.safety.stuck_samples or math.inf
        bounce_s = 0.0
        if plant.mechanism_n_mm is not None:
            omega = math.sqrt(1e3 * (plant.mechanism_n_mm + plant.stiffness_n_mm) / plant.payload_kg)
            bounce_s = BOUNCES / omega
        self._bounce_s = bounce_s
        self._marks: deque[float] = deque(maxlen=MARKS)
        self._slow_marks: deque[float] = deque(maxlen=SLOW_MARKS)
        self._growth: deque[float] = deque(maxlen=GROWTH_MARKS)
        self.seen = HeldTensionSeen()
        self.latch_anew()

    def found_stiffness(self, n_mm: float) -> None:
        """Take the rope's stiffness in N/mm as the sign check found it; the rig file's may be far from it."""
        self._stiffness = n_mm

    def follow(self) -> None:
        """One tick in which the stroke moves on purpose."""
        seen = self.seen
        seen.stretched_mm = seen.growing_mm = seen.fallen_n = seen.sinks_n = 0.0
        self.latch_anew()

    def latch_anew(self) -> None:
        """The motor has taken the load, a motion is acknowledged, or the cell is corrected; shown from the next tick.

        That tick clears ``seen`` before it looks.
        """
        self._from_mm = self._from_n = self._smooth_n = self._highest_n = math.nan
        self._on_brake = self.lost = False
        self._seen_s = 0.0

    def forget_loss(self) -> None:
        """A load that is gone has been taken off on purpose."""
        self.lost = False

    def watch(self, snapshot: Snapshot, ticks: int, *, latched: bool) -> None:
        """One tick, ``ticks`` after the last; ``latched``: the stroke has come to rest and is latched."""
        tension_n, seen = snapshot.tension_n, self.seen
        seen.stretched_mm = seen.growing_mm = seen.fallen_n = seen.sinks_n = 0.0
        stale = not snapshot.cell_heard or snapshot.plausibility.cell_repeats >= self._stuck
        if stale or snapshot.cell_quality or not math.isfinite(tension_n):
            return
        passed_s = ticks * self._dt
        if snapshot.drive_enabled:
            self._smooth(tension_n, passed_s, self._bounce_s)
            self._on_brake = False
            self._seen_s += passed_s
            if latched and self._seen_s >= BOUNCED * self._bounce_s:
                self._compare(snapshot.stroke_mm, passed_s)
            return
        self._smooth(tension_n, passed_s, SMOOTH_S)
        if not self._on_brake:  # the reference of the motor goes on as that of the brake
            self._on_brake, self._highest_n = True, self._from_n
            self._from_mm = self._from_n = math.nan
            self._begin_mark()
            self._settled_s = 0.0
        self._look_for_fall(passed_s)

    def _smooth(self, tension_n: float, passed_s: float, time_s: float) -> None:
        if not math.isfinite(self._smooth_n):
            self._smooth_n = tension_n
        share = -math.expm1(-passed_s / time_s) if time_s else 1.0
        self._smooth_n += (tension_n - self._smooth_n) * share

    def _look_for_slack(self, latched_n: float) -> bool:
        """The rope does not pull; it has lost its load where a tension was latched, until it pulls again."""
        slack = self._smooth_n < self._slack_n
        self.lost = slack and (self.lost or math.isfinite(latched_n))
        return slack

    def _compare(self, stroke_mm: float, passed_s: float) -> None:
        """Stretch against stroke; a slack rope takes up stroke without tension, so it is latched once it is tight."""
        if self._look_for_slack(self._from_n):
            self._from_mm = self._from_n = math.nan
            return
        if not math.isfinite(self._from_mm):
            self._from_mm, self._from_n, self._slow_mm, self._marked_s = stroke_mm, self._smooth_n, 0.0, 0.0
            self._growth.clear()
            self._goes_on = False
        stretched_mm = (self._smooth_n - self._from_n) / self._stiffness - self._share * (stroke_mm - self._from_mm)
        self._slow_mm += (stretched_mm - self._slow_mm) * -math.expm1(-passed_s / GROWTH_S)
        self._marked_s += passed_s
        if self._marked_s >= GROWTH_MARK_S:
            self._marked_s = 0.0
            grown_mm = self._slow_mm - self._growth[0] if len(self._growth) == GROWTH_MARKS else 0.0
            self._goes_on = math.copysign(grown_mm, grown_mm * stretched_mm) > GROWS_MM_S * GROWTH_MARKS * GROWTH_MARK_S
            self._growth.append(self._slow_mm)
        if abs(stretched_mm) * self._stiffness > SHARE * self._from_n:
            self.seen.stretched_mm = stretched_mm
        if self._goes_on:
            self.seen.growing_mm = stretched_mm

    def _begin_mark(self) -> None:
        self._marks.clear()
        self._slow_marks.clear()
        self._marked_s, self._slow_marked_s, self._lasted_s, self._least_n = 0.0, 0.0, 0.0, math.inf
        self._goes_on = self._goes_on_slowly = False
        self._went_on_s = self._lasts_s = 0.0

    def _look_for_fall(self, passed_s: float) -> None:
        """Compare with the highest tension that has lasted."""
        smooth_n = self._smooth_n
        if self._look_for_slack(self._highest_n):
            self._highest_n, self._settled_s = math.nan, 0.0
            self._begin_mark()
            return
        if not math.isfinite(self._highest_n):
            self._settled_s += passed_s
            if self._settled_s < SETTLES_S:
                return
            self._highest_n = smooth_n
        self._least_n = min(self._least_n, smooth_n)
        self._lasted_s += passed_s
        if self._lasted_s >= LASTS_S:
            self._highest_n = max(self._highest_n, self._least_n)
            self._lasted_s, self._least_n = 0.0, math.inf
        self._marked_s += passed_s
        if self._marked_s >= MARK_S:
            self._marked_s = 0.0
            fell_n = self._marks[0] - smooth_n if len(self._marks) == MARKS else 0.0
            speed_mm_s = fell_n / (self._stiffness * (MARKS * MARK_S))
            self._goes_on = SINKS_MM_S < speed_mm_s < UNLOADED_MM_S
            if self._goes_on:  # near the limit a fall that has lasted would come and go
                self._went_on_s = self._went_on_s + MARK_S if speed_mm_s < LINGERS * SINKS_MM_S else 0.0
                self._lasts_s = LASTS_S if self._went_on_s >= SINKS_NS * 1e-9 else 0.0
            elif self._lasts_s <= 0.0:
                self._went_on_s = 0.0
            else:
                self._lasts_s -= MARK_S
                self._goes_on = True
            self._marks.append(smooth_n)
        self._slow_marked_s += passed_s
        if self._slow_marked_s >= SLOW_MARK_S:
            self._slow_marked_s = 0.0
            self._slow_marks.append(smooth_n)
            self._goes_on_slowly = self._falls_slowly()
        fallen_n = self._highest_n - smooth_n
        if fallen_n > SHARE * self._highest_n:
            self.seen.fallen_n = fallen_n
        if self._goes_on or self._goes_on_slowly:
            self.seen.sinks_n = fallen_n

    def _falls_slowly(self) -> bool:
        """Every mark is below the one before it, and together they are a motion of `SLOW_MM_S` at least."""
        marks = self._slow_marks
        if len(marks) < SLOW_MARKS or not all(later < earlier for earlier, later in pairwise(marks)):
            return False
        return marks[0] - marks[-1] > SLOW_MM_S * SLOW_MARK_S * (SLOW_MARKS - 1) * self._stiffness
