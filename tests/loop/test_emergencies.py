"""Emergency messages by CiA 301: which begin an error, which end one, and the text for the operator."""

from __future__ import annotations

import struct

import pytest

from hil.lockstep import Lockstep
from hil.wire import FRAME
from rigctl.devices import objects
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

CELL, DRIVE = 2, 4


def send(rig: Lockstep, node: int, code: int, register: int, manufacturer: bytes = bytes(5)) -> list[str]:
    """Send one emergency message; returns the resulting events in words."""
    rig.events.read()
    rig.inject(FRAME.pack(objects.EMCY_BASE + node, 8, struct.pack("<HB5s", code, register, manufacturer)))
    rig.run(0.005)
    kinds, events = (Kind.EMERGENCY, Kind.TRIP), rig.events.read()
    found = [event for kind in kinds for event in events if event["kind"] == kind]
    return [worded(e["kind"], e["a"], e["b"], e["value"], e["limit"], e["text"].decode()).text for e in found]


@pytest.mark.parametrize("node", [CELL, DRIVE])
@pytest.mark.parametrize("code", [0x0000, 0x0001, 0x00FF])
@pytest.mark.starts_in(Mode.HOLD)
def test_a_code_of_class_00_is_no_error(rig: Lockstep, node: int, code: int) -> None:
    (said,) = send(rig, node, code, 0)
    assert said.startswith(f"node {node}: emergency over")
    assert rig.loop.machine.fault is Fault.NONE


@pytest.mark.starts_in(Mode.HOLD)
def test_several_errors_of_a_device_are_over_when_its_register_says_so(rig: Lockstep) -> None:
    said = send(rig, CELL, 0x4210, 0x09)
    assert said[0] == "node 2: emergency 0x4210, device temperature; error register 0x09: generic, temperature"
    assert said[1].endswith("a device's emergency message is active (node 2: 0x4210, device temperature)")
    send(rig, CELL, 0x5010, 0x29)
    (said_over,) = send(rig, CELL, 0x0000, 0x09)
    assert (
        said_over
        == "node 2: one emergency is over (0x0000), others are active: error register 0x09: generic, temperature"
    )
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert send(rig, CELL, 0x0000, 0x00) == ["node 2: emergency over"]
    assert rig.command(Verb.RESET) is Refusal.NONE


@pytest.mark.starts_in(Mode.HOLD)
def test_a_register_that_says_so_is_an_error_whose_message_was_lost(rig: Lockstep) -> None:
    send(rig, CELL, 0x0000, 0x11)
    assert rig.loop.machine.fault is Fault.SENSOR_EMERGENCY


@pytest.mark.starts_in(Mode.HOLD)
def test_a_makers_own_code_is_told_with_its_bytes(rig: Lockstep) -> None:
    said, _ = send(rig, DRIVE, 0xFF10, 0x81, bytes([0x12, 0x34, 0, 0, 0xAB]))
    assert said == (
        "node 4: emergency 0xFF10, device specific; error register 0x81: generic, manufacturer; "
        "manufacturer's bytes 12 34 00 00 ab"
    )
    assert rig.loop.machine.fault is Fault.DRIVE_EMERGENCY
