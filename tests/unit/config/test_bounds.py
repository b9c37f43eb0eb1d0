"""No legal value of a setting disables a protection: every bound refuses values beyond it and gives the reason."""

from __future__ import annotations

import math
import pathlib
from typing import Any

import pytest
import yaml

from rigctl.cli import check
from rigctl.config import bounds as config_bounds
from rigctl.config import rig_file as config
from rigctl.config.bounds import BOUNDS, Bound, Stop, findings
from rigctl.config.io_section import IoSettings
from rigctl.config.limits_section import LimitSettings
from rigctl.config.settings import RigSettings
from tests.builders.paths import ROOT

PAPER = ROOT / "config/paper_rig.yaml"
RIG = config.load(PAPER).model_copy(update={"io": IoSettings(e_stop_input=0)})
WAIVER = "a study without a spring"


def changed(**sections: dict[str, Any]) -> RigSettings:
    return RIG.model_copy(
        update={name: getattr(RIG, name).model_copy(update=values) for name, values in sections.items()}
    )


def refusals(tmp_path: pathlib.Path, **sections: dict[str, Any]) -> list[str]:
    data = yaml.safe_load(PAPER.read_text())
    for section, values in sections.items():
        data.setdefault(section, {}).update(values)
    for device, eds in (("tension_cell", "tension_amplifier"), ("inclinometer",) * 2, ("cylinder", "cylinder_drive")):
        data[device]["eds"] = str(ROOT / f"config/eds/{eds}.eds")
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(data))
    try:
        config.load(file)
    except config.ConfigError as error:
        return error.findings
    return []


def with_value(bound: Bound, value: float) -> RigSettings:
    section, name = bound.key.split(".")
    return changed(**{section: {name: value}})


@pytest.mark.parametrize("name", ["paper_rig", "plain_rig", "rig"])
def test_every_shipped_rig_is_within_its_bounds(name: str) -> None:
    assert list(findings(config.load(ROOT / f"config/{name}.yaml"))) == []


@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: f"{bound.key}-{'least' if bound.least else 'most'}")
def test_each_bound_holds_at_its_limit_and_refuses_what_lies_beyond_with_its_reason(bound: Bound) -> None:
    """The limit may move with the value (a speed changes every way), so the test finds it by halving."""

    def refused(value: float) -> bool:
        return any(f.key == bound.key and bound.why in f.allowed for f in findings(with_value(bound, value)))

    section, name = bound.key.split(".")
    good = float(getattr(getattr(RIG, section), name))
    bad = 1e-9 if bound.least else 1e9
    assert not refused(good)
    assert refused(bad)
    for _ in range(60):
        middle = math.sqrt(good * bad)
        good, bad = (good, middle) if refused(middle) else (middle, bad)
    found = next(f for f in findings(with_value(bound, bad)) if f.key == bound.key and bound.why in f.allowed)
    shown = float(found.allowed.split()[2])
    assert shown == pytest.approx(good, rel=0.01)
    assert not refused(shown), "what is said to be allowed is"
    assert "safety.waiver" in found.allowed


REFUSED: list[tuple[str, dict[str, dict[str, Any]], str]] = [
    ("cylinder.stop_deceleration_mm_s2", {"cylinder": {"stop_deceleration_mm_s2": 0.001}}, "within 1 mm"),
    ("cylinder.stop_deceleration_mm_s2", {"cylinder": {"stop_deceleration_mm_s2": 0.5}}, "at least 50"),
    ("cylinder.heartbeat_timeout_ms", {"cylinder": {"heartbeat_timeout_ms": 1000}}, "at most 100"),
    ("cylinder.command_deadline_ms", {"cylinder": {"command_deadline_ms": 1000}}, "at most 100"),
    ("cylinder.brake_delay_ms", {"cylinder": {"brake_delay_ms": 0}}, "no holding brake"),
    ("tension.acceleration_max_mm_s2", {"tension": {"acceleration_max_mm_s2": 0.5}}, "every hold brakes with it"),
    ("safety.tension_high_n", {"safety": {"tension_high_n": 900.0}, "tension_cell": {"range_n": 1000.0}}, "own weight"),
    ("safety.tension_low_n", {"safety": {"tension_low_n": 0.0}, "calibration": None}, "slack rope"),  # type: ignore[dict-item]
    ("safety.persistence_ms", {"safety": {"persistence_ms": 1000}}, "at most 100"),
    ("safety.stale_ms", {"safety": {"stale_ms": 1000}}, "at most 100"),
    ("safety.bus_silent_ms", {"safety": {"bus_silent_ms": 1000}}, "at most 100"),
    ("safety.inclination_stale_ms", {"safety": {"inclination_stale_ms": 5000}}, "swing"),
    ("safety.stuck_samples", {"safety": {"stuck_samples": 0}}, "never trips"),
    ("safety.stuck_samples", {"safety": {"stuck_samples": 10_000}}, "at most 100"),
    ("safety.overrun_ticks", {"safety": {"overrun_ticks": 1000}}, "at most 100"),
    ("safety.overrun_ticks", {"safety": {"overrun_window_ms": 10}}, "never reached"),
    ("estimator.reject_limit", {"estimator": {"reject_limit": 1000}}, "at most 100"),
    ("estimator.cell_noise_scale", {"estimator": {"cell_noise_scale": 1000.0}}, "the gate lets"),
    ("estimator.gate_speed_mm_s", {"estimator": {"gate_speed_mm_s": 1000.0}}, "no payload"),
    ("tension_cell.noise_n", {"tension_cell": {"noise_n": 100.0}}, "CELL_NOISY"),
    ("design.ms_max", {"design": {"ms_max": 10.0}}, "phase margin"),
    ("calibration.tare_limit_n", {"calibration": {"tare_limit_n": 30.0}, "safety": {"tension_low_n": 40.0}}, "5 %"),
    ("calibration.tolerance_pct", {"calibration": {"tolerance_pct": 5.0}}, "ISO 7500-1"),
    ("calibration.due_days", {"calibration": {"due_days": 3650}}, "18 months"),
    ("calibration.reference_n", {"calibration": {"reference_n": 1.0}}, "a fifth"),
    ("preflight.disk_free_mib", {"preflight": {"disk_free_mib": 1}}, "trip dump"),
    ("hold.park_s", {"hold": {"park_s": 0.4}}, "0.5 to 30"),
    ("hold.park_s", {"hold": {"park_s": 31.0}}, "found 31.0"),
]


