"""Faults of SYNC, RPDO and TPDO content in the simulated devices, and a drive whose polarity another master changes."""

from __future__ import annotations

import struct

import pytest

from hil.faults import in_device, on_bus
from hil.faults.stand import FaultyRig, Injector, Stand, Step
from hil.nodes.dictionary import Abort
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from rigctl.devices.objects import Controlword
from tests.builders.rig_bench import SETTINGS, RigBench

CELL, DRIVE = SETTINGS.tension_cell.node, SETTINGS.cylinder.node
ENABLE = Controlword.ENABLE_OPERATION
START, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x81, 0x82
ELSEWHERE = 0x0FF
BOTH_POLARITIES = objects.POSITION_POLARITY | objects.VELOCITY_POLARITY


class _Faulty(RigBench):
    """The bench as a fault meets it."""

    settings: RigSettings = SETTINGS

    def inject(self, frame: bytes) -> None:
        can_id, size, data = FRAME.unpack(frame)
        self.send(can_id, data[:size])


@pytest.fixture
def bench() -> _Faulty:
    bench = _Faulty()
    bench.enable()
    bench.drive(500, ENABLE, 5.0)
    return bench


def put(bench: _Faulty, injector: Injector) -> Step | None:
    faulty: FaultyRig = bench
    return injector(Stand(faulty, "test"))


def samples(bench: RigBench, node: int, ticks: int, velocity_mm_s: float = 5.0) -> list[bytes]:
    before = len(bench.sent(objects.TPDO1_BASE + node))
    bench.drive(ticks, ENABLE, velocity_mm_s)
    return bench.sent(objects.TPDO1_BASE + node)[before:]


def speed(bench: RigBench) -> float:
    return bench.rig.truth.speed_mm_s


@pytest.mark.parametrize("node", [CELL, DRIVE])
def test_a_device_takes_the_frames_that_its_sync_object_names_for_sync(bench: _Faulty, node: int) -> None:
    assert bench.write(node, objects.SYNC_COB_ID, 0, ELSEWHERE, 4) == 0
    assert bench.read(node, objects.SYNC_COB_ID) == ELSEWHERE
    assert samples(bench, node, 20) == []
    assert len(samples(bench, CELL + DRIVE - node, 20)) == 20
    before = len(bench.sent(objects.TPDO1_BASE + node))
    bench.send(ELSEWHERE)
    assert len(bench.sent(objects.TPDO1_BASE + node)) == before + 1
    assert bench.write(node, objects.SYNC_COB_ID, 0, objects.SYNC_COB, 4) == 0
    assert len(samples(bench, node, 20)) == 20


def test_a_reset_of_communication_brings_the_sync_back(bench: _Faulty) -> None:
    bench.write(CELL, objects.SYNC_COB_ID, 0, ELSEWHERE, 4)
    bench.nmt(RESET_COMMUNICATION, CELL)
    bench.nmt(START, CELL)
    assert len(samples(bench, CELL, 20)) == 20


@pytest.mark.parametrize("entry", [1 << 30 | objects.SYNC_COB, 1 << 29 | objects.SYNC_COB, 0x800])
def test_a_device_that_sends_no_sync_and_hears_no_extended_one_refuses_to(bench: _Faulty, entry: int) -> None:
    assert bench.write(DRIVE, objects.SYNC_COB_ID, 0, entry, 4) == Abort.VALUE_RANGE
    assert len(samples(bench, DRIVE, 20)) == 20


def test_without_sync_the_drive_keeps_its_last_speed_and_nothing_at_it_objects(bench: _Faulty) -> None:
    put(bench, on_bus.sdo_write(objects.SYNC_COB_ID, 0, 4, ELSEWHERE))
    bench.drive(500, ENABLE, 0.0)
    assert speed(bench) == pytest.approx(5.0)
    assert bench.emergencies(DRIVE) == []


