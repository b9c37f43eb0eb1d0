"""The errors of tension amplifier and inclinometer on the truth."""

from __future__ import annotations

import itertools
import math
import statistics

import pytest

from rigctl.devices import objects
from rigctl.devices.objects import AiStatus, EmcyCode
from tests.builders.rig_bench import SETTINGS, RigBench, changed

CELL, SLOPE = SETTINGS.tension_cell.node, SETTINGS.inclinometer.node
START = 0x01


def cell_samples(bench: RigBench, count: int) -> list[tuple[int, int]]:
    bench.frames.clear()
    for _ in range(count):
        bench.send(objects.SYNC_COB)
    return [objects.CELL_TPDO.codec.unpack(data) for data in bench.sent(objects.TPDO1_BASE + CELL)]


def signed(value: int) -> int:
    return value - 0x10000 if value & 0x8000 else value


def slopes(bench: RigBench) -> list[tuple[int, int]]:
    return [objects.SLOPE_TPDO.codec.unpack(data) for data in bench.sent(objects.TPDO1_BASE + SLOPE)]


def test_the_cell_reads_the_tension_in_millinewton_with_its_noise() -> None:
    bench = RigBench(changed(simulation={"rope": {"slack_mm": 0.0}}))
    bench.enable()
    bench.drive(1000, 0x0F, 10.0)
    bench.drive(1000, 0x0F, 0.0)
    samples = cell_samples(bench, 4000)
    readings = [value * objects.N_PER_CELL_UNIT for value, _ in samples]
    noise = SETTINGS.tension_cell.noise_n
    # 4000 samples: the mean is within 5 sigma / sqrt(4000), the spread within 5 / sqrt(8000) of itself
    assert statistics.mean(readings) == pytest.approx(bench.rig.truth.tension_n, abs=5 * noise / math.sqrt(4000))
    assert statistics.stdev(readings) == pytest.approx(noise, rel=5 / math.sqrt(8000))
    assert {status for _, status in samples} == {0}
    assert bench.rig.truth.tension_n > 50.0


def test_the_cell_has_its_resolution() -> None:
    bench = RigBench(changed(simulation={"cell": {"quantum_n": 0.05}}))
    bench.nmt(START)
    values = {value for value, _ in cell_samples(bench, 200)}
    assert all(value % 50 == 0 for value in values)
    assert len(values) > 1


def test_beyond_its_range_the_cell_saturates_and_says_so() -> None:
    bench = RigBench(changed(tension_cell={"range_n": 100.0}, simulation={"rope": {"slack_mm": 0.0}}))
    bench.enable()
    bench.drive(2500, 0x0F, 10.0)
    assert bench.rig.truth.tension_n > 101.0
    assert set(cell_samples(bench, 10)) == {(100_000, AiStatus.POSITIVE_OVERLOAD)}


def test_between_samples_too_the_amplifier_follows_the_tension() -> None:
    """Loaded at once and sampled a second later, a 5 Hz filter has settled; along a straight line it would trail."""
    bench = RigBench(changed(simulation={"cell": {"filter_hz": 5.0, "creep_pct": 0.0}}))
    bench.nmt(START)
    bench.rig.plant.preload(300.0)
    bench.wait(1000)
    ((value, _),) = cell_samples(bench, 1)
    assert value * objects.N_PER_CELL_UNIT == pytest.approx(300.0, abs=6 * SETTINGS.tension_cell.noise_n)


def test_the_same_seed_measures_the_same_and_another_does_not() -> None:
    def run(seed: int) -> list[tuple[int, int]]:
        bench = RigBench(changed(simulation={"seed": seed}))
        bench.nmt(START)
        return cell_samples(bench, 20)

    assert run(1) == run(1)
    assert run(1) != run(2)


@pytest.mark.parametrize("rate_hz", [10, 100])
def test_the_inclinometer_samples_at_its_own_rate(rate_hz: int) -> None:
    """Read at every SYNC, its value changes at most at its own rate: 2 s of noise show each new sample."""
    noisy = {"inclinometer": {"noise_deg": 1.0, "quantum_deg": 0.01}}
    bench = RigBench(changed(inclinometer={"rate_hz": rate_hz}, simulation=noisy))
    bench.write(SLOPE, objects.TPDO1_COMMUNICATION, 2, 1, 1)
    bench.nmt(START)
    for _ in range(2000):
        bench.send(objects.SYNC_COB)
        bench.wait(1)
    values = slopes(bench)
    changes = sum(before != after for before, after in itertools.pairwise(values))
    assert changes == pytest.approx(2 * rate_hz, abs=2)  # equal neighbours are 1 in 10^5


def test_a_slope_has_the_resolution_and_unit_that_its_object_says() -> None:
    bench = RigBench(changed(simulation={"inclinometer": {"noise_deg": 0.5, "quantum_deg": 0.1}}))
    bench.nmt(START)
    bench.wait(50)
    assert bench.read(SLOPE, objects.SLOPE_RESOLUTION) == objects.SLOPE_RESOLUTION_MDEG
    fine = signed(bench.read(SLOPE, objects.SLOPE_LONG))
    assert fine != 0 and fine % 10 == 0  # 0.1 deg in units of 0.01 deg
    assert bench.write(SLOPE, objects.SLOPE_RESOLUTION, 0, 100, 2) == 0
    assert signed(bench.read(SLOPE, objects.SLOPE_LONG)) == fine // 10


def test_the_filter_is_a_first_order_low_pass_on_the_tangential_angle() -> None:
    """With the rail stuck, the rope turns at a constant rate; a first-order low-pass trails by 1 / (2 pi f)."""
    filter_hz = 0.5
    quiet = {
        "inclinometer": {"filter_hz": filter_hz, "noise_deg": 0.0},
        "rail": {"friction_static": 1.0},
        "pulley": {"rest_share": 0.0},
        "rope": {"slack_mm": 0.0},
    }
    bench = RigBench(changed(simulation=quiet))
    bench.enable()
    bench.drive(1000, 0x0F, 10.0)
    assert bench.rig.start_motion()
    bench.drive(2000, 0x0F, 0.0)  # the ramp
    bench.frames.clear()
    bench.drive(4000, 0x0F, 0.0)
    rate_deg_s = math.degrees(math.radians(0.5) * 750.0 / 1800.0)
    expected = math.degrees(bench.rig.truth.tangential_rad) - rate_deg_s / (2 * math.pi * filter_hz)
    long, lateral = slopes(bench)[-1]
    assert long * 0.01 == pytest.approx(expected, abs=0.008)  # half a quantum, and the age of up to 10 ms
    assert lateral == -2  # R (cos 2.5 deg - 1) / L = -0.023 deg, less 0.003 deg of trail
    assert rate_deg_s / (2 * math.pi * filter_hz) > 0.05


def test_beyond_its_range_both_slopes_are_invalid_with_an_emergency() -> None:
    bench = RigBench(changed(inclinometer={"range_deg": 0.5}, simulation={"rail": {"friction_static": 1.0}}))
    bench.nmt(START)
    assert bench.rig.start_motion()
    bench.wait(8000)
    for _ in range(10):
        bench.send(objects.SYNC_COB)
    assert slopes(bench) == [(objects.SLOPE_INVALID, objects.SLOPE_INVALID)]
    assert bench.emergencies(SLOPE) == [EmcyCode.SENSOR_INVALID]
    bench.wait(46_000)  # back at the start
    assert bench.emergencies(SLOPE) == [EmcyCode.SENSOR_INVALID, EmcyCode.NO_ERROR]
