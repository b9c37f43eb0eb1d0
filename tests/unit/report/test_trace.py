"""Lines of long signals keep every spike and bridge no gap."""

from __future__ import annotations

import numpy as np

from rigctl.report.trace import trace


def test_one_sample_of_six_hundred_thousand_is_still_seen() -> None:
    t_s = np.arange(600_000) / 1000.0
    values = np.zeros(len(t_s))
    values[123_456], values[400_001] = 7.0, -3.0
    x, y = trace(t_s, values, 2000)
    assert len(x) == len(y) <= 2100
    assert (np.nanmax(y), np.nanmin(y)) == (7.0, -3.0)
    assert abs(x[int(np.nanargmax(y))] - 123.456) < 0.7
    assert np.all(np.diff(x[np.isfinite(y)]) >= 0.0)


def test_a_line_is_broken_where_nothing_was_recorded() -> None:
    t_s = np.concatenate([np.arange(1000), np.arange(2000, 3000)]) / 1000.0
    x, y = trace(t_s, np.ones(2000), 100)
    (broken,) = np.flatnonzero(np.isnan(y))
    assert x[broken] <= 1.0
    assert x[broken + 1] == 2.0


def test_few_samples_are_drawn_as_they_are() -> None:
    x, y = trace([0.0, 0.001], np.array([1.0, 2.0]), 100)
    assert (x.tolist(), y.tolist()) == ([0.0, 0.001], [1.0, 2.0])
