"""Any linear law on one linear plant, by what it does to the closed loop: linear in the law, so that a bound is convex.

A law reads the cell's sample y of the tick before and sends the command u. On a plant without other sensors' news (the
drive's speed follows from the commands) every law that stabilises it is one sequence x, and each is such a law (Youla,
Jabr, Bongiorno 1976; Boyd, Barratt: Linear Controller Design, 1991):

    x(j): the command, mm/s per N, j + 1 ticks after a disturbance has stepped the cell's tension by 1 N with u = 0

With p the change of the true tension after a command of one tick that is taken back (the plant's integrator makes a
stroke of it), the true tension is ``d + p * x * d_sensed`` for a disturbance that moves it by d with u = 0, the
cell's noise n moves it by ``p * x * n`` and the command by ``x - x(-1)`` per N, and S is ``1 + p x`` at the cell. A law
that does not use the drive's speed has the same S at the plant's input, and one that does has an equal without it, so
that one S is limited. The loop is stable if x ends and the stroke answers the whole step:
``sum(p) sum(x) = -1``. Where x ends after N ticks the law has that much memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.signal import fftconvolve

from rigctl.design.closed_loop import Controller, closed_loop
from rigctl.design.plant_family import Array, ComplexArray, Member

ENDED = 1e-7  # of its largest value: what an answer may still be where it is cut
FINE, SPREAD, WIDEST = 60, 0.06, 25.0
"""Knots of a long memory, in ticks, see `basis`."""
LONGEST = 60_000  # ticks: a mechanism of 2 % damping and 6 N/mm vibrates for 20 s


class NoBoundError(ValueError):
    """The plant has no such bound; ``str()`` is one line."""


@dataclass(frozen=True)
class StrokeAnswer:
    """Tension after a command of one tick that is taken back in the next, N per mm/s, with the tick of the sample."""

    sensed: Array
    true: Array

    @classmethod
    def of(cls, plant: Member) -> StrokeAnswer:
        """The answer until it has ended.

        Raises:
            NoBoundError: it does not end, as that of a plant that is unstable but for one integrator.
        """
        state, rows = plant.b_command.copy(), []
        largest = 0.0
        for tick in range(LONGEST):
            now = state[0], plant.tension @ state
            rows.append(now)
            if tick:
                change = max(abs(now[0] - rows[-2][0]), abs(now[1] - rows[-2][1]))
                largest = max(largest, change)
                if change <= ENDED * largest and tick > plant.delay_ticks + 50:
                    break
            state = plant.a @ state
        else:
            raise NoBoundError("the plant's tension does not come to rest after a command: no bound")
        late = 3 + plant.delay_ticks  # the sample's tick, the held command's, and those of the delay
        steps = np.diff(np.vstack([np.zeros((late, 2)), rows]), axis=0)
        return cls(steps[:, 0], steps[:, 1])

    @property
    def gain(self) -> float:
        """Its sum: N of tension per mm/s and tick."""
        return float(self.sensed.sum())


@dataclass(frozen=True)
class Inclination:
    """What the inclinometer tells of a disturbance: its stretch of the rope in each tick, held between samples."""

    stretch_mm: Array
    noise_mm: float
    """Rms of a sample's error, over the ticks that count."""
    held: int
    """Ticks from sample to sample."""


