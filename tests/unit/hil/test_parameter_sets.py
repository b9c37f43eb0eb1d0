"""Every set of ``config/sets`` fits both rigs and has the effect its name states."""

from __future__ import annotations

import math
import pathlib
from typing import Any

import pytest

from hil.plant import Plant
from hil.plant.layout import MECHANISM
from hil.plant.moves import out_and_back
from hil.studies.cell.drawn_cell import compensating
from hil.studies.moves.repeated_moves import LEARNING
from rigctl.config import rig_file as config
from rigctl.config import strict_yaml
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from tests.builders.rig_bench import MS, REPOSITORY, RigBench

SETS, PAPER = REPOSITORY / "config/sets", REPOSITORY / "config/paper_rig.yaml"
START = 0x01


def read(path: pathlib.Path) -> Any:
    return strict_yaml.load(path.read_text()).data


def laid_over(base: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    inner = {k: laid_over(base.get(k, {}), v) if isinstance(v, dict) else v for k, v in values.items()}
    return base | inner


def with_set(name: str, rig: str = "paper_rig") -> RigSettings:
    values = laid_over(read(REPOSITORY / f"config/{rig}.yaml"), read(SETS / f"{name}.yaml"))
    return RigSettings.model_validate({**values, "directory": str(REPOSITORY / "config")})


FITS = [
    (path.stem, rig)
    for path in sorted(SETS.glob("*.yaml"))
    for rig in ("paper_rig", "plain_rig")
    if (path.stem, rig) != ("compensated_cell", "plain_rig")  # a plain frame has no temperature
]


@pytest.mark.parametrize(("name", "rig"), FITS)
def test_every_set_is_valid_over_every_rig(name: str, rig: str) -> None:
    before = config.load(REPOSITORY / f"config/{rig}.yaml").model_dump(exclude={"directory", "plain"})
    assert with_set(name, rig).model_dump(exclude={"directory", "plain"}) != before


def test_the_studies_of_cell_and_moves_measure_what_the_sets_switch_on() -> None:
    assert with_set("compensated_cell").compensation == compensating(config.load(PAPER)).compensation
    assert with_set("learned_moves").learning == LEARNING


def test_the_ideal_rig_reports_the_truth() -> None:
    """To the unit of each object: 1 mN, 1 um, 10 um/s, 0.01 deg."""
    bench = RigBench(with_set("ideal"))
    bench.enable()
    bench.drive(1500, 0x0F, 10.0)
    bench.rig.start_motion()
    bench.drive(3000, 0x0F, 0.0)
    bench.drive(200, 0x0F, 3.0)
    drive, cell, slope = bench.rig.drive, bench.rig.cell, bench.rig.inclinometer
    truth = bench.rig.truth
    assert bench.read(cell.id, 0x9130, 1) == pytest.approx(truth.tension_n * 1e3, abs=0.6)  # type: ignore[union-attr]
    assert bench.read(drive.id, 0x6064) == pytest.approx(truth.stroke_mm * 1e3, abs=0.6)
    assert bench.read(drive.id, 0x606C) == pytest.approx(truth.speed_mm_s * 1e3, abs=0.6)
    read_deg = bench.read(slope.id, 0x6010) * 0.01  # type: ignore[union-attr]
    # half a unit, 0.002 deg in the 10 ms a sample may be old, 0.004 deg from the first jerk on the gyros
    assert read_deg == pytest.approx(math.degrees(truth.tangential_rad), abs=0.011)
    assert truth.tension_n > 80.0 and truth.speed_mm_s == pytest.approx(3.0) and read_deg > 0.2


def test_with_an_io_node_its_input_is_closed_until_the_button_is_pressed() -> None:
    bench = RigBench(with_set("io_node"))
    io = bench.rig.io
    assert io is not None
    assert bench.read(io.id, objects.INPUTS_8, 1) == 1
    assert bench.write(objects.SIMULATOR_NODE, objects.SIM_E_STOP, 0, 1, 1) == 0
    assert bench.read(io.id, objects.INPUTS_8, 1) == 0


def test_on_air_bearings_the_rope_stays_plumb() -> None:
    settings = with_set("air_bearing")
    assert settings.simulation is not None
    plant = Plant(settings, 0)
    plant.preload(300.0)
    plant.start_motion({MECHANISM: out_and_back(*map(math.radians, (13.0, 0.5, 0.25)))}, 0)
    lags = []
    while plant.moving:
        plant.advance(plant.t_ns + MS)
        lags.append(math.degrees(plant.truth.tangential_rad))
    mass_kg = settings.simulation.rail.mass_kg + settings.simulation.pulley.mass_kg
    lean_deg = 0.25 * 0.75 * mass_kg / 300.0  # of a rope that tows this mass at the ramp's 0.25 deg/s2
    assert max(map(abs, lags)) < 6.0 * lean_deg  # the acceleration jumps six times with hardly any damping between
    assert 6.0 * lean_deg < 0.1 * math.degrees(math.atan(0.012))
    cruise = lags[2000:26_000]
    drag_deg = math.degrees(0.4 * math.radians(0.5) * 0.75 / 300.0)
    assert sum(cruise) / len(cruise) == pytest.approx(drag_deg, abs=3e-4)  # swings of 0.015 deg, 24 s of them averaged
