"""Stiffness, drive and mechanism from a frequency response, by weighted least squares.

    stroke / u  = g e^{-s Td} H / (s (tau s + 1))                                H: a command held over a tick
    tension / u = (k + c s) R e^{-s (Td + Ts)} H / (s (tau s + 1))
    R = (m s^2 + c_m s + K_m) / (m s^2 + (c_m + c) s + K_m + k)                  R = 1 for a rigid mechanism

These are what is fitted, at frequencies far below the Nyquist frequency, where what aliases is less than the least
standard deviation of a response. Whatever is made of the plant found is made of the design's own plant with its values,
sampled exactly (`PlantModel.sampled`); a test holds the two together over the excited band.

k and c: spring and rope along the rope; Ts: what the tension is later than the stroke, by the cell's filter; g: share
of the commanded speed at which the drive runs; m: payload. The mechanism is believed to be rigid unless a resonance
explains the tension clearly better; then the least stiffness is stated that the tension does not contradict.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigctl.commission.frequency_response import ComplexArray, PlantResponse, Ratio
from rigctl.commission.identification import PITCH_SHARE, Estimated, student_t
from rigctl.commission.motion import Array
from rigctl.config.plant_section import PlantSettings
from rigctl.design.plant_family import of_values

KG_PER_N_S2_MM = 1000.0  # 1 N s^2/mm is 1000 kg
FLOOR = 0.003  # of a response: least standard deviation; what else is in it the equations do not have
SEARCHED_N_MM = np.geomspace(1.0, 3e4, 48)  # K_m
RATIO_ASSUMED = 0.02  # damping of a mechanism that no resonance shows
CLEARLY = 16.0  # least gain in the sum of squares for a resonance: 4 standard deviations
BOUND = 2.706  # sum of squares at which a one-sided 95 % bound lies
MASS_SPREAD, RATIO_SPREAD = 0.3, 1.0  # of what is assumed before, standard deviations of the logarithm
_ROUNDS, _LOOKS = 30, 5  # of the search; to compare stiffnesses of the mechanism
_DAMPING = 1  # position of c in a place
_LAG_SCALES = (1.0, 0.4, 2.5)
_LEAST_SENSOR = -0.1  # times 10 ms: with less, a damping below 0 would look like a delay
_STEP, _SETTLED = 1e-5, 1e-4  # of a slope; gain in the sum of squares below which the search ends


@dataclass(frozen=True)
class PlantModel:
    """The equations above with numbers: N/mm, N s/mm, s, s, s, 1, N/mm, ratio of critical, kg."""

    stiffness: float
    damping: float
    lag_s: float
    delay_s: float
    sensor_delay_s: float
    gain: float
    mechanism: float | None
    mechanism_damping: float
    payload_kg: float

    def responses(self, frequencies_hz: Array, tick_s: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Tension, stroke and speed per command; N s/mm, s, 1."""
        s = 2j * math.pi * frequencies_hz
        held = np.sinc(frequencies_hz * tick_s) * np.exp(-0.5 * s * tick_s)
        moved = held * np.exp(-s * self.delay_s) / (s * (self.lag_s * s + 1.0))
        stretch = self.stiffness + self.damping * s
        if self.mechanism is not None:
            mass = self.payload_kg / KG_PER_N_S2_MM
            own = mass * s**2 + 2.0 * self.mechanism_damping * math.sqrt(self.mechanism * mass) * s + self.mechanism
            stretch = stretch * own / (own + stretch)
        return stretch * moved * np.exp(-s * self.sensor_delay_s), self.gain * moved, self.gain * moved * s

    def sampled(self, frequencies_hz: Array, tick_s: float) -> tuple[ComplexArray, ComplexArray]:
        """Tension and speed per command of the design's plant with these values; N s/mm, 1."""
        z = np.exp(2j * math.pi * frequencies_hz * tick_s)

        def of(delay_s: float) -> ComplexArray:
            plant = of_values(
                self.stiffness, self.damping, self.lag_s, max(0.0, delay_s) / tick_s, tick_s,
                k_m=self.mechanism, payload_kg=self.payload_kg, mechanism_damping=self.mechanism_damping,
            )  # fmt: skip
            return plant.response(z)

        return of(self.delay_s + self.sensor_delay_s)[0], self.gain * of(self.delay_s)[1]

    @property
    def resonances_hz(self) -> tuple[float, ...]:
        """Of the mechanism without and with the rope; none of a rigid one."""
        if self.mechanism is None:
            return ()
        mass = self.payload_kg / KG_PER_N_S2_MM
        return tuple(math.sqrt(k / mass) / (2.0 * math.pi) for k in (self.mechanism, self.mechanism + self.stiffness))


