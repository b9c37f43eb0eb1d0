"""The charts' history: every extreme, bounded memory, gaps as gaps."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigctl.ipc.record import RECORD
from rigctl.model.samples import Quality
from rigctl.model.states import Mode
from rigctl.page.chart_frame import HEADER, frame
from rigctl.page.chart_signals import SIGNALS, values_of
from rigctl.page.history import BUCKETS, WINDOWS_S, History, Level
from rigctl.page.lateness import EDGES_US, Lateness

MS = 1_000_000
START = 1_800_000_000_000 * MS
NAMES = [signal.name for signal in SIGNALS]


def records(count: int, **fields: float) -> np.ndarray:
    found = np.zeros(count, RECORD.dtype)
    found["t_ns"] = np.arange(count) * MS
    for name, value in fields.items():
        found[name] = value
    return found


def filled(values: np.ndarray, blocks: int = 20) -> History:
    """A history of one signal (the first) at 1 kHz, in blocks; the others are 0."""
    history, walls = History(), START + np.arange(len(values)) * MS
    table = np.zeros((len(values), len(SIGNALS)))
    table[:, 0] = values
    for at in range(0, len(values), blocks):
        history.add(walls[at : at + blocks], table[at : at + blocks])
    return history


@settings(max_examples=30)
@given(
    spikes=st.lists(st.tuples(st.integers(0, 9_999), st.floats(-1e6, 1e6)), min_size=1, max_size=8),
    blocks=st.integers(50, 900),
)
def test_no_spike_of_one_tick_is_lost_in_any_window(spikes: list[tuple[int, float]], blocks: int) -> None:
    values = np.zeros(10_000)
    for at, value in spikes:
        values[at] = value
    for level in filled(values, blocks).levels:
        _, buckets = level.since(0)
        shown = buckets[:, 0]
        assert np.nanmin(shown) == np.float32(values.min())
        assert np.nanmax(shown) == np.float32(values.max())
        for at, _ in spikes:
            bucket = (START + at * MS) // level.width_ns - (level.newest - len(buckets) + 1)
            low, high = shown[bucket]
            assert low <= np.float32(values[at]) <= high


def test_every_window_is_whole_and_none_holds_more() -> None:
    history = filled(np.arange(70_000.0), 500)
    for window_s, level in zip(WINDOWS_S, history.levels, strict=True):
        first, buckets = level.since(0)
        assert len(buckets) == BUCKETS
        assert level.newest - first + 1 == BUCKETS
        assert level.width_ns * BUCKETS == window_s * 1_000_000_000
    _, minute = history.levels[0].since(0)
    assert np.nanmin(minute[:, 0]) > 9_000  # the first 9 s are outside the minute
    _, hour = history.levels[-1].since(0)
    assert np.nanmin(hour[:, 0]) == 0


def test_time_without_records_is_a_gap_not_a_line() -> None:
    level = Level(60)
    ones = np.ones((1, len(SIGNALS)))
    level.add(np.array([START]), ones)
    level.add(np.array([START + 10_000 * MS]), ones)
    _, buckets = level.since(level.newest - 200)
    shown = ~np.isnan(buckets[:, 0, 0])
    assert shown.sum() == 2
    assert shown[[0, -1]].all()


def test_a_window_is_emptied_by_a_pause_longer_than_itself() -> None:
    level = Level(60)
    ones = np.ones((1, len(SIGNALS)))
    level.add(np.array([START]), ones)
    level.add(np.array([START + 3_600_000 * MS]), 2 * ones)
    _, buckets = level.since(0)
    assert np.nanmin(buckets[:, 0]) == 2


def test_a_clock_that_goes_backwards_begins_anew() -> None:
    history = filled(np.ones(5_000))
    history.add(np.array([START - 3_600_000 * MS]), np.full((1, len(SIGNALS)), 3.0))
    _, buckets = history.levels[0].since(0)
    assert np.nanmin(buckets[:, 0]) == np.nanmax(buckets[:, 0]) == 3


def test_a_frame_goes_on_with_the_bucket_that_was_open() -> None:
    history = filled(np.zeros(1_000))
    payload, newest = frame(history, 0, 0)
    assert len(payload) == HEADER.size + BUCKETS * len(SIGNALS) * 8
    walls = START + np.arange(1_000, 1_120) * MS
    history.add(walls, np.full((120, len(SIGNALS)), 7.0))
    payload, again = frame(history, 0, newest)
    window, signals, count, first, width_ms, newest_ms = HEADER.unpack_from(payload)
    assert (window, signals, first, width_ms) == (0, len(SIGNALS), newest, 50.0)
    assert newest_ms == pytest.approx(walls[-1] / 1e6)
    assert count == again - newest + 1
    last = struct.unpack_from("<2f", payload, HEADER.size + (count - 1) * signals * 8)
    assert last == (7.0, 7.0)


def test_error_is_shown_while_compensating_alone() -> None:
    found = records(3, vertical_n=303.0, target_n=300.0)
    found["mode"] = [Mode.HOLD, Mode.COMPENSATING, Mode.COMPENSATING]
    found["tension_quality"][2] = Quality.STALE
    error = values_of(found)[:, NAMES.index("error_pct")]
    assert math.isnan(error[0])
    assert error[1] == pytest.approx(1.0)
    assert math.isnan(error[2])


@pytest.mark.parametrize("quality", [Quality.STALE, Quality.INVALID, Quality.NEVER])
def test_a_signal_that_is_not_seen_is_not_drawn_on(quality: Quality) -> None:
    found = records(2, tangential_rad=0.1, stroke_mm=5.0)
    found["inclination_quality"][1] = quality
    values = values_of(found)
    tangential, stroke = (values[:, NAMES.index(name)] for name in ("tangential_deg", "stroke_mm"))
    assert tangential[0] == pytest.approx(math.degrees(0.1))
    assert math.isnan(tangential[1])
    assert stroke.tolist() == [5.0, 5.0]


def test_values_without_meaning_are_gaps() -> None:
    values = values_of(records(1, vertical_n=math.inf, stroke_mm=math.nan))
    assert np.isnan(values[0, [NAMES.index("vertical_n"), NAMES.index("stroke_mm")]]).all()


def test_every_tick_is_in_the_lateness_histogram_once() -> None:
    lateness, found = Lateness(), records(5_000)
    rng = np.random.default_rng(1)
    found["lateness_ns"] = np.exp(rng.uniform(0, 22, len(found)))
    for at in range(0, len(found), 37):
        part = found[at : at + 37]
        lateness.add(START + part["t_ns"], part)
    window = lateness.window(60)
    expected, _ = np.histogram(np.clip(found["lateness_ns"] / 1e3, EDGES_US[0], EDGES_US[-1] - 1), EDGES_US)
    assert window["counts"] == expected.tolist()
    assert window["ticks"] == len(found)
    assert window["worst_us"] == pytest.approx(found["lateness_ns"].max() / 1e3, abs=0.1)


def test_missed_deadlines_are_counted_through_a_restart_of_the_loop() -> None:
    lateness, found = Lateness(), records(6)
    found["skipped"] = [4, 4, 7, 7, 2, 3]  # 3 during the window; then a new loop, which has missed 2, and 1 more
    lateness.add(START + found["t_ns"], found)
    assert lateness.window(60)["missed"] == 6


def test_lateness_leaves_its_window() -> None:
    lateness, found = Lateness(), records(10)
    lateness.add(START + found["t_ns"], found)
    found["t_ns"] += 100_000 * MS
    lateness.add(START + found["t_ns"], found)
    assert lateness.window(60)["ticks"] == 10
    assert lateness.window(300)["ticks"] == 20
