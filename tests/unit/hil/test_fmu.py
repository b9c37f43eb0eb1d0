"""The FMU of the plant, played by fmpy, against the plant itself."""

from __future__ import annotations

import math
import pathlib
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from hil.fmu.fmu_file import NAME, PLATFORM, FmuError, make
from hil.fmu.variables import OUTPUTS
from hil.plant import Plant
from hil.plant.inputs import Track
from hil.plant.layout import FORCE_TANGENTIAL, MASS, MECHANISM
from hil.plant.moves import out_and_back
from hil.truth import Truth
from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from tests.builders.paths import ROOT
from tests.conftest import Command

PAPER = ROOT / "config/paper_rig.yaml"
TENSION_N = 294.0
MS = 1_000_000
NAMES = [row.name for row in OUTPUTS[1:]]
RELATIVE = 1.0e-6
"""What is promised. On this platform they are the same to the last bit, but libm and compiler differ elsewhere."""


def paper() -> RigSettings:
    return rig_file.load(PAPER)


def flexible() -> RigSettings:
    """A rope of five elements, and a mechanism that gives way on all axes."""
    settings = paper()
    simulation = settings.simulation
    assert simulation is not None
    rope = simulation.rope.model_copy(update={"elements": 5})
    stiff = {f"{axis}_n_mm": 400.0 for axis in ("tangential", "normal", "vertical")}
    mechanism = simulation.mechanism.model_copy(update={**stiff, "damping_ratio": 0.02})
    own = simulation.model_copy(update={"rope": rope, "mechanism": mechanism, "step_us": 20})
    return settings.model_copy(update={"simulation": own})


def move_of(settings: RigSettings) -> Track:
    assert settings.demo is not None
    degrees = (settings.demo.angle_deg, settings.demo.speed_deg_s, settings.demo.acceleration_deg_s2)
    return out_and_back(*map(math.radians, degrees))


def close(found: np.ndarray[Any, Any], truth: list[Truth]) -> None:
    """Every output within the promise of its largest magnitude."""
    for name in NAMES:
        own = np.array([getattr(one, name) for one in truth])
        assert np.max(np.abs(found[name] - own)) <= RELATIVE * np.max(np.abs(own)), name


@pytest.mark.study
def test_the_papers_move_is_the_plants(tmp_path: pathlib.Path) -> None:
    settings, file = paper(), tmp_path / "plant.fmu"
    make(settings, file)
    assert validate_fmu(str(file)) == []
    plant, move = Plant(settings, 0), move_of(settings)
    plant.preload(TENSION_N)
    plant.start_motion({MECHANISM: move}, 0)
    count = int(move.end * 1000) + 500
    truth = []
    for tick in range(1, count + 1):
        plant.advance(tick * MS)
        truth.append(plant.truth)
    found = fmpy.simulate_fmu(
        str(file), stop_time=count * 1e-3, step_size=1e-3, output_interval=1e-3, start_values={"preload_n": TENSION_N}
    )
    close(found[1 : count + 1], truth)
    assert max(one.mechanism_rad for one in truth) > 0.2
    assert max(one.tension_n for one in truth) - min(one.tension_n for one in truth) > 0.5


class Played:
    """An FMU stepped by hand."""

    def __init__(self, file: pathlib.Path, folder: pathlib.Path, **start: float) -> None:
        described = fmpy.read_model_description(str(file))
        self.number = {one.name: one.valueReference for one in described.modelVariables}
        fmpy.extract(str(file), unzipdir=str(folder))
        self.fmu = FMU3Slave(
            guid=described.instantiationToken, unzipDirectory=str(folder), modelIdentifier=NAME, instanceName="one"
        )
        self.fmu.instantiate()
        for name, value in start.items():
            self.fmu.setFloat64([self.number[name.replace("__", ".")]], [value])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values: float) -> None:
        self.fmu.setFloat64([self.number[name] for name in values], list(values.values()))

    def step(self, tick: int) -> list[float]:
        self.fmu.doStep((tick - 1) * 1e-3, 1e-3)
        return [float(value) for value in self.fmu.getFloat64([self.number[name] for name in NAMES])]


