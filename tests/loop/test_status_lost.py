"""The drive's status (current, temperature, inputs) stops coming, while its position and speed go on."""

from __future__ import annotations

import pytest

from hil.lockstep import Lockstep
from hil.wire import FRAME
from rigctl.control.watch.safety import STATUS_PERIODS
from rigctl.devices import objects
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import latched

ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)


def lose_status(rig: Lockstep, frames: int | None = None) -> None:
    """Drop the drive's second TPDO, for so many frames or from now on."""
    status = objects.DRIVE_TPDO2.cob_base + rig.settings.cylinder.node
    left = [frames]

    def tap(_: object, frame: bytes) -> tuple[bytes, ...]:
        if FRAME.unpack(frame)[0] != status or left[0] == 0:
            return (frame,)
        left[0] = None if left[0] is None else left[0] - 1
        return ()

    rig.hub.tap = tap


@pytest.mark.parametrize("rig", ARMED, indirect=["rig"])
def test_a_status_that_has_died_is_a_fault_that_holds(rig: Lockstep) -> None:
    rig.events.read()
    lose_status(rig)
    rig.run(0.3)
    assert latched(rig) == (Mode.FAULT, Fault.STATUS_STALE, Action.HOLD)
    (trip,) = [event for event in rig.events.read() if event["kind"] == Kind.TRIP]
    assert trip["limit"] == STATUS_PERIODS * 50e6
    assert rig.rig.drive.control.enabled
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    rig.hub.tap = None
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_burst_that_takes_four_of_it_is_none(rig: Lockstep) -> None:
    lose_status(rig, frames=STATUS_PERIODS - 1)
    rig.run(1.0)
    assert rig.loop.machine.mode is Mode.COMPENSATING


def test_without_it_nobody_arms(rig: Lockstep) -> None:
    lose_status(rig)
    rig.run(0.3)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check(int(rig.reply["checks"])) == Check.STATUS_STALE | Check.E_STOP_UNSEEN | Check.LIMIT
