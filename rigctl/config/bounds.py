"""Bounds of the settings that a protection needs, each with its reason from physics or a standard.

A value may have the right type and still disable a protection: a stop that takes 60 mm, a limit no signal can reach, a
sensor that may be lost for a second. The bounds follow from the distance of the stroke meanwhile at
``tension.speed_max_mm_s``, and from the spring's change of tension over it. ``safety.waiver`` gives the reason why a
rig may be outside of them: a study without a spring, a simulated rig on a machine that pauses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rigctl.model.quantity import unit_of
from rigctl.model.signals import WATCHED

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings

BLIND_MM = 1.0
"""Largest stroke at top speed before a loss is detected, and in a ramp to standstill."""
STUDY = "a study: no load hangs on it"
PAYLOAD_MM_S = 80.0  # faster than any payload, see rigctl.control.bus.cell_step
NOISY = 30.0  # times the cell's noise, the limit of CELL_NOISY, see rigctl.control.bus.cell_step
OVERRANGE = 1.2  # of the cell's range, see rigctl.control.bus.channels
SAMPLES = 20  # for limits that count samples in a slow loop: fewer would trip by chance
GRAVITY_MM_S2 = 9806.65
SWING_SHARE = 0.1
SLOPE_DEG = 5.0  # 0.4 % of the vertical
FAST_MS, SLOW_MS = 1000, 60_000


@dataclass(frozen=True)
class Stop:
    """Distance of the stroke from top speed after the commands stop, and its change of tension."""

    unseen_mm: float  # in the longer of heartbeat time-out and command deadline, as either must suffice alone
    lag_mm: float  # in the drive's delay and lag
    ramp_mm: float  # on the drive's own ramp
    stiffness_n_mm: float

    @classmethod
    def of(cls, settings: RigSettings) -> Stop:
        """The stop of a rig whose loop has died."""
        cylinder, v = settings.cylinder, settings.tension.speed_max_mm_s
        unseen_s = max(cylinder.heartbeat_timeout_ms, cylinder.command_deadline_ms) * 1e-3
        lag_s = settings.plant.command_delay_s + settings.plant.cylinder_lag_s
        ramp_mm = v * v / (2.0 * cylinder.stop_deceleration_mm_s2)
        return cls(v * unseen_s, v * lag_s, ramp_mm, settings.plant.stiffness_n_mm)

    @property
    def distance_mm(self) -> float:
        """Whole distance."""
        return self.unseen_mm + self.lag_mm + self.ramp_mm

    @property
    def newtons(self) -> float:
        """Change of tension over that distance."""
        return self.stiffness_n_mm * self.distance_mm

    def in_words(self, settings: RigSettings) -> str:
        """Distance, change of tension and limits, in words."""
        tension, high = settings.tension, settings.safety.tension_high_n
        up, down = tension.target_max_n + self.newtons, max(0.0, tension.target_min_n - self.newtons)
        return (
            f"stop of a dead loop from {tension.speed_max_mm_s:g} mm/s: {self.distance_mm:.2f} mm "
            f"({self.unseen_mm:.2f} unseen, {self.lag_mm:.2f} lag and delay, {self.ramp_mm:.2f} ramp), "
            f"{self.newtons:.1f} N at {self.stiffness_n_mm:.4g} N/mm: {tension.target_max_n:g} N rise to {up:.1f} N "
            f"(limit {high:g}), {tension.target_min_n:g} N fall to {down:.1f} N (limit 0)"
        )


class _Figures:
    """Figures from which the bounds follow."""

    def __init__(self, s: RigSettings) -> None:
        self.s = s
        self.v = s.tension.speed_max_mm_s
        self.k = s.plant.stiffness_n_mm
        self.period_s = 1.0 / s.loop.rate_hz
        self.lag_s = s.plant.command_delay_s + s.plant.cylinder_lag_s
        self.room_n = min(s.safety.tension_high_n - s.tension.target_max_n, s.tension.target_min_n)
        self.room_mm = self.room_n / self.k
        self.blind_ms = 1e3 * BLIND_MM / self.v
        self.samples = max(SAMPLES, math.floor(self.blind_ms * 1e-3 * s.loop.rate_hz))
        self.root_s = math.sqrt(self.period_s)
        self.stop = Stop.of(s)

    def loss_ms(self) -> float:
        """Longest silence of the loop: 1 mm at top speed, and with lag and delay within the room for the tension."""
        return min(self.blind_ms, 1e3 * (self.room_mm / self.v - self.lag_s))

    def ramp(self, before_mm: float) -> float:
        """Least deceleration that ends within 1 mm, and within the room that is left after ``before_mm``."""
        left_mm = min(BLIND_MM, self.room_mm - before_mm)
        return self.v**2 / (2.0 * left_mm) if left_mm > 0.0 else math.inf

    def stop_deceleration(self) -> float:
        """Longest persistence: 1 mm at top speed; the tension stays in the cell's range until the stroke stands."""
        left_s = self.room_mm / self.v - 2.0 * self.s.plant.cylinder_lag_s
        cut = self.v / left_s if left_s > 0.0 else math.inf
        return max(self.ramp(self.stop.unseen_mm + self.stop.lag_mm), cut)

    def persistence_ms(self) -> float:
        """Longest persistence: 1 mm at top speed, and the tension stays in the cell's range until the stroke stands."""
        above_mm = (OVERRANGE * self.s.tension_cell.range_n - self.s.safety.tension_high_n) / self.k
        ramp_mm = self.v**2 / (2.0 * self.s.tension.acceleration_max_mm_s2)
        return min(self.blind_ms, 1e3 * ((above_mm - ramp_mm) / self.v - self.lag_s))

    def swing_ms(self) -> float:
        """A share of the rope's period of swing, or three samples of a slow sensor."""
        swing_s = 2.0 * math.pi * math.sqrt(self.s.plant.rope_length_mm / GRAVITY_MM_S2)
        return 1e3 * max(SWING_SHARE * swing_s, 3.0 / self.s.inclinometer.rate_hz)


