"""A scenario ready to be played: read, with its rig's settings, and checked against them."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

from hil.plant.inputs import Track
from hil.scenario import consistency, disturbances, format, layered_rig
from hil.scenario.format import Scenario
from rigctl.config.settings import RigSettings


@dataclass(frozen=True)
class Case:
    """Everything a run needs."""

    scenario: Scenario
    settings: RigSettings
    tracks: dict[int, Track]
    file: pathlib.Path

    @property
    def target_n(self) -> float:
        """Vertical tension to hold."""
        return self.settings.tension.target_n


def load(path: str | pathlib.Path) -> Case:
    """Read a scenario file and the rig it names.

    Raises:
        ScenarioError: one line per finding, ``FILE:LINE: key: found X, expected Y``.
    """
    source = format.read(path)
    settings = layered_rig.settings_of(source)
    consistency.check(source, settings)
    scenario = source.scenario
    prescribed = disturbances.tracks(scenario.disturbances, scenario.duration_s)
    return Case(scenario, settings, prescribed, source.file)
