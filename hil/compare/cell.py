"""The tension cell's systematic errors at the full size of the sensor budget."""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from rigctl.report.sensor_budget import CREEP_PCT, GAIN_PCT, Error, budget, combined_n

__all__ = ["Error", "budget", "combined_n", "with_errors"]


def with_errors(rig: RigSettings) -> RigSettings:
    """The same rig with every error of the budget at its full size and of one sign, the worst case."""
    simulation = rig.simulation
    assert simulation is not None  # the comparison refuses a rig without it
    size = {error.name: error.newtons for error in budget(rig)}
    update = {
        "bias_n": size["bias"] + size["drift"],
        "gain_pct": GAIN_PCT,
        "creep_pct": CREEP_PCT,
        "creep_s": 0.1,  # the creep has run its course
    }
    changed = simulation.model_copy(update={"cell": simulation.cell.model_copy(update=update)})
    return rig.model_copy(update={"simulation": changed})
