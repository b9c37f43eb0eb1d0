"""What the probe's multisine must show in the tension, how sure a judgement of it is, and so how long one takes.

The probe acts on the loop as a disturbance of the plant's input. Two impulses, one there and one on the cell, are
played through the loop's own filter and law about the plant of the rig file; they give the answer of the tension to
each of the multisine's frequencies, what cell noise makes of the true tension, and the law's own response, from which
the answer of every other plant of the family follows:

    T = P p / (1 - C_T P - C_v G),   P(s) = (k/s) (m s^2 + c s + K_m) / (m s^2 + c s + K_m + k) G(s)

Nothing here is done in a tick.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.control.excitation import margin_probe
from rigctl.control.excitation.frequency_trial import CORNERS, TICKS_PER_SINE
from rigctl.control.excitation.multisine import Band, Multisine, multisine
from rigctl.control.law.estimator import TensionFilter, filter_model
from rigctl.control.law.tension import Estimate, Gains, TensionLaw

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

LOWEST_HZ, HIGHEST_HZ, RATIO, POWER = 2.0, 14.0, 1.25, 0.5  # below, motion disturbs; above, a drive answers less
PERIOD_S = 2.0  # a judgement waits for the period under way: the shorter the sooner, but fewer frequencies
GROWTH = 0.0875
"""Of the rms error by the probe, against that by the cell's noise alone: of the whole error of a rig it is less.

