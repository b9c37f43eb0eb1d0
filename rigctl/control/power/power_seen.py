"""What is seen of the drive's power, its stop and its brake: each question about them is answered here, once a tick.

A question has a name of its own where its doubts are its own: a brake that has to be closed before the motor may take
the load is not the brake that has to be closed before a slip counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.devices.objects import UNPOWERED_STATES, Controlword
from rigctl.model.device_states import DriveState
from rigctl.model.states import REST_S

STILL_NS = 200_000_000
STILL_MM = 0.02
"""20 units of 0x6064 (um), or four counts of an encoder of 5 um: more than quantisation and a toggling count make.
Over ``STILL_NS`` it is 0.1 mm/s, half the limit of a slipping brake in `rigctl.control.watch.safety`."""
STILL_MM_S = 0.05
"""5 units of 0x2044; below it the brake may close. The speed is low-passed first, because one count of the encoder in
one millisecond is 1 to 5 mm/s by itself."""
SPEED_S = 0.02
BRAKE_TIMES = 2  # of the brake's time
REACTION_NS = 2_000_000_000
"""A stroke that still moves this long after the drive went off shows a slipping brake, and no stop under way."""
UNDO_NS = 1_000_000_000
"""A brake that slips within this time after a parking gives the load back to the motor that has just held it."""
SEATED_NS = 400_000_000
"""A drive reports off once its brake has closed: play and wind-up are taken up by then, whatever delay is stated."""
SETTLES_NS = round(REST_S * 1e9) + 1_000_000_000
"""From a closed brake to a load seen at rest, once it has swung out."""
ON_COMMANDS = frozenset({Controlword.SWITCH_ON.value, Controlword.ENABLE_OPERATION.value})
_CUT_WORDS = frozenset({Controlword.DISABLE_VOLTAGE.value, Controlword.FAULT_RESET.value})
_NEVER_NS = 1 << 62


def stopping_ns(settings: RigSettings) -> int:
    """Time in ns in which a drive that obeys stops by itself from top speed, with two lags to spare."""
    seconds = settings.tension.speed_max_mm_s / settings.cylinder.stop_deceleration_mm_s2
    return round((seconds + 2.0 * settings.plant.cylinder_lag_s) * 1e9)


class Standstill:
    """Time the stroke has stood still, from position and reported speed."""

    def __init__(self, settings: RigSettings) -> None:
        self._share = 1.0 / (1.0 + SPEED_S * settings.loop.rate_hz)
        self._anchor_mm, self._slow_mm_s = math.nan, 0.0
        self._since_ns = 0

    def look(self, now_ns: int, stroke_mm: float, speed_mm_s: float, heard: bool) -> int:
        """Nanoseconds of standstill as of ``now_ns``; 0 while the drive's samples are missing or not finite."""
        self._slow_mm_s += (speed_mm_s - self._slow_mm_s) * self._share
        if not math.isfinite(self._slow_mm_s):
            self._slow_mm_s = 0.0
        near = abs(stroke_mm - self._anchor_mm) <= STILL_MM  # False for NaN
        if not (near and abs(self._slow_mm_s) < STILL_MM_S and heard):
            self._anchor_mm, self._since_ns = stroke_mm, now_ns
        return now_ns - self._since_ns


@dataclass(slots=True)
class PowerSeen:
    """Findings of one tick. "Off" is a state without power, as the drive reports it; times are those it has lasted.

    ``state``: by the newest statusword, however old. ``off_ns``: how long the drive has been off.
    ``brake_time_over``: off for the brake's time, so that the next sequence may begin.
    ``stop_over``: off for so long that a stroke that moves shows a slipping brake.
    ``seated``: off until the play and wind-up of a brake are taken up.
    ``first_second_over``: off for a second beyond the brake's time.
    ``settles``: so shortly off that a load may still swing out.
    ``left_alone``: off for longer than a drive needs that has to be cut off first.
    ``overdue``: off for so long that a drive whose brake is not closed by now has to lose its power.
    ``stopped_and_closed``: off for its longest stop and the brake's time.
    ``braked``: see `PowerDetector`.
    """

    state: DriveState = DriveState.NOT_READY
    off_ns: int = 0
    brake_time_over: bool = False
    stop_over: bool = False
    seated: bool = False
    first_second_over: bool = False
    settles: bool = True
    left_alone: bool = False
    overdue: bool = False
    stopped_and_closed: bool = False
    braked: bool = False


class PowerDetector:
    """Call ``look`` every tick, before the decision, with the controlword that the tick before has sent.

    ``seen.braked``: the drive reports now that it is off, and has for its brake's time, with the stroke at rest or its
    power cut. Not while the motor has current.

    Drives report an off state from the begin of their ramp on, which ends at standstill; a stroke that does not come to
    rest needs disable voltage. An encoder may be stuck, so the ramp's own time is waited for as well. A word that leads
    to power may have its effect late: the time begins anew.
    """

    def __init__(self, settings: RigSettings) -> None:
        brake_ns = settings.cylinder.brake_delay_ms * 1_000_000
        self._brake_ns, self._stopping_ns = brake_ns, stopping_ns(settings)
        self._stop_over_ns = max(REACTION_NS, brake_ns)
        self._seated_ns = min(brake_ns, SEATED_NS)
        self._overdue_ns = BRAKE_TIMES * brake_ns
        self._off_from_ns = self._cut_from_ns = self._not_on_from_ns = _NEVER_NS
        self.seen = PowerSeen()

    def look(self, now_ns: int, state: DriveState, word: int, still_ns: int, *, heard: bool, current: bool) -> None:
        """One tick.

        Args:
            now_ns: the tick's time.
            state: by the newest statusword.
            word: the controlword in force.
            still_ns: how long the stroke has stood still.
            heard: the drive's samples are not stale.
            current: the motor has more current than one without power.
        """
        # A condition that does not hold begins at "never"; its time is 0 then.
        if state not in UNPOWERED_STATES:
            self._off_from_ns = _NEVER_NS
        elif self._off_from_ns == _NEVER_NS:
            self._off_from_ns = now_ns
        if word not in _CUT_WORDS:
            self._cut_from_ns = _NEVER_NS
        elif self._cut_from_ns == _NEVER_NS:
            self._cut_from_ns = now_ns
        if word in ON_COMMANDS:
            self._not_on_from_ns = _NEVER_NS
        elif self._not_on_from_ns == _NEVER_NS:
            self._not_on_from_ns = now_ns
        seen, brake_ns = self.seen, self._brake_ns
        seen.state = state
        seen.off_ns = off_ns = max(0, now_ns - self._off_from_ns)
        seen.brake_time_over, seen.stop_over = off_ns >= brake_ns, off_ns >= self._stop_over_ns
        seen.seated, seen.first_second_over = off_ns >= self._seated_ns, off_ns > brake_ns + UNDO_NS
        seen.settles, seen.left_alone = off_ns <= brake_ns + SETTLES_NS, off_ns >= self._overdue_ns + STILL_NS
        seen.overdue, seen.stopped_and_closed = off_ns >= self._overdue_ns, off_ns >= self._stopping_ns + brake_ns
        stopped_ns, cut_ns = min(still_ns, off_ns - self._stopping_ns), max(0, now_ns - self._cut_from_ns)
        closing_ns = min(off_ns, max(0, now_ns - self._not_on_from_ns), max(stopped_ns, cut_ns))
        seen.braked = heard and closing_ns >= brake_ns and not current