@pytest.mark.parametrize(("key", "sections", "why"), REFUSED, ids=[f"{key}-{why}" for key, _, why in REFUSED])
def test_a_value_that_disarms_a_protection_is_refused_in_words(
    tmp_path: pathlib.Path, key: str, sections: dict[str, dict[str, Any]], why: str
) -> None:
    sections = {name: values for name, values in sections.items() if values is not None}
    lines = refusals(tmp_path, **sections)
    if key == "safety.tension_low_n":  # the tare's limit is compared with it first
        assert len(lines) == 1
        found = [f for f in findings(changed(safety={"tension_low_n": 0.0})) if f.key == key]
        assert why in found[0].allowed
        return
    (line,) = lines
    assert line.startswith(f"{tmp_path}/rig.yaml:")
    assert f": {key}: found " in line
    assert why in line


def test_a_rope_without_a_spring_needs_words(tmp_path: pathlib.Path) -> None:
    bare = {"plant": {"spring_n_mm": None}}
    (line,) = refusals(tmp_path, **bare)
    assert "tension.speed_max_mm_s: found 10.0, expected at most 1.25 (" in line
    assert refusals(tmp_path, **bare, safety={"waiver": WAIVER}) == []


@pytest.mark.parametrize("k", [6.0, 13.0, 20.0, 27.0, 34.0])
def test_the_papers_springs_bear_the_stop(tmp_path: pathlib.Path, k: float) -> None:
    assert refusals(tmp_path, plant={"spring_n_mm": k}) == []


@pytest.mark.parametrize(
    ("row", "key"),
    [
        ({"signal": "tension_n", "high": 700.0}, "high"),
        ({"signal": "tangential_deg", "low": -40.0}, "low"),
        ({"signal": "tension_n", "high": 390.0, "persistence_ms": 3_600_000}, "persistence_ms"),
        ({"signal": "drive_temperature_c", "high": 80.0, "persistence_ms": 3_600_000}, "persistence_ms"),
    ],
)
def test_a_limit_that_acts_must_be_able_to_trip_in_time(row: dict[str, Any], key: str) -> None:
    def of(action: str) -> list[str]:
        rows = [LimitSettings.model_validate({**row, "action": action})]
        return [found.key for found in findings(RIG.model_copy(update={"limits": rows}))]

    assert of("hold") == [f"limits.0.{key}"]
    assert of("log") == []


def test_check_says_how_far_a_stop_goes_and_what_it_makes() -> None:
    stop = Stop.of(RIG)
    assert stop.distance_mm == pytest.approx(10.0 * 0.06 + 10.0 * 0.022 + 0.1)
    assert stop.newtons == pytest.approx(stop.distance_mm * RIG.plant.stiffness_n_mm)
    assert "0.92 mm" in stop.in_words(RIG)
    assert "350 N rise to 355.5 N (limit 400)" in stop.in_words(RIG)
    said = check.as_dict(RIG)
    assert (said["stop_distance_mm"], said["waived_bounds"]) == (0.92, [])
    bare = changed(plant={"spring_n_mm": None}, safety={"waiver": WAIVER})
    assert any(line.startswith("tension.speed_max_mm_s: found 10.0") for line in check.as_dict(bare)["waived_bounds"])


def test_figures_taken_from_the_loop_are_the_loops() -> None:
    from rigctl.control.bus import cell_step, channels
    from rigctl.control.watch import safety

    assert config_bounds.PAYLOAD_MM_S == cell_step.PAYLOAD_MM_S
    assert config_bounds.NOISY == safety.UNREST_NOISES
    assert config_bounds.OVERRANGE == channels.OVERRANGE


def test_the_page_is_what_the_table_gives() -> None:
    page = (ROOT / "docs/rig-file.md").read_text()
    assert config_bounds.section(config.load(PAPER)) in page, "run `python -m hil.cli.reference .`"


def test_a_scenario_is_a_study_and_may_take_the_spring_away(tmp_path: pathlib.Path) -> None:
    from hil.scenario.case import load

    file = tmp_path / "bare.yaml"
    file.write_text(
        f"scenario: bare\nrig: {PAPER}\nduration_s: 1.0\nchange: {{plant: {{spring_n_mm: null}}}}\n"
        "windows: {all: {from_s: 0.0, to_s: 1.0}}\n"
    )
    settings = load(file).settings
    assert settings.plant.spring_n_mm is None
    assert next(found.key for found in findings(settings)) == "tension.speed_max_mm_s"