The rest of the error, at rest as much as a third of it, comes from resolution, ripple and dead band of the drive.
"""
FALSE_ALARM_SIGMA = 5.2  # of the answer's spread: 1 in 10 million judgements of the worst plant of the family
DETECTION_SIGMA = 2.0  # of the spread of a cell that shows its noise alone
JUDGEMENTS_PER_PERIOD = 2  # windows of one period, each weighted by Hann's window, begin half a period apart
LEAST_CHANGE = 0.4  # of the stiffness, which is found for sure; beside the family's 0.2
OVERLAP = 4.0 / 3.0  # variance of a mean of such windows, against that of as many independent ones
ENBW = 1.5  # noise bandwidth of Hann's window
MOST_WINDOWS = 64
IMPULSE_S = 3.0  # the loop's answer has died away
IMPULSE_MM_S, IMPULSE_N = 0.01, 0.01  # small: no limit acts, no gate closes
MECHANISMS_N_MM = (60.0, 20.0, 6.0)  # of the family, where the rig file takes it as rigid
STIFFNESS_SCALES, MECHANISM_SCALES = (0.8, 1.2), (0.5, 2.0)
MECHANISM_DAMPING = 0.02


@dataclass(frozen=True)
class ProbePlan:
    """The multisine with its factor, and the judgement of its answer in windows of one period.

    ``answers``: complex amplitudes in N of the tension at ``lines`` (harmonics of the period). ``weights``: of what is
    found there, the answers over what the loop makes of the cell's noise, so that a line counts by how sure it is.
    ``spread``: standard deviation of the answer found in one window over the one expected, by the cell's noise in the
    closed loop; ``silent``: the same of a cell that shows its noise alone. ``least``: smallest answer of a plant of the
    family.
    ``error_n``, ``added_n``: rms of the true tension by the cell's noise, and by the probe.
    """

    shape: Multisine
    level: float
    lines: tuple[int, ...]
    answers: tuple[complex, ...]
    weights: tuple[complex, ...]
    noise_n: float
    spread: float
    silent: float
    least: float
    error_n: float
    added_n: float

    @property
    def period_s(self) -> float:
        """Of the multisine."""
        return self.shape.ticks / self.shape.rate_hz

    @property
    def range_n(self) -> float:
        """Of the true tension in a window, by cell noise and probe: three standard deviations to each side."""
        return 6.0 * math.hypot(self.error_n, self.added_n)

    @property
    def growth(self) -> float:
        """Of the rms error, as a share."""
        return math.hypot(1.0, self.added_n / self.error_n) - 1.0

    def windows(self, spread: float) -> int:
        """Windows that a judgement needs at this spread; more than `MOST_WINDOWS`: none is possible."""
        apart = (FALSE_ALARM_SIGMA * spread + DETECTION_SIGMA * self.silent) / self.least
        return max(2, math.ceil(OVERLAP * apart**2))

    def threshold(self, spread: float, windows: int) -> float:
        """Share of the expected answer below which the mean of the windows is a missing one."""
        return self.least - FALSE_ALARM_SIGMA * spread * math.sqrt(OVERLAP / windows)

    @property
    def detection_s(self) -> float:
        """Time in s within which a missing answer is found: the next window begins, and all needed have ended."""
        step_s = self.period_s / JUDGEMENTS_PER_PERIOD
        return step_s + self.period_s + (self.windows(self.spread) - 1) * step_s

    @property
    def rope_windows(self) -> int:
        """Windows whose mean shows a stiffness well enough to be compared with a mean of twice as many."""
        apart = (FALSE_ALARM_SIGMA + DETECTION_SIGMA) * self.silent / LEAST_CHANGE
        return math.ceil(1.5 * OVERLAP * apart**2)

    @property
    def rope_s(self) -> float:
        """Time in s within which a change of stiffness by `LEAST_CHANGE` is found, once watched thrice as long."""
        return self.period_s + (self.rope_windows + 1) * self.period_s / JUDGEMENTS_PER_PERIOD

    @property
    def decides(self) -> bool:
        """A judgement is possible at all."""
        return self.windows(self.spread) <= MOST_WINDOWS

    @property
    def false_alarms_per_hour(self) -> float:
        """Of the worst plant of the family, with noise as the rig file has it."""
        windows = self.windows(self.spread)
        sigmas = (self.least - self.threshold(self.spread, windows)) / (self.spread * math.sqrt(OVERLAP / windows))
        judgements = 3600.0 / self.period_s * JUDGEMENTS_PER_PERIOD
        return judgements * 0.5 * math.erfc(sigmas / math.sqrt(2.0))


def plan(settings: RigSettings, gains: Gains) -> ProbePlan:
    """The probe of a rig and its loop; some 100 ms for each new rig."""
    key = (settings.model_dump_json(include=_READ), gains.in_order)
    if key not in _plans:
        if len(_plans) >= _KEPT:
            _plans.clear()
        _plans[key] = _plan(settings, gains)
    return _plans[key]


_READ = {"loop", "tension_cell", "plant", "tension", "estimator", "cylinder", "margins"}
_KEPT = 64
_plans: dict[tuple[str, tuple[float, float, float]], ProbePlan] = {}  # made before the first tick, read-only


def _plan(settings: RigSettings, gains: Gains) -> ProbePlan:
    shape = _shape(settings)
    hz = np.array(shape.frequencies_hz)
    watched = (hz >= LOWEST_HZ) & (hz <= HIGHEST_HZ)
    stroke = np.array(shape.stroke_mm)
    speed = (np.roll(stroke, -1) - stroke) * shape.rate_hz
    spectrum = 2.0 * np.fft.rfft(speed)[list(shape.harmonics)] / shape.ticks
    loop = _answers(settings, gains, hz)
    unscaled = loop.tension * spectrum
    error_n = settings.tension_cell.noise_n * loop.noise_gain
    level = _level(settings, shape, error_n, _rms(unscaled))
    shown = level * unscaled[watched]
    reading = np.abs(loop.reading[watched])
    weights = shown / reading
    whole = float((shown * weights.conj()).real.sum())
    noise_n = settings.tension_cell.noise_n * math.sqrt(2.0 * ENBW / shape.ticks)  # of each part of an amplitude
    shares = [float((level * (other * spectrum)[watched] * weights.conj()).real.sum()) / whole for other in loop.others]
    return ProbePlan(
        shape, level, tuple(np.array(shape.harmonics)[watched].tolist()), tuple(shown.tolist()),
        tuple(weights.tolist()), noise_n, noise_n * float(np.linalg.norm(weights * reading)) / whole,
        noise_n * float(np.linalg.norm(weights)) / whole, min(shares), error_n, level * _rms(unscaled),
    )  # fmt: skip


def _rms(amplitudes: ComplexArray) -> float:
    return math.sqrt(0.5 * float((np.abs(amplitudes) ** 2).sum()))


def _shape(settings: RigSettings) -> Multisine:
    """The measured margins' multisine, or else one of the frequencies that a judgement uses."""
    if settings.margins is not None:
        return margin_probe.signal(settings)
    lag_s, rate_hz = settings.plant.cylinder_lag_s, settings.loop.rate_hz
    highest_hz = min(HIGHEST_HZ, CORNERS / (2.0 * math.pi * lag_s), rate_hz / TICKS_PER_SINE)
    return multisine(Band(PERIOD_S, LOWEST_HZ, highest_hz, RATIO), rate_hz, lag_s, POWER)


def _level(settings: RigSettings, shape: Multisine, error_n: float, rms_n: float) -> float:
    """Factor of the shape; ``rms_n``: of the true tension at factor 1."""
    if settings.margins is not None:
        return margin_probe.level(settings)
    return margin_probe.bounded(settings, shape, math.sqrt((1.0 + GROWTH) ** 2 - 1.0) * error_n / rms_n)


class _Answers(NamedTuple):
    """At each frequency: tension per probe (N s/mm), reading per cell noise, tension per probe of the family's plants.

    ``noise_gain``: rms of the true tension over that of the cell's noise.
    """

    tension: ComplexArray
    reading: ComplexArray
    noise_gain: float
    others: list[ComplexArray]


