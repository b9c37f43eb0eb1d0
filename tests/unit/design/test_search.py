"""A refused design names the weight that helps; the search finds weights that meet the limit, or the obstacle."""

from __future__ import annotations

import json
import pathlib
import subprocess
from collections.abc import Callable
from typing import Any

import pytest
import yaml

from rigctl.config.settings import RigSettings
from rigctl.design import search
from rigctl.design.margins import design_and_check
from tests.builders import daemons

Command = Callable[..., "subprocess.CompletedProcess[str]"]
WEIGHTS = {"stretch_weight": 50.0, "integral_weight": 38.0}
# 500 Hz and a spring of 13 N/mm: refused at Ms 1.648 with these weights.
STIFFER: dict[str, dict[str, Any]] = {
    "loop": {"rate_hz": 500}, "plant": {"spring_n_mm": 13.0}, "design": WEIGHTS,
    "estimator": {"tension_walk_n": 0.01, "speed_walk_mm_s": 0.075, "disturbance_walk_mm_s": 10.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def stiffer(rig: Callable[..., RigSettings]) -> RigSettings:
    return rig(**STIFFER)


def test_a_design_just_beyond_the_limit_is_told_the_least_change_of_stretch_weight(stiffer: RigSettings) -> None:
    assert design_and_check(stiffer).ms_max == pytest.approx(1.648, abs=0.002)
    hint = search._alone(stiffer, "design.stretch_weight")
    assert hint is not None
    assert hint.meets
    assert 10.0 <= hint.weight.value < 50.0
    assert hint.in_words().startswith(f"design.stretch_weight {hint.weight.value:g} instead of 50: Ms 1.59")
    changed = search._with(stiffer, [hint.weight])
    assert design_and_check(changed).ms_max == hint.ms_max < stiffer.design.ms_max


def test_a_design_within_the_limit_is_left_alone(rig: Callable[..., RigSettings]) -> None:
    found = search.auto(rig())
    assert (found.weights, found.meets, found.against) == ((), True, ())


def test_auto_prints_what_to_write_and_the_file_is_then_accepted(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = daemons.rig_file(tmp_path, STIFFER)
    refused = in_process("rigctl", "tune", str(file), "--json", "-")
    assert refused.returncode == 1
    first = json.loads(refused.stdout)["hints"][0]
    assert first["meets"]
    assert first["weight"]["key"] == "design.stretch_weight"
    done = in_process("rigctl", "tune", str(file), "--auto")
    assert done.returncode == 0, done.stderr
    after = done.stdout[done.stdout.index("To use them") :].splitlines()
    (weight,) = [line for line in after if "# was 50" in line]
    value = yaml.safe_load(weight)["stretch_weight"]
    daemons.rig_file(tmp_path, {**STIFFER, "design": WEIGHTS | {"stretch_weight": value}})
    assert in_process("rigctl", "tune", str(file)).returncode == 0


def test_what_no_weight_can_do_is_said_with_what_stands_against_it(
    rig: Callable[..., RigSettings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, "DESIGNS", 4)  # more designs would find nothing either, but take longer
    monkeypatch.setattr(search, "LADDER", (64.0,))
    found = search.auto(rig(plant={"spring_n_mm": None}))
    assert not found.meets
    assert "the best found is" in found.against[0]
    assert "worst with mechanism" in found.against[0]
    assert any("no spring" in line for line in found.against)
