"""What the records of a run say of drive, brake and load, in every tick, against the plant's truth.

A statement is false where the truth has denied it for longer than the age shown with it. What says less than the truth
(not known, not confirmed, not for so long) is not false.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.faults.lockstep_run import Floats, RecordedTruth
from hil.lockstep import WORK_NS
from rigctl.config.settings import RigSettings
from rigctl.control.load.brake_flag import FALLS_NS
from rigctl.model.states import REST_S, Flag, HeldBy, LoadAtRest, PowerOff

Bools = npt.NDArray[np.bool_]

SHOWN_TICKS = 2
"""Age of a statusword in ticks: latched at one SYNC, read in the next tick, and the grid of the truth."""
ROUNDING_S = 1e-6
RESTS_MM = 0.1
"""A load that is called at rest has moved less within `REST_S`, as stroke and, if the tension is known, as stretch."""
SWINGS = 2.0
"""Of that, as stretch, on a stroke at rest: a payload that bounces goes both ways."""
CLOSES_S = 3.0
"""A drive that is said to stop, to close its brake and to go off has done so by then."""
SLIPPED_MM = 0.03
"""Motion on the closed brake, true or reported, behind a flag that is set: the smallest limit is 0.04 mm."""
SUNK_MM = 0.2
"""Stretch lost on the closed brake, behind a flag that is set: a rope that gives way and a brake that does behind an
encoder that shows nothing are the same."""
UNFLAGGED_MM = 2.0
"""Motion on a closed brake after which the flag is set, once the tension has shown it for its time."""
_CONFIRMED = [int(shown) for shown in PowerOff if shown.confirmed]
_RESTS = [int(shown) for shown in LoadAtRest if shown.rests and shown is not LoadAtRest.STROKE]
_BY_MOTOR = [HeldBy.MOTOR, HeldBy.NOTHING]
_BLOCK = 10
"""Samples of the truth that make one of a window."""


class Statement(NamedTuple):
    """What records say: where they do, where the truth agrees, and for how long it may deny it."""

    words: str
    shown: Bools
    true: Bools
    late_s: float
    true_before: bool = True
    """The truth agreed until the run's begin."""
    process: bool = False
    """It says what is under way, so its age begins where it is first shown."""


def false_statements(run: RecordedTruth, settings: RigSettings, *, off_late_s: float, off_before: bool) -> list[str]:
    """Statements that are false, each with how often, and first when.

    Args:
        run: up to the death of its loop.
        settings: of its rig.
        off_late_s: age that the fault itself adds to the statusword shown.
        off_before: the motor had no current until the fault.
    """
    return [words for one in _statements(run, settings, off_late_s, off_before) for words in _false(one, run)]


def _statements(run: RecordedTruth, settings: RigSettings, off_late_s: float, off_before: bool) -> Iterator[Statement]:
    records, flags = run.records, run.records["flags"]
    latched_s = off_late_s + SHOWN_TICKS * settings.loop.period_ns * 1e-9
    silent_s = latched_s + settings.safety.stale_ms * 1e-3
    off, still = ~run.powered, _range(run.stroke_mm, run) <= RESTS_MM
    rests = still & (_range(run.tension_n / settings.plant.stiffness_n_mm, run) <= SWINGS * RESTS_MM)
    held_by, shown = records["held_by"], records["load_at_rest"]
    by_stroke = shown == LoadAtRest.STROKE  # the tension is not known then, and a payload may swing
    yield Statement(
        "power off shown", (flags & Flag.DRIVE_OFF != 0) | np.isin(records["power_off"], _CONFIRMED), off, latched_s,
        off_before,
    )  # fmt: skip
    yield Statement("motor holds or moves the load", np.isin(held_by, _BY_MOTOR), run.enabled, silent_s)
    fresh = records["drive_quality"] == 0
    yield Statement("drive enabled", (flags & Flag.DRIVE_ENABLED != 0) & fresh, run.enabled, silent_s)
    closing, closes_s = held_by == HeldBy.CLOSING, settings.cylinder.brake_delay_ms * 1e-3
    yield Statement("brake closing", closing, off | ~rests, CLOSES_S, process=True)
    yield Statement("brake still closing", closing, ~run.closed, closes_s + CLOSES_S, process=True)
    braked = held_by == HeldBy.BRAKE
    yield Statement("held by the brake", braked & ~by_stroke, off & run.closed & rests, REST_S)
    yield Statement("held by the brake", braked & by_stroke, off & run.closed & still, REST_S)
    yield Statement("load at rest", np.isin(shown, _RESTS), rests, REST_S)
    yield Statement("load at rest by the stroke", by_stroke, still, REST_S)
    fails = flags & Flag.BRAKE_FAILS != 0
    if settings.cylinder.brake_waiver is None and not fails[0]:
        moved_mm = (_slipped_mm(run, values, closes_s, from_off=True) for values in (run.stroke_mm, _reported_mm(run)))
        sunk = _sunk_n(run) > SUNK_MM * settings.plant.stiffness_n_mm
        slipped = (np.maximum(*moved_mm) > SLIPPED_MM) | sunk
        slipped_mm = _slipped_mm(run, run.stroke_mm, closes_s, from_off=False)
        yield Statement("brake does not hold", fails, slipped, 0.0, true_before=False)
        yield Statement("brake holds", ~fails & fresh, slipped_mm < UNFLAGGED_MM, FALLS_NS * 1e-9)


