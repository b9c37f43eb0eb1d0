"""An interface goes down and comes up again: the loop ticks on, counts and reports it, and recovers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import can
import pytest

from hil.faults import on_bus
from hil.faults.stand import Stand
from hil.lockstep import Lockstep
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb


def pull_down(rig: Lockstep, patch: pytest.MonkeyPatch) -> None:
    """As the kernel's socket behaves: every send fails, the next receive fails once, and then nothing comes."""
    untold = [can.CanOperationError("Error receiving: Network is down", 100)]

    def receive(_timeout_s: float) -> None:
        if untold:
            raise untold.pop()

    def send(*_: object) -> None:
        raise can.CanOperationError("Failed to transmit: Network is down", 100)

    patch.setattr(rig.bus, "recv", receive)
    patch.setattr(rig.bus, "send", send)


def told(rig: Lockstep) -> list[str]:
    return [
        worded(int(slot["kind"]), 0, 0, 0.0, 0.0, slot["text"].decode()).text
        for slot in rig.events.read()
        if slot["kind"] in (Kind.RECEIVE_FAILED, Kind.SEND_FAILED)
    ]


def test_a_bus_that_is_silent_while_disarmed_is_on_record_until_a_frame_comes(rig: Lockstep) -> None:
    rig.run(0.5)
    rig.events.read()
    on_bus.burst(math.inf)(Stand(rig, "cut"))
    rig.run(2.0)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.DISARMED, Fault.NONE)
    silent = [event for event in rig.events.read() if event["kind"] in (Kind.LIMIT, Kind.LIMIT_OVER)]
    assert [limit(event) for event in silent] == ["BUS_SILENT is active: no frame on the bus for 1016 ms (limit 15 ms)"]
    rig.hub.tap = None
    rig.run(0.1)
    over = [event for event in rig.events.read() if event["kind"] == Kind.LIMIT_OVER]
    assert [limit(event) for event in over] == ["BUS_SILENT is cleared"]


def limit(event: Any) -> str:
    return worded(event["kind"], event["a"], event["b"], event["value"], event["limit"], event["text"].decode()).text


@pytest.mark.parametrize(("down_s", "mode"), [(0.008, Mode.COMPENSATING), (0.2, Mode.FAULT)])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_an_interface_down_and_up(
    rig: Lockstep, enter: Callable[[Mode], None], monkeypatch: pytest.MonkeyPatch, down_s: float, mode: Mode
) -> None:
    rig.events.read()
    stroke_mm, ticks = rig.rig.truth.stroke_mm, rig.record["tick"]
    with monkeypatch.context() as patch:
        pull_down(rig, patch)
        rig.run(down_s)
    assert rig.record["tick"] == ticks + round(down_s * rig.settings.loop.rate_hz)
    assert rig.loop.inbox.receive_failures == 1
    assert told(rig) == [
        "frame not sent: Failed to transmit: Network is down [Error Code 100]",
        "bus not readable: Error receiving: Network is down [Error Code 100]",
    ]
    rig.run(0.5)
    assert rig.loop.machine.mode is mode
    if mode is Mode.FAULT:
        assert rig.loop.machine.fault is Fault.BUS_SILENT
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run(0.5)
        enter(Mode.COMPENSATING)
    assert rig.rig.truth.stroke_mm == pytest.approx(stroke_mm, abs=1.0)
    assert rig.rig.truth.vertical_n == pytest.approx(300.0, rel=0.03)
