"""A state queried after an event already shows the event's effect."""

from __future__ import annotations

from rigctl.client import Rig
from tests.builders.miniature import Daemon
from tests.builders.waiting import patience_s


def commanded(rig: Rig, verb: str, mode: str) -> None:
    assert rig.command(verb, operator="kim")["accepted"]
    event = rig.wait_event(kind="MODE", timeout_s=patience_s())
    state = rig.state()
    assert event is not None
    assert (state["mode"], state["event_seq"] >= event["seq"]) == (mode, True)


def test_the_state_queried_after_an_event_is_not_older_than_it(own: Daemon) -> None:
    with own.rig() as rig:
        for _ in range(25):
            commanded(rig, "arm", "HOLD")
            commanded(rig, "disarm", "DISARMED")
