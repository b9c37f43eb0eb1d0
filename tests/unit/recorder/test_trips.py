"""Which trips share a dump, and when its data is gone."""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Event, Mode
from rigctl.recorder.trips import AFTER_NS, Trigger, Trips, first_group

S = 1_000_000_000


def test_trips_within_two_seconds_of_the_first_share_a_dump_named_after_it() -> None:
    pending = [Trigger(3, 10 * S, ""), Trigger(4, 11 * S, "RIVAL"), Trigger(5, 10 * S + AFTER_NS, "SIGN_DRIVE")]
    group = first_group([*pending, Trigger(6, 10 * S + AFTER_NS + 1, "HOST")])
    assert group.triggers == tuple(pending)
    assert (group.start_ns, group.end_ns) == (0, 12 * S + AFTER_NS)
    assert (group.last_seq, group.fault) == (5, "RIVAL")


def test_a_dump_can_be_made_while_the_rings_hold_its_last_trip(runtime: Runtime, settings: RigSettings) -> None:
    trips = Trips(runtime, settings, 0)
    held_ns = settings.telemetry.history_s * S
    for times in ((5 * S,), (5 * S, 6 * S)):
        group = first_group([Trigger(number, t_ns, "RIVAL") for number, t_ns in enumerate(times)])
        assert not trips.missed(group, times[-1] + held_ns)
        assert trips.missed(group, times[-1] + held_ns + 1)


def test_a_dump_is_due_once_its_time_is_over_or_no_more_data_will_come(runtime: Runtime, settings: RigSettings) -> None:
    trips, events = Trips(runtime, settings, 0), runtime.events.writer()
    assert trips.due(4 * S) is None
    events.write(5 * S, Kind.TRIP, Fault.RIVAL, 0, 0.0, 0.0, b"")
    assert trips.due(5 * S + AFTER_NS - 1) is None
    group = trips.due(5 * S + AFTER_NS)
    assert group is not None
    assert (group.fault, trips.due(5 * S, final=True)) == ("RIVAL", group)
    trips.done(group)
    assert trips.due(99 * S) is None
    events.write(99 * S, Kind.MODE, Mode.RELEASING, Mode.FAULT, float(Event.RAMP_ENDS), 0.0, b"")
    assert trips.due(200 * S) is None  # no trip, but the end of a lowering out of FAULT
    events.write(200 * S, Kind.MODE, Mode.HOLD, Mode.FAULT, float(Event.TRIP), 0.0, b"")
    group = trips.due(300 * S)
    assert group is not None
    assert group.fault == "LOOP_EXCEPTION"  # nothing else leads to FAULT without an event of its trip