class Bound(NamedTuple):
    """One row: a key, its least or largest value, and why."""

    key: str
    limit: Callable[[_Figures], float]
    why: str
    least: bool = False

    def allows(self, found: float, limit: float) -> bool:
        """Whether ``found`` is within ``limit``, except for rounding."""
        spare = 1e-9 * abs(limit) if math.isfinite(limit) else 0.0
        return found >= limit - spare if self.least else found <= limit + spare

    def shown(self, limit: float) -> float:
        """The limit with three digits, rounded to the allowed side."""
        unit = 10.0 ** (math.floor(math.log10(limit)) - 2)
        whole = limit / unit
        return (math.ceil(whole - 1e-6) if self.least else math.floor(whole + 1e-6)) * unit

    def allowed(self, limit: float) -> str:
        """Allowed range, in words for a finding."""
        words = "at least" if self.least else "at most"
        number = f"{words} {self.shown(limit):g}" if 0.0 < limit < math.inf else "none with these other settings"
        return f"{number} ({self.why}; or safety.waiver: why not, in words)"


_BLIND = "until then the stroke moves by up to 1 mm at tension.speed_max_mm_s"
_ROOM = "the tension between targets and limits (tension_high_n less target_max_n, or target_min_n down to 0)"
BOUNDS: tuple[Bound, ...] = (
    Bound(
        "tension.speed_max_mm_s",
        lambda f: f.room_mm / max(f.lag_s, 2.0 * f.s.plant.cylinder_lag_s),
        f"in the drive's lag and delay alone the stroke takes up {_ROOM}",
    ),
    Bound("cylinder.heartbeat_timeout_ms", _Figures.loss_ms, f"{_BLIND}, or takes up {_ROOM}"),
    Bound("cylinder.command_deadline_ms", _Figures.loss_ms, f"{_BLIND}, or takes up {_ROOM}"),
    Bound(
        "cylinder.stop_deceleration_mm_s2",
        _Figures.stop_deceleration,
        f"a stop from tension.speed_max_mm_s is to end within 1 mm and, with time-out and lag, within {_ROOM}",
        least=True,
    ),
    Bound(
        "tension.acceleration_max_mm_s2",
        lambda f: f.ramp(f.stop.lag_mm),
        f"every hold brakes with it: within 1 mm and, with the lag, within {_ROOM}",
        least=True,
    ),
    Bound("cylinder.brake_delay_ms", lambda _: 10, "no holding brake closes faster", least=True),
    Bound("safety.tension_high_n", lambda f: 2.0 * f.s.tension.target_max_n,
          "twice target_max_n pulls the payload up with its own weight"),
    Bound("safety.tension_low_n", lambda f: f.s.tension.slack_n, "a slack rope (tension.slack_n) must trip",
          least=True),
    Bound("safety.persistence_ms", _Figures.persistence_ms, f"{_BLIND}, or the tension leaves what the cell reads"),
    Bound("safety.stale_ms", lambda f: f.blind_ms, _BLIND),
    Bound("safety.bus_silent_ms", lambda f: f.blind_ms, _BLIND),
    Bound("safety.inclination_stale_ms", _Figures.swing_ms, "a tenth of the rope's swing, or three samples"),
    Bound("safety.stuck_samples", lambda f: f.samples, _BLIND),
    Bound("safety.stuck_samples", lambda _: 1, "0 never trips on a cell that sends one value for ever", least=True),
    Bound("safety.overrun_ticks", lambda f: f.samples, _BLIND),
    Bound("safety.overrun_ticks", lambda f: 0.5 * f.s.safety.overrun_window_ms * 1e-3 * f.s.loop.rate_hz,
          "half the periods of safety.overrun_window_ms; more are never reached"),
    Bound("estimator.reject_limit", lambda f: f.samples, _BLIND),
    Bound("estimator.gate_speed_mm_s", lambda _: PAYLOAD_MM_S, "no payload moves faster, the gate would let all pass"),
    Bound("tension_cell.noise_n", lambda f: f.room_n / NOISY,
          f"CELL_NOISY trips at {NOISY:g} times it, to be within {_ROOM}"),
    Bound(
        "estimator.cell_noise_scale",
        lambda f: f.room_n / (f.s.estimator.gate_sigma * f.s.tension_cell.noise_n),
        f"the gate lets gate_sigma times the noise through, to be within {_ROOM}",
    ),
    Bound("estimator.tension_walk_n", lambda f: f.room_n / (f.s.estimator.gate_sigma * f.root_s),
          f"the gate lets gate_sigma times it through in a period, to be within {_ROOM}"),
    Bound("estimator.speed_noise_mm_s", lambda f: f.v / f.s.estimator.gate_sigma,
          "the gate must tell tension.speed_max_mm_s from standstill"),
    Bound("estimator.speed_walk_mm_s", lambda f: f.v / (f.s.estimator.gate_sigma * f.root_s),
          "the gate must tell tension.speed_max_mm_s from standstill within a period"),
    Bound("estimator.disturbance_walk_mm_s", lambda f: PAYLOAD_MM_S / (f.s.estimator.gate_sigma * f.root_s),
          "no payload gains more than 80 mm/s in a period"),
    Bound("estimator.inclination_noise_deg", lambda f: SLOPE_DEG / f.s.estimator.gate_sigma,
          "the gate must see 5 deg, 0.4 % of the vertical"),
    Bound("estimator.inclination_walk_deg_s", lambda f: SLOPE_DEG / f.s.estimator.gate_sigma
          * f.s.inclinometer.rate_hz**1.5, "the gate must see 5 deg, 0.4 % of the vertical, in a sample"),
    Bound("inclinometer.range_deg", lambda _: 60.0, "a rope beyond 60 deg is not believed"),
    Bound("io.stale_ms", lambda _: 500.0, "an emergency stop must be seen within 0.5 s"),
    Bound("design.ms_max", lambda _: 2.0, "Ms 2 leaves a gain margin of 2 and a phase margin of 29 deg, no more"),
    Bound("calibration.tolerance_pct", lambda _: 3.0, "class 3 of ISO 7500-1, the worst there is"),
    Bound("calibration.due_days", lambda _: 550.0, "18 months, ISO 7500-1"),
    Bound("calibration.tare_days", lambda _: 366.0, "the zero of a cell drifts with the seasons"),
    Bound("calibration.tare_limit_n", lambda f: 0.05 * f.s.tension_cell.range_n,
          "a zero beyond 5 % of tension_cell.range_n is a damaged cell"),
    Bound("calibration.reference_n", lambda f: 0.2 * f.s.tension.target_max_n,
          "a weight below a fifth of target_max_n proves nothing about the scale there", least=True),
    Bound("preflight.disk_free_mib", lambda _: 16.0, "a trip dump takes 2 MB, the ledger must take its entry",
          least=True),
)  # fmt: skip


