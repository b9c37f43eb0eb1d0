"""The load between brake and motor, judged by the plant: how far it sinks when one of them takes it from the other."""

from __future__ import annotations

import struct

import pytest

from rigctl.devices import objects
from rigctl.devices.objects import Controlword, EmcyCode
from rigctl.model.device_states import DriveState
from tests.builders.rig_bench import SETTINGS, RigBench, changed

DRIVE = SETTINGS.cylinder.node
ENABLE = Controlword.ENABLE_OPERATION
LOAD_N = 300.0
AS_BUILT = {"speed_loop_hz": 27.0, "moved_kg": 80.0, "brake_open_ms": 40, "brake_close_ms": 20}
YIELDS_N_MM = 0.08 * (3.141592653589793 * 27.0) ** 2
"""Load that the integrator takes over per millimetre lost."""
NO_SUCH_OBJECT = 0x06020000


def loaded(load_n: float = LOAD_N, **drive: float) -> RigBench:
    bench = RigBench(changed(SETTINGS, simulation={"drive": {**AS_BUILT, **drive}}))
    bench.rig.plant.preload(load_n)
    bench.wait(100)
    return bench


def per_mille(bench: RigBench, load_n: float) -> int:
    """Torque offset that carries a load."""
    rated_a = bench.read(DRIVE, objects.MOTOR_RATED_CURRENT) * objects.A_PER_RATED_CURRENT_UNIT
    assert SETTINGS.simulation is not None
    return round(1000 * load_n / (rated_a * SETTINGS.simulation.drive.force_n_a))


def offset(bench: RigBench, value: int) -> int:
    return bench.write(DRIVE, objects.TORQUE_OFFSET, 0, value, 2)


def current_n(bench: RigBench) -> float:
    """The motor's force by its own report."""
    (raw,) = struct.unpack("<h", struct.pack("<H", bench.read(DRIVE, objects.CURRENT_ACTUAL) & 0xFFFF))
    return float(raw) * 1.5  # per mille of 3 A, 500 N/A


def taken_over(bench: RigBench) -> float:
    """Way of the load when the motor takes it, mm."""
    before = bench.rig.truth.stroke_mm
    bench.enable()
    bench.drive(500, ENABLE)
    return bench.rig.truth.stroke_mm - before


@pytest.mark.parametrize("load_n", [50.0, 300.0, 350.0])
def test_a_motor_without_preload_lets_the_load_sink(load_n: float) -> None:
    bench = loaded(load_n)
    assert taken_over(bench) == pytest.approx(-load_n / YIELDS_N_MM, rel=0.02)
    assert bench.state() is DriveState.OPERATION_ENABLED
    position = struct.unpack("<i", struct.pack("<I", bench.read(DRIVE, objects.POSITION_ACTUAL)))[0]
    assert position == pytest.approx(bench.rig.truth.stroke_mm * 1000, abs=5)  # its own encoder measures it


@pytest.mark.parametrize("error_pct", [-10.0, 0.0, 5.0, 10.0])
def test_a_preload_leaves_only_its_error(error_pct: float) -> None:
    bench = loaded(preload_error_pct=error_pct)
    assert offset(bench, per_mille(bench, LOAD_N)) == 0
    expected_mm = -LOAD_N * error_pct * 1e-2 / YIELDS_N_MM
    assert taken_over(bench) == pytest.approx(expected_mm, abs=0.002)  # 1.5 N in one per mille


def test_the_motor_has_its_preload_before_the_brake_opens_and_the_load_after() -> None:
    bench = loaded()
    offset(bench, per_mille(bench, 120.0))
    bench.nmt(1)
    for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON):
        bench.drive(2, word)
    bench.drive(30, ENABLE)
    assert current_n(bench) == pytest.approx(120.0, abs=1.5)
    bench.drive(300, ENABLE)
    assert current_n(bench) == pytest.approx(bench.rig.truth.tension_n, abs=1.5)


def test_the_load_sinks_while_the_brake_opens_before_the_drive_reports_operation() -> None:
    bench = loaded()
    before = bench.rig.truth.stroke_mm
    bench.nmt(1)
    for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON):
        bench.drive(2, word)
    bench.drive(40, ENABLE)
    assert bench.rig.truth.stroke_mm == before
    bench.drive(8, ENABLE)
    assert bench.state() is DriveState.SWITCHED_ON
    assert bench.rig.truth.stroke_mm < before - 0.02