def _answers(settings: RigSettings, gains: Gains, hz: Array) -> _Answers:
    period_s = 1.0 / settings.loop.rate_hz
    probed = _impulse(settings, gains, IMPULSE_MM_S, 0.0)
    noisy = _impulse(settings, gains, 0.0, IMPULSE_N)
    turns = np.exp(-2j * np.pi * np.outer(hz * period_s, np.arange(len(probed))))
    by_probe, by_noise = turns @ probed, turns @ noisy
    # The law's command is C_T times the reading and C_v times the speed, in both.
    readings = np.stack([by_probe[:, :2], by_noise[:, :2]], axis=1)
    commands = np.stack([by_probe[:, 2] - IMPULSE_MM_S, by_noise[:, 2]], axis=1)
    law = np.linalg.solve(readings, commands[:, :, None])[:, :, 0]
    open_loop = by_probe[:, :2] / by_probe[:, 2:3]  # reading and speed per command, the mechanism rigid
    plant, k = settings.plant, settings.plant.stiffness_n_mm

    def answer(mechanism_n_mm: float | None, scale: float) -> ComplexArray:
        tension = open_loop[:, 0] * scale * _yielding(hz, mechanism_n_mm, scale * k, plant.payload_kg)
        return np.asarray(tension / (1.0 - law[:, 0] * tension - law[:, 1] * open_loop[:, 1]))

    own = plant.mechanism_n_mm
    softer = MECHANISMS_N_MM if own is None else tuple(own * scale for scale in MECHANISM_SCALES)
    family = [(mechanism_n_mm, 1.0) for mechanism_n_mm in softer] + [(own, scale) for scale in STIFFNESS_SCALES]
    return _Answers(
        answer(own, 1.0), by_noise[:, 0] / IMPULSE_N, math.sqrt(float((noisy[:, 3] ** 2).sum())) / IMPULSE_N,
        [answer(mechanism_n_mm, scale) for mechanism_n_mm, scale in family],
    )  # fmt: skip


def _yielding(hz: Array, mechanism_n_mm: float | None, stiffness_n_mm: float, payload_kg: float) -> ComplexArray:
    """Share of the tension that a mechanism leaves which gives way, 1 for a rigid one."""
    if mechanism_n_mm is None:
        return np.ones(len(hz), np.complex128)
    s, mass = 2j * np.pi * hz, payload_kg * 1e-3
    own = mass * s**2 + 2.0 * MECHANISM_DAMPING * math.sqrt(mechanism_n_mm * mass) * s + mechanism_n_mm
    return np.asarray(own / (own + stiffness_n_mm))


def _impulse(settings: RigSettings, gains: Gains, probe_mm_s: float, noise_n: float) -> Array:
    """Reading, speed, command and true tension from their rest, tick by tick, after one on the command or the cell.

    Shape (ticks, 4). The mechanism is rigid.
    """
    model, law = filter_model(settings), TensionLaw(settings, gains)
    kalman, start_n = TensionFilter(model), settings.tension.target_n
    stroke_mm = 0.5 * (settings.cylinder.stroke_min_mm + settings.cylinder.stroke_max_mm)
    law.aim(start_n)
    law.start_ramp(start_n, 0.0)
    kalman.reset(start_n, 0.0)
    kalman.settle()
    to_tension, keep, by_tension, by_speed = model.f.item(0, 1), model.f.item(1, 1), model.b.item(0), model.b.item(1)
    sent = [0.0] * model.delay_ticks
    kept, rising = _low_pass(settings)
    tension_n = speed_mm_s = shown_n = before_n = 0.0
    reading_n, read_mm_s = noise_n, 0.0
    found = []
    for tick in range(round(IMPULSE_S * settings.loop.rate_hz)):
        kalman.update(start_n + reading_n, read_mm_s)
        kalman.predict()
        added_mm_s = 0.0 if tick else probe_mm_s
        ahead_n, ahead_mm_s, disturbance_mm_s, lead_mm_s = kalman.ahead()
        estimate = Estimate(ahead_n, ahead_mm_s, disturbance_mm_s, stroke_mm, lead_mm_s)
        command_mm_s = law.compensating(estimate, 1.0, added_mm_s)
        kalman.command(command_mm_s - added_mm_s)
        found.append((reading_n, read_mm_s, command_mm_s, tension_n))
        sent.append(command_mm_s)
        acting = sent.pop(0)
        shown_n = tension_n - (tension_n - before_n) * rising - (before_n - shown_n) * kept
        before_n = tension_n
        reading_n, read_mm_s = shown_n, speed_mm_s  # latched at this tick's SYNC, read in the next
        tension_n += to_tension * speed_mm_s + by_tension * acting
        speed_mm_s = keep * speed_mm_s + by_speed * acting
    return np.array(found)


def _low_pass(settings: RigSettings) -> tuple[float, float]:
    """Of the cell's low-pass: what a period leaves of its lag, and its lag behind a rise over the period as a share."""
    late_s = settings.tension_cell.late_s
    if not late_s:
        return 0.0, 0.0
    periods = 1.0 / (settings.loop.rate_hz * late_s)
    kept = math.exp(-periods)
    return kept, (1.0 - kept) / periods
