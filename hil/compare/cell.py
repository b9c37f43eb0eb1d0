"""The tension cell's systematic errors at the full size of the sensor budget."""

from __future__ import annotations

from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.report.sensor_budget import CREEP_PCT, GAIN_PCT, budget


def with_errors(rig: RigSettings) -> RigSettings:
    """The same rig with every error of the budget at its full size and of one sign, the worst case."""
    size = {error.name: error.newtons for error in budget(rig)}
    errors = {
        "bias_n": size["bias"] + size["drift"],
        "gain_pct": GAIN_PCT,
        "creep_pct": CREEP_PCT,
        "creep_s": 0.1,  # the creep has run its course
    }
    return changed(rig, {f"simulation.cell.{key}": value for key, value in errors.items()})
