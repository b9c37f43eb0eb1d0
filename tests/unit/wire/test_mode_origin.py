"""Since when the rig is in its mode, and who or what began it."""

from __future__ import annotations

from typing import Any

from rigctl.model.events import Kind
from rigctl.model.states import Event, Mode
from rigctl.wire.mode_origin import ModeOrigin
from tests.unit.wire.test_alarms import S, event


def changed(at_s: float, before: Mode, after: Mode, by: Event) -> dict[str, Any]:
    return event(Kind.MODE, at_s, before, after, float(by))


def lease(kind: str, operator: str) -> dict[str, Any]:
    return {"source": "gateway", "kind": kind, "operator": operator}


def test_a_command_is_the_lease_holders_and_a_trip_is_nobodys() -> None:
    origin = ModeOrigin()
    assert origin.now is None
    origin.note(lease("LEASE_TAKEN", "kim"))
    origin.note(changed(2.0, Mode.HOLD, Mode.TENSIONING, Event.TENSION))
    assert origin.now is not None
    assert (origin.now.since_ns, origin.now.by) == (2 * S, "kim: tension commanded")
    origin.note(changed(5.0, Mode.TENSIONING, Mode.COMPENSATING, Event.TENSIONED))
    assert origin.now.by == "target reached"
    origin.note(changed(6.0, Mode.COMPENSATING, Mode.FAULT, Event.TRIP))
    assert "kim" not in origin.now.by
    origin.note(lease("LEASE_LAPSED", "kim"))
    origin.note(changed(7.0, Mode.HOLD, Mode.RELEASING, Event.RELEASE))
    assert origin.now.by == "release commanded"


def test_a_hold_is_of_who_gave_it_and_not_of_the_leases_holder() -> None:
    origin = ModeOrigin()
    origin.note(lease("LEASE_TAKEN", "kim"))
    origin.note(event(Kind.LOCAL_HOLD, 2.0, 1000, 4711, about="lee"))
    origin.note(changed(2.0, Mode.COMPENSATING, Mode.HOLD, Event.HOLD))
    assert origin.now is not None
    assert origin.now.by == "lee: hold commanded"
    origin.note(changed(3.0, Mode.HOLD, Mode.TENSIONING, Event.TENSION))
    assert origin.now.by == "kim: tension commanded"
    origin.note(event(Kind.STARTED, 9.0))
    assert origin.now.by == "the loop started anew, out of TENSIONING"
    origin.clear()
    assert origin.now is None


def test_a_loop_that_starts_anew_says_out_of_which_mode() -> None:
    origin = ModeOrigin()
    origin.note(event(Kind.STARTED, 1.0))
    assert origin.now is not None
    assert origin.now.by == "the daemon started"
    origin.note(changed(2.0, Mode.TENSIONING, Mode.COMPENSATING, Event.TENSIONED))
    origin.note(event(Kind.STARTED, 9.0))
    assert (origin.now.since_ns, origin.now.by) == (9 * S, "the loop started anew, out of COMPENSATING")
