"""The scenario format: read exactly, or refused with one line of place and reason; its page describes all of it."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Callable
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.scenario.case import load
from hil.scenario.errors import ScenarioError
from hil.scenario.figures import LOOP_FIGURES, TRUTH_FIGURES
from hil.scenario.format import Scenario, read
from hil.scenario.kinds import Disturbances
from hil.scenario.layered_rig import settings_of
from rigctl.config.wording import KeyType
from rigctl.model.quantity import unit_of
from tests.builders.paths import ROOT

PAGE = (ROOT / "docs/scenario.md").read_text()
SHIPPED = sorted((ROOT / "config/scenarios").glob("*.yaml"))

GOOD = """\
scenario: probe
rig: RIG
change:
  plant: {payload_kg: 20.0}
  simulation:
    mechanism: {vertical_n_mm: 60.0}
duration_s: 10.0
disturbances:
  mechanism:
    - {kind: rotate, angle_deg: 5.0, speed_deg_s: 0.5, acceleration_deg_s2: 0.25}
  vertical:
    - {kind: sine, amplitude_mm: 1.0, frequency_hz: 2.0, duration_s: 4.0}
  run_out:
    - kind: table
      points: [{angle_deg: 0.0, level_mm: 0.0}, {angle_deg: 5.0, level_mm: 0.2}]
  floor:
    - {kind: noise, axis: vertical, rms_mm: 0.01, from_hz: 2.0, to_hz: 20.0}
  impacts:
    - {kind: impulse, axis: vertical, impulse_n_s: 1.0, at_s: 2.0}
  mass:
    - {change_kg: -1.0, at_s: 3.0}
windows:
  plateau: {from_s: 5.0, to_s: 9.0}
