"""Whether a trip of the demo came of a pause of the computer, by the loop's records alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.demo.live import Pause, pause_before_trip
from rigctl.ipc.record import RECORD
from rigctl.model.signals import NEVER_AGE_NS
from rigctl.model.states import Mode
from tests.builders.rig_bench import SETTINGS

MS = 1_000_000
TRIP = 1500
"""The tick that trips: the window before it begins 1000 ticks earlier."""


def records(trip: int | None = TRIP) -> npt.NDArray[Any]:
    """Two seconds of ticks on the grid, with samples a period old."""
    found = np.zeros(2000, RECORD.dtype)
    found["t_ns"] = np.arange(2000) * MS
    found["mode"] = Mode.COMPENSATING
    found["tension_age_ns"] = found["drive_age_ns"] = MS
    if trip is not None:
        found["mode"][trip:] = Mode.FAULT
        found["drive_age_ns"][trip + 1 :] = 900 * MS  # a drive that is stopped by the trip is silent
    return found


def test_a_trip_on_time_is_none_of_the_computers() -> None:
    assert pause_before_trip(records(None), SETTINGS) is None
    assert pause_before_trip(records(), SETTINGS) is None


@pytest.mark.parametrize(("missed_at", "counts"), [(TRIP - 900, True), (TRIP + 1, True), (TRIP - 1100, False)])
def test_missed_periods_count_from_the_window_to_the_tick_after_the_trip(missed_at: int, counts: bool) -> None:
    found = records()
    found["skipped"][missed_at:] = 12
    expected = Pause("the loop", 12.0, TRIP * MS) if counts else None
    assert pause_before_trip(found, SETTINGS) == expected


@pytest.mark.parametrize("age", ["tension_age_ns", "drive_age_ns"])
def test_samples_that_did_not_come_are_a_pause_of_the_simulated_rig(age: str) -> None:
    found = records()
    found[age][TRIP - 200] = 14 * MS
    assert pause_before_trip(found, SETTINGS) == Pause("the simulated rig", 14.0, TRIP * MS)
    found["skipped"][TRIP - 100 :] = 20
    assert pause_before_trip(found, SETTINGS) == Pause("the loop", 20.0, TRIP * MS)
    found = records()
    found[age][TRIP - 200] = 9 * MS
    assert pause_before_trip(found, SETTINGS) is None


def test_a_device_that_was_never_heard_yet_has_not_fallen_silent() -> None:
    found = records(400)
    found["drive_age_ns"][:200] = NEVER_AGE_NS + 1
    found["tension_age_ns"][:200] = NEVER_AGE_NS
    assert pause_before_trip(found, SETTINGS) is None