def section(settings: RigSettings) -> str:
    """The bounds of docs/rig-file.md: every bound, its value for ``settings``, and why."""
    figures = _Figures(settings)
    rows = [
        f"| `{bound.key}` | {'at least' if bound.least else 'at most'} {bound.shown(bound.limit(figures)):g} "
        f"| {unit_of(bound.key)} | {bound.why} |"
        for bound in BOUNDS
    ]
    least, most = settings.plant.found_n_mm
    return (
        _PAGE.format(rig=settings.rig, stop=Stop.of(settings).in_words(settings))
        + "\n".join(rows)
        + _END.format(rig=settings.rig, least=least, most=most)
    )


_PAGE = """\
## Bounds

A value may be fine by its type and still disarm a protection. A rig file with a setting beyond its bound is refused,
`FILE:LINE: key: found X, expected Y (reason)`. `safety.waiver: "why"` lets it run, and `rigctl check` and `rigctl run`
then print what is waived: for a rig that carries no load, as a study. Scenarios need no waiver.

A bound follows from the rig file: how far the stroke goes at `tension.speed_max_mm_s` before a loss is noticed and
until it is at rest, and what the spring makes of that in newtons. The figures are those of `{rig}`; `rigctl check FILE`
prints for its rig:

> {stop}

| setting | expected | unit | why |
|---|---|---|---|
"""
_END = """

Rows of `limits` that act (all but `log`) may wait 1 s for a signal of rope or stroke and 60 s for any other, and lie
within what the sensor reads (1.2 times `tension_cell.range_n`, `inclinometer.range_deg`).

Always: `safety.tension_high_n` within the cell's range and above `tension.target_max_n`; `safety.tension_low_n` below
`tension.target_min_n`; `calibration.tare_limit_n` below `safety.tension_low_n`; `safety.stale_ms` two loop periods or
more; `estimator.gate_sigma` 3 to 10; `cylinder.status_rate_hz` 5 Hz or more; `cylinder.heartbeat_timeout_ms` twice
`can.heartbeat_ms` or more. The stiffness found in the first tensioning after a start is within the assumed family of
plants, {least:.2f} to {most:.2f} N/mm on `{rig}`, or SIGN_CELL ends the tensioning.

No protection hangs on `cylinder.stroke_min_mm` and `stroke_max_mm`, `preflight.stroke_margin_mm`, `tension.ramp_n_s`
and the weights under `design`.
"""


