"""Sensitivities of the loop that runs, and their peak Ms, from a frequency response taken in it. Pure functions.

The multisine d is added to the command behind the law, and the filter is not told of it, so that the whole command over
it is the sensitivity at the plant's input: S = u / d, whatever the law does, and L = 1 / S - 1.

Between the excited frequencies L follows the plant fitted to the same records and the controller in use,

    L(w) = rho(w) L_model(w),   L_model = -(C_T P_T + C_v P_v)

with rho a complex polynomial in log w, fitted to the measured L with the least degree that explains it: 1 where plant
and controller are as modelled, and what corrects the model where they are not. Beyond the excited frequencies rho keeps
its last value, and plant and controller continue L to the Nyquist frequency: a sensitivity that still rises at the edge
of the band has its peak beyond it. The sensitivity at the tension output is (1 - C_v P_v) S, as in
`rigctl.design.margins`. The uncertainty of a peak is that of a jackknife over the periods.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rigctl.commission import plant_fit
from rigctl.commission.frequency_response import ComplexArray, PlantResponse, Spectra, plant_response, without
from rigctl.commission.identification import Estimated, student_t
from rigctl.commission.motion import Array
from rigctl.commission.plant_fit import PlantFit, PlantModel
from rigctl.config.plant_section import PlantSettings

Controller = Callable[[Array], tuple[ComplexArray, ComplexArray]]
"""Frequencies in Hz to the command per tension (mm/s per N) and per speed (1), positive feedback."""

POINTS = 600  # between the lowest and the highest frequency
BELOW, TOP = 1.3, 0.9  # the curves begin so far below the excited band, and end at this share of the Nyquist frequency
COVERED = 1.1  # that far outside the excited band a peak is as good as measured
NEAR_POINTS, NEAR = 41, 0.1  # extra points within +-10 % of a resonance
_DEGREES = range(6)
_EXPLAINED = 1.2  # mean square of what is left over its variance
_LEAST_SHARE = 0.01  # least standard deviation of a measured L, over L: the model is not more exact between the lines


@dataclass(frozen=True)
class LoopResponse:
    """On a fine grid: frequencies in Hz, loop L, sensitivities at plant input and tension output."""

    frequencies_hz: Array
    loop: ComplexArray
    at_input: ComplexArray
    at_output: ComplexArray

    @property
    def peaks(self) -> tuple[float, float]:
        """Ms at the input and at the output."""
        return float(np.abs(self.at_input).max()), float(np.abs(self.at_output).max())


@dataclass(frozen=True)
class MeasuredMargins:
    """Ms at plant input and tension output with the uncertainty at 95 %, the frequency of the greater one, the curves.

    ``measured``: from a closed loop; else predicted from the plant and the controller. ``covered_hz``: the highest
    frequency excited; a peak above it is continued by the plant found, see ``beyond``.
    """

    ms_input: Estimated
    ms_output: Estimated
    peak_hz: float
    curves: LoopResponse
    plant: PlantFit
    measured: bool
    covered_hz: float
    at_least: float = 1.0
    """Largest |S| over the lines less its error: Ms is at least that, whatever is beyond them."""

    @property
    def beyond(self) -> bool:
        """The peak is above the excited frequencies: the plant found and the controller put it there."""
        return self.peak_hz > COVERED * self.covered_hz

    @property
    def ms(self) -> Estimated:
        """The greater one."""
        return max(self.ms_input, self.ms_output, key=lambda found: found.value)


def measure(
    found: Spectra, assumed: PlantSettings, controller: Controller, *, measured: bool = True
) -> MeasuredMargins:
    """Margins from a response in the closed loop, or with ``measured`` False predicted from one in HOLD.

    Raises:
        IdentificationError: the records do not determine the plant.
    """
    response = plant_response(found)
    plant = plant_fit.fit(response, assumed)
    degree = _degree(response, plant.model, controller) if measured else None
    curves = loop_response(response, plant.model, controller, degree)
    left_out = []
    for period in range(found.periods):
        part = plant_response(without(found, period))
        again = plant_fit.refit(part, plant, assumed)
        left_out.append(loop_response(part, again, controller, degree).peaks)
    spread = np.array(left_out)
    periods = len(spread)
    errors = student_t(periods - 1) * np.sqrt((periods - 1) / periods * np.sum((spread - spread.mean(0)) ** 2, axis=0))
    at_input, at_output = (
        Estimated(value, float(error)) for value, error in zip(curves.peaks, errors.tolist(), strict=True)
    )
    higher = np.maximum(np.abs(curves.at_input), np.abs(curves.at_output))
    peak_hz = float(curves.frequencies_hz[int(np.argmax(higher))])
    covered_hz = float(response.frequencies_hz[-1])
    least = float((np.abs(response.sensitivity.value) - response.sensitivity.gain_error).max()) if measured else 1.0
    return MeasuredMargins(at_input, at_output, peak_hz, curves, plant, measured, covered_hz, max(least, 1.0))


def loop_response(
    response: PlantResponse, plant: PlantModel, controller: Controller, degree: int | None
) -> LoopResponse:
    """Loop and sensitivities on a fine grid; ``degree`` of rho, None for no correction by what was measured."""
    lines = response.frequencies_hz
    grid = _grid(lines, plant, 0.5 / response.tick_s)
    modelled, by_speed = _modelled(plant, controller, grid, response.tick_s)
    if degree is not None:
        correction = _Correction(response, _modelled(plant, controller, lines, response.tick_s)[0])
        modelled = modelled * correction.at(grid, degree)
    at_input = 1.0 / (1.0 + modelled)
    return LoopResponse(grid, modelled, at_input, (1.0 - by_speed) * at_input)


def _modelled(
    plant: PlantModel, controller: Controller, frequencies_hz: Array, tick_s: float
) -> tuple[ComplexArray, ComplexArray]:
    """L, and the part of the drive-speed loop in it, C_v P_v."""
    tension, speed = plant.sampled(frequencies_hz, tick_s)
    per_tension, per_speed = controller(frequencies_hz)
    return -(per_tension * tension + per_speed * speed), per_speed * speed


def _degree(response: PlantResponse, plant: PlantModel, controller: Controller) -> int:
    """Least degree of rho that explains the sensitivity measured."""
    modelled, _ = _modelled(plant, controller, response.frequencies_hz, response.tick_s)
    correction = _Correction(response, modelled)
    return next((degree for degree in _DEGREES if correction.left(degree) <= _EXPLAINED), _DEGREES[-1])


class _Correction:
    """rho, constant outside the excited band."""

    def __init__(self, response: PlantResponse, modelled: ComplexArray) -> None:
        lines, sensitivity = response.frequencies_hz, response.sensitivity
        spread = np.sqrt(sensitivity.variance) / (np.abs(sensitivity.value) ** 2 * np.abs(modelled))
        self._lines = lines
        self._weights = 1.0 / np.hypot(spread, _LEAST_SHARE)
        self._excess = ((1.0 / sensitivity.value - 1.0) / modelled - 1.0) * self._weights

    def at(self, frequencies_hz: Array, degree: int) -> ComplexArray:
        """On other frequencies."""
        found: ComplexArray = 1.0 + self._powers(frequencies_hz, degree) @ self._fit(degree)
        return found

    def left(self, degree: int) -> float:
        """Mean square of what is left after a fit, over its variance."""
        left = self._excess - self._weights * (self._powers(self._lines, degree) @ self._fit(degree))
        return float(np.sum(np.abs(left) ** 2)) / max(1, len(self._lines) - degree - 1)

    def _fit(self, degree: int) -> ComplexArray:
        powers = self._powers(self._lines, degree) * self._weights[:, None]
        values, *_ = np.linalg.lstsq(powers, self._excess, rcond=None)
        return np.asarray(values, np.complex128)

    def _powers(self, frequencies_hz: Array, degree: int) -> Array:
        low, high = float(self._lines[0]), float(self._lines[-1])
        place = np.log(np.clip(frequencies_hz, low, high) / math.sqrt(low * high)) / math.log(high / low)
        return np.asarray(place[:, None] ** np.arange(degree + 1))


def _grid(lines: Array, plant: PlantModel, nyquist_hz: float) -> Array:
    """Frequencies in Hz, logarithmic, denser about the mechanism's resonances."""
    low, high = float(lines[0]) / BELOW, TOP * nyquist_hz
    near = np.linspace(1.0 - NEAR, 1.0 + NEAR, NEAR_POINTS)
    parts = [np.geomspace(low, high, POINTS), *(near * resonance for resonance in plant.resonances_hz)]
    every = np.unique(np.concatenate(parts))
    return every[(every >= low) & (every <= high)]
