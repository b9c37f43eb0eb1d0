"""The tension law: from the filter's estimate to the speed command.

State feedback with integral action about a disturbance feed-forward,

    u = -w - l + r/k - K_T (T - T_sp) - K_v (v + w - r/k) - I,    dI/dt = K_i sat(T - T_sp)

with l the change of w while the drive lags, as far as a model of the disturbance knows it, and T, v, w predicted to the
instant at which ``u`` acts (delay compensation), r the slope of the set-point ramp. The operator's target is the
vertical component, so the rope's set-point is ``target / (cos theta_x cos theta_y)``.
Every command passes the same limits: speed, acceleration, and the stroke left for stopping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings
from rigctl.model.states import Flag

SETTLED_FRACTION = 0.005  # of the target: tensioning ends within this error
RAMP_EASE_S = 0.25  # a ramp takes this long to reach its slope and to leave it
INTEGRAL_STRETCH_MM = 0.05
"""Largest error in the integral, as stretch: the feedback corrects a jolt, and the integral leaves no tail of it."""
PAYS_OUT_MM_S = 2.0  # a slack rope whose length is stated
PAY_OUT_SPARE_MM = 1.0  # rope paid out beyond the last stretch, so that the rope is surely slack
_SPEED, _STROKE = Flag.LIMITED_SPEED.value, Flag.LIMITED_STROKE.value  # as numbers: an IntFlag's | costs 1 us
_ACCELERATION = Flag.LIMITED_ACCELERATION.value


@built
@dataclass(frozen=True)
class Gains:
    """Feedback gains, computed by the design; only numbers cross to the loop."""

    k_tension: float  # mm/s per N
    k_speed: float  # 1
    k_integral: float  # mm/s per N s

    @property
    def in_order(self) -> tuple[float, float, float]:
        """The gains in the order in which they cross to the loop."""
        return self.k_tension, self.k_speed, self.k_integral

    @property
    def text(self) -> bytes:
        """For an event."""
        return f"{self.k_tension:.6g} {self.k_speed:.6g} {self.k_integral:.6g}".encode()


class Estimate(NamedTuple):
    """Input of the law: tension N, drive speed and disturbance speed mm/s, measured stroke mm.

    ``lead_mm_s``: change of the disturbance speed over the drive's lag.
    """

    tension_n: float
    speed_mm_s: float
    disturbance_mm_s: float
    stroke_mm: float
    lead_mm_s: float = 0.0


class TensionLaw:
    """The law and its state: integral, set-point on its ramp, last command."""

    def __init__(self, settings: RigSettings, gains: Gains) -> None:
        tension = settings.tension
        self._gains = gains
        self._dt = 1.0 / settings.loop.rate_hz
        self._stiffness = self._next_stiffness = settings.plant.stiffness_n_mm
        self._integrand_n = INTEGRAL_STRETCH_MM * self._stiffness
        self._slack_n = tension.slack_n
        self._ramp_n_s = tension.ramp_n_s
        self._ramp_n_s2 = tension.ramp_n_s / RAMP_EASE_S
        self._speed_max = tension.speed_max_mm_s
        self._step_max = tension.acceleration_max_mm_s2 * self._dt
        self._braking = 2.0 * tension.acceleration_max_mm_s2
        self._stroke_min = settings.cylinder.stroke_min_mm
        self._stroke_max = settings.cylinder.stroke_max_mm
        self._take_up = min(tension.speed_max_mm_s, tension.ramp_n_s / self._stiffness)
        self._pay_out_mm = tension.slack_n / self._stiffness + PAY_OUT_SPARE_MM
        self.target_n = tension.target_n
        self.setpoint_n = 0.0  # vertical, on its ramp
        self.rope_setpoint_n = 0.0
        self._slope_n_s = 0.0
        self.integral_mm_s = 0.0
        self._error_n = self._speed_error_mm_s = 0.0  # of the last closed tick
        self.command_mm_s = 0.0
        self.limits = 0  # bits, see rigctl.model.states.Flag
        self._slack_stroke_mm: float | None = None
        self._tight = False
        self.rope_lost = False  # this TENSIONING had tension and has lost it

    # -- entering a mode: bumpless, because only the start of the set-point changes -----------------------------
    def start_ramp(self, vertical_n: float, speed_mm_s: float) -> None:
        """Begin a ramp at the present tension, with the slope of the cylinder's speed."""
        self.setpoint_n = max(vertical_n, 0.0)
        self._slope_n_s = self._slope_of(speed_mm_s)
        self.integral_mm_s = self._error_n = self._speed_error_mm_s = 0.0
        self._slack_stroke_mm = None
        self._spare_mm, self._pays_mm_s = self._pay_out_mm, self._take_up

    def begin(self, vertical_n: float, speed_mm_s: float) -> None:
        """Enter TENSIONING or RELEASING."""
        self._tight = self.rope_lost = False
        self.start_ramp(vertical_n, speed_mm_s)

    def pay_out(self, stroke_mm: float, length_mm: float) -> None:
        """After `begin`, on a slack rope: pay out so much from this stroke on, and no more."""
        self._slack_stroke_mm, self._spare_mm, self._pays_mm_s = stroke_mm, length_mm, PAYS_OUT_MM_S

    @property
    def gains(self) -> Gains:
        """The gains in force."""
        return self._gains

    def change_gains(self, gains: Gains, stiffness_n_mm: float | None = None) -> None:
        """Use other gains from the next tick on, and another stiffness, if it is given, without a step in the command.

        The integral takes over the change of the feedback of the last tick's errors. The speed of a ramp under way goes
        on with the stiffness before: at 50 N/s from 6 to 6.6 N/mm the other one would be a step of 0.9 mm/s.
        """
        if stiffness_n_mm is not None:
            self._next_stiffness = stiffness_n_mm
            self._integrand_n = INTEGRAL_STRETCH_MM * stiffness_n_mm
        before = self._gains
        self.integral_mm_s += (before.k_tension - gains.k_tension) * self._error_n
        self.integral_mm_s += (before.k_speed - gains.k_speed) * self._speed_error_mm_s
        self._gains = gains

    def follow_speed(self, speed_mm_s: float) -> None:
        """Set the last command to the speed of a drive that moved by itself, or not at all."""
        self.command_mm_s = max(-self._speed_max, min(self._speed_max, speed_mm_s))

    # -- one tick in a mode -------------------------------------------------------------------------------------
    def hold(self, estimate: Estimate, correction_mm_s: float = 0.0) -> float:
        """Hold the stroke: the correction of `rigctl.control.load.stroke_hold`, reached at the acceleration limit."""
        self.integral_mm_s = self._error_n = self._speed_error_mm_s = 0.0
        self._slack_stroke_mm = None  # of a release that is over
        return self.limited(correction_mm_s, estimate.stroke_mm)

    def aim(self, target_n: float) -> None:
        """Take another target, reached on the ramp."""
        self.target_n = target_n

    def tensioning(
        self, estimate: Estimate, cosine: float, probe_mm_s: float = 0.0, added_mm_s: float = 0.0
    ) -> float:  # fmt: skip
        """Take up slack at a fixed speed, then follow a ramp to the target.

        Args:
            estimate: of this tick.
            cosine: of the rope against the vertical.
            probe_mm_s: if not 0, move a tight rope at this speed instead; the ramp begins again where the move ends.
            added_mm_s: to the closed law's command, by a trial, the probe, or `rigctl.control.law.move_learning`.
        """
        self._tight |= estimate.tension_n > 2.0 * self._slack_n
        self.rope_lost = self._tight and estimate.tension_n < self._slack_n
        if self.rope_lost:
            return self.hold(estimate)
        if estimate.tension_n < self._slack_n:
            self.start_ramp(estimate.tension_n, estimate.speed_mm_s)
            return self.limited(self._take_up, estimate.stroke_mm)
        if probe_mm_s:
            self.start_ramp(estimate.tension_n * cosine, estimate.speed_mm_s)
            return self.limited(probe_mm_s, estimate.stroke_mm)
        return self._closed(estimate, cosine, self._ramp_towards(self.target_n), added_mm_s)

    def compensating(self, estimate: Estimate, cosine: float, added_mm_s: float = 0.0) -> float:
        """Hold the target; a new target is reached on the same ramp. ``added_mm_s``: see `tensioning`."""
        return self._closed(estimate, cosine, self._ramp_towards(self.target_n), added_mm_s)

    def releasing(self, estimate: Estimate, cosine: float, added_mm_s: float = 0.0) -> float:
        """Follow a ramp down to slack, then pay out a little more rope. ``added_mm_s``: see `tensioning`."""
        if estimate.tension_n > self._slack_n and self._slack_stroke_mm is None:
            return self._closed(estimate, cosine, self._ramp_towards(0.0), added_mm_s)
        if self._slack_stroke_mm is None:
            self._slack_stroke_mm = estimate.stroke_mm
        return self.limited(-self._pays_mm_s, estimate.stroke_mm)

    def tensioned(self, estimate: Estimate) -> bool:
        """The ramp has ended and the tension is on the target."""
        error = estimate.tension_n - self.rope_setpoint_n
        return self.setpoint_n == self.target_n and abs(error) < SETTLED_FRACTION * self.target_n

    def slack(self, estimate: Estimate) -> bool:
        """The rope is slack, with rope to spare."""
        start = self._slack_stroke_mm
        return start is not None and estimate.stroke_mm < start - self._spare_mm

    # -- the law itself -----------------------------------------------------------------------------------------
    def _slope_of(self, speed_mm_s: float) -> float:
        slope = self._stiffness * speed_mm_s
        return max(-self._ramp_n_s, min(self._ramp_n_s, slope)) if math.isfinite(slope) else 0.0

    def _ramp_towards(self, target_n: float) -> float:
        """Move the set-point one tick along its ramp, easing in and out; returns its slope in N/s."""
        left = target_n - self.setpoint_n
        if self._slope_n_s == 0.0:
            self._stiffness = self._next_stiffness
            if left == 0.0:  # the ramp has ended
                return 0.0
        # Easing out at three quarters of the deceleration keeps the discrete steps from passing the target.
        fastest = min(self._ramp_n_s, math.sqrt(1.5 * self._ramp_n_s2 * abs(left)))
        wanted = math.copysign(fastest, left)
        change = self._ramp_n_s2 * self._dt
        self._slope_n_s = max(self._slope_n_s - change, min(self._slope_n_s + change, wanted))
        if abs(left) <= change * self._dt or (
            abs(left) <= abs(self._slope_n_s) * self._dt and left * self._slope_n_s > 0
        ):
            self.setpoint_n, self._slope_n_s = target_n, 0.0
        else:
            self.setpoint_n += self._slope_n_s * self._dt
        return self._slope_n_s

    def _closed(self, estimate: Estimate, cosine: float, slope_n_s: float, added_mm_s: float) -> float:
        gains = self._gains
        self.rope_setpoint_n = self.setpoint_n / cosine
        error = estimate.tension_n - self.rope_setpoint_n
        feed_forward = slope_n_s / self._stiffness - estimate.disturbance_mm_s
        speed_error = estimate.speed_mm_s - feed_forward
        self._error_n, self._speed_error_mm_s = error, speed_error
        wanted = feed_forward - gains.k_tension * error - gains.k_speed * speed_error - self.integral_mm_s
        wanted += added_mm_s - estimate.lead_mm_s
        command = self.limited(wanted, estimate.stroke_mm)
        # Anti-windup: integrate only what the limits let through, or what leads back inside them.
        if command == wanted or (wanted - command) * error > 0.0:
            bounded = max(-self._integrand_n, min(self._integrand_n, error))
            self.integral_mm_s += gains.k_integral * bounded * self._dt
        return command

    def limited(self, wanted: float, stroke_mm: float) -> float:
        """Apply the stroke, speed and acceleration limits; a non-finite demand means stop."""
        limits = 0
        command = wanted if math.isfinite(wanted) else 0.0
        up = min(self._speed_max, math.sqrt(self._braking * max(0.0, self._stroke_max - stroke_mm)))
        down = -min(self._speed_max, math.sqrt(self._braking * max(0.0, stroke_mm - self._stroke_min)))
        if command > up:
            limits, command = (_SPEED if up == self._speed_max else _STROKE), up
        elif command < down:
            limits, command = (_SPEED if down == -self._speed_max else _STROKE), down
        last, step = self.command_mm_s, self._step_max
        if command > last + step or command < last - step:
            limits |= _ACCELERATION
            command = min(max(command, last - step), last + step)
        self.limits = limits
        self.command_mm_s = command
        return command
