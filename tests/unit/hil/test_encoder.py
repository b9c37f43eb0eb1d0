"""The drive's measurement of its stroke."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from hil.nodes.encoder import Encoder
from hil.plant import Plant
from rigctl.devices import objects
from rigctl.devices.objects import Controlword
from tests.builders.rig_bench import MS, SETTINGS, RigBench, changed

DRIVE = SETTINGS.cylinder.node
ENABLE = Controlword.ENABLE_OPERATION


def driven(step_mm: float, velocity_mm_s: float, ms: int, **drive: Any) -> tuple[Plant, Encoder]:
    """An encoder read every millisecond on a motor that has run for ``ms``."""
    plant = Plant(changed(simulation={"drive": drive}), 0)
    encoder = Encoder(plant, step_mm)
    plant.set_drive(velocity_mm_s, braked=False)
    for _ in range(ms):
        plant.advance(plant.t_ns + MS)
        encoder.advance()
    return plant, encoder


def signed(value: int) -> int:
    return value - (1 << 32) if value & 1 << 31 else value


def test_a_perfect_encoder_knows_the_motors_stroke_and_speed() -> None:
    plant, encoder = driven(0.0, 5.0, 321, ripple_mm=0.0)
    assert (encoder.position_mm, encoder.speed_mm_s) == (plant.truth.stroke_mm, plant.truth.speed_mm_s)
    plant.advance(plant.t_ns + MS // 3)
    assert (encoder.position_mm, encoder.speed_mm_s) == (plant.truth.stroke_mm, plant.truth.speed_mm_s)


def test_position_and_speed_come_in_its_steps() -> None:
    """Steps of 0.02 mm at 4 mm/s: one every 5 ms, and then 20 mm/s for a millisecond."""
    plant, encoder = driven(0.02, 4.0, 500)
    speeds = []
    for _ in range(1000):
        plant.advance(plant.t_ns + MS)
        encoder.advance()
        assert encoder.position_mm == pytest.approx(round(encoder.position_mm / 0.02) * 0.02, abs=1e-9)
        speeds.append(encoder.speed_mm_s)
    assert {round(speed, 6) for speed in speeds} == {0.0, 20.0}
    assert sum(speeds) / 1000 == pytest.approx(4.0, abs=0.02)  # one step in a second


def test_its_speed_is_the_mean_of_the_last_millisecond() -> None:
    """While accelerating it is half a millisecond behind."""
    plant, encoder = driven(1e-7, 100.0, 20, acceleration_mm_s2=2000.0, speed_mm_s=100.0)
    assert 30.0 < plant.truth.speed_mm_s < 40.0
    assert plant.truth.speed_mm_s - encoder.speed_mm_s == pytest.approx(2000.0 * 0.5e-3, abs=1e-3)


def test_it_sees_neither_ripple_nor_play() -> None:
    plant, encoder = driven(0.0, 5.0, 273, ripple_mm=0.5, screw_lead_mm=5.0)
    state = plant.state[0]
    assert abs(plant.truth.stroke_mm - state["motor"]) > 0.4
    assert encoder.position_mm == pytest.approx(float(state["motor"]))
    plant, encoder = driven(0.0, -5.0, 273, ripple_mm=0.0, backlash_mm=0.3)  # a slack rope leaves the nut its play
    assert plant.truth.stroke_mm - encoder.position_mm == pytest.approx(0.3)


@pytest.mark.parametrize(("step_mm", "speeds_um_s"), [(0.01, {0, 10_000}), (0.0, {4000})])
def test_the_drive_reports_by_its_encoder(step_mm: float, speeds_um_s: set[int]) -> None:
    bench = RigBench(changed(simulation={"drive": {"encoder_mm": step_mm, "ripple_mm": 0.0}}))
    bench.enable()
    bench.drive(400, ENABLE, 4.0)
    seen, positions = set(), []
    for _ in range(50):
        bench.drive(1, ENABLE, 4.0)
        seen.add(signed(bench.read(DRIVE, objects.VELOCITY_ACTUAL)))
        positions.append(signed(bench.read(DRIVE, objects.POSITION_ACTUAL)))
    assert seen == speeds_um_s
    assert positions[-1] - positions[0] == pytest.approx(4 * 49, abs=10)
    assert all(position % 10 == 0 for position in positions) == bool(step_mm)


def test_the_rig_files_encoder_is_quieter_than_the_filter_assumes() -> None:
    """Within the object's 0.01 mm/s, a tenth of ``estimator.speed_noise_mm_s``."""
    bench = RigBench()
    bench.enable()
    bench.drive(1000, ENABLE, 3.0)
    bench.frames.clear()
    bench.drive(500, ENABLE, 3.0)
    speeds = [struct.unpack_from("<h", data, 6)[0] for data in bench.sent(objects.TPDO1_BASE + DRIVE)]
    assert len(speeds) == 500
    assert {abs(speed - 300) for speed in speeds} <= {0, 1}
