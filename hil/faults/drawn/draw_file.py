"""A draw as a file, which replays it without the seed (``python -m hil faults --replay FILE``)."""

from __future__ import annotations

import pathlib

import yaml
from pydantic import Field, ValidationError, field_validator

from hil.faults.drawn import courses, kinds
from hil.faults.drawn.draw import Draw, DrawnRig, PartFault
from hil.scenario.errors import ScenarioError
from hil.scenario.format import read_yaml
from rigctl.config.settings_base import Settings
from rigctl.config.wording import Wording
from rigctl.ipc import output_file


def _known(name: str, names: object) -> str:
    assert isinstance(names, dict)
    if name not in names:
        raise ValueError(f"expected {', '.join(names)}")
    return name


class RigChanges(Settings):
    """What differs from the rig file."""

    spring_n_mm: float = Field(gt=0, le=10_000, description="stiffness of the spring")
    mechanism_n_mm: float | None = Field(gt=0, le=1e6, description="vertical stiffness of the mechanism; null = rigid")
    target_n: float = Field(gt=0, le=10_000, description="vertical tension to hold")
    limits: bool = Field(description="whether the section limits of the rig file counts")


class FaultOfPart(Settings):
    """One fault."""

    kind: str = Field(description="what")
    size: float = Field(description="in the unit of its kind")
    at_s: float = Field(ge=0, le=600, description="when it begins, from power-on")

    _kind = field_validator("kind")(lambda name: _known(name, kinds.BY_NAME))


class DrawFile(Settings):
    """A whole file."""

    seed: int = Field(description="of the draws")
    index: int = Field(ge=0, description="number of the draw; with the seed it seeds the faults' noise")
    rig: RigChanges = Field(description="the drawn rig")
    course: str = Field(description="what the operator does")
    faults: list[FaultOfPart] = Field(min_length=1, max_length=4, description="in the order of their begin")
    then: str = Field(description="what the operator does after a reaction")
    then_after_s: float = Field(ge=0, le=600, description="how long after it")
    seconds: float = Field(gt=0, le=3600, description="from the first fault on")

    _course = field_validator("course")(lambda name: _known(name, courses.BY_NAME))
    _then = field_validator("then")(lambda name: _known(name, courses.THEN))

    @property
    def draw(self) -> Draw:
        """As the generator makes it."""
        faults = tuple(PartFault(**one.model_dump()) for one in sorted(self.faults, key=lambda one: one.at_s))
        return Draw(
            self.seed, self.index, DrawnRig(**self.rig.model_dump()), self.course, faults, self.then,
            self.then_after_s, self.seconds,
        )  # fmt: skip


def write(file: pathlib.Path, draw: Draw, findings: tuple[str, ...]) -> None:
    """Write a draw, with what was found as comments.

    Raises:
        OutputError: the file cannot be written.
    """
    head = "".join(f"# {line}\n" for line in (*findings, *(fault.words for fault in draw.faults)))
    document = {**draw.as_dict(), "faults": [vars(fault) for fault in draw.faults]}
    output_file.write(file, head + yaml.safe_dump(document, sort_keys=False))


def read(file: pathlib.Path) -> Draw:
    """Read a draw.

    Raises:
        ScenarioError: the file is not valid.
    """
    document = read_yaml(file)
    try:
        return DrawFile.model_validate(document.data).draw
    except ValidationError as error:
        raise ScenarioError(Wording(DrawFile, frozenset(), document, file).lines(error)) from None
