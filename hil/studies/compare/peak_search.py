"""Where |S| is the largest: which lines to measure, pass after pass, and the interval of what is found.

The first pass has lines from `LOW_HZ` up, each `RATIO` times the one before, and more of them in the spans where the
linear plant has a maximum (`hil.studies.compare.peak_hints`). Each further one has lines about the maxima that may be
the largest, as far apart as these are wide, until the largest is known to `GOOD` or no time is left. Between the lines
|S| is that of `hil.studies.compare.local_peak`, whose interval has the scatter and what the lines may miss. A maximum
narrower than the lines of the first pass, of which the linear plant says nothing, is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hil.studies.compare.local_peak import LocalPeak, SensitivityLine, local_peaks

PLACES = "input", "output"
BUDGET_S = 120.0
"""Of simulated time for a level of the filter."""
LOW_HZ, RATIO = 0.3, 1.07
STEP_OF_WIDTH, SPAN_LINES = 0.35, 24
"""In a span: the lines' distance over the width of its maximum; at most so many lines of a place."""
CLOSER_LINES, MOST_RIVALS = 12, 4
"""Of a closer pass: lines about each maximum, and maxima at each place."""
GOOD = 0.005
FURTHEST = 0.3
"""Of a closer pass: its lines are within so much of the maximum, as a share of its frequency."""


class SearchPass(NamedTuple):
    """What acts in a pass: harmonics of a period at the plant's input and others at the tension."""

    period_s: float
    periods: int
    settle_s: float
    """Before the first of the periods that are evaluated."""
    harmonics: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.settle_s + self.periods * self.period_s


FIRST = SearchPass(10.0, 2, 5.0)
CLOSER = SearchPass(2.0, 8, 2.0), SearchPass(5.0, 4, 2.5), SearchPass(10.0, 3, 5.0), SearchPass(20.0, 2, 5.0)
"""Of these the first that has its lines near enough to each other."""
Measure = Callable[[SearchPass], list[SensitivityLine]]


class Span(NamedTuple):
    """Frequencies among which a maximum may be, and how wide it is: the relative change in which |S| falls by 30 %."""

    low_hz: float
    high_hz: float
    width: float


class HighestPeak(NamedTuple):
    """The largest |S|, half of its 95 % interval, where, and what it took."""

    ms: float
    error: float
    hz: float
    place: str
    seconds: float


def largest(measure: Measure, spans: Sequence[Span], top_hz: float) -> HighestPeak:
    """The largest |S| from `LOW_HZ` to ``top_hz`` at either place."""
    lines: list[SensitivityLine] = []
    seconds = 0.0
    wanted: SearchPass | None = _with_lines(FIRST, *(_first_lines(spans, top_hz, share) for share in (0.0, 0.5)))
    while wanted is not None:
        lines += measure(wanted)
        seconds += wanted.seconds
        peaks = [peak for place in PLACES for peak in local_peaks([line for line in lines if line.place == place])]
        best = max(peaks, key=lambda peak: peak.ms - peak.error)
        wanted = _closer(peaks, best, top_hz, BUDGET_S - seconds, first=wanted.period_s == FIRST.period_s)
    upper = max(peak.ms + peak.error for peak in peaks)
    return HighestPeak(best.ms, max(best.error, upper - best.ms), best.hz, best.place, seconds)


def _first_lines(spans: Sequence[Span], top_hz: float, shift: float) -> list[float]:
    """``shift``: of the lines, as a share of their distance."""
    steps = math.floor(math.log(top_hz / LOW_HZ) / math.log(RATIO) - shift)
    found = [LOW_HZ * RATIO ** (step + shift) for step in range(steps + 1)]
    for span in spans:
        high = min(span.high_hz, top_hz)
        step = max(STEP_OF_WIDTH * span.width, math.log(high / span.low_hz) / SPAN_LINES)
        if high > span.low_hz and step < math.log(RATIO):
            count = 1 + math.ceil(math.log(high / span.low_hz) / step)
            found += [float(hz) for hz in np.geomspace(span.low_hz, high, count)]
    return found


def _closer(
    peaks: Sequence[LocalPeak], best: LocalPeak, top_hz: float, left_s: float, *, first: bool
) -> SearchPass | None:
    """The pass about the maxima that may be the largest; None once it is known well enough, or no time is left."""
    least = best.ms - best.error
    rivals = []
    for place in PLACES:
        may_be = (peak for peak in peaks if peak.place == place and peak.ms + peak.error >= least)
        highest = sorted(may_be, key=lambda peak: peak.ms + peak.error, reverse=True)[:MOST_RIVALS]
        rivals += [peak for peak in highest if peak.error > GOOD or first]
    able = [each for each in CLOSER if each.seconds <= left_s]
    if not rivals or not able:
        return None
    step_hz = min(_reach(peak) * peak.hz * 2.0 / (CLOSER_LINES - 1) for peak in rivals)
    fine = [each for each in able if 2.0 / each.period_s <= step_hz]
    wanted = [
        [
            float(hz)
            for peak in rivals
            if peak.place == place
            for hz in np.linspace(
                peak.hz * (1.0 - _reach(peak)), min(peak.hz * (1.0 + _reach(peak)), top_hz), CLOSER_LINES
            )
        ]
        for place in PLACES
    ]
    return _with_lines(fine[0] if fine else able[-1], *wanted)


def _reach(peak: LocalPeak) -> float:
    return min(peak.reach, FURTHEST)


def _with_lines(bare: SearchPass, of_input: Sequence[float], of_output: Sequence[float]) -> SearchPass:
    """With the harmonics nearest to these frequencies; of those that both want, each place takes every other one."""
    first, second = (
        {max(1, round(hz * bare.period_s)) for hz in wanted if hz >= 0.5 * LOW_HZ} for wanted in (of_input, of_output)
    )
    both = sorted(first & second)
    mine = (first - second) | set(both[::2])
    return bare._replace(harmonics=(tuple(sorted(mine)), tuple(sorted((second - first) | set(both[1::2])))))
