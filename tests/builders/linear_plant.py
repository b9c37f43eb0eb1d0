"""The simulated rig's plant about a taut rope at rest, linear: what a measurement of the frequency response must find.

    tau dv/dt = u(t - Td) - v,  ds/dt = v,  T = k (s - p) + c (v - dp/dt),  m p'' + c_m p' + K_m p = T,  cell's low-pass

with the values of the ``simulation`` section, commands held from SYNC to SYNC. Written from the equations of
`hil.plant.kernel` and `hil.nodes`, not from the program's own models.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from rigctl.config.settings import RigSettings

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
_SPEED, _STROKE, _PAYLOAD, _PAYLOAD_SPEED, _FILTERED = range(5)


@dataclass(frozen=True)
class TruePlant:
    """N/mm, N s/mm, s, s, N/mm or None (rigid), ratio, kg, Hz or None."""

    stiffness: float
    damping: float
    lag: float
    delay: float
    mechanism: float | None
    mechanism_damping: float
    payload_kg: float
    filter_hz: float | None
    period: float

    def response(self, frequencies_hz: Array) -> ComplexArray:
        """Cell's reading and stroke at a SYNC, and mean speed over the tick before it, per command sent with a SYNC.

        Shape (3, n): N s/mm, s, 1.
        """
        a, b, rows = self._model()
        whole = math.floor(self.delay / self.period)
        late = self.delay - whole * self.period
        step = _held(a, b, self.period)[0]
        rest, after = _held(a, b, self.period - late)
        before = rest @ _held(a, b, late)[1]  # of the command before, which still acts in the first part of the tick
        z = np.exp(2j * np.pi * frequencies_hz * self.period)[:, None]
        # x(n + 1) = step x(n) + after u(n - whole) + before u(n - whole - 1)
        inputs = (after + before / z) / z**whole
        pencil = z[:, :, None] * np.eye(len(a)) - step
        states = np.asarray(np.linalg.solve(pencil, inputs[:, :, None])[:, :, 0], np.complex128)
        found: ComplexArray = (states @ rows.T).T
        found[2] = found[1] * (1.0 - 1.0 / z[:, 0]) / self.period
        return found

    def _model(self) -> tuple[Array, Array, Array]:
        """State matrix, input, and rows of reading, stroke, (speed)."""
        k, c, n = self.stiffness, self.damping, 5
        tension = np.zeros(n)
        tension[[_STROKE, _SPEED]] = k, c
        a, b = np.zeros((n, n)), np.zeros(n)
        a[_SPEED, _SPEED], b[_SPEED] = -1.0 / self.lag, 1.0 / self.lag
        a[_STROKE, _SPEED] = 1.0
        if self.mechanism is not None:
            mass = self.payload_kg * 1e-3
            own = 2.0 * self.mechanism_damping * math.sqrt(self.mechanism * mass)
            tension[[_PAYLOAD, _PAYLOAD_SPEED]] = -k, -c
            a[_PAYLOAD, _PAYLOAD_SPEED] = 1.0
            a[_PAYLOAD_SPEED] = tension / mass
            a[_PAYLOAD_SPEED, _PAYLOAD] -= self.mechanism / mass
            a[_PAYLOAD_SPEED, _PAYLOAD_SPEED] -= own / mass
        reading = tension
        if self.filter_hz is not None:
            rate = 2.0 * math.pi * self.filter_hz
            a[_FILTERED] = rate * tension
            a[_FILTERED, _FILTERED] -= rate
            reading = np.eye(n)[_FILTERED]
        if self.mechanism is None or self.filter_hz is None:  # states that nothing drives would be singular at z = 1
            a[np.arange(n), np.arange(n)] -= 1e-9
        return a, b, np.stack([reading, np.eye(n)[_STROKE], np.eye(n)[_SPEED]])


def true_plant(settings: RigSettings) -> TruePlant:
    """Of a rig file with a ``simulation`` section."""
    simulation, plant = settings.simulation, settings.plant
    assert simulation is not None
    mechanism = simulation.mechanism
    return TruePlant(
        plant.stiffness_n_mm * simulation.stiffness_scale,
        plant.damping_n_s_mm if simulation.rope.damping_n_s_mm is None else simulation.rope.damping_n_s_mm,
        plant.cylinder_lag_s * simulation.lag_scale,
        plant.command_delay_s * simulation.delay_scale,
        mechanism.vertical_n_mm,
        mechanism.damping_ratio,
        plant.payload_kg,
        simulation.cell.filter_hz,
        1.0 / settings.loop.rate_hz,
    )


def _held(a: Array, b: Array, time: float) -> tuple[Array, Array]:
    """State transition, and what an input held for ``time`` adds."""
    n = len(b)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = a, b
    whole = expm(block * time)
    return whole[:n, :n], whole[:n, n]


def true_sensitivities(plant: TruePlant, per_tension: ComplexArray, per_speed: ComplexArray, hz: Array) -> ComplexArray:
    """S at plant input and tension output, shape (2, n), of a controller with these responses (`Controller.response`).

    Broken as in `rigctl.design.margins`: with the drive-speed loop closed.
    """
    tension, _, speed = plant.response(hz)
    at_input = 1.0 / (1.0 - per_tension * tension - per_speed * speed)
    return np.stack([at_input, (1.0 - per_speed * speed) * at_input])
