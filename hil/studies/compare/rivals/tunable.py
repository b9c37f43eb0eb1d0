"""The parameters of each rival, so that an optimiser may tune it under the limits that our law has to keep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hil.studies.compare.rivals.adrc import OBSERVER_RATIO, Adrc
from hil.studies.compare.rivals.disturbance_observer import DisturbanceObserver
from hil.studies.compare.rivals.feedback import Feedback, Model
from hil.studies.compare.rivals.lqi import HELD_S, STRETCH_MM, Lqi
from hil.studies.compare.rivals.pid import PidFeedForward
from hil.studies.compare.rivals.proportional import INTEGRAL_RATIO, ULTIMATE_SHARE, Proportional, ProportionalIntegral
from rigctl.config.settings import RigSettings
from rigctl.design.knobs import Knob


class Tunable(NamedTuple):
    """A rival with every parameter that its structure has.

    ``start`` gives the published rule's values, or such as keep the limits where those do not.
    """

    knobs: tuple[Knob, ...]
    start: Callable[[Model], Sequence[float]]
    make: Callable[[RigSettings, Sequence[float]], Feedback]


def _pid(settings: RigSettings, values: Sequence[float]) -> Feedback:
    slowness_s, integral_ratio, derivative_s, filter_s = values
    return PidFeedForward(
        Model.of(settings), settings.tension.speed_max_mm_s, settings.plant.rope_length_mm,
        slowness_s=slowness_s, integral_ratio=integral_ratio, derivative_s=derivative_s, filter_s=filter_s,
    )  # fmt: skip


_SLOWNESS, _INTEGRAL = Knob("slowness_s", 0.004, 1.0), Knob("integral_ratio", 0.3, 100.0)
TUNABLE: dict[str, Tunable] = {
    "p": Tunable(
        (Knob("share", 0.01, 0.9),),
        lambda _model: (ULTIMATE_SHARE,),
        lambda settings, values: Proportional(Model.of(settings), *values),
    ),
    "pi": Tunable(
        (_SLOWNESS, _INTEGRAL),
        lambda model: (2.0 * (model.delay_s + 0.5 * model.lag_s), INTEGRAL_RATIO),
        lambda settings, values: ProportionalIntegral(Model.of(settings), *values),
    ),
    "pid_ff": Tunable(
        (_SLOWNESS, _INTEGRAL, Knob("derivative_s", 0.001, 0.2), Knob("filter_s", 0.0015, 0.2)),
        lambda model: (0.06, INTEGRAL_RATIO, model.lag_s, 0.5 * model.lag_s),
        _pid,
    ),
    "lqi": Tunable(
        (Knob("stretch_mm", 0.002, 10.0), Knob("held_s", 0.01, 10.0), Knob("disturbance_mm_s", 0.005, 100.0)),
        lambda _model: (STRETCH_MM, HELD_S, 1.0),
        lambda settings, values: Lqi(settings, *values),
    ),
    "pi_dob": Tunable(
        (Knob("bandwidth_rad_s", 1.0, 400.0), _SLOWNESS, _INTEGRAL),
        lambda model: (0.15 / model.delay_s, 0.1, INTEGRAL_RATIO),
        lambda settings, values: DisturbanceObserver(Model.of(settings), *values),
    ),
    "adrc": Tunable(
        (Knob("bandwidth_rad_s", 0.5, 200.0), Knob("observer_ratio", 1.0, 30.0)),
        lambda model: (0.06 / model.delay_s, OBSERVER_RATIO),
        lambda settings, values: Adrc(Model.of(settings), *values),
    ),
}