@dataclass(frozen=True)
class PlantFit:
    """The fitted plant with the uncertainty of its values at 95 %.

    ``mechanism``: None where no resonance was found; then it is stiffer than ``mechanism_above``, N/mm, or nothing is
    known of it (None). The error of the stiffness includes the screw's pitch error, which is always the same.
    ``damping_n_s_mm``: None where the response does not separate it from the delay of the cell (`found`).
    ``misfit``: rms of the residuals over their standard deviations; 1 or less where the equations hold.
    """

    model: PlantModel
    stiffness_n_mm: Estimated
    damping_n_s_mm: Estimated | None
    lag_s: Estimated
    delay_s: Estimated
    sensor_delay_s: Estimated
    gain: Estimated
    mechanism_n_mm: Estimated | None
    mechanism_damping: Estimated | None
    payload_kg: Estimated | None
    mechanism_above: float | None
    misfit: float


def fit(found: PlantResponse, assumed: PlantSettings) -> PlantFit:
    """Fit the equations; ``assumed``: where the search begins, and the payload."""
    problem = _Problem(found, assumed)
    rigid = min((problem.solve(start, None) for start in _starts(found, assumed)), key=lambda at: at.squares)
    tried = [problem.solve(rigid.place, float(k_m), _LOOKS) for k_m in SEARCHED_N_MM]
    best = min(range(len(tried)), key=lambda i: tried[i].squares)
    free = problem.solve(problem.freed(tried[best].place, float(SEARCHED_N_MM[best])), math.nan)
    scale = max(1.0, min(rigid.squares / problem.freedom(rigid), free.squares / problem.freedom(free)))
    if rigid.squares - free.squares > CLEARLY * scale:
        return problem.found(free, None)
    above = None
    for k_m, at in zip(SEARCHED_N_MM.tolist(), tried, strict=True):
        if at.squares - rigid.squares > BOUND * scale:
            above = k_m
    return problem.found(rigid, above)


def refit(found: PlantResponse, before: PlantFit, assumed: PlantSettings) -> PlantModel:
    """The same equations fitted to other figures of the same plant, from what was found before."""
    problem, model = _Problem(found, assumed), before.model
    if before.mechanism_n_mm is None:
        return problem.model(problem.solve(problem.place(model), None).place, None)
    return problem.model(problem.solve(problem.place(model), math.nan).place, math.nan)


