"""One cause has one name: page, status, alarms and trip dump of a bus without frames, whatever took them away."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
import pytest

from hil.faults.catalogue import BY_ID
from hil.faults.stand import Stand
from hil.lockstep import Lockstep
from rigctl.model.event_row import Priority
from rigctl.model.faults import Fault
from rigctl.model.parts import Part
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.page.operator_panel import answers
from rigctl.wire import state_words
from rigctl.wire.alarm_words import listed
from rigctl.wire.alarms import as_message
from rigctl.wire.operator_view import view
from tests.loop.test_causes import Shown

FOREIGN_STEPS = ("commands the drive", "panel", "withdraw", "Look at the signal", "writes all")
"""Of remedies that a bus without frames does not need."""


def unplugged(stand: Stand) -> None:
    """The adapter is gone, as the kernel's socket shows it: one receive fails, then every send."""
    bus, failures = stand.lockstep.bus, [can.CanOperationError("Error receiving: Network is down", 100)]

    def receive(_timeout_s: float) -> None:
        if failures:
            raise failures.pop()

    def send(*_: object) -> None:
        raise can.CanOperationError("Failed to transmit: No such device", 19)

    bus.recv, bus.send = receive, send  # type: ignore[method-assign,assignment]


TAKEN_AWAY: dict[str, Callable[[Stand], Any]] = {
    "bus_cut": BY_ID["bus_cut"].inject, "bus_off": BY_ID["bus_off"].inject,
    "sync_lost": BY_ID["sync_lost"].inject, "unplugged": unplugged,
}  # fmt: skip


@pytest.mark.gate("bus_cut-3", "sync_lost-1")
@pytest.mark.parametrize("rig", [Mode.HOLD, Mode.COMPENSATING], indirect=True)
@pytest.mark.parametrize("taken", TAKEN_AWAY)
def test_a_bus_without_frames_is_one_part_with_one_list_of_steps(rig: Lockstep, taken: str) -> None:
    """DRIVE_UNASKED had been the first cause after a second, and "find who commands the drive" a step."""
    shown = Shown(rig)
    shown.state()
    TAKEN_AWAY[taken](Stand(rig, "a"))
    named: set[tuple[str, ...]] = set()
    first: set[str] = set()
    for seconds in (0.1, 0.4, 1.0, 1.0, 3.0):
        rig.run(seconds)
        state = shown.state()
        alarms, now_ns = shown.alarms(state)
        seen = view(state, alarms)
        named.add((state["fault"], state_words.why(state).partition(":")[0], answers(state, alarms)["parts"][0]))
        named.add((seen.causes[0].fault, *seen.parts))
        first.add(state["culprit"]["first"])
        assert sum(step.text in first for step in seen.steps) == 1
        text = "\n".join([*seen.numbered, *listed(alarms, state, now_ns), *state_words.causes(state)])
        assert not [words for words in FOREIGN_STEPS if words in text]
        folded = [as_message(row, now_ns, state) for row in alarms if row.priority < Priority.LOW]
        assert {(row["follows"], row["remedy"]) for row in folded} == {(True, *first)}
        assert not [row.cause for row in alarms if not as_message(row, now_ns, state)["follows"]]
    assert "DRIVE_UNASKED" in {cause["fault"] for cause in state["causes"]}, "the case that is to be folded"
    fault = "SYNC_LOST" if taken == "sync_lost" else "BUS_SILENT"
    assert named == {(fault, fault, Part.BUS), (fault, Part.BUS)}
    assert len(first) == 1


def test_a_drive_whose_bus_goes_before_it_shows_that_it_is_off_is_no_other_masters(rig: Lockstep) -> None:
    """The latched fault is then DRIVE_UNASKED itself: another master or tool had been named."""
    assert rig.command(Verb.ARM) is Refusal.NONE
    shown = Shown(rig)
    rig.give(Verb.DISARM)
    TAKEN_AWAY["bus_cut"](Stand(rig, "a"))
    rig.run(3.0)
    state = shown.state()
    assert state["fault"] == Fault.DRIVE_UNASKED.name
    assert state["culprit"]["parts"] == [Part.BUS]
    assert "withdraw" not in view(state, shown.alarms(state)[0]).next_step


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_what_has_a_cause_of_its_own_is_not_folded_under_the_bus(rig: Lockstep) -> None:
    shown = Shown(rig)
    TAKEN_AWAY["bus_cut"](Stand(rig, "a"))
    rig.run(0.5)
    rig.hub.tap = None
    rig.rig.drive.press_e_stop(True)
    rig.run(0.3)
    state = shown.state()
    assert state["culprit"]["parts"] == [Part.BUS]
    assert view(state, shown.alarms(state)[0]).causes[0].fault == Fault.E_STOP.name
    assert state_words.why(state).startswith("E_STOP: ")
