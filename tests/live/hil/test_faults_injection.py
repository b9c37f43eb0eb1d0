"""The injectors of faults have their stated effect, and none while unused."""

from __future__ import annotations

import pathlib
import subprocess
import sys
import time
from collections.abc import Iterator

import can
import pytest

from hil.faults import in_device, in_plant, on_bus, stand, wall_clock
from hil.faults.stand import Injector, Stand
from hil.hub import Hub
from hil.lockstep import Lockstep, lockstep
from rigctl.config import rig_file as config
from rigctl.design.margins import design_and_check
from rigctl.model.states import Mode
from tests.builders.paths import ROOT

RIG = config.load(ROOT / "config/paper_rig.yaml")
GAINS = design_and_check(RIG).gains


@pytest.fixture
def rig() -> Iterator[Lockstep]:
    """A rig in HOLD, 300 N on the rope."""
    with lockstep(RIG, GAINS) as subject:
        stand.start(subject, Mode.HOLD, None)
        stand.enter(subject, Mode.HOLD)
        yield subject


def put_in(rig: Lockstep, fault: Injector, ticks: int = 5) -> None:
    step = fault(Stand(rig, "test"))
    for n in range(ticks):
        if step is not None:
            step(n * 1e-3)
        rig.loop.tick()


def newest(rig: Lockstep) -> dict[str, float]:
    record = rig.run(1e-3)[-1]
    return {name: record[name].item() for name in record.dtype.names}


# -- the wire -------------------------------------------------------------------------------------------------------
def test_a_tap_decides_what_goes_on_the_wire() -> None:
    hub, heard = Hub(), list[bytes]()
    sender = hub.attach(lambda _: None)
    hub.attach(heard.append)
    hub.tap = lambda port, frame: (frame, b"more") if port is sender and frame != b"gone" else ()
    for frame in (b"one", b"gone"):
        sender.send(frame)
    hub.put(sender, b"past")
    hub.tap = None
    sender.send(b"last")
    assert heard == [b"one", b"more", b"past", b"last"]


def test_what_a_tap_raises_meets_the_sender_and_the_wire_goes_on() -> None:
    def refuse(_port: object, _frame: bytes) -> tuple[bytes, ...]:
        raise can.CanOperationError("full")

    hub, heard = Hub(), list[bytes]()
    sender = hub.attach(lambda _: None)
    hub.attach(heard.append)
    hub.tap = refuse
    with pytest.raises(can.CanOperationError):
        sender.send(b"one")
    hub.tap = None
    sender.send(b"two")
    assert heard == [b"two"]


@pytest.mark.parametrize(
    ("fault", "counter"),
    [
        (on_bus.lost(0.3), "frames_lost"),
        (on_bus.cut(on_bus.cell, 1.0), "frames_refused"),
        (on_bus.error_frames(), "error_frames"),
        (on_bus.bus_off(), "send_failures"),
    ],
)
def test_the_loop_counts_what_the_wire_does(rig: Lockstep, fault: Injector, counter: str) -> None:
    before = newest(rig)[counter]
    put_in(rig, fault)
    assert newest(rig)[counter] > before


def test_late_frames_are_late_by_so_many_ticks(rig: Lockstep) -> None:
    put_in(rig, on_bus.late(5), 5)
    assert newest(rig)["tension_age_ns"] == 5e6


# -- devices --------------------------------------------------------------------------------------------------------
def test_a_sensor_reads_what_its_fault_makes_of_the_truth(rig: Lockstep) -> None:
    put_in(rig, in_device.reads(in_device.CELL, times=0.5, plus=10.0))
    assert newest(rig)["tension_n"] == pytest.approx(160.0, abs=0.2)
    put_in(rig, in_device.reads(in_device.STROKE, plus=-3.0))
    assert newest(rig)["stroke_mm"] == pytest.approx(rig.rig.truth.stroke_mm - 3.0, abs=0.01)


def test_a_stuck_cell_repeats_itself_to_the_last_bit(rig: Lockstep) -> None:
    put_in(rig, in_device.stuck(in_device.CELL))
    assert len(set(rig.run(0.01)["reading_n"])) == 1


# -- the plant ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("fault", "tension_n"),
    [
        (in_plant.rope_breaks(), 0.0),
        (in_plant.spring_breaks(), 0.0),
        (in_plant.rope_slips(1000.0, 1.0), 294.0),
        (in_plant.spring_stiffens(1.3), 300.0),
        (in_plant.backlash(2.0), 300.0),
    ],
)
def test_what_hangs_on_the_rope_after_a_fault_of_the_plant(rig: Lockstep, fault: Injector, tension_n: float) -> None:
    put_in(rig, fault, 20)
    assert rig.rig.truth.tension_n == pytest.approx(tension_n, abs=0.5)


def test_a_clock_that_skips_lets_the_rig_go_on_without_the_loop(rig: Lockstep) -> None:
    moments: list[int] = []
    rig.on_advance = lambda: moments.append(rig.rig.truth.t_ns)
    before = newest(rig)
    rig.clock.skip = 9
    after = newest(rig)
    assert after["t_ns"] - before["t_ns"] == 10e6
    assert after["skipped"] - before["skipped"] == 9
    assert len(moments) == 11


def test_a_stepped_wall_clock_steps_that_of_the_process_and_no_other(tmp_path: pathlib.Path) -> None:
    environment = wall_clock.prepare(tmp_path)
    asked = "import sys, time; print(time.time(), time.time_ns(), flush=True); sys.stdin.readline(); print(time.time())"
    with subprocess.Popen(
        [sys.executable, "-c", asked], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        before, before_ns = process.stdout.readline().split()
        wall_clock.step(tmp_path, 86_400_000_000_000)
        process.stdin.write("\n")
        process.stdin.flush()
        after = process.stdout.readline()
    assert float(before) == pytest.approx(int(before_ns) * 1e-9, abs=60.0)
    assert float(before) == pytest.approx(time.time(), abs=600.0)
    assert float(after) - float(before) == pytest.approx(86_400.0, abs=600.0)
