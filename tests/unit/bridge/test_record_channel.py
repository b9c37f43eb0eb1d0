"""Records are thinned evenly at every rate, wherever a block begins and ends."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.bridge.record_channel import thinned


@pytest.mark.parametrize(("rate_hz", "steps"), [(20.0, {50}), (100.0, {10}), (300.0, {3, 4}), (1000.0, {1})])
def test_numbers_of_thinned_records_are_evenly_apart(rate_hz: float, steps: set[int]) -> None:
    records = np.zeros(300_000, dtype=[("seq", np.uint64)])
    records["seq"] = np.arange(1, len(records) + 1)
    chosen = np.concatenate([thinned(block, rate_hz, 1000.0) for block in np.array_split(records, 7001)])
    assert set(np.diff(chosen["seq"].astype(np.int64)).tolist()) == steps
