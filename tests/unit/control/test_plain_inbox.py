"""Plain frames in the loop's inbox: values, quality and counters, and which ids reach it at all."""

from __future__ import annotations

import math
import struct
from collections import deque

import can
import pytest

from rigctl.config import rig_file as config
from rigctl.config.plain import PlainSignal
from rigctl.config.sensor_sections import PlainMessages
from rigctl.config.settings import RigSettings
from rigctl.control.control_process import receive_filters
from rigctl.devices import objects as od
from rigctl.devices.process_data import wanted
from rigctl.model.samples import Quality
from tests.builders import inboxes
from tests.builders.paths import ROOT

CONFIG = ROOT / "config"
PLAIN = config.load(CONFIG / "plain_rig.yaml")
CELL, SLOPE = PLAIN.plain_messages["tension_cell"], PLAIN.plain_messages["inclinometer"]


class Queue(can.BusABC):
    """A bus whose frames come from the test."""

    def __init__(self) -> None:
        self.frames: deque[can.Message] = deque()
        super().__init__(channel="queue")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        self.frames.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        return (self.frames.popleft() if self.frames else None), True


class Bench:
    def __init__(self, settings: RigSettings = PLAIN) -> None:
        self.bus = Queue()
        self.inbox = inboxes.alone(settings, self.bus)
        self.t_ns = 0

    def give(self, can_id: int, data: bytes, *, extended: bool = False) -> None:
        self.t_ns += 1_000_000
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=extended))
        self.inbox.drain(self.t_ns, self.t_ns // 1_000_000)


def test_a_tension_frame_is_a_fresh_sample() -> None:
    bench = Bench()
    bench.give(CELL.can_id, CELL.payload({"tension": 300.125, "valid": 1.0}))
    assert bench.inbox.cell.tension_n == pytest.approx(300.125, abs=1e-9)
    assert (bench.inbox.cell.quality, bench.inbox.cell.t_ns, bench.inbox.cell_fresh) == (0, bench.t_ns, True)


def test_valid_0_is_seen_and_its_value_is_not_taken() -> None:
    bench = Bench()
    bench.give(CELL.can_id, CELL.payload({"tension": 300.0, "valid": 1.0}))
    bench.give(CELL.can_id, CELL.payload({"tension": 1.0, "valid": 0.0}))
    inbox = bench.inbox
    assert (inbox.cell.tension_n, inbox.cell.quality, inbox.cell_fresh) == (300.0, Quality.INVALID, False)
    assert inbox.cell.t_ns == bench.t_ns
    assert inbox.refused == 0
    angles = {"tangential": 0.1, "normal": -0.1}
    bench.give(SLOPE.can_id, SLOPE.payload({**angles, "valid": 1.0}))
    bench.give(SLOPE.can_id, SLOPE.payload({"valid": 0.0}))
    assert inbox.slope.quality == Quality.INVALID
    assert (inbox.slope.tangential_rad, inbox.slope.normal_rad) == pytest.approx((0.1, -0.1), abs=math.radians(0.005))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_invalid_counted_and_not_taken(value: float) -> None:
    signal = PlainSignal(
        name="t", start=0, length=32, big_endian=False, signed=True, floating=True, scale=1.0, offset=0.0
    )
    message = CELL.model_copy(update={"size": 4, "signals": {"tension": signal}})
    bench = Bench(PLAIN.model_copy(update={"plain": PLAIN.plain.model_copy(update={"tension_cell": message})}))
    bench.give(message.can_id, struct.pack("<f", 42.0))
    bench.give(message.can_id, struct.pack("<f", value))
    inbox = bench.inbox
    assert (inbox.cell.tension_n, inbox.cell.quality, inbox.cell_fresh) == (42.0, Quality.INVALID, False)
    assert inbox.refused == 1


@pytest.mark.parametrize("size", [0, 4, 6, 8])
def test_a_wrong_length_is_refused_and_nothing_of_it_taken(size: int) -> None:
    bench = Bench()
    for message in (CELL, SLOPE):
        bench.give(message.can_id, bytes(size))
    assert bench.inbox.refused == 2
    assert (bench.inbox.cell.quality, bench.inbox.slope.quality) == (Quality.NEVER, Quality.NEVER)


def test_an_extended_frame_with_the_same_number_is_another_frame() -> None:
    bench = Bench()
    bench.give(CELL.can_id, CELL.payload({"valid": 1.0}), extended=True)
    assert bench.inbox.cell.quality == Quality.NEVER


def test_plain_frames_are_never_missing() -> None:
    bench = Bench()
    bench.give(CELL.can_id, CELL.payload({"valid": 1.0}))
    bench.give(SLOPE.can_id, SLOPE.payload({"valid": 1.0}))
    for _ in range(100):
        bench.give(od.DRIVE_TPDO.cob_base + 4, od.DRIVE_TPDO.codec.pack(0, 0, 0))
    assert bench.inbox.frames_missing() == 0


def test_the_filters_let_through_what_is_decoded_and_nothing_else() -> None:
    def ids(settings: RigSettings) -> set[int]:
        filters = receive_filters(settings, wanted(settings))
        assert all(f["can_mask"] == 0x7FF and not f.get("extended", True) for f in filters)
        return {f["can_id"] for f in filters}

    rivals = {0x000, 0x080, 0x204, 0x701}  # frames that only another controller sends
    assert ids(PLAIN) == {0x110, 0x111, 0x084, 0x184, 0x284, 0x584, 0x604, 0x704} | rivals
    canopen = ids(config.load(CONFIG / "paper_rig.yaml"))
    bases = (0x080, 0x180, 0x580, 0x600, 0x700)
    assert canopen == {base + node for base in bases for node in (2, 3, 4)} | {0x284} | rivals


def test_settings_whose_dbc_files_were_not_read_are_refused() -> None:
    with pytest.raises(ValueError, match="tension_cell: its DBC file has not been read"):
        Bench(PLAIN.model_copy(update={"plain": PlainMessages()}))
