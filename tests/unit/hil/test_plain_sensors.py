"""The simulated sensors with plain frames: when they send, and their values read with cantools."""

from __future__ import annotations

import math
import statistics
from typing import Any

import cantools
import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from tests.builders.rig_bench import REPOSITORY, SAME_CLOCKS, RigBench, changed

PLAIN = changed(config.load(REPOSITORY / "config/plain_rig.yaml"), simulation=SAME_CLOCKS)
DATABASE = cantools.database.load_file(str(REPOSITORY / "config/plain_sensors.dbc"))
TENSION, INCLINATION = DATABASE.get_message_by_name("Tension"), DATABASE.get_message_by_name("Inclination")
QUIET = {
    "inclinometer": {"noise_deg": 0.0},
    "rail": {"friction_static": 1.0},
    "rope": {"slack_mm": 0.0},
}


def sent(bench: RigBench, message: Any) -> list[dict[str, float]]:
    return [message.decode(data, decode_choices=False) for data in bench.sent(message.frame_id)]


def with_cycle(settings: RigSettings, device: str, cycle_ms: int | None) -> RigSettings:
    message = getattr(settings.plain, device).model_copy(update={"cycle_ms": cycle_ms})
    return changed(settings, plain={device: message})


def test_they_send_at_their_cycle_time_without_sync_or_start() -> None:
    bench = RigBench(PLAIN)
    bench.wait(1000)
    assert len(sent(bench, TENSION)) == 1000
    assert len(sent(bench, INCLINATION)) == 100


@pytest.mark.parametrize(("cycle_ms", "frames"), [(3, 333), (None, 1000)])
def test_another_cycle_time_or_none_is_kept_on_the_rigs_grid(cycle_ms: int | None, frames: int) -> None:
    bench = RigBench(with_cycle(PLAIN, "tension_cell", cycle_ms))
    bench.wait(1000)
    assert len(sent(bench, TENSION)) == frames


def test_they_are_no_canopen_nodes() -> None:
    bench = RigBench(PLAIN)
    bench.nmt(1)
    bench.drive(20, 0)
    ids = {can_id for can_id, _ in bench.frames}
    assert ids == {0x110, 0x111, objects.TPDO1_BASE + 4, *(objects.HEARTBEAT_BASE + n for n in (4, 112))} & ids
    assert {node.id for node in bench.rig.nodes} == {4, objects.SIMULATOR_NODE}


def test_the_cell_measures_as_the_canopen_one_does() -> None:
    """Same truth, same seed, one sample a millisecond each: the same numbers in newton."""
    plain, other = RigBench(PLAIN), RigBench()
    other.nmt(1)
    plain.wait(200)
    for _ in range(200):
        other.send(objects.SYNC_COB)
        other.wait(1)
    canopen = [objects.CELL_TPDO.codec.unpack(data)[0] for data in other.sent(objects.TPDO1_BASE + 2)]
    found = [round(values["RopeTension"] * 1000) for values in sent(plain, TENSION)]
    assert found == canopen
    assert statistics.stdev(found) > 0
    assert all(values["TensionValid"] == 1 for values in sent(plain, TENSION))


def test_beyond_its_range_the_cell_stays_there_and_is_not_valid() -> None:
    bench = RigBench(changed(PLAIN, tension_cell={"range_n": 100.0}, simulation={"rope": {"slack_mm": 0.0}}))
    bench.enable()
    bench.drive(2500, 0x0F, 10.0)
    assert bench.rig.truth.tension_n > 101.0
    assert sent(bench, TENSION)[-1] == {"RopeTension": 100.0, "TensionValid": 0}


def test_the_inclinometer_sends_both_angles_in_the_units_of_its_dbc() -> None:
    bench = RigBench(changed(PLAIN, simulation=QUIET))
    assert bench.rig.start_motion()
    bench.wait(6000)
    truth, values = bench.rig.truth, sent(bench, INCLINATION)[-1]
    # half a quantum of 0.01 deg, and the change in a cycle and the filter's 8 ms
    assert values["AngleTangential"] == pytest.approx(math.degrees(truth.tangential_rad), abs=0.009)
    assert values["AngleTangential"] > 0.3
    assert values["AngleNormal"] == pytest.approx(math.degrees(truth.normal_rad), abs=0.009)
    assert values["AngleValid"] == 1


def test_beyond_its_range_the_inclinometer_is_not_valid() -> None:
    bench = RigBench(changed(PLAIN, inclinometer={"range_deg": 0.5}, simulation=QUIET))
    assert bench.rig.start_motion()
    bench.wait(8000)
    assert sent(bench, INCLINATION)[-1]["AngleValid"] == 0
