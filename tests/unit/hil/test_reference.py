"""Schemas and reference of the keys: current, true of every file shipped, and false of a wrong one."""

from __future__ import annotations

import copy
import json
import pathlib
import posixpath
import re
import tomllib
from typing import Any

import jsonschema
import pytest

from hil.cli.reference import documents, rig_schema, scenario_schema
from rigctl.config import strict_yaml
from tests.builders.paths import ROOT

RIGS = sorted(ROOT.glob("config/*.yaml"))
SCENARIOS = sorted(ROOT.glob("config/scenarios/*.yaml"))
WRONG: dict[str, tuple[tuple[str, ...], Any]] = {
    "an unknown key": (("loop", "rate"), 1000),
    "an unknown section": (("looop",), {}),
    "a text for a number": (("plant", "spring_n_mm"), "six"),
    "a value out of its bounds": (("loop", "rate_hz"), -5),
    "a key of the program": (("directory",), "/tmp"),
}


MODELINE = re.compile(r"# yaml-language-server: \$schema=(\S+)\n")


def data(file: pathlib.Path) -> Any:
    return copy.deepcopy(strict_yaml.read(file).data)


@pytest.mark.parametrize("name", sorted(documents()))
def test_every_generated_file_is_current(name: str) -> None:
    assert (ROOT / name).read_text() == documents()[name], "python -m hil.cli.reference ."


@pytest.mark.parametrize("file", RIGS, ids=lambda file: file.stem)
def test_every_rig_file_fits_its_schema(file: pathlib.Path) -> None:
    jsonschema.validate(data(file), rig_schema())


@pytest.mark.parametrize("file", SCENARIOS, ids=lambda file: file.stem)
def test_every_scenario_fits_its_schema(file: pathlib.Path) -> None:
    jsonschema.validate(data(file), scenario_schema())


def schema_named_by(file: pathlib.Path) -> str:
    """The path in the first line of a file, relative to it."""
    found = MODELINE.match(file.read_text())
    assert found is not None, f"{file}: its first line names no schema"
    return found[1]


@pytest.mark.parametrize("file", RIGS + SCENARIOS, ids=lambda file: file.stem)
def test_every_file_shipped_names_a_schema_that_it_fits(file: pathlib.Path) -> None:
    schema = json.loads((file.parent / schema_named_by(file)).read_text())
    assert schema["title"] == ("rigctl rig file" if file in RIGS else "rigctl scenario file")
    jsonschema.validate(data(file), schema)


def test_the_schema_is_at_that_path_of_an_installation_too() -> None:
    """As the wheel lays the files out; with it each scenario finds its rig, and its parameter sets."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    there = {posixpath.join(folder, found.name): found for folder, patterns in groups.items()
             for pattern in patterns for found in ROOT.glob(pattern)}  # fmt: skip
    files = {place: file for place, file in there.items() if file in RIGS + SCENARIOS}
    assert len(files) == len(RIGS + SCENARIOS)
    for place, file in files.items():
        folder = posixpath.dirname(place)
        assert posixpath.normpath(posixpath.join(folder, schema_named_by(file))) in there
        if file in SCENARIOS:
            rig = posixpath.normpath(posixpath.join(folder, data(file)["rig"]))
            assert rig in there
            for name in data(file).get("sets", []):
                assert posixpath.join(posixpath.dirname(rig), "sets", f"{name}.yaml") in there


@pytest.mark.parametrize("what", WRONG)
def test_what_the_program_refuses_the_schema_refuses(what: str) -> None:
    (*sections, key), value = WRONG[what]
    found = place = data(RIGS[0])
    for section in sections:
        place = place[section]
    place[key] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, rig_schema())


def test_a_scenario_with_a_wrong_key_is_refused() -> None:
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**data(SCENARIOS[0]), "durations_s": 3}, scenario_schema())


def test_the_schemas_are_schemas_and_an_identity_may_be_hexadecimal() -> None:
    for schema in (rig_schema(), scenario_schema()):
        jsonschema.Draft202012Validator.check_schema(schema)
    found = data(RIGS[0])
    found["cylinder"]["vendor"] = "0x1F"
    jsonschema.validate(found, rig_schema())
    found["cylinder"]["vendor"] = "1F"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, rig_schema())


def test_the_page_names_every_key() -> None:
    page = (ROOT / "docs/rig-file.md").read_text()
    for schema in (rig_schema(), scenario_schema()):
        for section in [schema, *json.loads(json.dumps(list(schema["$defs"].values())))]:
            for name in section.get("properties", {}):
                assert f"| `{name}` |" in page
