"""CiA 301 behaviour that all devices share, tested over the bus."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hil.nodes.dictionary import Abort
from rigctl.devices import objects
from rigctl.model.device_states import NmtState
from tests.builders.rig_bench import SETTINGS, RigBench

CELL, SLOPE, DRIVE, BENCH = NODES = (2, 3, 4, objects.SIMULATOR_NODE)
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82


@pytest.fixture
def bench() -> RigBench:
    return RigBench()


def heartbeats(bench: RigBench, node: int) -> list[int]:
    return [data[0] for data in bench.sent(objects.HEARTBEAT_BASE + node)]


def test_every_device_boots_up_and_waits_in_pre_operational(bench: RigBench) -> None:
    bench.wait(250)
    for node in NODES:
        assert heartbeats(bench, node) == [NmtState.BOOT_UP, NmtState.PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL]


@pytest.mark.parametrize("node", NODES)
def test_nmt_reaches_one_device_or_all(bench: RigBench, node: int) -> None:
    bench.nmt(START, node)
    bench.wait(100)
    assert {n: heartbeats(bench, n)[-1] for n in NODES} == {
        n: NmtState.OPERATIONAL if n == node else NmtState.PRE_OPERATIONAL for n in NODES
    }
    bench.nmt(STOP)
    bench.wait(100)
    assert {heartbeats(bench, n)[-1] for n in NODES} == {NmtState.STOPPED}


def test_heartbeat_period_is_the_written_one(bench: RigBench) -> None:
    assert bench.write(CELL, objects.PRODUCER_HEARTBEAT, 0, 10, 2) == 0
    bench.frames.clear()
    bench.wait(200)
    assert len(heartbeats(bench, CELL)) == 20
    assert bench.write(CELL, objects.PRODUCER_HEARTBEAT, 0, 0, 2) == 0
    bench.frames.clear()
    bench.wait(500)
    assert heartbeats(bench, CELL) == []


def test_a_heartbeat_that_was_held_up_is_not_made_up_for(bench: RigBench) -> None:
    bench.wait(100)
    bench.frames.clear()
    bench.t_ns += 1_000_000_000
    bench.wait(20)
    assert len(heartbeats(bench, CELL)) == 1


def test_identity_tells_the_devices_apart(bench: RigBench) -> None:
    assert [bench.read(n, objects.DEVICE_TYPE) for n in (CELL, SLOPE, DRIVE)] == [
        objects.DEVICE_TYPE_404,
        objects.DEVICE_TYPE_410,
        objects.DEVICE_TYPE_402,
    ]
    assert len({bench.read(n, objects.IDENTITY, 4) for n in NODES}) == len(NODES)


def test_a_stopped_device_answers_neither_sdo_nor_sync(bench: RigBench) -> None:
    bench.nmt(START)
    bench.nmt(STOP)
    bench.frames.clear()
    bench.send(objects.SDO_RX_BASE + CELL, struct.pack("<BHBI", 0x40, 0x1000, 0, 0))
    bench.send(objects.SYNC_COB)
    assert bench.frames == []


def test_tpdos_come_by_sync_only_while_operational_in_order(bench: RigBench) -> None:
    bench.send(objects.SYNC_COB)
    assert not any(objects.TPDO1_BASE <= can_id < 0x200 for can_id, _ in bench.frames)
    bench.nmt(START)
    bench.frames.clear()
    for _ in range(10):
        bench.send(objects.SYNC_COB)
    tpdos = [can_id for can_id, _ in bench.frames]
    assert tpdos == [0x182, 0x184] * 10 + [0x183]


def test_transmission_type_n_answers_every_nth_sync(bench: RigBench) -> None:
    assert bench.write(SLOPE, objects.TPDO1_COMMUNICATION, 2, 3, 1) == 0
    bench.nmt(START)
    for _ in range(9):
        bench.send(objects.SYNC_COB)
    assert len(bench.sent(0x183)) == 3
    assert bench.write(SLOPE, objects.TPDO1_COMMUNICATION, 2, 0, 1) == Abort.VALUE_TOO_LOW
    assert bench.write(SLOPE, objects.TPDO1_COMMUNICATION, 2, 255, 1) == Abort.VALUE_TOO_HIGH


def test_syncs_are_counted_from_the_start_of_operation(bench: RigBench) -> None:
    for _ in range(2):
        bench.nmt(START)
        for _ in range(9):
            bench.send(objects.SYNC_COB)
        bench.nmt(PRE_OPERATIONAL)
    assert bench.sent(0x183) == []


def test_a_written_mapping_is_the_one_sent(bench: RigBench) -> None:
    unit = objects.ERROR_REGISTER << 16 | 8
    status = objects.AI_STATUS << 16 | 1 << 8 | 8
    for subindex, value, size in ((0, 0, 1), (1, status, 4), (2, unit, 4), (0, 2, 1)):
        assert bench.write(CELL, objects.TPDO1_MAPPING, subindex, value, size) == 0
    bench.nmt(START)
    bench.send(objects.SYNC_COB)
    assert bench.sent(0x182) == [b"\x00\x00"]


@pytest.mark.parametrize(
    ("subindex", "value", "size", "abort"),
    [
        (1, 0x91300120, 4, Abort.UNSUPPORTED_ACCESS),  # while the mapping is in use
        (0, 9, 1, Abort.PDO_TOO_LONG),
        (0, 3, 1, Abort.CANNOT_BE_MAPPED),  # entry 3 is empty
    ],
)
def test_a_mapping_in_use_is_protected(bench: RigBench, subindex: int, value: int, size: int, abort: int) -> None:
    assert bench.write(CELL, objects.TPDO1_MAPPING, subindex, value, size) == abort


@pytest.mark.parametrize(
    "value",
    [
        0x91300110,  # wrong length
        0x91300320,  # no such sub-index
        0x12340020,  # no such object
        0x10170010,  # not mappable
        0x00050008,  # a dummy has no value to send
    ],
)
def test_what_cannot_be_mapped_is_refused(bench: RigBench, value: int) -> None:
    assert bench.write(CELL, objects.TPDO1_MAPPING, 0, 0, 1) == 0
    assert bench.write(CELL, objects.TPDO1_MAPPING, 1, value, 4) == Abort.CANNOT_BE_MAPPED


def test_more_than_eight_bytes_are_refused(bench: RigBench) -> None:
    assert bench.write(CELL, objects.TPDO1_MAPPING, 0, 0, 1) == 0
    for subindex in (1, 2, 3):
        assert bench.write(CELL, objects.TPDO1_MAPPING, subindex, 0x91300120, 4) == 0
    assert bench.write(CELL, objects.TPDO1_MAPPING, 0, 3, 1) == Abort.PDO_TOO_LONG


def test_a_pdo_is_moved_by_switching_it_off_first(bench: RigBench) -> None:
    assert bench.write(CELL, objects.TPDO1_COMMUNICATION, 1, 0x1A0, 4) == Abort.VALUE_RANGE
    assert bench.write(CELL, objects.TPDO1_COMMUNICATION, 1, 0x80000182, 4) == 0
    bench.nmt(START)
    bench.send(objects.SYNC_COB)
    assert bench.sent(0x182) == []
    assert bench.write(CELL, objects.TPDO1_COMMUNICATION, 1, 0x1A0, 4) == 0
    bench.send(objects.SYNC_COB)
    assert len(bench.sent(0x1A0)) == 1


def test_resets_bring_the_defaults_back(bench: RigBench) -> None:
    for reset, resolution in ((RESET_COMMUNICATION, 100), (RESET_NODE, 10)):
        bench.write(SLOPE, objects.TPDO1_COMMUNICATION, 2, 3, 1)
        bench.write(SLOPE, objects.SLOPE_RESOLUTION, 0, 100, 2)
        bench.frames.clear()
        bench.nmt(reset, SLOPE)
        assert heartbeats(bench, SLOPE) == [NmtState.BOOT_UP]
        assert bench.read(SLOPE, objects.TPDO1_COMMUNICATION, 2) == 10
        assert bench.read(SLOPE, objects.SLOPE_RESOLUTION) == resolution


def test_sdo_refuses_what_the_dictionary_does_not_allow(bench: RigBench) -> None:
    assert bench.write(CELL, objects.AI_PHYSICAL_UNIT, 1, 0, 4) == 0x06010002  # read only
    assert bench.write(CELL, 0x5555, 0, 0, 4) == 0x06020000  # no such object
    assert bench.write(CELL, objects.PRODUCER_HEARTBEAT, 0, 5, 4) == 0x06070010  # length
    assert bench.write(SLOPE, objects.SLOPE_RESOLUTION, 0, 7, 2) == Abort.VALUE_RANGE


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=40))
@hypothesis_settings(deadline=None)
def test_no_frame_whatever_gets_out_of_a_device(frames: list[tuple[int, bytes]]) -> None:
    bench = RigBench()
    bench.nmt(START)
    for can_id, data in frames:
        bench.send(can_id, data)
        bench.wait(1)
    bench.nmt(RESET_NODE)
    assert bench.read(DRIVE, objects.DEVICE_TYPE) == objects.DEVICE_TYPE_402


@given(st.sampled_from(NODES), st.lists(st.binary(min_size=8, max_size=8), max_size=20))
@hypothesis_settings(deadline=None)
def test_no_sdo_request_whatever_breaks_the_server(node: int, requests: list[bytes]) -> None:
    bench = RigBench()
    for request in requests:
        bench.send(objects.SDO_RX_BASE + node, request)
    bench.nmt(RESET_NODE, node)
    assert bench.read(node, objects.IDENTITY, 4) > 0


@pytest.mark.parametrize("continued", [0x00, 0x10, 0x60, 0x70])
def test_a_segment_of_a_transfer_that_was_never_begun_is_refused(bench: RigBench, continued: int) -> None:
    """Download and upload segments, either toggle bit."""
    answer = bench.ask(CELL, bytes([continued, *bytes(7)]))
    assert answer[0] == 0x80
    assert struct.unpack_from("<I", answer, 4)[0] == Abort.COMMAND


def test_block_download_is_refused_in_silence(bench: RigBench, caplog: pytest.LogCaptureFixture) -> None:
    assert bench.ask(CELL, bytes([0xC6, 0x17, 0x10, 0, 4, 0, 0, 0])) == struct.pack(
        "<BHBI", 0x80, objects.PRODUCER_HEARTBEAT, 0, Abort.COMMAND
    )
    assert caplog.records == []


@pytest.mark.parametrize("frame", [b"", bytes(15), bytes(17), struct.pack("=IB3x8s", 0x80000080, 0, b"")])
def test_foreign_frames_are_passed_over(frame: bytes) -> None:
    bench = RigBench()
    bench.nmt(START)
    bench.frames.clear()
    bench.rig.receive(frame)
    assert bench.frames == []


def test_the_simulator_node_starts_the_move_once_and_tells_the_truth(bench: RigBench) -> None:
    assert bench.read(BENCH, objects.SIM_MOTION_STATE) == 0
    assert bench.write(BENCH, objects.SIM_MOTION_START, 0, 1, 1) == 0
    bench.wait(3000)
    assert bench.read(BENCH, objects.SIM_MOTION_STATE) == 1
    assert bench.write(BENCH, objects.SIM_MOTION_START, 0, 1, 1) == Abort.DEVICE_STATE
    assert bench.rig.truth.mechanism_rad == pytest.approx(0.01745329 * 1.0)  # 3 s at 0.5 deg/s, 1 s of it lost in ramp
    assert bench.read(BENCH, objects.SIM_TRUE_STROKE_UM) == 0


def test_without_a_demo_section_there_is_no_move_to_start() -> None:
    bench = RigBench(SETTINGS.model_copy(update={"demo": None}))
    assert bench.write(BENCH, objects.SIM_MOTION_START, 0, 1, 1) == Abort.DEVICE_STATE
