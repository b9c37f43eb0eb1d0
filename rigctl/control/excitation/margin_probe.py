"""The multisine that is added while COMPENSATING: cell, encoder and drive have to answer it, see `sensor_probe`.

With a ``margins`` section it is strong enough that the loop's margins can be measured by it. It is weak, always the
same, and acts as a disturbance of the plant's input (see `rigctl.control.excitation.frequency_trial`). It grows from
nothing once the tension has been near its set-point for some time, and is off at once when something else happens: a
trial, a mode that ends, an error beyond its bound, a new target: its ramp would pass for an answer of the cell's, and a
large one.
"""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from rigctl.control.excitation import frequency_trial
from rigctl.control.excitation.frequency_trial import PERIOD_S, REGULATED
from rigctl.control.excitation.multisine import Multisine

WINDOW_S = 60.0  # of one measurement
WINDOW_PERIODS = round(WINDOW_S / PERIOD_S)
SETTLED_S, GROW_S = 2.0, 4.0  # near the set-point before it begins; from nothing to its level
BOUND_N, BOUND_PROBES = 3.0, 10.0  # the error that ends it: this, and this many times its own tension at least
SPEED_SHARE = 0.2  # of the limits of speed and acceleration, at most


def signal(settings: RigSettings) -> Multisine:
    """Its shape for the margins: the trial's while COMPENSATING."""
    return frequency_trial.signal(settings, regulated=True)


def level(settings: RigSettings) -> float:
    """Its factor for the margins; 0 without a ``margins`` section."""
    section, shape = settings.margins, signal(settings)
    if section is None:
        return 0.0
    stretched_n = settings.plant.stiffness_n_mm * shape.peak_above_mm(REGULATED.corner_hz)
    return bounded(settings, shape, section.probe_n / stretched_n)


def bounded(settings: RigSettings, shape: Multisine, factor: float) -> float:
    """This factor of a multisine, or less where it would take too much of the limits of speed and acceleration."""
    tension = settings.tension
    return min(
        factor,
        SPEED_SHARE * tension.speed_max_mm_s / shape.peak_mm_s,
        SPEED_SHARE * tension.acceleration_max_mm_s2 / shape.peak_mm_s2,
    )


class Probe:
    """Speed added in each tick. ``place``: in the multisine, of the speed given last; ``whole``: it has grown up."""

    def __init__(self, settings: RigSettings, shape: Multisine, factor: float) -> None:
        section, rate = settings.margins, settings.loop.rate_hz
        stroke = shape.stroke_mm
        following = (*stroke[1:], stroke[0])
        self._speeds = [factor * rate * (then - now) for now, then in zip(stroke, following, strict=True)]
        self._bound_n = BOUND_N if section is None else max(BOUND_N, BOUND_PROBES * section.probe_n)
        self._wait = round(SETTLED_S * rate)
        self._growth = 1.0 / (GROW_S * rate)
        self._settled = self.place = 0
        self._grown, self.whole = 0.0, False

    def speed_mm_s(self, error_n: float, *, free: bool) -> float:
        """Speed of this tick; ``error_n`` of the vertical tension, ``free``: COMPENSATING at rest, see `LoopProbe`."""
        if not free or not -self._bound_n < error_n < self._bound_n:
            self._settled, self._grown, self.whole = 0, 0.0, False
            return 0.0
        if self._settled < self._wait:
            self._settled += 1
            return 0.0
        if self._grown < 1.0:
            self._grown = min(1.0, self._grown + self._growth)
            self.whole = self._grown >= 1.0
        self.place = self.place + 1 if self.place + 1 < len(self._speeds) else 0
        return self._grown * self._speeds[self.place]
