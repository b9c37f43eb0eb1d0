"""Feedback gains by python-control, settled gains of the filter by filterpy.

Deviation states of the law: tension error e, speed deviation s = v + w - r/k and the integral z of the error. With
``u = -w + r/k + u'`` the disturbance and the ramp drop out of the filter's own model:

    e' = e + f01 s + b0 u',   s' = f11 s + b1 u',   z' = z + dt e

The error is weighted as stretch, e/k in mm, so that the loop's shape does not depend on the spring.

The filter settles at the covariance that solves its Riccati equation, which python-control solves; there filterpy makes
the gain. Both libraries take two seconds to load, so only a function that designs loads them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, FilterModel, filter_model
from rigctl.control.law.tension import Gains

_METHOD = "scipy"  # of python-control: with slycot (GPL) installed, it would take that


class DesignError(ValueError):
    """No gains for these settings; ``str()`` is one line that says why."""


def design(settings: RigSettings) -> Gains:
    """Discrete linear-quadratic gains for the weights in ``design:``.

    Raises:
        DesignError: the Riccati equation has no solution, or no finite one.
    """
    model, weights = filter_model(settings), settings.design
    k = settings.plant.stiffness_n_mm
    cost = np.diag([weights.stretch_weight / k**2, 0.0, weights.integral_weight / k**2])
    import control

    try:
        found, _, _ = control.dlqr(
            model.f[:2, :2],
            np.reshape(model.b[:2], (2, 1)),
            cost,
            np.array([[weights.command_weight]]),
            integral_action=np.array([[model.period_s, 0.0]]),
            method=_METHOD,
        )
    except (np.linalg.LinAlgError, ValueError, control.ControlArgument) as error:
        raise DesignError(f"no gains for these weights: {error}") from None
    k_tension, k_speed, k_integral = (float(gain) for gain in found[0])
    if not np.isfinite([k_tension, k_speed, k_integral]).all():
        raise DesignError("no gains for these weights: not finite")
    return Gains(k_tension, k_speed, k_integral)


OPEN, QUIET = "open", "quiet"


def filter_gains(model: FilterModel) -> dict[str, Array]:
    """The settled gain of each setting of the filter, see `filter_gain`; ``open`` alone, or ``open`` and ``quiet``.

    Of the quiet setting's gain only the column of the tension is in use.

    Raises:
        DesignError: as `filter_gain`.
    """
    gains = {OPEN: filter_gain(model)}
    if model.quiet_q is not None:
        quiet = filter_gain(replace(model, q=model.quiet_q))
        gains[QUIET] = np.column_stack([quiet[:, 0], gains[OPEN][:, 1]])
    return gains


def filter_gain(model: FilterModel) -> Array:
    """Settled gain of the filter when open, states by (tension, speed), shape (n, 2): ``x += gain (y - H x)``.

    Raises:
        DesignError: the Riccati equation has no solution, or no finite one.
    """
    import control
    from filterpy.kalman import KalmanFilter

    kalman = KalmanFilter(dim_x=len(model.f), dim_z=2)
    kalman.H = np.eye(2, len(model.f))
    kalman.R = np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])
    try:
        kalman.P, _, _ = control.dare(model.f.T, kalman.H.T, model.q, kalman.R, method=_METHOD)
        kalman.update(np.zeros(2))
    except (np.linalg.LinAlgError, ValueError, control.ControlArgument) as error:
        raise DesignError(f"no steady state of the filter for these noises: {error}") from None
    gain: Array = np.asarray(kalman.K, np.float64)
    if not np.isfinite(gain).all():
        raise DesignError("no steady state of the filter for these noises: not finite")
    return gain
