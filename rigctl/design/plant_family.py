"""The family of plants a design is judged over, in discrete time at the loop's period.

From the speed of the rope's upper end to tension, with the mechanism as a mass on a spring of its own:

    dT/dt = k (v + w - p'),   m p'' = T - c p' - K_m p,   tau dv/dt = u(t - Td) - v

which is ``P(s) = (k/s) (m s^2 + c s + K_m) / (m s^2 + c s + K_m + k) e^{-s Td} / (tau s + 1)`` from the command u to
the tension T; w is the speed of the disturbance (the upper point's level, the payload's height). Without K_m the
mechanism carries its own height (the paper's case) and p = 0. The assumed family: domain notes, "Control facts worth
knowing"; that of an identified plant: `rigctl.design.identified`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from rigctl.config.settings import RigSettings

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

STIFFNESSES_N_MM: tuple[float | None, ...] = (None, 1000.0, 60.0, 20.0, 6.0)  # K_m; None = rigid
REPORTED_N_MM = 2.0  # shown beside the family, not part of the verdict
K_SCALES = (0.8, 1.0, 1.2)
DELAY_SCALES = (1, 2)
MECHANISM_DAMPING = 0.02  # of critical, for the mechanism on its own stiffness
KG_PER_N_S2_MM = 1000.0  # 1 N s^2/mm is 1000 kg
WHOLE = 1e-6  # ticks: a delay this near to a whole number of them has no fraction
ASSUMED = "assumed"


@dataclass(frozen=True)
class Member:
    """One plant of the family, sampled: ``x' = a x + b_command u(n - delay_ticks) + b_disturbance w(n)``.

    States: tension N, cylinder speed mm/s, with a flexible mechanism its deflection mm and speed mm/s, and with a delay
    of no whole number of ticks the command before. The measured signals are the first two states. Shapes (n, n), (n,),
    (n,) with n = 2 to 5.
    """

    k_m: float | None  # N/mm, None = rigid
    k_scale: float
    delay_scale: float
    a: Array
    b_command: Array
    b_disturbance: Array
    delay_ticks: int
    resonances_hz: tuple[float, ...]  # of the mechanism: without and with the rope
    lag_scale: float = 1.0

    def response(self, z: ComplexArray) -> ComplexArray:
        """Tension and speed per command (N s/mm, 1), and tension per disturbance speed (N s/mm); shape (3, len(z))."""
        inputs = np.stack([self.b_command, self.b_disturbance], axis=1).astype(np.complex128)
        pencil = z[:, None, None] * np.eye(len(self.a)) - self.a
        states = np.linalg.solve(pencil, np.broadcast_to(inputs, (len(z), *inputs.shape)))
        late = z**-self.delay_ticks
        return np.stack([states[:, 0, 0] * late, states[:, 1, 0] * late, states[:, 0, 1]])


@dataclass(frozen=True)
class Family:
    """The plants of a verdict; ``name`` in words, for messages (``assumed``, ``identified 2026-11-23``)."""

    name: str
    members: tuple[Member, ...]
    reported: tuple[Member, ...] = ()  # shown beside it, not part of the verdict


def member(settings: RigSettings, k_m: float | None, k_scale: float = 1.0, delay_scale: float = 1) -> Member:
    """One plant of the assumed family: the plant in the settings, scaled.

    ``k_m`` in N/mm, ``None`` for a rigid mechanism; the delay is rounded to whole ticks, as the estimator does.
    """
    ticks = round(delay_scale * settings.plant.command_delay_s * settings.loop.rate_hz)
    return sampled(settings, k_m, k_scale, 1.0, delay_scale, ticks)


def sampled(
    settings: RigSettings, k_m: float | None, k_scale: float, lag_scale: float, delay_scale: float, delay_ticks: float
) -> Member:
    """The plant in the settings, scaled, with inputs held over each period (exact: matrix exponential).

    ``delay_scale`` is a name here, ``delay_ticks`` counts. The command of a tick acts whole ticks later, and where the
    delay has a fraction, only after that fraction of the period (Franklin, Powell, Workman: Digital Control of Dynamic
    Systems, section 4.3.4).
    """
    plant, dt = settings.plant, 1.0 / settings.loop.rate_hz
    k, mass = k_scale * plant.stiffness_n_mm, plant.payload_kg / KG_PER_N_S2_MM
    lag = 1.0 / (lag_scale * plant.cylinder_lag_s)
    resonances: tuple[float, ...] = ()
    if k_m is None:
        a = np.array([[0.0, k], [0.0, -lag]])
    else:
        c = 2.0 * MECHANISM_DAMPING * math.sqrt(k_m * mass)
        a = np.array(
            [[0.0, k, 0.0, -k], [0.0, -lag, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1 / mass, 0.0, -k_m / mass, -c / mass]]
        )
        resonances = tuple(math.sqrt(stiffness / mass) / (2 * math.pi) for stiffness in (k_m, k_m + k))
    n = len(a)
    inputs = np.zeros((n, 2))
    inputs[1, 0] = lag
    inputs[0, 1] = k
    rates = np.block([[a, inputs], [np.zeros((2, n + 2))]])
    held = expm(rates * dt)
    state, by_command, by_disturbance = held[:n, :n], held[:n, n], held[:n, n + 1]
    whole = math.floor(delay_ticks + WHOLE)
    fraction = max(0.0, delay_ticks - whole)
    if fraction > WHOLE:
        newer = expm(rates * (1.0 - fraction) * dt)[:n, n]
        state = np.block([[state, (by_command - newer)[:, None]], [np.zeros((1, n + 1))]])
        by_command, by_disturbance = np.append(newer, 1.0), np.append(by_disturbance, 0.0)
    return Member(k_m, k_scale, delay_scale, state, by_command, by_disturbance, whole, resonances, lag_scale)


def assumed(settings: RigSettings) -> Family:
    """The family of a rig that was not identified: what a rig of this kind may be."""
    return Family(ASSUMED, tuple(family(settings)), tuple(reported(settings)))


def family(settings: RigSettings) -> list[Member]:
    """Every member of the assumed family; it always includes the mechanism's stiffness of the file."""
    stiffnesses = list(STIFFNESSES_N_MM)
    if settings.plant.mechanism_n_mm not in stiffnesses:
        stiffnesses.append(settings.plant.mechanism_n_mm)
    return [member(settings, *scales) for scales in product(stiffnesses, K_SCALES, DELAY_SCALES)]


def reported(settings: RigSettings) -> list[Member]:
    """Members shown beside the family, with a mechanism much softer than the rope's spring."""
    return [member(settings, REPORTED_N_MM, k_scale, delay) for k_scale, delay in product(K_SCALES, DELAY_SCALES)]
