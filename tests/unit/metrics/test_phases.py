"""The spans of a recording that are judged."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.metrics.phases import phases
from rigctl.model.states import Mode
from tests.builders.synthetic import RATE_HZ, run, stay


def test_a_phase_is_judged_from_two_seconds_after_it_was_entered_to_its_end() -> None:
    records = run(stay(Mode.HOLD, 1.0), stay(Mode.COMPENSATING, 5.0), stay(Mode.RELEASING, 1.0))
    (phase,) = phases(records)
    assert (phase.first, phase.after) == (3 * RATE_HZ, 6 * RATE_HZ)
    assert (phase.number, phase.target_n, phase.ended, phase.faulted) == (1, 300.0, "RELEASING", False)


def test_a_phase_shorter_than_that_is_none() -> None:
    assert phases(run(stay(Mode.HOLD, 1.0), stay(Mode.COMPENSATING, 1.9))) == []
    assert phases(run(stay(Mode.HOLD, 1.0))) == []


def test_a_new_target_begins_a_phase_judged_once_its_ramp_is_over() -> None:
    changed = stay(Mode.COMPENSATING, 6.0, target_n=250.0)
    ramp = np.linspace(300.0, 250.0, RATE_HZ)  # one second
    changed["setpoint_n"][:RATE_HZ] = ramp
    first, second = phases(run(stay(Mode.COMPENSATING, 4.0), changed))
    assert first.ended == "target changed to 250 N"
    assert first.after == 4 * RATE_HZ
    assert second.target_n == 250.0
    assert second.ended == "end of the recording"
    assert second.first == pytest.approx(7 * RATE_HZ, abs=3)


def test_a_phase_ended_by_a_trip_says_so() -> None:
    (phase,) = phases(run(stay(Mode.COMPENSATING, 4.0), stay(Mode.FAULT, 1.0)))
    assert phase.faulted
    assert phase.ended == "FAULT"


def test_every_phase_of_a_recording_is_found() -> None:
    again = [part for _ in range(3) for part in (stay(Mode.HOLD, 0.5), stay(Mode.COMPENSATING, 3.0))]
    assert [phase.number for phase in phases(run(*again))] == [1, 2, 3]
