"""Whether cell, encoder and drive answer the probe: one judgement each half period of the multisine.

In windows of one period, which overlap by half and are weighted by Hann's window, the amplitudes of tension, stroke and
modelled stroke at the multisine's frequencies are summed up, a few multiplications a tick. Each window then shows

    answer = Re sum(T W*) / Re sum(E W*)     E, W: the amplitudes expected of the tension, and their weights
                                             (`rigctl.control.excitation.probe_plan`)
    follows = Re sum(S M*) / sum |M|^2       S, M: stroke as the drive reports it, and as a model has it by the commands

The tension is judged against the probe alone, because the law's own motion answers the tension; the stroke against the
whole command. sum(T W*) over sum(S W*) is the stiffness, see `rigctl.control.watch.rope_change`. How many windows a
judgement takes follows from the spread of the answers, as it has been found or as the cell's noise and the readings'
own size allow, whichever is less: a disturbance delays a judgement and falsifies none.
"""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.probe_plan import MOST_WINDOWS, ProbePlan
from rigctl.control.watch.plausibility import DriveModel
from rigctl.control.watch.rope_change import RopeChange

SPREAD_SHARE = 1.0 / 16.0  # of a new difference in the spread found so far
SPREAD_ROOM = 1.25  # two standard deviations of the spread found: within it the spread is the plan's
QUIET_SIZE = 1.3  # of the readings, in the cell's own noise: nothing but that is in them, as of a frozen cell
LARGEST_CHANGE = 9.0  # a difference counts as this many times the variance found so far at most
LEAST_QUANTA = 3.0  # of the encoder, which the modelled stroke moves by in a window that judges the encoder
MOST_BLOCK = 40  # ticks whose samples are summed up in one of them
FOLLOWS = 0.5  # a stroke that answers with less does not follow


def _block(half: int) -> int:
    """Ticks that are summed up at once: a divisor of half a period."""
    return max(size for size in range(1, MOST_BLOCK + 1) if half % size == 0)


class ProbeFinding(IntEnum):
    """What the probe has found; all but NONE and WHOLE are faults."""

    NONE = 0  # no judgement yet
    WHOLE = 1
    CELL_FROZEN = 2
    ENCODER_STUCK = 3
    DRIVE_MOTIONLESS = 4
    ROPE_CHANGED = 5


