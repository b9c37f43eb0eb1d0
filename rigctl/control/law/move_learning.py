"""Iterative learning from move to move: a speed over a move's phase, added to the law's command.

An operator, or the program that moves the mechanism, marks the start of a move with its number. From the mark on the
table of that number is played, and the tension error e is averaged about each of its points. After the move the next
table f is worked out, a few points a tick:

    f <- Q [f - rate e^(sT) ((tau s^2 + (1 + K_v) s) / k + K_T + K_i / s) e]

The bracket is the inverse of what f does to e in the loop of the rig file: the filter is told every command, so f
leaves its disturbance alone, and e = k s e^(-sT) / (tau s^3 + (1 + K_v) s^2 + k K_T s + k K_i) f. T is the transport
delay and the tick between a sample's latch and its use. Q is a Butterworth low-pass of second order, forwards and then
backwards, without phase: |Q| = 1 / (1 + (f/cutoff)^4). `rigctl.design.learning_margin` shows that the error shrinks
from move to move with every plant of the family (Bristow, Tharayil, Alleyne, "A survey of iterative learning control",
IEEE Control Systems 26(3), 2006, theorem 6); a rig whose settings do not converge is refused.

The tables are in memory only: a start of the daemon, a fault, DISARMED, another target and other gains end them.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

from rigctl.config.settings import LearningSettings, RigSettings
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.model.states import Mode

STEP_S = 0.01
"""Between two points of a table."""
TAPER_S = 0.3
"""A table rises from 0 at its start and falls to 0 at its end within this time."""
FADE_S = 0.1
"""Time constant with which what is left of a table that ends early fades out."""
FADED_MM_S = 1e-6
SHORTEST_S = 2.0
"""A shorter move teaches nothing."""
LOOKS = 10
"""Points between two looks at whether the move is the one that was learnt."""
DIVERGES = 1.2
"""A move with a table may have this many times the rms error of the one without; else the table is dropped."""
MOST_N = 10.0
"""A table's stroke changes the tension by no more than this, even if nothing answered it."""
POINTS_PER_TICK = 4
"""Points worked out per tick after a move, which takes 3 us."""


_PASSES = 3
_KEEP_STROKE = (Mode.HOLD, Mode.FAULT, Mode.DISARMED)


class LearningFilter(NamedTuple):
    """Coefficients of the learning law on points ``step_s`` apart; see the module for their meaning."""

    step_s: float
    lead_ticks: int
    on_error: float  # mm/s per N
    on_integral: float  # mm/s per N s
    on_slope: float  # mm/s per N/s
    on_bend: float  # mm/s per N/s^2
    b0: float  # of Q's low-pass, b1 = 2 b0, b2 = b0
    a1: float
    a2: float


def learning_filter(settings: RigSettings, gains: Gains) -> LearningFilter:
    """The learning law of a rig file with a section `learning`, for these gains."""
    section, plant, loop = settings.learning, settings.plant, settings.loop
    assert section is not None
    step_s = step_ticks(settings) / loop.rate_hz
    k, rate = plant.stiffness_n_mm, section.rate
    warped = math.tan(math.pi * section.cutoff_hz * step_s)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * warped + warped * warped)
    return LearningFilter(
        step_s=step_s,
        lead_ticks=round(plant.command_delay_s * loop.rate_hz) + 1,
        on_error=rate * gains.k_tension,
        on_integral=rate * gains.k_integral,
        on_slope=rate * (1.0 + gains.k_speed) / k,
        on_bend=rate * plant.cylinder_lag_s / k,
        b0=warped * warped * scale,
        a1=2.0 * (warped * warped - 1.0) * scale,
        a2=(1.0 - math.sqrt(2.0) * warped + warped * warped) * scale,
    )


def step_ticks(settings: RigSettings) -> int:
    """Ticks between two points of a table."""
    return max(1, round(STEP_S * settings.loop.rate_hz))


class News(NamedTuple):
    """A line for the record; ``ended`` says why nothing was learnt, empty after a lesson."""

    number: int
    taught: int
    rms_n: float
    first_n: float
    ended: str = ""


