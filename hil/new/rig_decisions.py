"""What an engineer decides about a new rig: the settings behind the options, their bounds and their defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from hil.scenario.errors import ScenarioError
from rigctl.config.bounds import GRAVITY_MM_S2
from rigctl.config.settings import RigSettings
from rigctl.config.settings_base import Settings
from rigctl.config.wording import KeyType
from rigctl.model.quantity import unit_of

LIFTING = 1.1
"""Largest target over the payload's weight: the paper's is 1.02; a larger one pulls at the mechanism from above."""
LONGEST_S = 40.0
"""Longest tensioning at the largest speed: it begins and ends slower, and `rigctl demo` waits for 60 s."""
_WHOLE_MM = 10.0


@dataclass(frozen=True)
class RigDecision:
    """A number of the rig file that an option sets; range and meaning are the setting's own."""

    option: str
    key: str

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return unit_of(self.key.rpartition(".")[2])

    @property
    def meaning(self) -> str:
        """What it is, in words."""
        return str(self._field.description)

    @property
    def allowed(self) -> str:
        """What is allowed, in words, with the unit."""
        return KeyType(float, tuple(self._field.metadata)).allowed(self.key)

    def check(self, value: float) -> None:
        """Refuse a value out of the setting's range.

        Raises:
            ScenarioError: one line.
        """
        try:
            TypeAdapter(Annotated[float, Field(allow_inf_nan=False), *self._field.metadata]).validate_python(value)
        except ValidationError:
            raise ScenarioError([f"{self.option}: found {value:g}, expected {self.allowed}"]) from None

    @property
    def _field(self) -> FieldInfo:
        section, name = self.key.split(".")
        model = RigSettings.model_fields[section].annotation
        assert isinstance(model, type) and issubclass(model, Settings)
        return model.model_fields[name]


PAYLOAD = RigDecision("--payload", "plant.payload_kg")
SPRING = RigDecision("--spring", "plant.spring_n_mm")
TARGET = RigDecision("--target", "tension.target_n")
SPEED = RigDecision("--speed", "tension.speed_max_mm_s")
STROKE = RigDecision("--stroke", "cylinder.stroke_max_mm")
DECISIONS = (PAYLOAD, SPRING, TARGET, SPEED, STROKE)
"""In the order of the questions: a default may depend on what stands before it."""


@dataclass(frozen=True)
class DecidedRig:
    """A number for each decision, in its unit."""

    payload_kg: float
    spring_n_mm: float
    target_n: float
    speed_mm_s: float
    stroke_mm: float

    @classmethod
    def of(cls, found: Mapping[RigDecision, float]) -> DecidedRig:
        """The decisions by name."""
        return cls(*(found[decision] for decision in DECISIONS))


def default(decision: RigDecision, before: Mapping[RigDecision, float], paper: RigSettings) -> float:
    """What the paper's rig has, in proportion to what is decided before it.

    Args:
        decision: which one.
        before: the decisions above it in `DECISIONS`.
        paper: settings of the paper's rig.
    """
    plant, tension = paper.plant, paper.tension
    assert plant.spring_n_mm is not None
    if decision is TARGET:
        return _significant(before[PAYLOAD] * tension.target_n / plant.payload_kg)
    if decision is STROKE:
        least = least_stroke_mm(before[SPRING], before[TARGET], paper)
        return max(paper.cylinder.stroke_max_mm, _WHOLE_MM * math.ceil(least / _WHOLE_MM))
    return {
        PAYLOAD: plant.payload_kg, SPRING: plant.spring_n_mm, SPEED: tension.speed_max_mm_s,
    }[decision]  # fmt: skip


def least_stroke_mm(spring_n_mm: float, target_n: float, paper: RigSettings) -> float:
    """Stroke that takes up the slack and the highest target, and leaves the travel that `limits` allow beyond it."""
    assert paper.simulation is not None
    stiffness = _in_series(spring_n_mm, paper)
    highest_n = target_n * paper.tension.target_max_n / paper.tension.target_n
    travel_mm = max(row.high or 0.0 for row in paper.limits if row.signal == "travel_mm")
    warned_mm = paper.cylinder.stroke_max_mm - max(row.high or 0.0 for row in paper.limits if row.signal == "stroke_mm")
    return math.ceil(paper.simulation.rope.slack_mm + highest_n / stiffness + travel_mm + warned_mm)


def check_together(decided: DecidedRig, paper: RigSettings) -> None:
    """Refuse decisions that do not go together.

    Raises:
        ScenarioError: one line.
    """
    weight_n = 1e-3 * GRAVITY_MM_S2 * decided.payload_kg
    if decided.target_n > LIFTING * weight_n:
        raise ScenarioError([
            f"--target: found {decided.target_n:g}, expected at most {LIFTING * weight_n:.3g} N: "
            f"{LIFTING:g} times the weight of {decided.payload_kg:g} kg"
        ])  # fmt: skip
    taken_mm = decided.target_n / _in_series(decided.spring_n_mm, paper)
    if decided.speed_mm_s < taken_mm / LONGEST_S:
        raise ScenarioError([
            f"--speed: found {decided.speed_mm_s:g}, expected at least {taken_mm / LONGEST_S:.3g} mm/s: "
            f"{taken_mm:.3g} mm of stroke for {decided.target_n:g} N take {LONGEST_S:g} s at most"
        ])  # fmt: skip
    least = least_stroke_mm(decided.spring_n_mm, decided.target_n, paper)
    if decided.stroke_mm < least:
        raise ScenarioError([
            f"--stroke: found {decided.stroke_mm:g}, expected at least {least:g} mm: a spring of "
            f"{decided.spring_n_mm:g} N/mm takes it for {decided.target_n:g} N and the highest target above it"
        ])  # fmt: skip


def _in_series(spring_n_mm: float, paper: RigSettings) -> float:
    """Stiffness of spring and rope, equation (17)."""
    return paper.plant.model_copy(update={"spring_n_mm": spring_n_mm}).stiffness_n_mm


def _significant(value: float) -> float:
    return float(f"{value:.3g}")
