"""The family of plants a design is judged over, in discrete time at the loop's period.

From the speed of the rope's upper end to tension, with the mechanism as a mass on a spring of its own:

    T = k x + c x',   x' = v + w - p',   m p'' = T - c_m p' - K_m p,   tau dv/dt = u(t - Td) - v,   tau_c dy/dt = T - y

which is ``P(s) = ((k + c s)/s) R e^{-s Td} / ((tau s + 1) (tau_c s + 1))`` from the command u to the measured tension
y, with ``R = (m s^2 + c_m s + K_m) / (m s^2 + (c_m + c) s + K_m + k)``; x is the stretch of spring and rope, w the
speed of the disturbance (the upper point's level, the payload's height), tau_c the low-pass of the cell's amplifier.
Without K_m the mechanism carries its own height (the paper's case) and p = 0.

Spring and rope are a chain of two parts with a loss each, k_s + c_s s and k_r + c_r s. Of a
rope at least ten times as stiff as the spring the chain is k + c s within 1 % and 1 deg up to 300 Hz, with
`PlantSettings.stiffness_n_mm` and `PlantSettings.damping_n_s_mm`. The assumed family: domain notes, "Control facts
worth knowing"; that of an identified plant: `rigctl.design.identified`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt

from rigctl.config.plant_section import MECHANISMS_N_MM, STIFFNESS_SCALES
from rigctl.config.settings import RigSettings

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

REPORTED_N_MM = 2.0  # shown beside the family, not part of the verdict
DELAY_SCALES = (1, 2)
LOSS_SCALE = 2.0  # of spring and rope: one that is not measured is known by its order of magnitude
LOSS_STEPS = 5
MECHANISM_DAMPING = 0.02  # of critical, for the mechanism on its own stiffness
KG_PER_N_S2_MM = 1000.0  # 1 N s^2/mm is 1000 kg
HELD = "zoh"  # of python-control: inputs held over each period, exact
WHOLE = 1e-6  # ticks: a delay this near to a whole number of them has no fraction
ASSUMED = "assumed"


@dataclass(frozen=True)
class Member:
    """One plant of the family, sampled: ``x' = a x + b_command u(n - delay_ticks) + b_disturbance w(n)``.

    States: measured tension N, cylinder speed mm/s, with a low-pass of the cell the spring's force N, with a flexible
    mechanism its deflection mm and speed mm/s, and with a delay of no whole number of ticks the command before. The
    measured signals are the first two states, beside ``sensed_n_s_mm w`` in the tension. The true tension is
    ``tension x + loss_n_s_mm w``. Shapes (n, n), (n,), (n,) with n = 2 to 6.
    """

    k_m: float | None  # N/mm, None = rigid
    k_scale: float
    delay_scale: float
    a: Array
    b_command: Array
    b_disturbance: Array
    delay_ticks: int
    resonances_hz: tuple[float, ...]  # of the mechanism: without and with the rope
    tension: Array  # row of the true tension, shape (n,)
    loss_n_s_mm: float = 0.0  # of spring and rope: true tension per speed of the disturbance, at once
    sensed_n_s_mm: float = 0.0  # the same of the measured tension: 0 behind a low-pass of the cell
    lag_scale: float = 1.0

    def response(self, z: ComplexArray) -> ComplexArray:
        """Measured tension and speed per command (N s/mm, 1), and true tension per disturbance speed (N s/mm).

        Shape (3, len(z)).
        """
        inputs = np.stack([self.b_command, self.b_disturbance], axis=1).astype(np.complex128)
        pencil = z[:, None, None] * np.eye(len(self.a)) - self.a
        states = np.linalg.solve(pencil, np.broadcast_to(inputs, (len(z), *inputs.shape)))
        late = z**-self.delay_ticks
        disturbed = states[:, :, 1] @ self.tension + self.loss_n_s_mm
        return np.stack([states[:, 0, 0] * late, states[:, 1, 0] * late, disturbed])


@dataclass(frozen=True, eq=False)
class Family:
    """The plants of a verdict; ``name`` in words, for messages (``assumed``, ``identified 2026-11-23``).

    One is equal to itself only, so that what is computed of it can be kept with it.
    """

    name: str
    members: tuple[Member, ...]
    reported: tuple[Member, ...] = ()  # shown beside it, not part of the verdict


def member(
    settings: RigSettings, k_m: float | None, k_scale: float = 1.0, delay_scale: float = 1, loss_scale: float = 0.0
) -> Member:
    """One plant of the assumed family: the plant in the settings, scaled.

    ``k_m`` in N/mm, ``None`` for a rigid mechanism; the delay is rounded to whole ticks, as the estimator does. The
    family is without the loss of spring and rope: up to `LOSS_SCALE` times that of a steel spring lowers every Ms (a
    test has the bound), so that none is the worst.
    """
    ticks = round(delay_scale * settings.plant.command_delay_s * settings.loop.rate_hz)
    damping = loss_scale * k_scale * settings.plant.damping_n_s_mm
    return sampled(settings, k_m, k_scale, 1.0, delay_scale, ticks, damping)


def sampled(
    settings: RigSettings,
    k_m: float | None,
    k_scale: float,
    lag_scale: float,
    delay_scale: float,
    delay_ticks: float,
    damping_n_s_mm: float | None = None,
    mechanism_damping: float = MECHANISM_DAMPING,
) -> Member:
    """The plant in the settings, scaled, with the low-pass of its cell and with inputs held over each period.

    The held inputs are exact, by python-control. ``delay_scale`` is a name here, ``delay_ticks`` counts.
    ``damping_n_s_mm``: of spring and rope; None: that of the settings, scaled as the stiffness is. Where the settings
    have no corner of the amplifier's low-pass (`tension_cell.filter_hz`), what it is late by is part of the delay,
    which costs a loop no less phase and more gain. The command of a tick acts whole ticks later, and where the delay
    has a fraction, only after that fraction of the period (Franklin, Powell, Workman: Digital Control of Dynamic
    Systems, section 4.3.4).
    """
    plant, dt = settings.plant, 1.0 / settings.loop.rate_hz
    c = k_scale * plant.damping_n_s_mm if damping_n_s_mm is None else damping_n_s_mm
    made = of_values(
        k_scale * plant.stiffness_n_mm, c, lag_scale * plant.cylinder_lag_s, delay_ticks, dt,
        k_m=k_m, payload_kg=plant.payload_kg, mechanism_damping=mechanism_damping,
        cell_hz=settings.tension_cell.filter_hz,
    )  # fmt: skip
    return replace(made, k_scale=k_scale, delay_scale=delay_scale, lag_scale=lag_scale)


def of_values(
    k: float,
    c: float,
    lag_s: float,
    delay_ticks: float,
    dt: float,
    *,
    k_m: float | None = None,
    payload_kg: float = 0.0,
    mechanism_damping: float = MECHANISM_DAMPING,
    cell_hz: float | None = None,
) -> Member:
    """The plant of these values (N/mm, N s/mm, s, ticks, s), as `sampled`; the one place where it is made."""
    import control  # 1.5 s

    mass = payload_kg / KG_PER_N_S2_MM
    rates, tension = _rates(k, c, mass, k_m, lag_s, cell_hz, mechanism_damping)
    n = len(tension)
    system = control.ss(rates[:n, :n], rates[:n, n:], tension, np.array([[0.0, c]]))
    held = system.sample(dt, method=HELD)
    state, (by_command, by_disturbance) = held.A, held.B.T
    whole = math.floor(delay_ticks + WHOLE)
    fraction = max(0.0, delay_ticks - whole)
    if fraction > WHOLE:
        newer = system.sample((1.0 - fraction) * dt, method=HELD).B[:, 0]
        state = np.block([[state, (by_command - newer)[:, None]], [np.zeros((1, n + 1))]])
        by_command, by_disturbance = np.append(newer, 1.0), np.append(by_disturbance, 0.0)
        tension = np.append(tension, 0.0)
    resonances = () if k_m is None else tuple(math.sqrt(x / mass) / (2.0 * math.pi) for x in (k_m, k_m + k))
    return Member(
        k_m, 1.0, 1.0, state, by_command, by_disturbance, whole, resonances, tension, c, c if cell_hz is None else 0.0
    )


def _rates(
    k: float, c: float, mass: float, k_m: float | None, lag_s: float, cell_hz: float | None, ratio: float
) -> tuple[Array, Array]:
    """Rates of the states and of the held inputs u and w, and the row of the true tension without its ``c w``.

    States: with a low-pass of the cell measured tension, speed, the spring's force k x; without one the true tension
    but for ``c w``, and speed; then the mechanism's deflection and speed.
    """
    names = ["F", "v"] if cell_hz is None else ["y", "v", "F"]
    names += ["p", "dp"] if k_m is not None else []
    at = {name: i for i, name in enumerate(names)}
    n = len(names)
    u, w = n, n + 1
    rates, tension = np.zeros((n + 2, n + 2)), np.zeros(n)
    tension[at["F"]], tension[at["v"]] = 1.0, c
    rates[at["F"], [at["v"], w]] = k
    rates[at["v"], [at["v"], u]] = -1.0 / lag_s, 1.0 / lag_s
    if k_m is not None:
        tension[at["dp"]] = -c
        rates[at["F"], at["dp"]] = -k
        rates[at["p"], at["dp"]] = 1.0
        rates[at["dp"], :n], rates[at["dp"], w] = tension / mass, c / mass
        rates[at["dp"], at["p"]] -= k_m / mass
        rates[at["dp"], at["dp"]] -= 2.0 * ratio * math.sqrt(k_m / mass)
    if cell_hz is not None:
        corner = 2.0 * math.pi * cell_hz
        rates[0, :n], rates[0, w] = corner * tension, corner * c
        rates[0, 0] = -corner
        return rates, tension
    basis = np.eye(n + 2)
    basis[0, :n] = tension
    return basis @ rates @ np.linalg.inv(basis), np.eye(1, n)[0]


def nominal(settings: RigSettings) -> Member:
    """The plant in the settings, its delay exact."""
    ticks = settings.plant.command_delay_s * settings.loop.rate_hz
    return sampled(settings, settings.plant.mechanism_n_mm, 1.0, 1.0, 1.0, ticks)


def assumed(settings: RigSettings) -> Family:
    """The family of a rig that was not identified: what a rig of this kind may be."""
    return Family(ASSUMED, tuple(family(settings)), tuple(reported(settings)))


def with_losses(settings: RigSettings) -> Family:
    """The assumed family with the loss of spring and rope from none to `LOSS_SCALE` times that of the settings.

    It lowers the largest |S|, and raises it elsewhere: on a soft spring from 1.08 to 1.4 at 48 Hz. What is compared
    with a measured |S| frequency by frequency has to have it.
    """
    stiffnesses = dict.fromkeys((*MECHANISMS_N_MM, settings.plant.mechanism_n_mm))
    losses = np.linspace(0.0, LOSS_SCALE, LOSS_STEPS).tolist()
    members = [member(settings, *scales) for scales in product(stiffnesses, STIFFNESS_SCALES, DELAY_SCALES, losses)]
    return Family(ASSUMED, tuple(members))


def family(settings: RigSettings) -> list[Member]:
    """Every member of the assumed family; it always includes the mechanism's stiffness of the file."""
    stiffnesses = list(MECHANISMS_N_MM)
    if settings.plant.mechanism_n_mm not in stiffnesses:
        stiffnesses.append(settings.plant.mechanism_n_mm)
    return [member(settings, *scales) for scales in product(stiffnesses, STIFFNESS_SCALES, DELAY_SCALES)]


def reported(settings: RigSettings) -> list[Member]:
    """Members shown beside the family, with a mechanism much softer than the rope's spring."""
    return [
        member(settings, REPORTED_N_MM, k_scale, delay) for k_scale, delay in product(STIFFNESS_SCALES, DELAY_SCALES)
    ]