def as_study(data: dict[str, Any]) -> dict[str, Any]:
    """The data of a rig file with the bounds waived, if they are not waived already."""
    safety = data.get("safety")
    return {**data, "safety": {**safety, "waiver": safety.get("waiver") or STUDY}} if isinstance(safety, dict) else data


class BeyondBound(NamedTuple):
    """A setting that is out of its bound."""

    key: str
    found: Any
    allowed: str


def findings(settings: RigSettings) -> Iterator[BeyondBound]:
    """Every setting that is out of its bound, waived or not."""
    figures = _Figures(settings)
    for bound in BOUNDS:
        section, name = bound.key.split(".")
        holder = getattr(settings, section)
        found = None if holder is None else getattr(holder, name)
        if found is None:
            continue
        limit = bound.limit(figures)
        if not bound.allows(found, limit):
            yield BeyondBound(bound.key, found, bound.allowed(limit))
    yield from _of_limits(settings)


def _of_limits(settings: RigSettings) -> Iterator[BeyondBound]:
    """Rows of `limits` with an action that can never trip, or only far too late."""
    slope, cell_n = settings.inclinometer.range_deg, OVERRANGE * settings.tension_cell.range_n
    reach = {
        "tension_n": (-cell_n, cell_n, "what the cell reads"),
        "vertical_error_n": (-math.inf, cell_n, "what the cell reads"),
        "tangential_deg": (-slope, slope, "inclinometer.range_deg"),
        "normal_deg": (-slope, slope, "inclinometer.range_deg"),
    }
    for i, row in enumerate(settings.limits):
        if row.action == "log":
            continue
        most_ms = FAST_MS if WATCHED[row.signal].fast else SLOW_MS
        if row.persistence_ms > most_ms:
            why = f"at most {most_ms} for {row.signal} with action {row.action}: later it protects nothing"
            yield BeyondBound(f"limits.{i}.persistence_ms", row.persistence_ms, why)
        low, high, what = reach.get(row.signal, (-math.inf, math.inf, ""))
        if row.high is not None and row.high > high:
            yield BeyondBound(f"limits.{i}.high", row.high, f"at most {high:g} ({what}; beyond it the row never trips)")
        if row.low is not None and row.low < low:
            yield BeyondBound(f"limits.{i}.low", row.low, f"at least {low:g} ({what}; beyond it the row never trips)")