""".replace("RIG", str(ROOT / "config/paper_rig.yaml"))

Refuse = Callable[[str, str], list[str]]


@pytest.fixture
def refuse(tmp_path: pathlib.Path) -> Refuse:
    file = tmp_path / "probe.yaml"

    def findings(old: str, new: str) -> list[str]:
        assert old in GOOD
        file.write_text(GOOD.replace(old, new, 1))
        with pytest.raises(ScenarioError) as error:
            load(file)
        assert error.value.exit_code == 2
        return [line.replace(str(file), "FILE") for line in error.value.findings]

    return findings


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_the_files_we_ship_are_accepted_and_named_after_themselves(file: pathlib.Path) -> None:
    assert load(file).scenario.scenario == file.stem


def test_what_is_written_is_what_is_read(tmp_path: pathlib.Path) -> None:
    (tmp_path / "probe.yaml").write_text(GOOD)
    case = load(tmp_path / "probe.yaml")
    assert case.settings.plant.payload_kg == 20.0
    assert case.settings.simulation is not None
    assert case.settings.simulation.mechanism.vertical_n_mm == 60.0
    assert case.target_n == 300.0
    assert case.scenario.spans == {"run": (0.0, 10.0), "plateau": (5.0, 9.0)}


@pytest.mark.parametrize(
    ("old", "new", "key", "found", "allowed"),
    [
        ("duration_s: 10.0\n", "", "duration_s", "nothing", "a number in s, above 0 to 3600"),
        ("duration_s: 10.0", "duration_s: -1.0", "duration_s", "-1.0", "above 0"),
        ("duration_s: 10.0", "duraton_s: 10.0", "duraton_s", "an unknown key", "duration_s?"),
        ("scenario: probe", "scenario: Probe 1", "scenario", "'Probe 1'", "matching ^[a-z]"),
        ("duration_s: 10.0", "duration_s: 10.0\ncontroller: off_line", "controller", "'off_line'", "loop or locked"),
        ("duration_s: 10.0", "duration_s: 10.0\nsets: ideal", "sets", "'ideal'", "a list of text"),
        ("duration_s: 10.0", "duration_s: 10.0\nsets: [1]", "sets.0", "1", "text"),
        ("duration_s: 10.0", "duration_s: 10.0\nsets: [nothing]", "sets.0", "'nothing'", "air_bearing, as_sold"),
        ("duration_s: 10.0", "duration_s: 10.0\nsets: [./no.yaml]", "sets.0", "'./no.yaml'", "no.yaml is not there"),
        ("duration_s: 10.0", "duration_s: 10.0\nsets: [\u202eabc]", "sets.0", r"'\u202eabc'", r"\u202eabc.yaml is"),
        ("duration_s: 10.0", "duration_s: 10.0\ntarget_n: 500.0", "target_n", "500.0", "50 to 350"),
        ("kind: rotate", "kind: spin", "disturbances.mechanism.0.kind", "'spin'", "rotate or out_and_back"),
        ("kind: rotate, ", "", "disturbances.mechanism.0.kind", "nothing", "rotate or out_and_back"),
        ("- {kind: rotate", "- 5\n    - {kind: rotate", "disturbances.mechanism.0", "5", "a section"),
        ("speed_deg_s: 0.5", "speed_deg_s: 0.0", "disturbances.mechanism.0.speed_deg_s", "0.0", "deg/s, above 0 to 90"),
        ("speed_deg_s: 0.5, ", "", "disturbances.mechanism.0.speed_deg_s", "nothing", "a number in deg/s"),
        ("speed_deg_s", "sped_deg_s", "disturbances.mechanism.0.sped_deg_s", "an unknown key", "speed_deg_s?"),
        ("0.25}", "0.25, start_s: 10.0}", "disturbances.mechanism.0.start_s", "10.0", "below duration_s (10)"),
        ("  mechanism:\n", "  mechanisms:\n", "disturbances.mechanisms", "an unknown key", "mechanism?"),
        ("duration_s: 4.0", "duration_s: 0.5", "disturbances.vertical.0.duration_s", "0.5", "twice fade_s (1)"),
        ("frequency_hz: 2.0", "frequency_hz: 501.0", "disturbances.vertical.0.frequency_hz", "501.0", "0 to 500"),
        ("{angle_deg: 5.0, l", "{angle_deg: 0.0, l", "disturbances.run_out.0.points.1.angle_deg", "0.0", "above"),
        (", {angle_deg: 5.0, level_mm: 0.2}", "", "disturbances.run_out.0.points", "a list", "2 to 1000 items"),
        ("axis: vertical, rms", "axis: up, rms", "disturbances.floor.0.axis", "'up'", "vertical, radial or tangential"),
        ("from_hz: 2.0", "from_hz: 20.0", "disturbances.floor.0.from_hz", "20.0", "below to_hz (20)"),
        ("vertical, impulse", "normal, impulse", "disturbances.impacts.0.axis", "rigid", "mechanism.normal_n_mm"),
        ("{vertical_n_mm: 60.0}", "{normal_n_mm: 1.0}", "disturbances.impacts.0.axis", "rigid", "set simulation"),
        ("change_kg: -1.0", "change_kg: -20.0", "disturbances.mass.0.change_kg", "-20.0", "above -20"),
        ("to_s: 9.0", "to_s: 11.0", "windows.plateau.to_s", "11.0", "at most duration_s (10)"),
        ("from_s: 5.0", "from_s: 9.0", "windows.plateau.from_s", "9.0", "below to_s (9)"),
        ("{from_s: 5.0, to_s: 9.0}", "[5.0, 9.0]", "windows.plateau", "a list", "a section"),
        ("plateau:", "run:", "windows.run", "a window", "another name"),
        ("plateau:", "Plateau 1:", "windows.Plateau 1", "'Plateau 1'", "matching"),
        ("payload_kg: 20.0", "payload_kg: -2.0", "change.plant.payload_kg", "-2.0", "a number in kg, 0.1 to 1000"),
        ("payload_kg: 20.0", "payload_t: 0.02", "change.plant.payload_t", "an unknown key", "payload_kg?"),
        ("payload_kg: 20.0", "radius_mm: x", "change.plant.radius_mm", "'x'", "a number in mm"),
        ("plant: {payload_kg: 20.0}", "plant: null", "change.plant", "None", "a section"),
        ("plant: {", "plain: {", "change.plain", "an unknown key", "rig file"),
        ("plant: {payload_kg: 20.0}", "cylinder: {eds: x.eds}", "change.cylinder.eds", "a key", "rig file only"),
        ("paper_rig.yaml", "no_rig.yaml", "rig", "no_rig.yaml", "a rig file"),
    ],
)  # fmt: skip
def test_a_bad_value_gets_one_line(refuse: Refuse, old: str, new: str, key: str, found: str, allowed: str) -> None:
    line = refuse(old, new)[0]
    prefix, _, rest = line.partition(": ")
    assert prefix.startswith("FILE:")
    text = GOOD.replace(old, new, 1).splitlines()[int(prefix.removeprefix("FILE:")) - 1]
    own = key.rpartition(".")[2]
    if found != "nothing" and not own.isdigit():
        assert own in text
    assert rest.startswith(f"{key}: found ")
    assert found in rest.partition(", expected")[0]
    assert allowed in rest.partition(", expected")[2]


def test_a_change_that_does_not_go_with_the_rig_file_says_so(refuse: Refuse) -> None:
    (line,) = refuse("  plant: {payload_kg: 20.0}", "  tension_cell: {range_n: 390.0}")
    assert re.fullmatch(
        r".*paper_rig.yaml:\d+: safety.tension_high_n \(as changed by FILE\): found 400.0, .*\(390\)", line
    )


def test_an_error_in_a_set_names_the_set(refuse: Refuse, tmp_path: pathlib.Path) -> None:
    (tmp_path / "soft.yaml").write_text("plant:\n  rope_n_mm: 500.0\n  spring_n_mm: -6.0\n")
    (line,) = refuse("duration_s: 10.0", "duration_s: 10.0\nsets: [./soft.yaml]")
    assert line.startswith(f"{tmp_path}/soft.yaml:3: plant.spring_n_mm: found -6.0, expected a number in N/mm")


def test_a_later_layer_wins(tmp_path: pathlib.Path) -> None:
    (tmp_path / "a.yaml").write_text("plant: {payload_kg: 1.0, radius_mm: 700.0, spring_n_mm: null}\n")
    (tmp_path / "b.yaml").write_text("plant: {radius_mm: 710.0}\n")
    (tmp_path / "probe.yaml").write_text(GOOD + "sets: [./a.yaml, ./b.yaml]\n")
    plant = load(tmp_path / "probe.yaml").settings.plant
    assert (plant.payload_kg, plant.radius_mm, plant.spring_n_mm) == (20.0, 710.0, None)


@pytest.mark.parametrize(
    "text", ["", "- 1\n", "a: &x [*x]\n", "\x00", "a: !!python/object:os.system x\n", "rig: {" * 3000, '"a\\nb": 1\n']
)
def test_what_is_no_scenario_is_refused(tmp_path: pathlib.Path, text: str) -> None:
    file = tmp_path / "probe.yaml"
    file.write_text(text)
    with pytest.raises(ScenarioError) as error:
        load(file)
    assert all(line.startswith(f"{file}:") and "\n" not in line for line in error.value.findings)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: pathlib.Path) -> None:
    (tmp_path / "latin.yaml").write_bytes(b"rig: \xff\xfe\n")
    for name, words in (("none.yaml", "cannot be read"), (".", "cannot be read"), ("latin.yaml", "not UTF-8")):
        with pytest.raises(ScenarioError, match=words):
            load(tmp_path / name)


_LEAVES = (
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9).map(lambda x: round(x, 3)) | st.text(max_size=3)
)
_KEYS = st.sampled_from(
    ["scenario", "rig", "sets", "change", "disturbances", "windows", "mechanism", "impacts", "floor", "kind", "plant"]
) | st.text(max_size=2)
_TREES = st.recursive(_LEAVES, lambda x: st.lists(x, max_size=3) | st.dictionaries(_KEYS, x, max_size=4), max_leaves=12)


@settings(max_examples=80, deadline=None)
@given(st.sampled_from(sorted(Scenario.model_fields)), _TREES)
def test_any_data_is_a_scenario_or_refused_in_lines(tmp_path_factory: Any, key: str, value: Any) -> None:
    import yaml

    file = tmp_path_factory.getbasetemp() / "any.yaml"
    data = {**yaml.safe_load(GOOD), key: value}
    file.write_text(yaml.safe_dump(data, allow_unicode=True), encoding="utf-8")
    try:
        load(file)
    except ScenarioError as error:
        assert error.findings
        assert all("found" in line or "cannot be read" in line for line in error.findings)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, len(GOOD)), st.integers(0, 40), st.text(max_size=8))
def test_any_damage_leaves_a_scenario_or_is_refused(tmp_path_factory: Any, at: int, length: int, new: str) -> None:
    file = tmp_path_factory.getbasetemp() / "damaged.yaml"
    file.write_text(GOOD[:at] + new + GOOD[at + length :], encoding="utf-8")
    try:
        load(file)
    except ScenarioError as error:
        assert error.findings


# --- the page


def test_the_page_leads_to_every_key_with_its_range_and_default() -> None:
    """`tests/unit/hil/test_reference.py` holds that page to the format."""
    assert "(rig-file.md#scenario-file)" in PAGE


def test_the_page_names_every_kind() -> None:
    for info in Disturbances.model_fields.values():
        item = KeyType.of(info).child(0)
        assert item is not None
        for kind in item.kinds:
            assert f"`{kind}`" in PAGE


def test_the_page_defines_every_figure() -> None:
    for heading, table in (("figures of the truth", TRUTH_FIGURES), ("figures of the loop", LOOP_FIGURES)):
        section = PAGE.partition(f"### {heading}\n")[2].partition("\n#")[0]
        written = re.findall(r"^\| (`.+?) \| (.*?) \|", section, re.MULTILINE)
        named = {name: unit for names, unit in written for name in re.findall(r"`(\w+)`", names)}
        assert named == {figure.name: unit_of(figure.name) for figure in table}


def test_the_pages_example_is_a_scenario(tmp_path: pathlib.Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    file = tmp_path / "example.yaml"
    file.write_text(block.replace("../paper_rig.yaml", str(ROOT / "config/paper_rig.yaml")))
    scenario = load(file).scenario
    for name in Disturbances.model_fields:
        assert getattr(scenario.disturbances, name), f"the example has no {name}"
    assert set(read(file).document.data) == set(Scenario.model_fields), "the example shows every key"


def test_kinds_are_told_apart_by_their_name() -> None:
    for info in Disturbances.model_fields.values():
        item = KeyType.of(info).child(0)
        assert item is not None
        for kind, model in item.kinds.items():
            assert get_args(model.model_fields["kind"].annotation) == (kind,)


def test_a_value_that_cannot_be_read_hides_no_other_finding(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text(
        "scenario: broken\nrig: rig.yaml\nduration_s: .nan\nsettle_s: -3\nbogus: 1\n"
        "windows: {early: {from_s: 1e-3, to_s: 2.0}}\n"
    )
    with pytest.raises(ScenarioError) as refused:
        read(file)
    found = str(refused.value).splitlines()
    assert len(found) == 4
    number = "expected a finite number written like 10, 0.001 or 1.0e-3"
    assert f"{file}:3: duration_s: found .nan, {number}" in found
    assert f"{file}:6: windows.early.from_s: found 1e-3, {number}" in found
    assert any(line.startswith(f"{file}:4: settle_s: found -3") for line in found)
    assert any(line.startswith(f"{file}:5: bogus: found an unknown key") for line in found)


def test_an_unreadable_value_in_a_change_is_refused(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text(
        f"scenario: broken\nrig: {ROOT / 'config/paper_rig.yaml'}\nduration_s: 5.0\n"
        "change: {plant: {spring_n_mm: .inf}}\n"
    )
    with pytest.raises(ScenarioError, match=r"change\.plant\.spring_n_mm: found \.inf, expected a finite number"):
        settings_of(read(file))
