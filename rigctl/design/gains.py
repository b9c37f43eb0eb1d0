"""Feedback gains and the filter's steady state, with python-control.

Deviation states of the law: tension error e, speed deviation s = v + w - r/k and the integral z of the error. With
``u = -w + r/k + u'`` the disturbance and the ramp drop out of the filter's own model:

    e' = e + f01 s + b0 u',   s' = f11 s + b1 u',   z' = z + dt e

The error is weighted as stretch, e/k in mm, so that the loop's shape does not depend on the spring.
"""

from __future__ import annotations

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.estimator import Array, FilterModel, filter_model
from rigctl.control.tension import Gains


class DesignError(ValueError):
    """No gains for these settings; ``str()`` is one line that says why."""


def design(settings: RigSettings) -> Gains:
    """Discrete linear-quadratic gains for the weights in ``design:``.

    Raises:
        DesignError: the Riccati equation has no solution, or no finite one.
    """
    import control  # takes 0.5 s, so only for a design

    model, weights = filter_model(settings), settings.design
    k = settings.plant.stiffness_n_mm
    cost = np.diag([weights.stretch_weight / k**2, 0.0, weights.integral_weight / k**2])
    try:
        found, _, _ = control.dlqr(
            model.f[:2, :2],
            model.b[:2],
            cost,
            [[weights.command_weight]],
            integral_action=np.array([[model.period_s, 0.0]]),
            method="scipy",
        )
    except (np.linalg.LinAlgError, ValueError, control.ControlException) as error:
        raise DesignError(f"no gains for these weights: {error}") from None
    k_tension, k_speed, k_integral = (float(gain) for gain in np.asarray(found)[0])
    if not np.isfinite([k_tension, k_speed, k_integral]).all():
        raise DesignError("no gains for these weights: not finite")
    return Gains(k_tension, k_speed, k_integral)


def filter_gain(model: FilterModel) -> Array:
    """Settled gain of the Kalman filter, states by (tension, speed), shape (3, 2): ``x += gain (y - H x)``.

    Raises:
        DesignError: the Riccati equation has no solution, or no finite one.
    """
    import control

    h = np.eye(2, 3)
    r = np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])
    try:
        _, before, _ = control.dlqe(model.f, np.eye(3), h, model.q, r, method="scipy")
    except (np.linalg.LinAlgError, ValueError, control.ControlException) as error:
        raise DesignError(f"no steady state of the filter for these noises: {error}") from None
    gain: Array = np.linalg.solve(h @ before @ h.T + r, h @ before).T
    if not np.isfinite(gain).all():
        raise DesignError("no steady state of the filter for these noises: not finite")
    return gain