def test_a_preload_that_is_written_under_load_moves_it() -> None:
    bench = loaded()
    bench.enable()
    bench.drive(500, ENABLE)
    before = bench.rig.truth.stroke_mm
    offset(bench, per_mille(bench, 200.0))
    bench.drive(300, ENABLE)
    assert bench.rig.truth.stroke_mm - before == pytest.approx(200.0 / YIELDS_N_MM, abs=0.002)


def test_a_node_reset_takes_the_preload_away() -> None:
    bench = loaded()
    offset(bench, 200)
    bench.nmt(0x81, DRIVE)
    bench.wait(10)
    assert bench.read(DRIVE, objects.TORQUE_OFFSET) == 0
    assert taken_over(bench) == pytest.approx(-LOAD_N / YIELDS_N_MM, rel=0.02)


def test_a_stock_drive_has_no_torque_offset() -> None:
    stock = SETTINGS.cylinder.eds.replace("cylinder_drive", "stock_drive")
    bench = RigBench(changed(SETTINGS, cylinder={"eds": stock}))
    assert offset(bench, 100) == NO_SUCH_OBJECT


@pytest.mark.parametrize(("close_ms", "falls_ms"), [(20, 0), (50, 0), (150, 100)])
def test_a_drive_that_does_not_wait_for_its_brake_drops_the_load_meanwhile(close_ms: int, falls_ms: int) -> None:
    bench = loaded(brake_close_ms=close_ms)
    bench.enable()
    bench.drive(500, ENABLE)
    before = bench.rig.truth
    bench.drive(600, Controlword.SWITCH_ON)
    creep_mm = before.tension_n / 600.0 * falls_ms * 1e-3
    sunk_mm = before.stroke_mm - bench.rig.truth.stroke_mm
    assert bench.rig.drive.control.stage.braked
    assert 0.7 * creep_mm <= sunk_mm <= creep_mm + 1e-6  # its speed rises with its lag


def test_a_brake_that_opens_later_than_the_drive_believes_is_pulled_at() -> None:
    bench = loaded(brake_open_ms=200)
    offset(bench, per_mille(bench, LOAD_N))
    before = bench.rig.truth.stroke_mm
    bench.enable()
    bench.drive(100, ENABLE, 5.0)
    assert bench.rig.truth.stroke_mm == before
    assert current_n(bench) > LOAD_N + 100.0
    bench.drive(500, ENABLE, 5.0)
    lag_mm = 5.0 * 0.022
    assert bench.rig.truth.stroke_mm - before == pytest.approx(5.0 * 0.6 - lag_mm, abs=0.2)  # it makes up for the wait


def test_against_a_brake_that_sticks_the_motor_pulls_up_to_its_peak_current() -> None:
    bench = loaded()
    bench.rig.drive.brake.stuck_closed = True
    before = bench.rig.truth.stroke_mm
    bench.enable()
    bench.drive(3000, ENABLE, 5.0)
    assert bench.rig.truth.stroke_mm == before
    assert current_n(bench) == pytest.approx(3 * 3.0 * 500.0, rel=0.02)


def test_a_brake_that_opens_only_partly_costs_current_and_holds_part_of_the_load() -> None:
    bench = loaded()
    bench.rig.drive.brake.drag_n = 200.0
    assert taken_over(bench) == pytest.approx(-100.0 / YIELDS_N_MM, rel=0.05)
    free = loaded()
    taken_over(free)
    for each in (bench, free):
        each.drive(300, ENABLE, 2.0)
    assert current_n(bench) - current_n(free) == pytest.approx(200.0, abs=5.0)


def test_a_drive_whose_sync_period_is_set_stops_when_sync_is_lost() -> None:
    bench = loaded()
    bench.enable()
    bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, objects.ABORT_CONNECTION_QUICK_STOP, 2)
    assert bench.write(DRIVE, objects.CYCLE_PERIOD, 0, 1000, 4) == 0
    bench.drive(100, ENABLE, 5.0)
    for _ in range(600):
        bench.send(objects.HEARTBEAT_BASE + 1, b"\x05")
        bench.command(ENABLE, 5.0)
        bench.wait(1)
    assert bench.emergencies(DRIVE) == [EmcyCode.SYNC_LOST]
    assert bench.state() is DriveState.FAULT
    assert bench.rig.drive.control.stage.braked
