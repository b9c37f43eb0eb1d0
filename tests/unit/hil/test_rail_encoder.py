"""The simulated rail encoder on its bus."""

from __future__ import annotations

import math
import struct

import pytest

from hil.plant.layout import MECHANISM
from hil.plant.moves import out_and_back
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.devices import objects
from tests.builders.rig_bench import SETTINGS, RigBench

NODE = 5
COUNTS = 1 << 20
FITTED = SETTINGS.model_copy(update={"rail_encoder": RailEncoderSettings(counts_per_turn=COUNTS, rate_hz=1000)})


@pytest.fixture
def bench() -> RigBench:
    return RigBench(FITTED)


def positions(bench: RigBench) -> list[int]:
    return [int(struct.unpack("<I", data)[0]) for data in bench.sent(objects.TPDO1_BASE + NODE)]


def test_a_rig_without_the_section_has_no_such_node() -> None:
    bench = RigBench()
    bench.nmt(1)
    bench.drive(20, 0)
    assert bench.rig.rail_encoder is None
    assert not [can_id for can_id, _ in bench.frames if can_id & 0x7F == NODE]


def test_it_tells_what_it_is_and_how_it_counts(bench: RigBench) -> None:
    assert bench.read(NODE, objects.DEVICE_TYPE) == objects.DEVICE_TYPE_406
    assert bench.read(NODE, objects.ENCODER_COUNTS_PER_TURN) == COUNTS
    assert bench.read(NODE, objects.ENCODER_TOTAL_RANGE) == COUNTS


def test_it_answers_every_nth_sync_with_the_rails_angle(bench: RigBench) -> None:
    bench.write(NODE, objects.TPDO1_COMMUNICATION, 2, 10, 1)
    bench.nmt(1)
    bench.drive(100, 0)
    assert positions(bench) == [math.floor(bench.rig.truth.rail_rad / math.tau * COUNTS) % COUNTS] * 10


def test_it_follows_the_rail_and_counts_on_below_zero_from_the_end_of_its_range(bench: RigBench) -> None:
    bench.rig.plant.preload(300.0)
    back = out_and_back(math.radians(10.0), math.radians(5.0), math.radians(50.0))
    back.segments[:, 1:] *= -1.0  # reversed
    bench.rig.plant.start_motion({MECHANISM: back}, 0)
    bench.nmt(1)
    bench.drive(1500, 0)
    rail = bench.rig.truth.rail_rad
    assert rail < math.radians(-1.0)
    assert bench.read(NODE, objects.ENCODER_POSITION) == math.floor(rail / math.tau * COUNTS) + COUNTS


def test_another_scale_is_taken_and_gone_after_a_reset(bench: RigBench) -> None:
    assert bench.write(NODE, objects.ENCODER_COUNTS_PER_TURN, 0, 0, 4) != 0  # 0 counts in a turn: refused
    assert bench.write(NODE, objects.ENCODER_COUNTS_PER_TURN, 0, 4096, 4) == 0
    assert bench.write(NODE, objects.ENCODER_TOTAL_RANGE, 0, 8192, 4) == 0
    bench.rig.plant.start_motion({MECHANISM: out_and_back(0.2, 0.2, 2.0)}, 0)
    bench.wait(1000)
    assert bench.read(NODE, objects.ENCODER_POSITION) == math.floor(bench.rig.truth.rail_rad / math.tau * 4096) % 8192
    bench.nmt(0x81, NODE)
    assert bench.read(NODE, objects.ENCODER_COUNTS_PER_TURN) == COUNTS
