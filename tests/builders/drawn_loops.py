"""Linear loops drawn by seed, of a mechanism with weak damping; their S, and its largest modulus, by python-control.

From the command's speed, held from tick to tick and late by whole ticks, to the reading and the drive's speed:

    P_v = 1 / (tau s + 1),   P_T = P_v (k + c s) / s * R / (tau_c s + 1),
    R = (m s^2 + c_m s + K_m) / (m s^2 + (c_m + c) s + K_m + k)

closed by our law as designed for a rigid mechanism, up to `KEENEST` times as keen. What a search is led by is another
plant: stiffness, K_m, lag and delay are off by up to `OFF`, one for each draw.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import control
import numpy as np
import numpy.typing as npt

from hil.studies.compare import peak_hints
from hil.studies.compare.local_peak import SensitivityLine
from hil.studies.compare.peak_search import PLACES, SearchPass, Span
from rigctl.config.changed_settings import changed
from rigctl.control.law.tension import Gains
from rigctl.design.closed_loop import Controller
from rigctl.design.gains import design
from rigctl.design.plant_family import of_values
from tests.builders.rig_bench import SETTINGS

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

STIFFNESS_N_MM, MECHANISM_N_MM, DAMPING = (4.0, 40.0), (6.0, 3000.0), (0.005, 0.02)
LAG_S, DELAY_TICKS, FILTER_HZ, PAYLOAD_KG, PERIOD_S = (0.014, 0.026), (0, 4), 500.0, 30.0, 1e-3
ROPE_DAMPING = (0.0, 0.005)
"""Of critical, with the payload on the rope."""
KEENEST, MOST_MS = 8.0, 2.5
"""Loops with more are drawn again, and those that are unstable."""
OFF = {"stiffness": 0.2, "mechanism": 0.05, "lag": 0.1}
LOW_HZ, TOP_HZ = 0.3, 400.0
DENSE, NEAR, CLOSER, GOLDEN = 1500, 0.15, 300, 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class Plant:
    """N/mm, N s/mm, s, ticks, N/mm, ratio."""

    stiffness: float
    damping: float
    lag: float
    delay_ticks: int
    mechanism: float
    mechanism_damping: float

    def sampled(self) -> control.StateSpace:
        """Reading and speed at a tick per command, inputs held."""
        s = control.tf("s")
        m = PAYLOAD_KG * 1e-3
        own = 2.0 * self.mechanism_damping * math.sqrt(self.mechanism * m)
        k, c = self.stiffness, self.damping
        mechanism = (m * s**2 + own * s + self.mechanism) / (m * s**2 + (own + c) * s + self.mechanism + k)
        speed = 1 / (self.lag * s + 1)
        reading = speed * (k + c * s) / s * mechanism / (s / (2.0 * math.pi * FILTER_HZ) + 1)
        held = [control.c2d(control.ss(each), PERIOD_S, "zoh") for each in (reading, speed)]
        late = control.ss(control.tf([1.0], [1.0, *(0.0,) * self.delay_ticks], PERIOD_S))
        return [late * each for each in held]


@dataclass(frozen=True)
class Loop:
    """A drawn loop: S at either place, and the plant that the search is led by."""

    number: int
    plant: Plant
    led_by: Plant
    keener: float
    law: Controller
    sensitivities: tuple[control.StateSpace, control.StateSpace]

    def at(self, place: str, hz: Floats) -> Complex:
        """S."""
        system = self.sensitivities[PLACES.index(place)]
        z = np.exp(2j * np.pi * hz * PERIOD_S)
        states = np.linalg.solve(z[:, None, None] * np.eye(len(system.A)) - system.A, system.B.astype(np.complex128))
        return np.asarray((system.C @ states)[:, 0, 0] + system.D[0, 0], np.complex128)

    @functools.cached_property
    def true(self) -> tuple[float, float]:
        """The largest |S| and where: dense, denser about resonances, and by golden section at each maximum."""
        plant, m = self.plant, PAYLOAD_KG * 1e-3
        own = [math.sqrt(x / m) / (2.0 * math.pi) for x in (plant.mechanism, plant.mechanism + plant.stiffness)]
        parts = [np.geomspace(LOW_HZ, TOP_HZ, DENSE)]
        parts += [np.linspace(1.0 - NEAR, 1.0 + NEAR, CLOSER) * hz for hz in own]
        hz = np.unique(np.clip(np.concatenate(parts), LOW_HZ, TOP_HZ))
        best = (0.0, 0.0)
        for place in PLACES:
            moduli = np.abs(self.at(place, hz))
            for at in np.flatnonzero((moduli[1:-1] >= moduli[:-2]) & (moduli[1:-1] >= moduli[2:])) + 1:
                if moduli[at] > 0.98 * best[0]:
                    best = max(best, self._golden(place, float(hz[at - 1]), float(hz[at + 1])))
        return best

    def _golden(self, place: str, low: float, high: float) -> tuple[float, float]:
        def modulus(hz: float) -> float:
            return float(np.abs(self.at(place, np.array([hz])))[0])

        for _ in range(40):
            inner = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
            low, high = (low, inner[1]) if modulus(inner[0]) > modulus(inner[1]) else (inner[0], high)
        return modulus(0.5 * (low + high)), 0.5 * (low + high)

    def spans(self) -> list[Span]:
        """Of the plant that the search is led by, with 0.8, 1 and 1.2 times its stiffness."""
        led = self.led_by
        members = [
            of_values(
                scale * led.stiffness, led.damping, led.lag, led.delay_ticks, PERIOD_S, k_m=led.mechanism,
                payload_kg=PAYLOAD_KG, mechanism_damping=led.mechanism_damping, cell_hz=FILTER_HZ,
            )
            for scale in (0.8, 1.0, 1.2)
        ]  # fmt: skip
        return [*peak_hints.of_mechanism(members), *peak_hints.of_loop(members, self.law, PERIOD_S, TOP_HZ)]

    def measure(self, excitation: SearchPass, error: float, rng: np.random.Generator) -> list[SensitivityLine]:
        """S at the lines of a pass with normal errors; ``error``: half of the 95 % interval of a modulus."""
        found = []
        for place, harmonics in zip(PLACES, excitation.harmonics, strict=True):
            hz = np.array(harmonics) / excitation.period_s
            noise = rng.normal(size=(2, len(hz))) * error / 1.96
            values = self.at(place, hz) + noise[0] + 1j * noise[1]
            found += [
                SensitivityLine(place, float(f), complex(value), error) for f, value in zip(hz, values, strict=True)
            ]
        return found


def drawn(seed: int, count: int) -> list[Loop]:
    """Stable loops below `MOST_MS`."""
    found: list[Loop] = []
    rng = np.random.default_rng(seed)
    while len(found) < count:
        loop = _drawn(rng, len(found))
        if loop is not None:
            found.append(loop)
    return found


def _drawn(rng: np.random.Generator, number: int) -> Loop | None:
    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    def off(share: float) -> float:
        return 1.0 + share * float(rng.uniform(-1.0, 1.0))

    k = between(*STIFFNESS_N_MM)
    damping = 2.0 * float(rng.uniform(*ROPE_DAMPING)) * math.sqrt(k * PAYLOAD_KG * 1e-3)
    plant = Plant(
        k, damping, between(*LAG_S), int(rng.integers(DELAY_TICKS[0], DELAY_TICKS[1] + 1)),
        between(*MECHANISM_N_MM), between(*DAMPING),
    )  # fmt: skip
    led = Plant(
        k * off(OFF["stiffness"]), damping, plant.lag * off(OFF["lag"]),
        max(0, plant.delay_ticks + int(rng.integers(-1, 2))), plant.mechanism * off(OFF["mechanism"]),
        plant.mechanism_damping,
    )  # fmt: skip
    keener = between(1.0, KEENEST)
    believed = changed(SETTINGS, {"plant.spring_n_mm": 1.0 / (1.0 / k - 1.0 / SETTINGS.plant.rope_n_mm)})
    gains = design(believed)
    law = peak_hints.law_at(believed, Gains(keener * gains.k_tension, gains.k_speed, gains.k_integral), 1.0)
    per_tension, per_speed = (
        control.ss(law.a, law.b[:, column : column + 1], law.c[None], [[0.0]], PERIOD_S) for column in (0, 1)
    )
    reading, speed = plant.sampled()
    inner = control.feedback(1, per_speed * speed, sign=1)
    at_input = control.feedback(1, per_tension * reading + per_speed * speed, sign=1)
    at_output = control.feedback(1, reading * inner * per_tension, sign=1)
    if float(np.abs(control.poles(at_input)).max()) >= 1.0:
        return None
    loop = Loop(number, plant, led, keener, law, (at_input, at_output))
    return loop if loop.true[0] <= MOST_MS else None