class _Table:
    """What is known of one move: the speeds, and what the move looks like."""

    def __init__(self, points: int) -> None:
        looks = points // LOOKS + 1
        self.speeds = array("d", bytes(8 * (points + 1)))
        self.length = 0  # points in use
        self.taught = 0  # lessons behind it
        self.first_n = math.nan  # rms error of the first move, without a table
        self.looks = 0  # of the three below, the stroke relative to the start of the move
        self.stroke_mm, self.tangential_rad, self.normal_rad = (array("d", bytes(8 * looks)) for _ in range(3))
        self.gains: Gains | None = None
        self.target_n = math.nan

    def speed(self, i: int) -> float:
        return self.speeds[i] if i < self.length else 0.0


class Lesson:
    """Works the next table out from the errors of a move, some points at each call of `go_on`.

    Three passes: the learning law with Q forwards, Q backwards, bounds and tapers forwards.
    """

    def __init__(self, section: LearningSettings, stiffness_n_mm: float, points: int) -> None:
        self._speed_max = section.speed_max_mm_s
        self._stroke_max = min(section.stroke_max_mm, MOST_N / stiffness_n_mm)
        self.errors = array("d", bytes(8 * (points + 3)))
        """Mean error about each point, in N."""
        self._work = array("d", bytes(8 * (points + 3)))
        self.left = False
        self.rms_n = 0.0

    def begin(self, table: _Table, points: int, coefficients: LearningFilter) -> None:
        """Start from ``points`` errors."""
        self.left = True
        self._table, self._points, self._by = table, points, coefficients
        self._taper = round(TAPER_S / coefficients.step_s)
        self._pass = self._i = 0
        self._sum = self._squares = self._stroke_mm = 0.0
        self._past = 0.0, 0.0, 0.0, 0.0  # the low-pass' last two inputs and outputs

    def go_on(self, points: int = POINTS_PER_TICK) -> None:
        """Work out some points; ``left`` is false after the last."""
        begin = self._i
        end = self._i = min(begin + points, self._points)
        (self._forwards, self._backwards, self._bounded)[self._pass](begin, end)
        if end == self._points:
            self._pass, self._i = self._pass + 1, 0
            self._past = 0.0, 0.0, 0.0, 0.0
            self.left = self._pass < _PASSES

    def _forwards(self, begin: int, end: int) -> None:
        """The learning law, and Q's low-pass over its result."""
        by, table, errors, work = self._by, self._table, self.errors, self._work
        step_s, last, speeds, length = by.step_s, self._points - 1, table.speeds, table.length
        b0, a1, a2 = by.b0, by.a1, by.a2
        x1, x2, y1, y2 = self._past
        for i in range(begin, end):
            here = errors[i]
            before, after = errors[i - 1] if i else here, errors[i + 1] if i < last else here
            self._sum += 0.5 * (before + here) * step_s
            self._squares += here * here
            x = (speeds[i] if i < length else 0.0) - by.on_error * here - by.on_integral * self._sum
            x -= by.on_slope * (after - before) / (2.0 * step_s)
            x -= by.on_bend * (after - 2.0 * here + before) / (step_s * step_s)
            y = b0 * (x + 2.0 * x1 + x2) - a1 * y1 - a2 * y2
            work[i] = y
            x2, x1, y2, y1 = x1, x, y1, y
        self._past = x1, x2, y1, y2

    def _backwards(self, begin: int, end: int) -> None:
        """Q's low-pass again, from the end to the start, which takes its phase away."""
        work, last, (b0, a1, a2) = self._work, self._points - 1, self._by[-3:]
        x1, x2, y1, y2 = self._past
        for i in range(last - begin, last - end, -1):
            x = work[i]
            y = b0 * (x + 2.0 * x1 + x2) - a1 * y1 - a2 * y2
            work[i] = y
            x2, x1, y2, y1 = x1, x, y1, y
        self._past = x1, x2, y1, y2

    def _bounded(self, begin: int, end: int) -> None:
        """Bound speed and stroke of the table, taper its ends, and put it in force with its last point."""
        table, work, most, stroke, step_s = (
            self._table, self._work, self._speed_max, self._stroke_max, self._by.step_s,
        )  # fmt: skip
        for i in range(begin, end):
            share = min(1.0, i / self._taper, (self._points - 1 - i) / self._taper)
            speed = share * max(-most, min(most, work[i]))
            fastest, slowest = (stroke - self._stroke_mm) / step_s, (-stroke - self._stroke_mm) / step_s
            speed = max(slowest, min(fastest, speed))
            self._stroke_mm += speed * step_s
            work[i] = speed
        if end == self._points:
            table.speeds, self._work = work, table.speeds
            table.length, table.taught = self._points, table.taught + 1
            self.rms_n = math.sqrt(self._squares / self._points)


