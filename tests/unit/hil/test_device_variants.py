"""The simulated devices as commercial ones: each variant refuses, or is slow, as the real ones are."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from hil.nodes.dictionary import Abort
from rigctl.devices import objects
from rigctl.model.device_states import NmtState
from tests.builders.rig_bench import SETTINGS, RigBench, changed

CELL, SLOPE, DRIVE = 2, 3, 4
START, RESET_NODE = 0x01, 0x81


def bench(**devices: Any) -> RigBench:
    return RigBench(changed(SETTINGS, simulation={"devices": devices}))


@pytest.mark.parametrize("node", [CELL, SLOPE, DRIVE])
def test_without_rtr_bit_30_of_a_tpdo_is_set_for_good(node: int) -> None:
    rig = bench(rtr=False)
    own = objects.TPDO1_BASE + node
    assert rig.read(node, objects.TPDO1_COMMUNICATION, 1) == own | objects.PDO_NO_RTR
    for value in (own, own | objects.PDO_NOT_VALID):
        assert rig.write(node, objects.TPDO1_COMMUNICATION, 1, value, 4) == Abort.VALUE_RANGE
        assert rig.write(node, objects.TPDO1_COMMUNICATION, 1, value | objects.PDO_NO_RTR, 4) == 0


def test_with_rtr_either_is_taken() -> None:
    rig = bench()
    for flags in (objects.PDO_NOT_VALID, objects.PDO_NOT_VALID | objects.PDO_NO_RTR):
        assert rig.write(CELL, objects.TPDO1_COMMUNICATION, 1, objects.TPDO1_BASE + CELL | flags, 4) == 0


@pytest.mark.parametrize("index", [objects.TPDO1_MAPPING, objects.RPDO1_MAPPING])
def test_a_fixed_mapping_is_read_only(index: int) -> None:
    rig = bench(fixed_mapping=True)
    assert rig.write(DRIVE, index, 0, 0, 1) == Abort.READ_ONLY == 0x06010002
    assert rig.read(DRIVE, index, 0) > 0


def test_a_slow_device_answers_an_sdo_when_its_time_has_passed() -> None:
    rig = bench(sdo_ms=200)
    rig.send(objects.SDO_RX_BASE + CELL, struct.pack("<BHBI", 0x40, objects.DEVICE_TYPE, 0, 0))
    rig.wait(199)
    assert rig.sent(objects.SDO_TX_BASE + CELL) == []
    rig.wait(1)
    (answer,) = rig.sent(objects.SDO_TX_BASE + CELL)
    assert struct.unpack("<BHBI", answer) == (0x43, objects.DEVICE_TYPE, 0, objects.DEVICE_TYPE_404)


def test_a_device_that_boots_says_and_hears_nothing() -> None:
    rig = bench(boot_s=5.0)
    rig.nmt(START)
    rig.send(objects.SDO_RX_BASE + DRIVE, struct.pack("<BHBI", 0x40, objects.DEVICE_TYPE, 0, 0))
    rig.wait(4_999)
    assert [can_id for can_id, _ in rig.frames if can_id & 0x7F in (CELL, SLOPE, DRIVE)] == []
    rig.wait(1)
    assert rig.sent(objects.HEARTBEAT_BASE + DRIVE) == [bytes([NmtState.BOOT_UP])]
    assert rig.read(DRIVE, objects.DEVICE_TYPE) == objects.DEVICE_TYPE_402
    assert rig.rig.drive.nmt_state is NmtState.PRE_OPERATIONAL
    rig.nmt(RESET_NODE, DRIVE)
    rig.frames.clear()
    rig.wait(4_999)
    assert rig.sent(objects.HEARTBEAT_BASE + DRIVE) == []


def test_a_drive_in_increments_counts_tells_and_moves_in_them() -> None:
    per_mm = 209_715.2
    cylinder = {"eds": "eds/stock_drive.eds"}
    rig = RigBench(changed(SETTINGS, cylinder=cylinder, simulation={"drive": {"increments_per_mm": per_mm}}))
    assert rig.read(DRIVE, objects.SI_UNIT_POSITION) == 0
    assert rig.read(DRIVE, objects.FEED_CONSTANT, 1) / rig.read(DRIVE, objects.FEED_CONSTANT, 2) == 5 * per_mm
    rig.write(DRIVE, objects.RPDO1_MAPPING, 0, 0, 1)
    for place, entry in enumerate(objects.DRIVE_RPDO.mapping, 1):
        assert rig.write(DRIVE, objects.RPDO1_MAPPING, place, entry, 4) == 0
    assert rig.write(DRIVE, objects.RPDO1_MAPPING, 0, 2, 1) == 0
    rig.enable()
    rig.drive(1000, 0x0F, 5.0 * per_mm / 1000.0)  # the bench's commands are in um/s
    assert rig.rig.truth.speed_mm_s == pytest.approx(5.0, abs=0.05)
    assert rig.read(DRIVE, objects.VELOCITY_ACTUAL) == pytest.approx(5.0 * per_mm, rel=0.01)
    position = rig.read(DRIVE, objects.POSITION_ACTUAL)
    assert position / per_mm == pytest.approx(rig.rig.truth.stroke_mm, abs=0.05)


@pytest.mark.parametrize("request_", [0xA0, 0xA4, 0xA3, 0xC6, 0xC2], ids=hex)
def test_a_block_transfer_is_refused_by_its_command(request_: int) -> None:
    answer = bench().ask(DRIVE, bytes([request_, 0x08, 0x10, 0, 0x7F, 0, 0, 0]))
    assert struct.unpack("<BHBI", answer) == (0x80, 0x1008, 0, 0x05040001)


@pytest.mark.parametrize("node", [CELL, SLOPE, DRIVE, objects.SIMULATOR_NODE])
def test_a_variable_has_no_sub_index(node: int) -> None:
    rig = bench()
    for request in (struct.pack("<BHBI", 0x40, 0x1017, 1, 0), struct.pack("<BHBI", 0x2B, 0x1017, 1, 500)):
        assert struct.unpack("<BHBI", rig.ask(node, request)) == (0x80, 0x1017, 1, 0x06090011)
    assert rig.read(node, 0x1017) == 100  # unchanged
