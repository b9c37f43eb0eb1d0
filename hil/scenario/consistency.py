"""Checks of a scenario against its rig: what is valid by itself but has no effect, or no meaning, on that rig."""

from __future__ import annotations

from collections.abc import Iterator

from hil.scenario import kinds
from hil.scenario.errors import ScenarioError
from hil.scenario.format import ScenarioFile
from hil.scenario.kinds import Disturbances
from rigctl.config.settings import RigSettings
from rigctl.config.wording import Path

STEPS_PER_PERIOD = 10
"""Fewest integration steps in the shortest prescribed period."""
STEPS_PER_IMPULSE = 5

Finding = tuple[Path, object, str]


def check(source: ScenarioFile, settings: RigSettings) -> None:
    """Check the scenario against its rig.

    Raises:
        ScenarioError: one line per contradiction.
    """
    findings = [*_timing(source), *of_rig(source.scenario.disturbances, settings)]
    if findings:
        raise ScenarioError([source.wording.say(*finding) for finding in findings])


def of_rig(disturbances: Disturbances, settings: RigSettings) -> Iterator[Finding]:
    """Place below the scenario, what was found and what is expected, of each that has no meaning on this rig."""
    yield from _rigid_axes(disturbances, settings)
    yield from _resolution(disturbances, settings)


def _timing(source: ScenarioFile) -> Iterator[Finding]:
    """A disturbance that begins after the end means that one of the two numbers is wrong."""
    end_s = source.scenario.duration_s
    disturbances = source.scenario.disturbances
    for name in type(disturbances).model_fields:
        for i, item in enumerate(getattr(disturbances, name)):
            for key in ("start_s", "at_s"):
                begin_s = getattr(item, key, 0.0)
                if begin_s >= end_s:
                    yield ("disturbances", name, i, key), begin_s, f"below duration_s ({end_s:g})"


def _rigid_axes(disturbances: Disturbances, settings: RigSettings) -> Iterator[Finding]:
    """A force or a change of mass moves the payload only where the mechanism is not rigid."""
    assert settings.simulation is not None  # settings_of raises without it
    mechanism = settings.simulation.mechanism
    for i, impact in enumerate(disturbances.impacts):
        if isinstance(impact, kinds.Impulse) and getattr(mechanism, f"{impact.axis}_n_mm") is None:
            yield ("disturbances", "impacts", i, "axis"), f"{impact.axis}, which is rigid", _gives_way(impact.axis)
    if disturbances.mass and mechanism.vertical_n_mm is None:
        yield ("disturbances", "mass"), "a change of mass on a rigid mechanism", _gives_way("vertical")
    left_kg = settings.plant.payload_kg
    for i, change in sorted(enumerate(disturbances.mass), key=lambda item: item[1].at_s):
        left_kg += change.change_kg
        if left_kg <= 0.0:
            lowest = change.change_kg - left_kg
            yield ("disturbances", "mass", i, "change_kg"), change.change_kg, f"above {lowest:g}: some payload is left"


def _gives_way(axis: str) -> str:
    return f"an axis that gives way: set simulation.mechanism.{axis}_n_mm under change:"


def _resolution(disturbances: Disturbances, settings: RigSettings) -> Iterator[Finding]:
    """The integration must resolve every prescribed motion."""
    assert settings.simulation is not None  # settings_of raises without it
    step_s = settings.simulation.step_us * 1e-6
    highest_hz = 1.0 / (STEPS_PER_PERIOD * step_s)
    shortest_s = STEPS_PER_IMPULSE * step_s
    for name in ("vertical", "floor"):
        for i, item in enumerate(getattr(disturbances, name)):
            for key in ("frequency_hz", "to_hz"):
                frequency = getattr(item, key, 0.0)
                if frequency > highest_hz:
                    words = f"at most {highest_hz:g}, {STEPS_PER_PERIOD} steps of simulation.step_us a period"
                    yield ("disturbances", name, i, key), frequency, words
    for i, impact in enumerate(disturbances.impacts):
        if isinstance(impact, kinds.Impulse) and impact.duration_s < shortest_s:
            words = f"at least {shortest_s:g}, {STEPS_PER_IMPULSE} steps of simulation.step_us"
            yield ("disturbances", "impacts", i, "duration_s"), impact.duration_s, words