def _starts(found: PlantResponse, assumed: PlantSettings) -> list[Array]:
    """Places to begin: stiffness as tension over stroke where both are slow, the assumed lag and others."""
    shares = np.abs(found.tension.value) / np.maximum(np.abs(found.stroke.value), 1e-12)
    stiffness = max(1e-3, float(np.median(shares[: max(3, len(shares) // 3)])))
    lags = [math.log(assumed.cylinder_lag_s * scale) for scale in _LAG_SCALES]
    return [np.array([math.log(stiffness), 0.0, lag, assumed.command_delay_s * 1e2, 0.0, 1.0]) for lag in lags]


@dataclass(frozen=True)
class _Solution:
    place: Array
    k_m: float | None  # NaN: among the values of ``place``
    squares: float


class _Problem:
    """Residuals of tension and stroke over their standard deviations.

    ``place``: log k, c, log tau, 100 Td, 100 Ts, g, and where K_m is fitted log K_m, log damping ratio, log m.
    """

    def __init__(self, found: PlantResponse, assumed: PlantSettings) -> None:
        self._hz, self._tick_s, self._mass = found.frequencies_hz, found.tick_s, assumed.payload_kg
        self._measured = np.concatenate([found.tension.value, found.stroke.value])
        self._weights = np.concatenate([_weights(found.tension), _weights(found.stroke)])

    def freedom(self, solution: _Solution) -> int:
        """Number of residuals less that of the values fitted; what is assumed counts as a residual."""
        extra = 2 if len(solution.place) > 6 else 0
        return 2 * len(self._measured) + extra - len(solution.place)

    def freed(self, place: Array, k_m: float) -> Array:
        """The place with the mechanism among the values."""
        return np.concatenate([place, [math.log(k_m), math.log(RATIO_ASSUMED), math.log(self._mass)]])

    def place(self, model: PlantModel) -> Array:
        """The place of a plant."""
        drive = [math.log(model.lag_s), 1e2 * model.delay_s, 1e2 * model.sensor_delay_s, model.gain]
        place = np.array([math.log(model.stiffness), model.damping, *drive])
        if model.mechanism is None:
            return place
        flexible = (model.mechanism, model.mechanism_damping, model.payload_kg)
        return np.concatenate([place, np.log(flexible)])

    def model(self, place: Array, k_m: float | None) -> PlantModel:
        """The plant at a place."""
        log_k, c, log_lag, delay, sensor, gain = place[:6].tolist()
        values = math.exp(log_k), c, math.exp(log_lag), delay * 1e-2, sensor * 1e-2, gain
        if k_m is not None and math.isnan(k_m):
            return PlantModel(*values, *(math.exp(value) for value in place[6:].tolist()))
        return PlantModel(*values, k_m, RATIO_ASSUMED, self._mass)

    def solve(self, place: Array, k_m: float | None, rounds: int = _ROUNDS) -> _Solution:
        """Least squares by Levenberg and Marquardt's method from a place."""
        residual = self._residual(place, k_m)
        squares, pull = float(residual @ residual), 1e-3
        for _ in range(rounds):
            slopes = self._slopes(place, k_m, residual)
            normal, downhill = slopes.T @ slopes, slopes.T @ residual
            while pull < 1e6:
                move = np.linalg.solve(normal + pull * np.diag(np.diag(normal) + 1e-12), downhill)
                tried = place - np.clip(move, -1.0, 1.0)
                tried[_DAMPING], tried[4] = max(tried[_DAMPING], 0.0), max(tried[4], _LEAST_SENSOR)
                left = self._residual(tried, k_m)
                if np.isfinite(left).all() and float(left @ left) < squares:
                    break
                pull *= 4.0
            else:
                break
            gained = squares - float(left @ left)
            place, residual, squares, pull = tried, left, float(left @ left), max(pull * 0.25, 1e-9)
            if gained < _SETTLED * (1.0 + squares):
                break
        return _Solution(place, k_m, squares)

    def _residual(self, place: Array, k_m: float | None) -> Array:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            tension, stroke, _ = self.model(place, k_m).responses(self._hz, self._tick_s)
            left = (np.concatenate([tension, stroke]) - self._measured) * self._weights
        parts = [left.real, left.imag]
        if len(place) > 6:
            parts.append(np.array([(place[7] - math.log(RATIO_ASSUMED)) / RATIO_SPREAD]))
            parts.append(np.array([(place[8] - math.log(self._mass)) / MASS_SPREAD]))
        return np.concatenate(parts)

    def _slopes(self, place: Array, k_m: float | None, residual: Array) -> Array:
        columns = []
        for i in range(len(place)):
            moved = place.copy()
            moved[i] += _STEP
            columns.append((self._residual(moved, k_m) - residual) / _STEP)
        return np.column_stack(columns)

    def found(self, solution: _Solution, above: float | None) -> PlantFit:
        """The fit with its uncertainties.

        A damping that is small against the stiffness advances the tension by c / k at every frequency, as a shorter
        delay of the cell does. Where the response leaves that advance open by more than a tick, only their difference
        is known: the damping stays as it was fitted, and the other values have the uncertainties with it.
        """
        place, model = solution.place, self.model(solution.place, solution.k_m)
        slopes = self._slopes(place, solution.k_m, self._residual(place, solution.k_m))
        freedom = self.freedom(solution)
        misfit = math.sqrt(solution.squares / freedom)

        def errors_of(slopes: Array) -> list[float]:
            deviations = np.linalg.norm(np.linalg.pinv(slopes), axis=1) * max(1.0, misfit)
            found: list[float] = (student_t(freedom) * deviations).tolist()
            return found

        errors, damping = errors_of(slopes), None
        if errors[_DAMPING] <= model.stiffness * self._tick_s:
            damping = Estimated(model.damping, errors[_DAMPING])
        else:
            slopes[:, _DAMPING] = 0.0
            errors = errors_of(slopes)
        k_m = ratio = payload = None
        if len(place) > 6:
            values = (model.mechanism or 0.0, model.mechanism_damping, model.payload_kg)
            k_m, ratio, payload = (
                Estimated(value, value * error) for value, error in zip(values, errors[6:], strict=True)
            )
        return PlantFit(
            model,
            Estimated(model.stiffness, model.stiffness * (errors[0] + PITCH_SHARE)),  # a bound adds linearly
            damping,
            Estimated(model.lag_s, model.lag_s * errors[2]),
            Estimated(model.delay_s, 1e-2 * errors[3]),
            Estimated(model.sensor_delay_s, 1e-2 * errors[4]),
            Estimated(model.gain, errors[5]),
            k_m,
            ratio,
            payload,
            above,
            misfit,
        )


def _weights(ratio: Ratio) -> Array:
    """One over the standard deviation of real and imaginary part."""
    return np.asarray(1.0 / np.sqrt(0.5 * ratio.variance + (FLOOR * np.abs(ratio.value)) ** 2 + 1e-30))