@pytest.mark.parametrize("settings_of", [paper, flexible])
def test_commands_brake_forces_and_mass_act_as_on_the_plant(
    settings_of: Callable[[], RigSettings], tmp_path: pathlib.Path
) -> None:
    settings, file = settings_of(), tmp_path / "plant.fmu"
    make(settings, file)
    plant = Plant(settings, 0)
    plant.preload(TENSION_N)

    def steady(value: float) -> Track:
        return Track(segments=np.array([[0.0, value, 0.0, 0.0, 0.0]]))

    plant.start_motion({MECHANISM: move_of(settings), FORCE_TANGENTIAL: steady(3.0), MASS: steady(1.5)}, 0)
    played = Played(file, tmp_path / "fmu", preload_n=TENSION_N)
    played.set(force_tangential_n=3.0, extra_mass_kg=1.5)
    truth, found = [], []
    for tick in range(1, 2001):
        braked = tick < 50 or tick > 1800
        command = 8.0 * math.sin(tick / 60.0)
        plant.set_drive(command, braked)
        played.set(command_mm_s=command)
        played.fmu.setBoolean([played.number["braked"]], [braked])
        plant.advance(tick * MS)
        truth.append(plant.truth)
        found.append(played.step(tick))
    table = np.array([tuple(row) for row in found], [(name, "f8") for name in NAMES])
    close(table, truth)
    assert np.ptp([one.stroke_mm for one in truth]) > 0.3


def test_a_state_is_kept_and_taken_up_again(tmp_path: pathlib.Path) -> None:
    make(paper(), tmp_path / "plant.fmu")
    played = Played(tmp_path / "plant.fmu", tmp_path / "fmu", preload_n=TENSION_N)
    for tick in range(1, 200):
        played.step(tick)
    kept = played.fmu.getFMUState()
    once = [played.step(tick) for tick in range(200, 300)]
    played.fmu.setFMUState(kept)
    assert [played.step(tick) for tick in range(200, 300)] == once


def test_parameters_may_differ_from_the_rig_files(tmp_path: pathlib.Path) -> None:
    settings = paper()
    make(settings, tmp_path / "plant.fmu")
    softer = settings.plant.model_copy(update={"stiffness_n_mm": settings.plant.stiffness_n_mm / 2})
    plant = Plant(settings.model_copy(update={"plant": softer}), 0)
    plant.preload(TENSION_N)
    half = plant.parameters["stiffness"].item()
    played = Played(tmp_path / "plant.fmu", tmp_path / "fmu", preload_n=TENSION_N, plant__stiffness=half)
    plant.start_motion({MECHANISM: move_of(settings)}, 0)
    for tick in range(1, 500):
        plant.advance(tick * MS)
        found = played.step(tick)
    assert found == pytest.approx([getattr(plant.truth, name) for name in NAMES], rel=RELATIVE, abs=1e-12)


def test_the_library_needs_the_c_library_alone(tmp_path: pathlib.Path) -> None:
    make(paper(), tmp_path / "plant.fmu")
    with zipfile.ZipFile(tmp_path / "plant.fmu") as archive:
        library = archive.extract(f"binaries/{PLATFORM}/{NAME}.so", tmp_path)
    read = subprocess.run(["readelf", "-d", library], capture_output=True, text=True, check=True).stdout
    needed = {line.split("[")[1].rstrip("]") for line in read.splitlines() if "(NEEDED)" in line}
    assert needed <= {"libm.so.6", "libc.so.6"}


def test_the_command_writes_it_or_says_why_not(in_process: Command, tmp_path: pathlib.Path) -> None:
    out = tmp_path / "rig.fmu"
    assert in_process("hil", "fmu", PAPER, "--out", out).returncode == 0
    assert zipfile.ZipFile(out).testzip() is None
    for words in ((PAPER, "--out", tmp_path / "none" / "rig.fmu"), (tmp_path / "none.yaml", "--out", out)):
        answer = in_process("hil", "fmu", *words)
        assert (answer.returncode, answer.stderr.count("\n")) == (2, 1), answer.stderr


def test_without_a_compiler_or_a_simulated_rig_it_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path
) -> None:
    with pytest.raises(FmuError, match="simulation: found nothing"):
        make(paper().model_copy(update={"simulation": None}), tmp_path / "plant.fmu")
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    with pytest.raises(FmuError, match="found no C compiler"):
        make(paper(), tmp_path / "plant.fmu")
