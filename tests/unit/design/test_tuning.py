"""From the ledger to a gain file, and from the gain file to what a start makes of it."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
import yaml

from rigctl.config.rig_file import load
from rigctl.config.settings import RigSettings
from rigctl.control.law.gain_table import ScheduledGains
from rigctl.design import gain_file
from rigctl.design.gain_file import GainFileError
from rigctl.design.in_use import adopted, design_in_use, design_while_running
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from tests.builders import daemons
from tests.builders.identifications import NOON_NS, response, steps

Command = Callable[..., "subprocess.CompletedProcess[str]"]
NOW = datetime.fromtimestamp(NOON_NS / 1e9, UTC)
FOUND: dict[str, Any] = {
    "stiffness": (6.1, 0.01),
    "plant__cylinder_lag_s": (0.018, 0.0002),
    "plant__command_delay_s": (0.0024, 0.0001),
}


PLANT = {
    name: {"value": value, "error": error}
    for name, (value, error) in zip(("stiffness_n_mm", "lag_s", "delay_s"), FOUND.values(), strict=True)
}


def rig_with(folder: pathlib.Path, *made: Callable[[RigSettings], Entry], **changes: Any) -> pathlib.Path:
    """A rig file that names its gain file, with these entries in its ledger."""
    file = daemons.rig_file(
        folder, {"design": {"gains_file": "gains.yaml", "identify_days": 3650}, **changes}, rig="known"
    )
    settings = load(file)
    for make in made:
        ledger.append(settings, make(settings))
    return file


def tuned(file: pathlib.Path, in_process: Command, *options: str) -> subprocess.CompletedProcess[str]:
    """`rigctl tune --from` of a rig's ledger, with its gain file."""
    settings = load(file)
    return in_process(
        "rigctl", "tune", file, "--from", settings.ledger, "--gains", file.with_name("gains.yaml"), *options
    )


def stiffer(settings: RigSettings) -> Entry:
    return steps(settings, 1.0, **FOUND)


def rigid(settings: RigSettings) -> Entry:
    return response(settings, 2.0)


