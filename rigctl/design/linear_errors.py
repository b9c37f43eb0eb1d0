"""Errors of a law in the linear cases: the recorded move, heave, shakes and rest, by the closed loop's response.

With the plant's responses P_T, P_v (per command) and P_d (true tension per disturbance speed, the stroke locked), and
C_T, C_v of the law, as in `rigctl.design.margins`:

    S_d = (1 - C_v P_v) S P_d,    S_n = P_T C_T S,    S = 1 / (1 - C_T P_T - C_v P_v)

per disturbance speed and per newton of the cell's noise. The same formulas judge every law that has a response: it is
the law's own, so that no second law is written down here.
"""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.design.performance import SHAKE_HZ, VERTICAL_HZ, VERTICAL_MM
from rigctl.design.plant_family import Array, ComplexArray, nominal

SHAKE_MM = 0.05
TONES = {
    "vertical": (VERTICAL_HZ, VERTICAL_MM), **{f"shake_{hz:g}hz": (hz, SHAKE_MM) for hz in SHAKE_HZ},
}  # fmt: skip
"""Frequency in Hz and amplitude in mm of the sines, by group."""
MOVE = "move"
REFERENCES = pathlib.Path(__file__).with_name("references.yaml")
MOST_HZ = 10.0  # of the move: above it there is nothing
FADE_S = 2.0  # after its record, in which the speed comes back to zero
NOISE_POINTS = 400
SOFT_N_MM = 6.0  # at which the references are given
UNKNOWN_SHARE = 0.4

Response = Callable[[ComplexArray], ComplexArray]
"""Command per tension and per speed of z, shape (2, n)."""


@dataclass(frozen=True)
class LinearErrors:
    """True errors of the tension by group, N rms with the cell's noise; noise of the command and of its steps, mm/s."""

    rms_n: Mapping[str, float]
    command_mm_s: float
    step_mm_s: float


@lru_cache(maxsize=1)
def _document() -> Any:
    import yaml

    return yaml.load(REFERENCES.read_text(), Loader=yaml.CSafeLoader)


def references_n(settings: RigSettings) -> dict[str, float]:
    """The error of each group that one law can reach beside the others, N rms: what the cost is a multiple of."""
    share = settings.plant.stiffness_n_mm / SOFT_N_MM
    return {name: row["rms_n"] * share ** row["by_stiffness"] for name, row in _document()["references"].items()}


@lru_cache(maxsize=1)
def recorded_move() -> tuple[float, float, Array]:
    """The move: seconds between its values, and from which on errors count; speeds of the rope's stretch, mm/s."""
    move = _document()["move"]
    return float(move["every_s"]), float(move["from_s"]), np.array(move["speeds_mm_s"])


def unknown_share(settings: RigSettings) -> float:
    """Of the recorded move: what a lead by the inclination leaves of it beside the cell's noise."""
    return 1.0 if settings.estimator.inclination_swing_hz is None else UNKNOWN_SHARE


class LinearCases:
    """The cases on the plant in the settings: its responses are computed once, for every law that is tried."""

    def __init__(self, settings: RigSettings) -> None:
        rate = settings.loop.rate_hz
        self._noise_n = settings.tension_cell.noise_n
        self._noise_hz = np.concatenate([[0.0], np.geomspace(0.02, 0.5 * rate, NOISE_POINTS)])
        every_s, from_s, speeds = recorded_move()
        speeds = unknown_share(settings) * speeds
        fade = np.linspace(1.0, 0.0, round(FADE_S / every_s))[1:]
        whole = np.concatenate([speeds, speeds[-1] * fade])
        whole = np.concatenate([whole, np.zeros(len(whole))])  # so that the end does not come round to the beginning
        self._count, self._first, self._last = len(whole), round(from_s / every_s), len(speeds)
        bins = np.fft.rfftfreq(len(whole), every_s)
        self._move, self._move_hz = np.fft.rfft(whole)[bins <= MOST_HZ], bins[bins <= MOST_HZ]
        hz = [self._noise_hz[1:], np.array([tone for tone, _ in TONES.values()]), self._move_hz[1:]]
        self._cuts = np.cumsum([len(each) for each in hz])[:-1]
        self.z: ComplexArray = np.exp(2j * np.pi * np.concatenate(hz) / rate)
        self._plant = nominal(settings).response(self.z)
        speed = rate * np.abs(self.z[self._cuts[0] : self._cuts[1]] - 1.0)
        self._speeds = speed * np.array([amplitude for _, amplitude in TONES.values()])

    def errors(self, response: Response) -> LinearErrors:
        """Of a stable law with an integral: without one a constant disturbance would leave an error at 0 Hz."""
        by_tension, by_speed = response(self.z)
        tension, speed, disturbance = self._plant
        s = 1.0 / (1.0 - by_tension * tension - by_speed * speed)
        disturbed = (1.0 - by_speed * speed) * s * disturbance
        cut, end = self._cuts
        command = np.abs(by_tension * s)[:cut]
        noise_n = self._noise(np.abs(by_tension * s * tension)[:cut])
        rms = {
            name: math.hypot(noise_n, float(amplitude) / math.sqrt(2.0))
            for name, amplitude in zip(TONES, np.abs(disturbed[cut:end]) * self._speeds, strict=True)
        }
        error = np.fft.irfft(self._padded(np.concatenate([[0.0], disturbed[end:]]) * self._move), self._count)
        moved = error[self._first : self._last]
        rms[MOVE] = math.hypot(noise_n, float(np.sqrt(np.mean(moved**2))))
        return LinearErrors(rms, self._noise(command), self._noise(command * np.abs(self.z[:cut] - 1.0)))

    def _noise(self, gain: Array) -> float:
        """Rms of what the cell's white noise makes through a gain on the grid, N or mm/s."""
        power = np.concatenate([gain[:1] ** 2, gain**2])
        mean = np.trapezoid(power, self._noise_hz) / self._noise_hz[-1]
        return self._noise_n * math.sqrt(float(mean))

    def _padded(self, bins: ComplexArray) -> ComplexArray:
        full = np.zeros(self._count // 2 + 1, np.complex128)
        full[: len(bins)] = bins
        return full
