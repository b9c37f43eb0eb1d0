"""The weights of our law that a search may turn: keys of the rig file with the widest sensible range.

Of stretch, integral and command weight only the ratios count, and of the filter's noises only those to the cell's, so
one of each kind stays as it is. The quiet setting's are turned where the settings are `searchable`, those of the swing
where its frequency is set: its damping is how long the filter remembers it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings


class Knob(NamedTuple):
    """A positive number that is searched on a logarithmic scale."""

    key: str
    low: float
    high: float


KNOBS = (
    Knob("design.stretch_weight", 1.0, 1e5),
    Knob("design.integral_weight", 0.1, 1e9),
    Knob("estimator.disturbance_walk_mm_s", 0.03, 300.0),
    Knob("estimator.tension_walk_n", 1e-4, 3.0),
    Knob("estimator.speed_walk_mm_s", 1e-3, 10.0),
)
QUIETER = 0.5  # first walks of a quiet setting over the open one's: near enough for any design to bear
_OF_SWING = (Knob("estimator.swing_walk_mm_s", 1e-3, 100.0), Knob("estimator.swing_damping", 0.003, 0.9))
_OF_QUIET = (
    Knob("estimator.quiet_tension_walk_n", 1e-5, 3.0),
    Knob("estimator.quiet_disturbance_walk_mm_s", 0.01, 300.0),
)


def searchable(settings: RigSettings) -> RigSettings:
    """The settings with a quiet setting of the filter for a search to turn, which begins near the open one.

    Settings that have one stay as they are.
    """
    estimator = settings.estimator
    if estimator.adapts:
        return settings
    quiet = {
        "estimator.quiet_tension_walk_n": estimator.tension_walk_n,
        "estimator.quiet_disturbance_walk_mm_s": QUIETER * estimator.disturbance_walk_mm_s,
    }
    return changed(settings, quiet)


def one_setting(settings: RigSettings) -> RigSettings:
    """The settings without a quiet setting of the filter."""
    return changed(settings, dict.fromkeys((knob.key for knob in _OF_QUIET), None))


def knobs_for(settings: RigSettings) -> tuple[Knob, ...]:
    """The weights that act in these settings."""
    swings = _OF_SWING if settings.estimator.swing_hz is not None else ()
    return (*KNOBS, *swings, *(knob for knob in _OF_QUIET if value_of(settings, knob.key) is not None))


def at_bound(settings: RigSettings) -> list[Knob]:
    """The weights that are within a hundredth of an end of their range: a search there may have stopped short."""
    values = [(knob, float(value_of(settings, knob.key))) for knob in knobs_for(settings)]
    return [knob for knob, value in values if not 1.01 * knob.low < value < knob.high / 1.01]


def value_of(settings: RigSettings, key: str) -> Any:
    """The value of a dotted key."""
    section, name = key.split(".")
    return getattr(getattr(settings, section), name)


def with_weights(settings: RigSettings, values: Sequence[float]) -> RigSettings:
    """The settings with these values of the weights that act, those of a quiet setting where there are so many."""
    acting = settings if len(values) == len(knobs_for(settings)) else searchable(settings)
    return turned(acting, knobs_for(acting), values)


def turned(settings: RigSettings, knobs: Sequence[Knob], values: Sequence[float]) -> RigSettings:
    """The settings with each knob at a value."""
    return changed(settings, {knob.key: value for knob, value in zip(knobs, values, strict=True)})