def test_the_identified_plant_is_designed_for_and_used_at_the_next_start(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = rig_with(tmp_path, rigid, stiffer)
    answer = tuned(file, in_process)
    assert answer.returncode == 0, answer.stderr
    assert "accepted: Ms 1." in answer.stdout
    assert "over the family of plants identified 2026-10-30" in answer.stdout
    assert "k 5.917 to 6.283 N/mm, lag 16.2 to 19.8 ms, delay 1.9 to 2.9 ms, K_m rigid, 1000, 300 N/mm" in answer.stdout
    assert "plant.cylinder_lag_s: 0.018  # was 0.02" in answer.stdout
    settings = load(file)
    used = adopted(settings, NOW)
    assert used.plant.stiffness_n_mm == pytest.approx(6.1)
    assert (used.plant.cylinder_lag_s, used.plant.command_delay_s) == (0.018, 0.0024)
    assert used.model_copy(update={"plant": settings.plant}) == settings
    for rig in (settings, used):  # as the supervisor has them, and as a client reads them
        found = design_in_use(rig, NOW)
        assert found.accepted
        assert found.family == "identified 2026-10-30"
        assert found.warnings() == []
        assert "over the family of plants identified 2026-10-30 (limit 1.6); gains of gains.yaml" in found.verdict()
    for clock in (datetime(1970, 1, 1, tzinfo=UTC), datetime(2099, 1, 1, tzinfo=UTC)):
        unset = design_in_use(settings, clock)
        assert (unset.family, unset.warnings()) == ("identified 2026-10-30", [])
        assert ledger.clock_doubt(settings, unset.as_dict(), clock)
    assert found.as_dict()["source"]["identified"] == (rigid(settings).when,)
    text = file.with_name("gains.yaml").read_text()
    assert design_while_running(used, text, "gains.yaml", NOW).family == "identified 2026-10-30"
    with pytest.raises(GainFileError, match=r"replace plant\.spring_n_mm.*: name the file as design\.gains_file"):
        design_while_running(settings, text, "gains.yaml", NOW)


@pytest.mark.parametrize(
    ("later", "days", "why"),
    [
        (None, 400, "is 402 days old, design.identify_days is 365"),
        (
            lambda rig: steps(rig, -1.0, **FOUND | {"stiffness": (7.0, 0.02)}),
            2,
            "found stiffness_n_mm 7 +- 0.02, the identification of",
        ),
        (lambda rig: response(rig, -1.0, plant=PLANT, fit=5.0), 2, "does not fit the model"),
        (
            lambda rig: response(
                rig, -1.0, plant=PLANT, margins={"measured": True, "ms_output": {"value": 1.9, "error": 0.1}}
            ),
            2,
            "measured Ms 1.90 +- 0.10",
        ),
    ],
    ids=["outdated", "contradicted", "unfit", "fragile"],
)
def test_what_the_ledger_does_not_bear_out_falls_back_to_the_assumed_family_and_says_why(
    tmp_path: pathlib.Path, in_process: Command, later: Callable[[RigSettings], Entry] | None, days: int, why: str
) -> None:
    file = rig_with(tmp_path, rigid, stiffer, design={"gains_file": "gains.yaml", "identify_days": 365})
    assert tuned(file, in_process).returncode == 0
    settings = load(file)
    used = adopted(settings, NOW)
    if later is not None:
        ledger.append(settings, later(settings))
    now = NOW + timedelta(days=days)
    assert adopted(settings, now) == settings
    found = design_in_use(settings, now)
    assert (found.accepted, found.family, found.source) == (True, "assumed", None)
    (warning,) = found.warnings()
    assert warning.startswith("the gains of gains.yaml are not used, but new ones over the assumed family: the ")
    assert why in warning
    with pytest.raises(GainFileError, match=why.split(" +", maxsplit=1)[0]):
        design_while_running(used, file.with_name("gains.yaml").read_text(), "gains.yaml", now)


def test_an_identification_of_another_ledger_is_not_believed(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = rig_with(tmp_path, stiffer)
    assert tuned(file, in_process).returncode == 0
    settings = load(file)
    assert settings.ledger is not None
    settings.ledger.unlink()
    found = design_in_use(settings, NOW)
    assert found.family == "assumed"
    assert "is not in the ledger" in found.warnings()[0]


def test_a_rig_file_that_was_changed_since_is_refused_with_its_key(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = rig_with(tmp_path, stiffer)
    assert tuned(file, in_process).returncode == 0
    text = file.read_text()
    file.write_text(text.replace("spring_n_mm: 6.0", "spring_n_mm: 13.0"))
    with pytest.raises(GainFileError, match=r"made for other settings \(plant.spring_n_mm was 6, is 13\)"):
        adopted(load(file), NOW)
    file.write_text(text.replace("cylinder_lag_s: 0.02", "cylinder_lag_s: 0.03"))
    with pytest.raises(GainFileError, match=r"plant.cylinder_lag_s was 0.02, is 0.03"):
        adopted(load(file), NOW)


def test_every_spring_that_was_identified_has_its_gains(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = rig_with(tmp_path, stiffer)
    other = load(file).model_copy(update={"plant": load(file).plant.model_copy(update={"spring_n_mm": 13.0})})
    ledger.append(load(file), steps(other, 0.5, stiffness=(12.5, 0.02)))
    answer = tuned(file, in_process, "--every-spring")
    assert answer.returncode == 0, answer.stderr
    assert "spring 13 N/mm: Ms 1." in answer.stdout
    soft = design_in_use(load(file), NOW)
    file.write_text(file.read_text().replace("spring_n_mm: 6.0", "spring_n_mm: 13.0"))
    used, hard = adopted(load(file), NOW), design_in_use(load(file), NOW)
    assert used.plant.stiffness_n_mm == pytest.approx(12.5)
    assert hard.family == "identified 2026-11-01"
    assert hard.gains.k_tension < 0.6 * soft.gains.k_tension
    file.write_text(file.read_text().replace("spring_n_mm: 13.0", "spring_n_mm: 20.0"))
    with pytest.raises(GainFileError, match="nor for another of its 2 springs"):
        adopted(load(file), NOW)


@pytest.mark.study
def test_optimised_weights_are_carried_by_the_gain_file_and_keep_every_limit(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = rig_with(tmp_path, rigid)
    figures = tmp_path / "tune.json"
    answer = tuned(file, in_process, "--optimize", "--evaluations", "50", "--json", str(figures))
    assert answer.returncode == 0, answer.stderr
    assert "--optimize: seed 1, " in answer.stdout
    said = json.loads(figures.read_text())
    assert said["optimised"]["within"]
    assert said["optimised"]["cost_ratio"] < 1.0
    assert said["ms_max"] <= 1.6
    assert said["performance"]["command_noise_mm_s"] <= 0.5
    replaced = {key: value["used"] for key, value in said["replaces"].items()}
    assert "estimator.disturbance_walk_mm_s" in replaced
    used = adopted(load(file), NOW)
    assert used.estimator.disturbance_walk_mm_s == replaced["estimator.disturbance_walk_mm_s"]
    assert design_in_use(load(file), NOW).gains.k_tension == pytest.approx(said["gains"]["k_tension"])
    again = tmp_path / "again.json"
    tuned(file, in_process, "--optimize", "--evaluations", "50", "--json", str(again))
    assert json.loads(again.read_text())["optimised"] == said["optimised"]  # the same seed, the same weights


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"replaces": {"safety.tension_high_n": {"file": 400.0, "used": 4000.0}}}, "found safety.tension_high_n"),
        ({"replaces": {"plant.spring_n_mm": {"file": 6.0, "used": 400.0}}}, "do not give"),
        ({"identified": {"when": "yesterday"}}, "identified"),
    ],
)
def test_an_edited_file_replaces_only_what_it_may(
    tmp_path: pathlib.Path, in_process: Command, change: dict[str, Any], said: str
) -> None:
    file = rig_with(tmp_path, stiffer)
    assert tuned(file, in_process).returncode == 0
    gains = file.with_name("gains.yaml")
    data = yaml.safe_load(gains.read_text())
    data.pop("seal")
    for key, value in change.items():
        data[key] |= value
    if said == "do not give":
        data["provenance"]["inputs"]["plant"]["spring_n_mm"] = 400.0
    gains.write_text(yaml.dump(data, Dumper=gain_file._Dumper, sort_keys=False))
    with pytest.raises(GainFileError) as refused:
        adopted(load(file), NOW)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_replaced_value_is_held_to_its_bound(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = rig_with(tmp_path, stiffer)
    assert tuned(file, in_process).returncode == 0
    gains = file.with_name("gains.yaml")
    data = yaml.safe_load(gains.read_text())
    data.pop("seal")
    walk = load(file).estimator.disturbance_walk_mm_s
    data["replaces"]["estimator.disturbance_walk_mm_s"] = {"file": walk, "used": 9e3}
    data["provenance"]["inputs"]["estimator"]["disturbance_walk_mm_s"] = 9e3
    data["provenance"]["inputs_sha256"] = gain_file.sha256(data["provenance"]["inputs"])
    gains.write_text(yaml.dump(data, Dumper=gain_file._Dumper, sort_keys=False))
    with pytest.raises(GainFileError, match=r"estimator\.disturbance_walk_mm_s: at most"):
        adopted(load(file), NOW)


def test_a_ledger_without_an_identification_is_one_line(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = rig_with(tmp_path, lambda rig: steps(rig, stiffness=(None, None)))
    answer = tuned(file, in_process)
    assert answer.returncode == 2
    assert "--from: the stiffness with a stiffness of 5.964 N/mm in the rig file is not on record" in answer.stderr


def at(tension_n: float, k_n_mm: float, stroke_mm: float) -> Callable[[RigSettings], Entry]:
    plant = {"stiffness_n_mm": {"value": k_n_mm, "error": 0.01}}
    return lambda rig: response(rig, 2.0, tension_n, plant=plant, stroke_mm=stroke_mm)


def test_a_gain_table_has_an_entry_for_each_point_and_is_judged_and_proven_at_the_start(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = rig_with(tmp_path, at(300.0, 6.0, 50.0), at(150.0, 5.2, 40.0))
    answer = tuned(file, in_process, "--table")
    assert answer.returncode == 0, answer.stderr
    assert "gain table, by operating point:" in answer.stdout
    settings = load(file)
    for rig in (settings, adopted(settings, NOW)):  # as the supervisor has them, and as a client reads them
        found = design_in_use(rig, NOW)
        assert isinstance(found.gains, ScheduledGains)
        first, second = found.gains.table
        assert (first.tension_n, first.stroke_mm, first.believes) == (300.0, 50.0, {})
        assert (second.tension_n, second.stroke_mm) == (150.0, 40.0)
        assert set(second.believes) == {"plant.spring_n_mm"}
        assert 0.0 < found.gains.dwell_s < 10.0
        said = found.as_dict()
        assert set(said["gains"]) == {"k_tension", "k_speed", "k_integral"}
        assert [entry["tension_n"] for entry in said["schedule"]["table"]] == [300.0, 150.0]


def test_a_table_that_is_not_borne_out_leaves_its_first_entry_with_a_warning(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = rig_with(tmp_path, at(300.0, 6.0, 50.0), at(150.0, 5.2, 40.0))
    assert tuned(file, in_process, "--table").returncode == 0
    settings = load(file)
    ledger.append(settings, response(settings, -1.0, 150.0, stroke_mm=40.0))  # 6 N/mm there
    found = design_in_use(settings, NOW + timedelta(days=2))
    assert not isinstance(found.gains, ScheduledGains)
    assert found.accepted
    (warning,) = found.warnings()
    assert warning.startswith("the gain table is not used, only its first entry: ")
    assert "found stiffness_n_mm 6 +- 0.01" in warning


def test_a_sensitivity_that_differs_bars_other_gains_and_warns_at_a_start(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    """Of gains that no identification backs; those of an identified plant are then not believed."""
    file = rig_with(tmp_path)
    settings, gains = load(file), file.with_name("gains.yaml")
    assert in_process("rigctl", "tune", file, "--gains", gains).returncode == 0
    text = gains.read_text()

    def window(hours: float, worst: dict[str, float] | None) -> None:
        t_ns = NOON_NS + round(hours * 3600e9)
        figures = {"difference": worst}
        ledger.append(
            settings, ledger.entry(settings, "margins", "gateway", t_ns, before={}, after={}, figures=figures)
        )

    assert design_while_running(settings, text, "gains.yaml", NOW).accepted
    window(-2.0, {"hz": 60.0, "measured": 1.9, "error": 0.02, "low": 1.1, "high": 1.5})
    said = r"measured \|S\| 1\.90 \+- 0\.02 at 60 Hz, the design had 1\.10 to 1\.50"
    with pytest.raises(GainFileError, match=f"{said}: identify and tune again"):
        design_while_running(settings, text, "gains.yaml", NOW)
    found = design_in_use(settings, NOW)
    assert found.accepted
    (warning,) = found.warnings()
    assert re.search(f"{said}; identify and tune again", warning)
    window(-1.0, None)
    assert design_while_running(settings, text, "gains.yaml", NOW).accepted
    assert design_in_use(settings, NOW).warnings() == []


def test_a_table_needs_a_ledger(in_process: Command) -> None:
    answer = in_process("rigctl", "tune", "config/paper_rig.yaml", "--table")
    assert answer.returncode == 2
    assert answer.stderr == "rigctl: --table: expected with --from\n"
