"""Python calls a tick, which are the same on every computer: a ceiling that only goes down."""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from tests.bench.calls import calls_a_tick, of_loop

OF_LOOP, OF_ALL = 142, 312
"""In control, ipc and devices; with the simulated rig. A commit that makes a tick cheaper lowers them."""


def test_a_tick_makes_no_more_python_calls_than_it_did(settings: RigSettings) -> None:
    calls = calls_a_tick(settings, 200)
    ours, all_of_them = of_loop(calls), sum(calls.values())
    assert OF_LOOP - 2 < ours <= OF_LOOP, dict(sorted(calls.items(), key=lambda one: -one[1]))
    assert OF_ALL - 4 < all_of_them <= OF_ALL