class MoveLearning:
    """The tables, the move under way, and the lesson after it.

    Each tick: `step`, whose result is the speed to add to the command of the closed law. ``number`` is that of the
    move under way, 0 for none; ``news`` what the record has yet to say.
    """

    def __init__(self, settings: RigSettings, law: TensionLaw) -> None:
        section = settings.learning
        assert section is not None
        self._settings, self._section, self._law = settings, section, law
        self._step_ticks = step_ticks(settings)
        self._dt = 1.0 / settings.loop.rate_hz
        self._points = points = math.ceil(section.move_s / (self._step_ticks * self._dt))
        self._tables = [_Table(points) for _ in range(section.moves)]
        self._lesson = Lesson(section, settings.plant.stiffness_n_mm, points)
        self._errors = array("d", bytes(8 * (points + 3)))
        self._kept = math.exp(-self._dt / FADE_S)
        self._shortest = round(SHORTEST_S / (self._step_ticks * self._dt))
        self._by = learning_filter(settings, law.gains)
        self.number = 0
        self.news: list[News] = []
        self.learned_mm_s = 0.0
        self._rest_mm_s = 0.0  # of a table that ended early, fading
        self._phase = 0  # ticks since the mark
        self._point = -1  # about which errors are summed now
        self._sum, self._samples = 0.0, 0
        self._stroke_mm = 0.0  # at the mark
        self._any = False  # a table or a lesson exists

    @property
    def taught(self) -> int:
        """Lessons behind the table of the move under way."""
        return self._tables[self.number - 1].taught if self.number else 0

    def begin(self, number: int, stroke_mm: float, tangential_rad: float, normal_rad: float) -> None:
        """A move starts now, and one under way has ended; 0 only ends it."""
        self._finish()
        if not number:
            return
        table, law = self._tables[number - 1], self._law
        if self._lesson.left and self._lesson_of == number:
            self._lesson.left = False
            self.news.append(News(number, table.taught, 0.0, 0.0, "marked again before it was worked out"))
        if table.taught and (table.gains != law.gains or table.target_n != law.target_n):
            table.taught = 0
            self.news.append(News(number, 0, 0.0, 0.0, "target or gains have changed"))
        self._stroke_mm = stroke_mm
        if table.taught and (away := self._away(table, 0, 0.0, tangential_rad, normal_rad)):
            table.taught = 0
            self.news.append(News(number, 0, 0.0, 0.0, f"another start: {away}"))
        if not table.taught:
            table.length = table.looks = 0
        if table.gains != law.gains:
            self._by = learning_filter(self._settings, law.gains)
        table.gains, table.target_n = law.gains, law.target_n
        self.number, self._phase, self._point = number, 0, -1
        self._sum, self._samples = 0.0, 0
        self._any = True

    def step(
        self, mode: Mode, ticks: int, tension_n: float, stroke_mm: float, tangential_rad: float, normal_rad: float
    ) -> float:
        """Advance ``ticks`` periods, after the filters; returns the speed to add to the command, mm/s.

        ``tension_n``: newest good sample. Only in COMPENSATING a move goes on and a table is played.
        """
        if not self._any:
            return 0.0
        if self._rest_mm_s:
            self._rest_mm_s *= self._kept
            if abs(self._rest_mm_s) < FADED_MM_S:
                self._rest_mm_s = 0.0
        if mode is not Mode.COMPENSATING:
            self._leave(mode)
        elif self.number:
            self._play(ticks, tension_n, stroke_mm, tangential_rad, normal_rad)
        if self._lesson.left:
            self._lesson.go_on()
            if not self._lesson.left:
                self._judge()
        self.learned_mm_s = learned_mm_s = self._rest_mm_s + (self._played() if self.number else 0.0)
        return learned_mm_s

    def _played(self) -> float:
        table = self._tables[self.number - 1]
        if not table.taught:
            return 0.0
        i, ticks = divmod(self._phase, self._step_ticks)
        here = table.speed(i)
        return here + (table.speed(i + 1) - here) * ticks / self._step_ticks

    def _play(self, ticks: int, tension_n: float, stroke_mm: float, tangential_rad: float, normal_rad: float) -> None:
        law, step = self._law, self._step_ticks
        self._phase += ticks
        table = self._tables[self.number - 1]
        gains_differ = law.gains is not table.gains and law.gains != table.gains  # equal gains may be given again
        if gains_differ or law.target_n != table.target_n:
            self._end("target or gains have changed", forget=True)
            return
        point = (self._phase - self._by.lead_ticks + step // 2) // step
        if point != self._point:
            self._close_point(point)
            if point >= self._points:
                self._finish()
                return
            if not point % LOOKS and point >= 0:
                seen = stroke_mm - self._stroke_mm, tangential_rad, normal_rad
                if not self._same(table, point // LOOKS, *seen):
                    return
        if point >= 0:
            self._sum += tension_n - law.rope_setpoint_n
            self._samples += 1

    def _close_point(self, point: int) -> None:
        """Store the mean error about the point that has passed, also for points that an overrun has skipped."""
        if self._samples:
            mean = self._sum / self._samples
            for i in range(max(0, self._point), min(point, self._points)):
                self._errors[i] = mean
        self._point, self._sum, self._samples = point, 0.0, 0

    def _same(self, table: _Table, look: int, stroke_mm: float, tangential_rad: float, normal_rad: float) -> bool:
        """Compare with the move before, and keep what is seen for the next one."""
        if table.taught and look < table.looks:
            away = self._away(table, look, stroke_mm, tangential_rad, normal_rad)
            if away:
                self._end(f"another move from {self._phase * self._dt:.1f} s on: {away}", forget=True)
                return False
        table.stroke_mm[look], table.tangential_rad[look], table.normal_rad[look] = (
            stroke_mm,
            tangential_rad,
            normal_rad,
        )
        table.looks = max(table.looks, look + 1)
        return True

    def _away(self, table: _Table, look: int, stroke_mm: float, tangential_rad: float, normal_rad: float) -> str:
        """How far this is from the move before, in words; "" if it is the same."""
        away_mm = abs(stroke_mm - table.stroke_mm[look])
        away_rad = max(abs(tangential_rad - table.tangential_rad[look]), abs(normal_rad - table.normal_rad[look]))
        away_deg = math.degrees(away_rad)
        same = away_mm <= self._section.same_mm and away_deg <= self._section.same_deg
        return "" if same else f"{away_mm:.2f} mm, {away_deg:.2f} deg"

    def _end(self, why: str, *, forget: bool = False) -> None:
        """End the move under way without a lesson; what is played fades out."""
        number, table = self.number, self._tables[self.number - 1]
        self._rest_mm_s += self._played()
        self.number = 0
        if forget:
            table.taught = 0
        self.news.append(News(number, table.taught, 0.0, 0.0, why))

    def _finish(self) -> None:
        """The move under way has ended: learn from it."""
        number = self.number
        if not number:
            return
        if self._lesson.left:
            self._end("the lesson before is not worked out yet")
        elif self._point < self._shortest:
            self._end(f"shorter than {SHORTEST_S:g} s")
        else:
            self._rest_mm_s += self._played()
            self.number, self._lesson_of = 0, number
            self._errors, self._lesson.errors = self._lesson.errors, self._errors
            self._lesson.begin(self._tables[number - 1], min(self._point, self._points), self._by)

    def _judge(self) -> None:
        """A lesson is complete: drop a table under which the error has grown."""
        number = self._lesson_of
        table, rms_n = self._tables[number - 1], self._lesson.rms_n
        if table.taught == 1:
            table.first_n = rms_n
        grown = rms_n > DIVERGES * table.first_n
        if grown:
            table.taught = 0
        self.news.append(News(number, table.taught, rms_n, table.first_n, "the error has grown" if grown else ""))

    def _leave(self, mode: Mode) -> None:
        """COMPENSATING has ended."""
        if self.number:
            self._end(f"{mode.name} came in between")
        if mode in _KEEP_STROKE:
            self._rest_mm_s = 0.0
        if mode is Mode.FAULT or mode is Mode.DISARMED:
            for table in self._tables:
                table.taught = 0
            self._lesson.left = self._any = False
