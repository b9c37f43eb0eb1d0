"""The I/O node's inputs in the loop's inbox: pressed, closed, bouncing, malformed, and from other devices."""

from __future__ import annotations

import struct

import can
import pytest

from rigctl.config import rig_file as config
from rigctl.config.io_section import IoSettings
from rigctl.control.control_process import receive_filters
from rigctl.devices import objects as od
from rigctl.devices.process_data import wanted
from rigctl.model.device_states import NmtState
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault
from rigctl.model.states import EStop
from tests.unit.control.test_plain_inbox import CONFIG, Bench

PAPER = config.load(CONFIG / "paper_rig.yaml")
IO = IoSettings(e_stop_input=11)
RIG = PAPER.model_copy(update={"io": IO})
INPUTS = od.TPDO1_BASE + IO.node
CLOSED, OPEN = b"\x08", b"\xf7"


def test_nothing_is_seen_at_first_and_every_frame_is_an_age() -> None:
    bench = Bench(RIG)
    assert bench.inbox.inputs.t_ns < 0
    assert not bench.inbox.inputs.e_stop
    bench.give(INPUTS, CLOSED)
    assert (bench.inbox.inputs.e_stop, bench.inbox.inputs.t_ns) == (False, bench.t_ns)


def test_only_its_own_bit_is_the_stop_and_open_is_pressed() -> None:
    bench = Bench(RIG)
    for data, pressed in ((OPEN, True), (CLOSED, False), (b"\x00", True), (b"\xff", False)):
        bench.give(INPUTS, data)
        assert bench.inbox.inputs.e_stop is pressed
    assert not bench.inbox.drive_status.e_stop  # that is the drive's input


def test_a_contact_that_bounces_between_two_ticks_was_pressed() -> None:
    bench = Bench(RIG)
    for data in (OPEN, CLOSED):
        bench.bus.send(can.Message(arbitration_id=INPUTS, data=data, is_extended_id=False))
    bench.inbox.drain(7_000_000, 7)
    assert bench.inbox.inputs.e_stop
    bench.give(INPUTS, CLOSED)
    assert bench.inbox.inputs.e_stop is (bench.t_ns == 7_000_000)
    bench.inbox.drain(8_000_000, 8)
    bench.t_ns = 8_000_000
    bench.give(INPUTS, CLOSED)
    assert not bench.inbox.inputs.e_stop


@pytest.mark.parametrize("data", [b"", b"\x08\x00", bytes(8)])
def test_a_frame_of_a_wrong_length_is_refused_and_makes_nothing_younger(data: bytes) -> None:
    bench = Bench(RIG)
    bench.give(INPUTS, CLOSED)
    seen_ns = bench.inbox.inputs.t_ns
    bench.give(INPUTS, data)
    assert (bench.inbox.refused, bench.inbox.inputs.t_ns, bench.inbox.inputs.e_stop) == (1, seen_ns, False)


def test_its_frames_are_due_to_no_sync() -> None:
    bench = Bench(RIG)
    bench.give(INPUTS, CLOSED)
    for _ in range(50):
        bench.give(0x7FF, b"")
    assert bench.inbox.frames_missing() == 0


def test_its_emergency_is_a_devices_and_its_boot_up_a_restart() -> None:
    bench = Bench(RIG)
    bench.give(od.EMCY_BASE + IO.node, struct.pack("<HB5x", od.EmcyCode.EXTERNAL, 1))
    assert (
        bench.inbox.network.sensor_emergency != 0,
        bench.inbox.network.drive_emergency,
        bench.inbox.drive_status.e_stop,
    ) == (True, 0, False)
    bench.give(od.EMCY_BASE + IO.node, bytes(8))
    assert bench.inbox.network.sensor_emergency == 0
    bench.give(od.HEARTBEAT_BASE + IO.node, bytes([NmtState.OPERATIONAL]))
    assert not bench.inbox.network.restarted
    bench.give(od.HEARTBEAT_BASE + IO.node, bytes([NmtState.BOOT_UP]))
    assert bench.inbox.network.restarted


def test_the_receive_filters_let_its_frames_through_and_only_where_it_is_fitted() -> None:
    own = {base + IO.node for base in (od.TPDO1_BASE, od.EMCY_BASE, od.HEARTBEAT_BASE)}
    assert own <= {item["can_id"] for item in receive_filters(RIG, wanted(RIG))}
    assert not own & {item["can_id"] for item in receive_filters(PAPER, wanted(PAPER))}


def test_without_one_fitted_its_frames_mean_nothing() -> None:
    bench = Bench(PAPER)
    bench.give(INPUTS, OPEN)
    assert not bench.inbox.inputs.e_stop
    assert bench.inbox.inputs.t_ns < 0


@pytest.mark.parametrize(
    ("pressed", "words"),
    [
        (EStop.DRIVE, "emergency stop pressed (drive's input)"),
        (EStop.IO_NODE, "emergency stop pressed (I/O node's input)"),
        (EStop.DRIVE | EStop.IO_NODE, "emergency stop pressed (inputs of drive and I/O node)"),
    ],
)
def test_a_trip_says_which_input_is_pressed(pressed: EStop, words: str) -> None:
    assert fault_text(Fault.E_STOP, float(pressed), 0.0) == words
