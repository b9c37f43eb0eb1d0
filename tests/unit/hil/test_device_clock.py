"""Clocks that drift from each other, and the timers that run on them."""

from __future__ import annotations

import itertools
import struct

import pytest

from hil.nodes.clock import DeviceClock
from rigctl.config import rig_file as config
from rigctl.devices import objects
from rigctl.devices.objects import EmcyCode
from tests.builders.rig_bench import MS, REPOSITORY, SAME_CLOCKS, SETTINGS, RigBench, changed

CELL, SLOPE, DRIVE = SETTINGS.tension_cell.node, SETTINGS.inclinometer.node, SETTINGS.cylinder.node
HOUR = 3_600_000_000_000
START = 0x01


@pytest.mark.parametrize("ppm", [50.0, -30.0, 0.0])
def test_a_clock_gains_its_parts_per_million_from_the_start(ppm: float) -> None:
    clock = DeviceClock(7 * HOUR, ppm)
    assert clock.local_ns(7 * HOUR) == 7 * HOUR
    assert clock.local_ns(8 * HOUR) == 8 * HOUR + round(3600e3 * ppm)
    assert clock.span_ns(MS) == MS + ppm


@pytest.mark.parametrize(("ppm", "samples"), [(1000.0, 2003), (0.0, 2001), (-1000.0, 1999)])
def test_the_inclinometer_samples_by_its_own_clock(ppm: float, samples: int) -> None:
    """One sample at power-on and 4 s at 500 Hz; read every millisecond, noise shows each new sample."""
    noisy = {"noise_deg": 1.0, "quantum_deg": 0.01, "clock_ppm": ppm}
    bench = RigBench(changed(inclinometer={"rate_hz": 500}, simulation={"inclinometer": noisy}))
    bench.write(SLOPE, objects.TPDO1_COMMUNICATION, 2, 1, 1)
    bench.nmt(START)
    for _ in range(4000):
        bench.send(objects.SYNC_COB)
        bench.wait(1)
    bench.send(objects.SYNC_COB)
    changes = sum(a != b for a, b in itertools.pairwise(bench.sent(objects.TPDO1_BASE + SLOPE)))
    assert changes == samples  # equal neighbours are 1 in 10^5


@pytest.mark.parametrize(("ppm", "tensions", "slopes"), [(1000.0, 10_010, 1001), (-1000.0, 9990, 999)])
def test_plain_frames_come_by_their_senders_clock(ppm: float, tensions: int, slopes: int) -> None:
    clocks = SAME_CLOCKS | {"cell": {"clock_ppm": ppm}, "inclinometer": {"clock_ppm": ppm}}
    bench = RigBench(changed(config.load(REPOSITORY / "config/plain_rig.yaml"), simulation=clocks))
    bench.wait(10_000)
    assert (len(bench.sent(0x110)), len(bench.sent(0x111))) == (tensions, slopes)


@pytest.mark.parametrize(("ppm", "beats"), [(1000.0, 1001), (0.0, 1000), (-1000.0, 999)])
def test_heartbeats_come_by_their_senders_clock(ppm: float, beats: int) -> None:
    bench = RigBench(changed(simulation={"cell": {"clock_ppm": ppm}}))
    for node in (CELL, SLOPE):
        bench.write(node, objects.PRODUCER_HEARTBEAT, 0, 10, 2)
    bench.frames.clear()
    bench.wait(10_000)
    assert len(bench.sent(objects.HEARTBEAT_BASE + CELL)) == beats
    assert len(bench.sent(objects.HEARTBEAT_BASE + SLOPE)) == 1000  # the other device has its own clock


@pytest.mark.parametrize(("ppm", "silence_ms"), [(1000.0, 4996), (0.0, 5001), (-1000.0, 5006)])
def test_the_drive_judges_silence_by_its_own_clock(ppm: float, silence_ms: int) -> None:
    """5 s of heartbeat time; the first millisecond beyond it, or 5 earlier or later."""
    bench = RigBench(changed(simulation={"drive": {"clock_ppm": ppm}}))
    bench.write(DRIVE, objects.CONSUMER_HEARTBEAT, 1, SETTINGS.can.controller_node << 16 | 5000, 4)
    bench.nmt(START)
    bench.send(objects.HEARTBEAT_BASE + SETTINGS.can.controller_node, b"\x05")
    bench.wait(silence_ms - 1)
    assert bench.emergencies(DRIVE) == []
    bench.wait(1)
    assert bench.emergencies(DRIVE) == [EmcyCode.HEARTBEAT_LOST]


def test_samples_driven_by_sync_do_not_depend_on_the_cells_clock() -> None:
    def readings(ppm: float) -> list[int]:
        bench = RigBench(changed(simulation={"cell": {"clock_ppm": ppm}}))
        bench.nmt(START)
        for _ in range(500):
            bench.send(objects.SYNC_COB)
            bench.wait(1)
        return [struct.unpack_from("<i", data)[0] for data in bench.sent(objects.TPDO1_BASE + CELL)]

    assert len(readings(1000.0)) == 500
    assert readings(1000.0) == readings(-1000.0)