def _false(one: Statement, run: RecordedTruth) -> Iterator[str]:
    """The truth's sample of the same tick is the next after a record; what changes between the two is of that tick.

    A tick that comes after skipped ones shows what was received before them.
    """
    agrees_s = np.append(run.t_s[one.true], -math.inf)
    agrees_s.sort()
    first_s = 0.0 if one.true_before else run.t_s[0] - one.late_s
    same_tick_s = run.records_t_s + WORK_NS * 1e-9 + ROUNDING_S
    since_s = np.maximum(agrees_s[np.searchsorted(agrees_s, same_tick_s, side="right") - 1], first_s)
    if one.process:
        since_s = np.maximum(since_s, np.maximum.accumulate(np.where(one.shown, -math.inf, run.records_t_s)))
    on_time = np.diff(run.records["skipped"], prepend=run.before["skipped"]) == 0
    wrong = np.flatnonzero(one.shown & on_time & (run.records_t_s - since_s > one.late_s + ROUNDING_S))
    if len(wrong):
        yield f"{one.words} in {len(wrong)} ticks against the truth, first {run.records_t_s[wrong[0]]:.3f} s"


def _range(values: Floats, run: RecordedTruth) -> Floats:
    """Greatest less least value of the last `REST_S`; what was before the run counts as its first value."""
    step_s = float(np.median(np.diff(run.t_s)))
    width = max(round(REST_S / step_s / _BLOCK), 1)
    padded = np.concatenate([np.full(width * _BLOCK, values[0]), values, np.full(-len(values) % _BLOCK, values[-1])])
    blocks = padded.reshape(-1, _BLOCK)
    windows = np.lib.stride_tricks.sliding_window_view
    most = windows(blocks.max(axis=1), width + 1).max(axis=1)
    least = windows(blocks.min(axis=1), width + 1).min(axis=1)
    return np.repeat(most - least, _BLOCK)[: len(values)]


def _reported_mm(run: RecordedTruth) -> Floats:
    """The drive's position at the truth's samples: the flag goes by it where the tension says nothing against it."""
    at = np.searchsorted(run.records_t_s, run.t_s, side="right") - 1
    reported: Floats = run.records["stroke_mm"][np.maximum(at, 0)]
    return reported


def _sunk_n(run: RecordedTruth) -> Floats:
    """At each sample: the most that the tension has fallen so far while the brake alone had the load."""
    alone = run.closed & ~run.powered
    fallen_n = np.maximum.accumulate(np.where(alone, run.tension_n, -math.inf)) - run.tension_n
    found: Floats = np.maximum.accumulate(np.where(alone, fallen_n, 0.0))
    return found


def _slipped_mm(run: RecordedTruth, stroke_mm: Floats, closes_s: float, *, from_off: bool) -> Floats:
    """At each sample: the largest motion so far on a brake that has had ``closes_s`` to take the load.

    ``from_off``: since the motor's end, of which the flag may count all; else since the brake has had its time.
    """
    alone = run.closed | ~run.powered
    found = np.zeros(len(run.t_s))
    edges = np.flatnonzero(np.diff(alone.astype(int), prepend=0, append=0))
    for since, end in zip(edges[::2], edges[1::2], strict=True):
        begin = since if not since or run.closed[since] else np.searchsorted(run.t_s, run.t_s[since] + closes_s)
        if begin >= end:
            continue
        found[begin:end] = np.abs(stroke_mm[begin:end] - stroke_mm[since if from_off else begin])
    return np.maximum.accumulate(found)