@pytest.mark.parametrize(
    ("injector", "cell_samples", "speed_mm_s"),
    [
        (on_bus.sync_lost(), 0, 5.0),
        (on_bus.sync_twice(), 1000, 0.0),
        (on_bus.sdo_write(objects.SYNC_COB_ID, 0, 4, ELSEWHERE), 500, 5.0),
        (on_bus.sdo_write(objects.SYNC_COB_ID, 0, 4, ELSEWHERE, on_bus.cell), 0, 0.0),
        (in_device.sync_unheard(on_bus.drive), 500, 5.0),
        (in_device.sync_unheard(on_bus.cell), 0, 0.0),
        (in_device.rpdo_ignored(), 500, 5.0),
        (on_bus.frozen(on_bus.cell), 500, 0.0),
    ],
)
def test_a_fault_of_sync_takes_samples_commands_or_both(
    bench: _Faulty, injector: Injector, cell_samples: int, speed_mm_s: float
) -> None:
    put(bench, injector)
    assert len(samples(bench, CELL, 500, 0.0)) == cell_samples
    assert speed(bench) == pytest.approx(speed_mm_s, abs=1e-6)
    assert bench.emergencies(DRIVE) == []


def test_a_foreign_sync_makes_the_devices_send_more(bench: _Faulty) -> None:
    step = put(bench, on_bus.sync_foreign())
    assert step is not None
    step(0.0)
    step(0.001)
    before = len(bench.sent(objects.TPDO1_BASE + CELL))
    step(0.002)
    assert len(bench.sent(objects.TPDO1_BASE + CELL)) == before + 1


def test_a_frozen_rpdo_repeats_the_command_that_came_first(bench: _Faulty) -> None:
    put(bench, in_device.rpdo_frozen())
    bench.drive(1, ENABLE, 3.0)
    bench.drive(500, Controlword.QUICK_STOP)
    assert speed(bench) == pytest.approx(3.0)


def test_a_late_rpdo_is_obeyed_as_many_ticks_late(bench: _Faulty) -> None:
    put(bench, in_device.rpdo_late(50))
    bench.drive(50, ENABLE, 0.0)
    assert bench.rig.drive.control.stage.velocity_mm_s == 5.0
    bench.drive(1, ENABLE, 0.0)
    assert bench.rig.drive.control.stage.velocity_mm_s == 0.0


def test_frozen_samples_repeat_to_the_last_bit_while_the_stroke_moves(bench: _Faulty) -> None:
    assert len(set(samples(bench, DRIVE, 50))) > 1
    put(bench, on_bus.frozen(on_bus.drive))
    assert len(set(samples(bench, DRIVE, 50))) == 1
    assert len(set(samples(bench, CELL, 50))) > 1


def test_defects_of_the_wire_add_up_and_go_one_by_one(bench: _Faulty) -> None:
    stand = Stand(bench, "test")
    without_sync = stand.intercept(lambda _, frame: () if on_bus.can_id(frame) == objects.SYNC_COB else (frame,))
    put(bench, on_bus.twice())
    assert samples(bench, CELL, 20) == []
    without_sync()
    assert len(samples(bench, CELL, 20)) == 80  # SYNC comes twice, and so does each answer


@pytest.mark.parametrize(
    ("polarity", "position_sign", "velocity_sign"),
    [(objects.POSITION_POLARITY, -1, 1), (objects.VELOCITY_POLARITY, 1, -1), (BOTH_POLARITIES, -1, -1)],
)
def test_a_foreign_polarity_turns_the_way_the_motor_goes_and_what_it_reports(
    bench: _Faulty, polarity: int, position_sign: int, velocity_sign: int
) -> None:
    put(bench, on_bus.sdo_write(objects.POLARITY, 0, 1, polarity))
    bench.drive(300, ENABLE, 5.0)
    truth = bench.rig.truth
    assert truth.speed_mm_s == pytest.approx(velocity_sign * 5.0)
    _, position, velocity = objects.DRIVE_TPDO.codec.unpack(samples(bench, DRIVE, 1)[0])
    assert position * objects.MM_PER_POSITION_UNIT == pytest.approx(
        position_sign * truth.stroke_mm, abs=0.1
    )  # the nut has its play on a slack rope
    assert velocity == 500  # its own direction is the right one to the drive
    (reported,) = struct.unpack("<i", struct.pack("<I", bench.read(DRIVE, objects.VELOCITY_ACTUAL)))
    assert reported == pytest.approx(5000, abs=10)
    bench.nmt(RESET_NODE, DRIVE)
    assert bench.read(DRIVE, objects.POLARITY) == 0
