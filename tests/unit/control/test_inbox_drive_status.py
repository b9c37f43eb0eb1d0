"""The drive's second TPDO and its emergency message in the inbox: current, temperature, emergency stop, lost frames."""

from __future__ import annotations

import math
import struct

import can
import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.devices import objects as od
from tests.unit.control.test_plain_inbox import CONFIG, Bench
from tests.unit.hil.test_parameter_sets import with_set

RIG = config.load(CONFIG / "paper_rig.yaml")
NODE = RIG.cylinder.node
STATUS, EMERGENCY = od.TPDO2_BASE + NODE, od.EMCY_BASE + NODE
CLOSED, OPEN = 1 << 16, 0


def status(current: int = 0, temperature: int = 250, inputs: int = CLOSED) -> bytes:
    return od.DRIVE_TPDO2.codec.pack(current, temperature, inputs)


def emergency(code: int) -> bytes:
    return struct.pack("<HB5x", code, 1)


def test_current_is_by_the_rated_one_and_nothing_is_known_at_first() -> None:
    bench = Bench(RIG)
    assert math.isnan(bench.inbox.drive_status.current_a + bench.inbox.drive_status.temperature_c)
    bench.give(STATUS, status(-250, 415))
    assert bench.inbox.drive_status.current_a == pytest.approx(-0.25 * 3.0)
    assert bench.inbox.drive_status.temperature_c == pytest.approx(41.5)
    assert bench.inbox.drive_status.t_ns == bench.t_ns


def test_the_emergency_stop_is_the_newest_of_message_and_input() -> None:
    bench = Bench(RIG)
    bench.give(STATUS, status())
    assert not bench.inbox.drive_status.e_stop
    bench.give(EMERGENCY, emergency(od.EmcyCode.HEARTBEAT_LOST))
    assert not bench.inbox.drive_status.e_stop  # an emergency message of another cause
    bench.give(EMERGENCY, emergency(od.EmcyCode.EXTERNAL))
    assert bench.inbox.drive_status.e_stop
    bench.give(STATUS, status(inputs=OPEN | 0xFFFE_FFFF))
    assert bench.inbox.drive_status.e_stop
    bench.give(EMERGENCY, emergency(od.EmcyCode.NO_ERROR))
    assert bench.inbox.drive_status.e_stop  # the input decides
    bench.give(STATUS, status())
    assert not bench.inbox.drive_status.e_stop


def test_without_an_emergency_stop_input_none_of_the_drives_inputs_is_one() -> None:
    bench = Bench(changed(RIG, {"cylinder.e_stop_input": None}))
    for inputs in (0, 1, CLOSED, 0xFFFF_FFFF):
        bench.give(STATUS, status(inputs=inputs))
        assert not bench.inbox.drive_status.e_stop


def test_the_same_message_of_another_device_is_no_emergency_stop() -> None:
    bench = Bench(RIG)
    bench.give(od.EMCY_BASE + RIG.tension_cell.node, emergency(od.EmcyCode.EXTERNAL))
    assert not bench.inbox.drive_status.e_stop


def test_without_one_fitted_neither_is_one() -> None:
    bench = Bench(RIG.model_copy(update={"cylinder": RIG.cylinder.model_copy(update={"e_stop_input": None})}))
    bench.give(STATUS, status(inputs=OPEN))
    bench.give(EMERGENCY, emergency(od.EmcyCode.EXTERNAL))
    assert not bench.inbox.drive_status.e_stop


def test_a_status_of_a_wrong_length_is_refused() -> None:
    bench = Bench(RIG)
    bench.give(STATUS, status()[:7])
    assert (bench.inbox.refused, bench.inbox.drive_status.t_ns < 0) == (1, True)


def test_a_status_that_does_not_come_is_missing() -> None:
    bench = Bench(RIG)
    bench.give(STATUS, status())
    for tick in range(1, 3 * RIG.status_divisor):
        bench.give(0x7FF, b"")
        assert bench.inbox.frames_missing() == tick // RIG.status_divisor


def test_a_speed_in_a_frame_of_its_own_is_missing_if_it_does_not_come() -> None:
    stock = with_set("stock_drive")
    bench, cylinder = Bench(stock), stock.cylinder
    speed, place = (od.tpdo_base(pdo) + cylinder.node for pdo in (cylinder.velocity_pdo, cylinder.position_pdo))
    for _ in range(3):
        bench.bus.send(can.Message(arbitration_id=speed, data=bytes(4), is_extended_id=False))
        bench.give(place, bytes(6))
    assert bench.inbox.frames_missing() == 0
    for lost in range(1, 4):
        bench.give(place, bytes(6))
        assert bench.inbox.frames_missing() == lost
