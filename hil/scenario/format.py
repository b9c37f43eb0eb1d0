"""The scenario file (YAML) as frozen, validated settings; see docs/scenario.md."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from hil.scenario.errors import ScenarioError
from hil.scenario.kinds import LONGEST_S, Disturbances
from rigctl.config import strict_yaml
from rigctl.config.one_line import printable
from rigctl.config.settings_base import Settings, require
from rigctl.config.wording import Path, Wording

WHOLE_RUN = "run"
"""Name of the window that every scenario has."""

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class Window(Settings):
    """A span of the run that figures are taken over, both ends included."""

    from_s: float = Field(ge=0, le=LONGEST_S, description="begin")
    to_s: float = Field(gt=0, le=LONGEST_S, description="end")


class Scenario(Settings):
    """A whole scenario file."""

    scenario: Name = Field(description="name, in every output")
    rig: str = Field(min_length=1, description="rig file, relative to this one")
    sets: list[str] = Field(
        default_factory=list, description="parameter sets laid over the rig file in this order: names or files"
    )
    change: dict[str, Any] = Field(default_factory=dict, description="settings of the rig file, laid over last")
    controller: Literal["loop", "locked"] = Field(
        default="loop", description="loop: the real loop; locked: the cylinder holds its stroke"
    )
    target_n: float | None = Field(
        default=None, ge=1, le=10_000, description="vertical tension to hold; null = the rig file's tension.target_n"
    )
    settle_s: float = Field(default=2.0, ge=0, le=600, description="loop: time in COMPENSATING before time 0")
    duration_s: float = Field(gt=0, le=LONGEST_S, description="of the run, from time 0")
    disturbances: Disturbances = Field(default_factory=Disturbances, description="what happens, from time 0")
    windows: dict[Name, Window] = Field(default_factory=dict, description="spans figures are taken over, by name")

    @model_validator(mode="after")
    def _windows_are_in_the_run(self) -> Scenario:
        for name, window in self.windows.items():
            require(name != WHOLE_RUN, f"windows.{name}", "a window", "another name: this one is the whole run's")
            end = window.to_s
            require(end <= self.duration_s, f"windows.{name}.to_s", end, f"at most duration_s ({self.duration_s:g})")
            require(window.from_s < end, f"windows.{name}.from_s", window.from_s, f"below to_s ({end:g})")
        return self

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """All windows by name, the whole run first."""
        named = {name: (window.from_s, window.to_s) for name, window in self.windows.items()}
        return {WHOLE_RUN: (0.0, self.duration_s), **named}


@dataclass(frozen=True)
class ScenarioFile:
    """A scenario with its source file, so that later findings can name their line."""

    scenario: Scenario
    file: pathlib.Path
    document: strict_yaml.Document
    wording: Wording

    def refusal(self, path: Path, found: object, allowed: str) -> ScenarioError:
        """An error about the entry at ``path``."""
        return ScenarioError([self.wording.say(path, found, printable(allowed))])  # it may quote a file's path


def read(path: str | pathlib.Path) -> ScenarioFile:
    """Read and validate a scenario file; the rig it names is not read.

    Raises:
        ScenarioError: one line per finding, ``FILE:LINE: key: found X, expected Y``.
    """
    file = pathlib.Path(path)
    document = read_yaml(file)
    wording = Wording(Scenario, frozenset(), document, file)
    try:
        return ScenarioFile(Scenario.model_validate(document.data), file, document, wording)
    except ValidationError as error:
        raise ScenarioError(wording.lines(error)) from None


def read_yaml(file: pathlib.Path) -> strict_yaml.Document:
    """A file that is a mapping of keys.

    Raises:
        ScenarioError: the file cannot be read, is not text, not YAML, or not a mapping.
    """
    try:
        document = strict_yaml.read(file)
    except strict_yaml.FileError as error:
        raise ScenarioError([str(error)]) from None
    if not isinstance(document.data, dict):
        raise ScenarioError([f"{file}:1: found {type(document.data).__name__}, expected a mapping of keys"])
    return document
