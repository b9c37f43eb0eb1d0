"""The trip behind a latched fault, and the window about it."""

from __future__ import annotations

import math

import numpy as np

from rigctl.config import rig_file
from rigctl.diagnosis.diagnose import diagnose
from rigctl.diagnosis.window import AFTER_NS, BEFORE_NS, around, latched, trips
from rigctl.ipc.record import RECORD
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.loop_event import LoopEvent
from rigctl.model.parts import Part
from tests.builders.paths import ROOT

S = 1_000_000_000
SETTINGS = rig_file.load(ROOT / "config/paper_rig.yaml")
NO_RECORDS = np.empty(0, RECORD.dtype)


def trip(t_s: float, fault: Fault) -> LoopEvent:
    return LoopEvent.of(round(t_s * S), Kind.TRIP, fault)


def test_the_first_trip_since_the_reset_is_latched() -> None:
    events = [trip(1, Fault.LIMIT), LoopEvent.of(2 * S, Kind.RESET), trip(3, Fault.CELL_STALE), trip(4, Fault.E_STOP)]
    assert latched(events) == events[2]
    assert latched(events[:2]) is None
    assert [one.fields["fault"] for one in trips(events)] == [Fault.LIMIT, Fault.CELL_STALE]


def test_a_new_loop_ends_what_was_latched() -> None:
    assert latched([trip(1, Fault.LIMIT), LoopEvent.of(2 * S, Kind.STARTED)]) is None


def test_the_window_is_cut_out_of_longer_series() -> None:
    records = np.zeros(10_000, RECORD.dtype)
    records["t_ns"] = np.arange(10_000) * 1_000_000
    found = around(trip(5, Fault.LIMIT), SETTINGS, [trip(1, Fault.E_STOP), trip(5, Fault.LIMIT)], records)
    assert found.records["t_ns"][0] == 5 * S - BEFORE_NS
    assert found.records["t_ns"][-1] == 5 * S + AFTER_NS
    assert len(found.events) == 1


def test_what_follows_is_listed_under_the_culprit_its_own_fault_first() -> None:
    stop = trip(5, Fault.E_STOP)
    events = [
        stop,
        LoopEvent.of(5 * S + 1, Kind.CAUSE, Fault.DRIVE_FAULT),
        LoopEvent.of(5 * S + 2, Kind.CAUSE, Fault.DRIVE_FAULT),
    ]
    found = diagnose(around(stop, SETTINGS, events, NO_RECORDS))
    assert found.parts == (Part.E_STOP,)
    assert found.follows == ("E_STOP", "DRIVE_FAULT")
    assert found.as_message()["parts"] == ["emergency stop"]


def test_a_trip_that_shows_nothing_names_no_part_but_its_own_words_and_remedy() -> None:
    found = diagnose(around(trip(5, Fault.LIMIT), SETTINGS, [], NO_RECORDS))
    assert found.parts == ()
    assert found.first == Fault.LIMIT.remedy


def test_whatever_a_recording_holds_its_trip_is_diagnosed() -> None:
    """Fields of any value: NaN, infinite, of no mode, out of order."""
    rng, odd = np.random.default_rng(1), (0.0, math.nan, math.inf, -math.inf, 1e300, 300.0)
    kinds, at_ns = list(Kind), 10 * S
    for _ in range(400):
        records = np.zeros(int(rng.choice([0, 1, 2, 30, 700])), RECORD.dtype)
        for name in records.dtype.names or ():
            if records.dtype[name].kind == "f":
                records[name] = rng.choice(odd, len(records))
            elif records.dtype[name].kind in "iu" and rng.random() < 0.5:
                records[name] = rng.integers(0, 100, len(records))
        records["t_ns"] = np.sort(at_ns + rng.integers(-2 * S, S, len(records)))
        events = [
            LoopEvent.of(at_ns + int(rng.integers(-S, S)), int(rng.choice(kinds)), int(rng.integers(0, 120)),
                  int(rng.integers(0, 1 << 31)), rng.choice(odd), rng.choice(odd), "node 2")
            for _ in range(5)
        ]  # fmt: skip
        found = LoopEvent.of(
            at_ns, Kind.TRIP, int(rng.integers(0, 80)), 0, rng.choice(odd), rng.choice(odd), "tangential_deg"
        )
        assert diagnose(around(found, SETTINGS, [*events, found], records)).words