@dataclass(frozen=True)
class Disturbance:
    """Tension with u = 0, N: what the cell reads of it and the true one, and the first tick that counts."""

    sensed: Array
    true: Array
    first: int = 0
    seen: Inclination | None = None
    """None: the law does not use the inclination."""

    @classmethod
    def of(cls, plant: Member, speed_mm_s: Array, first: int = 0, seen: Inclination | None = None) -> Disturbance:
        """Of the speed of the rope's upper end in each tick."""
        state, sensed, true = np.zeros(len(plant.a)), np.zeros(len(speed_mm_s)), np.zeros(len(speed_mm_s))
        for tick, speed in enumerate(speed_mm_s.tolist()):
            sensed[tick] = state[0] + plant.sensed_n_s_mm * speed
            true[tick] = plant.tension @ state + plant.loss_n_s_mm * speed
            state = plant.a @ state + plant.b_disturbance * speed
        return cls(sensed, true, first, seen)

    def errors(self, answer: StrokeAnswer, laws: Array) -> tuple[Array, Array]:
        """``A, d`` of the error ``A c + d``, N, of the law ``laws c`` in each tick that counts."""
        return self._by(answer, self.sensed, laws), self.true[self.first :]

    def forward(self, answer: StrokeAnswer, laws: Array) -> tuple[Array, Array]:
        """The same A of a second law that is fed the inclination's stretch, and rows of its noise; N per mm."""
        assert self.seen is not None
        hold = np.full(self.seen.held, self.seen.noise_mm / math.sqrt(self.seen.held))
        noise = fftconvolve(np.convolve(answer.true, hold)[:, None], laws, axes=0)
        return self._by(answer, self.seen.stretch_mm, laws), noise

    def _by(self, answer: StrokeAnswer, signal: Array, laws: Array) -> Array:
        count = len(self.true)
        by_one = fftconvolve(answer.true, signal)[:count, None]
        found: Array = fftconvolve(by_one, laws, axes=0)[self.first : count]
        return found


@dataclass(frozen=True)
class Tone:
    """A sine of the upper end of the rope that has always been there: complex tension with u = 0, N, and its z."""

    z: complex
    sensed: complex
    true: complex

    @classmethod
    def of(cls, plant: Member, amplitude_mm: float, frequency_hz: float, period_s: float) -> Tone:
        """Of an amplitude in mm."""
        z = np.exp(2j * np.pi * frequency_hz * period_s)
        speed = amplitude_mm * (z - 1.0) / period_s
        state = np.linalg.solve(z * np.eye(len(plant.a)) - plant.a, plant.b_disturbance.astype(np.complex128))
        sensed = state[0] + plant.sensed_n_s_mm
        return cls(complex(z), complex(speed * sensed), complex(speed * (plant.tension @ state + plant.loss_n_s_mm)))

    def errors(self, answer: StrokeAnswer, laws: Array) -> tuple[Array, Array]:
        """As `Disturbance.errors`: two rows of which the root mean square is that of the sine."""
        row = self.sensed * at(answer.true, self.z) * at(laws, self.z)
        return np.array([row.real, row.imag]), np.array([self.true.real, self.true.imag])


def basis(memory: int, fine: int = FINE) -> Array:
    """Laws of which any law is a sum: hats over knots, shape (memory, knots).

    Each tick is a knot at first, from ``fine`` on they are apart by ``SPREAD`` of their time and `WIDEST` at most, and
    the law is straight between them; with ``memory`` ticks or more of ``fine`` any sequence x is one.
    """
    knots = [float(tick) for tick in range(min(fine, memory))]
    while knots[-1] < memory - 1:
        knots.append(min(knots[-1] + min(max(1.0, SPREAD * knots[-1]), WIDEST), memory - 1.0))
    hats = np.eye(len(knots))
    found: Array = np.stack([np.interp(np.arange(memory), knots, hat) for hat in hats], axis=1)
    return found


def triangular(rows: Array) -> Array:
    """A square matrix R with ``|R c| = |rows c|`` for every c."""
    factor: Array = qr(rows, mode="r")[0][: rows.shape[1]]
    return factor


def law_of(plant: Member, law: Controller, ticks: int) -> Array:
    """The sequence x of a controller on the plant, cut after so many ticks."""
    loop = closed_loop(plant, law)
    state, command, found = loop.b[:, 0].copy(), 0.0, np.zeros(ticks)
    for tick in range(ticks):
        command += float(loop.command @ state)
        found[tick] = command
        state = loop.a @ state
    return found


def at(answer: Array, z: complex | ComplexArray) -> ComplexArray:
    """The transform of a sequence, or of the columns of several, at a z; shape of the columns, then of z."""
    return np.asarray(np.polynomial.polynomial.polyval(1.0 / np.asarray(z), answer), np.complex128)
