"""What ``rigctl check`` prints of the probe and of unseen travel, and what it refuses."""

from __future__ import annotations

import io
import json
import pathlib

import pytest
import typer
from rich.console import Console

from rigctl.cli import check, run
from rigctl.cli.probe_check import ProbeCheck, refusal
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.probe_plan import plan
from rigctl.design.gains import design
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")


def with_values(spring_n_mm: float = 6.0, **safety: float | str) -> RigSettings:
    plant = PAPER.plant.model_copy(update={"spring_n_mm": spring_n_mm})
    return PAPER.model_copy(update={"plant": plant, "safety": PAPER.safety.model_copy(update=safety)})


def printed(settings: RigSettings) -> list[str]:
    console = Console(width=600, record=True, file=io.StringIO())
    check.show(settings, console)
    return console.export_text().splitlines()


def test_time_to_detection_and_false_alarms_are_those_of_the_loop() -> None:
    found = plan(PAPER, design(PAPER))
    (line,) = [line for line in printed(PAPER) if line.startswith("probe:")]
    assert f"within {found.detection_s:.0f} s at 5.96 N/mm and 0.03 N of noise" in line
    assert f"within {found.rope_s:.0f} s" in line
    assert found.detection_s <= 14.0
    assert found.false_alarms_per_hour <= 1e-3
    assert check.as_dict(PAPER)["probe"]["detection_s"] == found.detection_s


@pytest.mark.parametrize(("spring_n_mm", "newtons"), [(6.0, "71.6 N"), (30.0, "349.5 N")])
def test_a_travel_in_millimetres_is_named_in_newtons_and_the_bound_acts_first(spring_n_mm: float, newtons: str) -> None:
    lines = printed(with_values(spring_n_mm))
    (line,) = [line for line in lines if "travel_mm 12 mm" in line]
    assert newtons in line
    assert "the bound above acts first" in line
    assert [line for line in lines if "may move the load by 27.0 N" in line]


def test_a_coarse_encoder_is_named() -> None:
    assert not [line for line in printed(PAPER) if "steps of the drive" in line]
    assert [line for line in printed(with_values(30.0)) if "steps of the drive" in line]


def test_a_payload_that_a_frozen_cell_could_hide_behind_is_refused_until_its_speed_is_declared() -> None:
    settings = with_values(heave_mm=10.0)
    why = refusal(settings)
    assert why is not None
    assert why.startswith("safety.heave_mm: found 10, ")
    assert "(30.0 N, 10% of tension.target_n)" in why
    detection_s = ProbeCheck.of(settings).detection_s
    slow_mm_s = 30.0 / PAPER.plant.slow_stiffness_n_mm / detection_s
    assert refusal(with_values(heave_mm=10.0, heave_mm_s=0.98 * slow_mm_s)) is None
    assert refusal(with_values(heave_mm=10.0, heave_mm_s=1.02 * slow_mm_s)) is not None
    assert refusal(with_values(heave_mm=2.0)) is None


def test_a_stiff_rope_is_refused_and_a_waiver_is_printed() -> None:
    why = refusal(with_values(200.0))
    assert why is not None
    assert "expected a softer spring" in why
    waived = with_values(200.0, waiver="a study")
    assert refusal(waived) is None
    assert [line for line in printed(waived) if line.startswith("WAIVED (a study): plant: found")]


def test_the_command_ends_with_one_line_and_exit_code_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, "load_rig_file", lambda _: with_values(heave_mm=10.0))
    with pytest.raises(typer.Exit) as ended:
        run.check(pathlib.Path("rig.yaml"), json=True)
    assert ended.value.exit_code == 2
    found = capsys.readouterr()
    assert len(found.err.splitlines()) == 1
    assert "rig.yaml: safety.heave_mm: found 10" in found.err
    assert "safety.waiver" in found.err
    assert not found.out


def test_the_figures_are_json() -> None:
    assert json.dumps(check.as_dict(PAPER)["probe"])
