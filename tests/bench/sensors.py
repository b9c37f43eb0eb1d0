"""``python -m tests.bench sensors``: what each sensor buys on the paper's move at each spring of the paper.

The move of the comparison (`paper_k6` to `paper_k34`) is played in lockstep on the simulated rig with each set of
sensors, from the same seeds and with the same gains. Figures are of the true vertical tension, in % of the target.
"""

from __future__ import annotations

import argparse
import json
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.nodes.second_force import ORIGIN_MM
from hil.plant.layout import MECHANISM
from hil.scenario.play import play
from hil.studies.compare.compared_runs import MOVE_S, STEADY_S
from hil.studies.planned_run import SPEED_DEG_S, STIFFNESSES_N_MM, onwards
from rigctl.cli.progress import progress
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings
from rigctl.metrics.tension_error import largest_and_rms_pct
from tests.builders import daemons

QUICK_HZ = 3.0


def with_stretch(settings: RigSettings, **section: Any) -> RigSettings:
    """The rig with an encoder below its spring, at the loop's rate."""
    spring = settings.plant.spring_n_mm
    assert spring is not None
    fitted = SecondForceSettings(
        kind="stretch", spring_n_mm=spring, zero_n=-ORIGIN_MM * spring, rate_hz=settings.loop.rate_hz, u_n=0.5,
        cell_u_n=0.05, disagree_n=2.0, **{"quick_hz": QUICK_HZ, **section},
    )  # fmt: skip
    return settings.model_copy(update={"second_force": fitted})


def _simulation(settings: RigSettings) -> SimulationSettings:
    assert settings.simulation is not None
    return settings.simulation


SENSORS: dict[str, Callable[[RigSettings], RigSettings]] = {
    "cell and inclinometer": lambda settings: settings,
    "and stretch encoder, 1 um": with_stretch,
    "and stretch encoder, 0.1 um": lambda settings: with_stretch(settings, noise_um=0.1, counts_per_mm=10_000.0),
    "an inclinometer ten times quieter": lambda settings: changed(
        settings, {"simulation.inclinometer.noise_deg": 0.1 * _simulation(settings).inclinometer.noise_deg}
    ),
}


def played(settings: RigSettings, seed: int) -> tuple[float, float]:
    """Largest and rms error in %."""
    run = play(
        changed(settings, {"simulation.seed": seed}), {MECHANISM: onwards(SPEED_DEG_S, MOVE_S)}, seconds=MOVE_S,
        controller="loop", target_n=settings.tension.target_n,
    )  # fmt: skip
    largest, rms = largest_and_rms_pct(run.truth["vertical_n"][run.t_s >= STEADY_S], run.target_n)
    return largest, rms


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench sensors", description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--springs", type=float, nargs="+", default=list(STIFFNESSES_N_MM), help="N/mm")
    parser.add_argument("--sensors", nargs="+", default=list(SENSORS), choices=list(SENSORS))
    options = parser.parse_args(arguments)
    filed = config.load(daemons.PAPER)
    found: list[dict[str, Any]] = []
    with progress("sensors", float(len(options.springs) * len(options.sensors) * options.seeds)) as advance:
        for spring in options.springs:
            for sensors in options.sensors:
                rig = SENSORS[sensors](changed(filed, {"plant.spring_n_mm": spring}))
                errors = []
                for seed in range(1, options.seeds + 1):
                    errors.append(played(rig, seed))
                    advance(1.0, f"{spring:g} N/mm, {sensors}")
                found.append({"spring_n_mm": spring, "sensors": sensors, "largest_rms_pct": errors})
                if options.json:
                    options.json.write_text(json.dumps(found, indent=2) + "\n")
    table = Table("k N/mm", "sensors", "max %", "rms %", box=None)
    for row in found:
        largest, rms = np.array(row["largest_rms_pct"]).mean(axis=0)
        table.add_row(f"{row['spring_n_mm']:g}", row["sensors"], f"{largest:.4f}", f"{rms:.4f}")
    Console().print(table, highlight=False)
    return 0