class SensorProbe:
    """Sums and judgements. Call `see` in each tick in which the whole multisine is on, else `lose`."""

    def __init__(self, settings: RigSettings, plan: ProbePlan, quantum_mm: float) -> None:
        """``quantum_mm``: of the drive's position."""
        ticks, lines = plan.shape.ticks, np.array(plan.lines)
        turns = np.outer(np.arange(ticks), 2.0 * np.pi * lines / ticks)
        waves = np.concatenate([np.cos(turns), -np.sin(turns)], axis=1)
        hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(ticks) / ticks)
        self._half = half = ticks // 2
        rows = [(window * 4.0 / ticks)[:, None] * waves for window in (hann, np.roll(hann, -half))]
        self._block = block = _block(half)
        self._rows = np.concatenate(rows, axis=1).reshape(ticks // block, 1, block, -1)
        self._last, self._size = ticks - 1, waves.shape[1]
        self._plan = plan
        self._weights = [*np.real(plan.weights).tolist(), *np.imag(plan.weights).tolist()]
        self._whole = sum((e * w.conjugate()).real for e, w in zip(plan.answers, plan.weights, strict=True))
        self._turned = [*np.imag(plan.weights).tolist(), *(-np.real(plan.weights)).tolist()]
        self.rope = RopeChange(plan)
        self._samples = np.zeros((3, block, 1))
        self._sums = np.zeros((3, 2 * self._size))
        self._least_mm = LEAST_QUANTA * quantum_mm
        self._drive = DriveModel(settings)
        self._answers: deque[float] = deque(maxlen=MOST_WINDOWS)
        self._sizes: deque[float] = deque(maxlen=MOST_WINDOWS)
        self.lose()

    def lose(self) -> None:
        """The multisine is off: whatever was seen of it ends. Only the stiffness found so far is kept."""
        if self.rope.changed:
            self.rope.forget()
        self.sees = False
        self.found = ProbeFinding.NONE
        self.share = math.nan
        self._seen_whole = [False, False]  # the window under way has been seen from its begin
        self._variance = self._plan.spread**2
        self._deaf = 0
        self._answers.clear()
        self._sizes.clear()
        self._drive.follow(0.0)
        self._model_mm = 0.0
        self._low_mm, self._high_mm = [math.inf, math.inf], [-math.inf, -math.inf]

    def skip(self) -> None:
        """Ticks were skipped: the windows under way are not judged."""
        self._seen_whole = [False, False]

    def see(self, place: int, tension_n: float, stroke_mm: float, command_mm_s: float) -> bool:
        """One tick; whether a window has ended in it.

        Args:
            place: in the multisine's table, of the speed of this tick.
            tension_n: newest of the cell; its level does not matter.
            stroke_mm: newest of the drive, likewise.
            command_mm_s: sent in the tick before.
        """
        self.sees = True
        self._model_mm = model_mm = self._model_mm + self._drive.advance(command_mm_s, 1)
        inside, samples = place % self._block, self._samples
        samples[0, inside, 0], samples[1, inside, 0], samples[2, inside, 0] = tension_n, stroke_mm, model_mm
        if inside < self._block - 1:
            return False
        # Summed along an axis in the middle, so tick by tick and the same on every computer.
        self._sums += (samples * self._rows[place // self._block]).sum(axis=1)
        low_mm, high_mm = samples[2].min(), samples[2].max()
        for window in (0, 1):
            self._low_mm[window] = min(self._low_mm[window], low_mm)
            self._high_mm[window] = max(self._high_mm[window], high_mm)
        if place == self._last:
            return self._end(0)
        return self._end(1) if place == self._half - 1 else False

    def _end(self, window: int) -> bool:
        """End a window, judge it if it is whole, and begin its next one."""
        part = slice(window * self._size, (window + 1) * self._size)
        whole, self._seen_whole[window] = self._seen_whole[window], True
        moved_mm = self._high_mm[window] - self._low_mm[window]
        self._low_mm[window], self._high_mm[window] = math.inf, -math.inf
        if whole:
            tension, stroke, model = self._sums[:, part].tolist()
            self._look(tension, stroke, model, moved_mm)
        self._sums[:, part] = 0.0
        return whole

    def _look(self, tension: list[float], stroke: list[float], model: list[float], moved_mm: float) -> None:
        answers, plan = self._answers, self._plan
        answered = self._weighted(tension)
        answers.append(answered.real / self._whole)
        self._sizes.append(sum(x * x for x in tension) / (len(tension) * plan.noise_n**2))
        if len(answers) > 2:  # these two windows do not overlap
            apart = 0.5 * (answers[-1] - answers[-3]) ** 2
            self._variance += (min(apart, LARGEST_CHANGE * self._variance) - self._variance) * SPREAD_SHARE
        if moved_mm >= self._least_mm:
            power = sum(x * x for x in model)
            follows = sum(x * y for x, y in zip(stroke, model, strict=True)) < FOLLOWS * power
            self._deaf = self._deaf + 1 if follows else 0
            self.rope.add(answered, self._weighted(stroke))
        self.found = self._judge()

    def _weighted(self, amplitudes: list[float]) -> complex:
        """Sum of complex amplitudes, given by their parts, over the conjugate weights."""
        along = sum(x * y for x, y in zip(amplitudes, self._weights, strict=True))
        return complex(along, -sum(x * y for x, y in zip(amplitudes, self._turned, strict=True)))

    def _judge(self) -> ProbeFinding:
        plan, answers = self._plan, self._answers
        count = plan.windows(plan.spread)
        if len(answers) < count:
            return ProbeFinding.NONE
        size = sum(list(self._sizes)[-count:]) / count
        bound = plan.silent**2 * max(1.0, size)  # no reading disturbs more than by all of its size
        found = math.sqrt(min(self._variance, bound))
        spread = plan.spread if size <= QUIET_SIZE or found <= SPREAD_ROOM * plan.spread else found
        count = plan.windows(spread)
        if len(answers) < count or count > MOST_WINDOWS:
            return ProbeFinding.NONE
        self.share = sum(list(answers)[-count:]) / count
        missing = self.share < plan.threshold(spread, count)
        if self._deaf:
            if self._deaf < count:
                return ProbeFinding.NONE
            return ProbeFinding.DRIVE_MOTIONLESS if missing else ProbeFinding.ENCODER_STUCK
        if missing:
            return ProbeFinding.CELL_FROZEN
        return ProbeFinding.ROPE_CHANGED if self.rope.changed else ProbeFinding.WHOLE
