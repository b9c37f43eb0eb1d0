"""The controller of the loop as one linear system, and that system closed around a plant.

Tick n reads the sample latched in tick n - 1, corrects the state of tick n - 1, predicts it to tick n and ahead to
the instant the command acts, and sends ``u = -w - l - K_T T - K_v (v + w) - I`` (set-point zero, no limits), with w
the disturbance of all states and l the lead of a swing.
With the filter at a steady gain that is linear; the margins are of this system, and a test compares it
with the loop's code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigctl.control.law.estimator import Array, FilterModel
from rigctl.control.law.tension import Gains
from rigctl.design.plant_family import ComplexArray, Member


@dataclass(frozen=True)
class Controller:
    """``x' = a x + b y``, ``u = c x`` from the samples y = (tension N, speed mm/s) to the command u mm/s.

    State: filter state carried to the last tick (s: 3, or 5 with a swing), last tick's sample (2), commands sent
    u(n - 1 - d) to u(n - 1) (d + 1), integral (1). Shapes (m, m), (m, 2), (m,) with m = s + 4 + d.
    """

    a: Array
    b: Array
    c: Array
    states: int
    """s: of the filter."""

    def response(self, z: ComplexArray) -> ComplexArray:
        """Command per tension (mm/s per N) and per speed (1), shape (2, len(z)).

        The commands already sent are delays of u itself; without them s + 3 states remain to be solved for, for any
        transport delay.
        """
        size, own = len(self.a), self.states + 2
        sent = np.arange(own, size - 1)
        kept = np.array([*range(own), size - 1])
        pencil = z[:, None, None] * np.eye(len(kept)) - self.a[np.ix_(kept, kept)]
        row = np.broadcast_to(self.c[kept].astype(np.complex128)[:, None], (len(z), len(kept), 1))
        through = np.linalg.solve(pencil.transpose(0, 2, 1), row)[:, :, 0]  # c (zI - a)^-1
        late = z[:, None] ** -(size - 1.0 - sent)
        again = late @ self.c[sent] + np.einsum("fi,ij,fj->f", through, self.a[np.ix_(kept, sent)], late)
        response: ComplexArray = (through @ self.b[kept]).T / (1.0 - again)
        return response


def controller(model: FilterModel, gains: Gains, filter_gain: Array) -> Controller:
    """``TensionFilter`` and ``TensionLaw`` over one tick, with a settled gain of the filter (shape (s, 2))."""
    return _controller(model, gains, filter_gain)[0]


def law_errors(model: FilterModel, gains: Gains, filter_gain: Array) -> Array:
    """Rows that give the law's errors of tension (N) and speed (mm/s) from the controller's state, shape (2, m)."""
    ahead = _controller(model, gains, filter_gain)[1]
    rows: Array = np.stack([ahead[0], ahead[1] + model.disturbance @ ahead])
    return rows


def _controller(model: FilterModel, gains: Gains, filter_gain: Array) -> tuple[Controller, Array]:
    """The controller, and the filter's state at the instant at which the command acts, by the controller's state."""
    delay, n = model.delay_ticks, len(model.f)
    state, sample, sent = slice(0, n), slice(n, n + 2), n + 2  # positions in its state; the integral is last
    size = n + 4 + delay
    corrected = np.zeros((n, size))
    corrected[:, state] = np.eye(n) - filter_gain @ np.eye(2, n)
    corrected[:, sample] = filter_gain
    predicted = model.f @ corrected
    predicted[:, sent] += model.b[:, 0]
    ahead = predicted
    for tick in range(delay):
        ahead = model.f @ ahead
        ahead[:, sent + 1 + tick] += model.b[:, 0]
    own = np.array([gains.k_tension, gains.k_speed, *np.zeros(n - 2)])
    command = -(own + (1.0 + gains.k_speed) * model.disturbance + model.lead) @ ahead
    command[-1] -= 1.0
    a, b = np.zeros((size, size)), np.zeros((size, 2))
    a[state] = predicted
    b[sample] = np.eye(2)
    a[sent : size - 2, sent + 1 : size - 1] = np.eye(delay)
    a[size - 2] = command
    a[-1] = gains.k_integral * model.period_s * ahead[0]
    a[-1, -1] += 1.0
    return Controller(a, b, command, n), ahead


@dataclass(frozen=True)
class ClosedLoop:
    """``x' = a x + b e``: e is (cell noise N, speed noise mm/s, disturbance speed mm/s), state (plant, sent, law)."""

    a: Array
    b: Array
    command: Array  # row that gives the command, mm/s
    tension: Array  # row of the true tension, N
    loss_n_s_mm: float  # true tension per disturbance speed, at once

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of an eigenvalue; below 1 the loop is stable."""
        return float(np.abs(np.linalg.eigvals(self.a)).max())


def closed_loop(plant: Member, law: Controller) -> ClosedLoop:
    """The plant, its transport delay and the controller, joined."""
    n, d, m = len(plant.a), plant.delay_ticks, len(law.a)
    size = n + d + m
    a, b = np.zeros((size, size)), np.zeros((size, 3))
    command = np.concatenate([np.zeros(n + d), law.c])
    a[:n, :n] = plant.a
    a[:n] += np.outer(plant.b_command, np.eye(size)[n] if d else command)  # oldest command sent, or this one
    if d:
        a[n : n + d - 1, n + 1 : n + d] = np.eye(d - 1)
        a[n + d - 1] = command
    a[n + d :, :2] = law.b
    a[n + d :, n + d :] = law.a
    b[:n, 2] = plant.b_disturbance
    b[n + d :, :2] = law.b
    b[n + d :, 2] = plant.sensed_n_s_mm * law.b[:, 0]
    tension = np.concatenate([plant.tension, np.zeros(d + m)])
    return ClosedLoop(a, b, command, tension, plant.loss_n_s_mm)
