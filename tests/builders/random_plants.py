"""Random plants, and the findings of `identify`: ``python -m tests.builders.random_plants [SEED [N [wide]]]``.

Held at 40 to 340 N by a spring of 3 to 40 N/mm; ``wide``: also by a rope of 200 to 2000 N/mm alone, at 10 N where the
load does not seat the nut, or slack. Lag 5 to 60 ms, delay 0.5 to 10 ms, backlash up to 0.2 mm, cell noise 0.01 to
0.2 N. The rig file has the noise of the plant and otherwise the values of config/paper_rig.yaml.
"""

from __future__ import annotations

import functools
import multiprocessing
import random
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.faults import in_controller
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.commission import proposal
from rigctl.commission.identification import IdentificationError
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design.margins import design_and_check
from rigctl.model.verbs import Refusal, Verb
from tests.builders.daemons import PAPER

LIMIT_S = 12.0
STEP_US = 50  # of the integration: the plant takes a command to the nearest step, so that a true delay is a multiple
KEYS = {
    "lag": "plant.cylinder_lag_s",
    "delay": "plant.command_delay_s",
    "stiffness": "stiffness",
    "backlash": "backlash",
    "noise": "tension_cell.noise_n",
    "gain": "drive speed / command",
}


@dataclass(frozen=True)
class RandomPlant:
    """The true values of a rig: N/mm, s, s, mm, N, N."""

    stiffness: float
    lag: float
    delay: float
    backlash: float
    noise: float
    tension_n: float
    seed: int

    @property
    def slack(self) -> bool:
        return self.tension_n == 0.0

    def truth(self, name: str) -> float:
        """True value by name; the backlash shows only where the load does not seat the nut."""
        seated = name == "backlash" and self.tension_n > 20.0
        return 1.0 if name == "gain" else 0.0 if seated else float(getattr(self, name))


def plants(seed: int, count: int, *, wide: bool = False) -> list[RandomPlant]:
    draw = random.Random(seed)
    found: list[RandomPlant] = []
    for number in range(count):
        stiff, slack = wide and number % 4 == 2, wide and number % 4 == 3
        tension_n = 0.0 if slack else draw.choice([10.0, 300.0]) if wide else draw.uniform(40.0, 340.0)
        low, high = (200.0, 2000.0) if stiff else (3.0, 40.0)
        found.append(
            RandomPlant(
                low * (high / low) ** draw.random(),
                draw.uniform(0.005, 0.06),
                STEP_US * 1e-6 * draw.randint(10, 200),
                draw.uniform(0.0, 0.2),
                0.01 * 20.0 ** draw.random(),
                tension_n,
                number,
            )
        )
    return found


def built(settings: RigSettings, plant: RandomPlant) -> RigSettings:
    """The rig of ``settings`` built with the values of ``plant``."""
    simulation = settings.simulation
    assert simulation is not None
    drive = simulation.drive.model_copy(update={"backlash_mm": plant.backlash})
    update = {"seed": 1 + plant.seed, "step_us": STEP_US, "drive": drive}
    update |= {
        "lag_scale": plant.lag / settings.plant.cylinder_lag_s,
        "delay_scale": plant.delay / settings.plant.command_delay_s,
        "stiffness_scale": plant.stiffness / settings.plant.stiffness_n_mm,
    }
    cell = settings.tension_cell.model_copy(update={"noise_n": plant.noise})
    return settings.model_copy(update={"simulation": simulation.model_copy(update=update), "tension_cell": cell})


@dataclass(frozen=True)
class Result:
    """Rows by name, and the largest change of tension during the identification in N."""

    plant: RandomPlant
    rows: dict[str, dict[str, Any]]
    span_n: float
    refused: str = ""

    def told(self, name: str) -> bool:
        return self.rows[name]["found"] is not None

    def off(self, name: str) -> float:
        """Error of the value found."""
        return float(self.rows[name]["found"]) - self.plant.truth(name)

    def inside(self, name: str) -> bool:
        return abs(self.off(name)) <= float(self.rows[name]["error"])


@functools.cache
def _as_filed() -> tuple[RigSettings, Gains]:
    settings = config.load(PAPER)
    return settings, design_and_check(settings).gains


def pause(rig: Lockstep, plant: RandomPlant, gap_s: float) -> None:
    """From now on the computer is busy: pauses of the loop, ``gap_s`` apart in the mean."""
    step = in_controller.busy(gap_s)(Stand(rig, f"busy {plant.seed}"))
    assert step is not None
    start_ns = rig.rig_ns
    rig.on_advance = lambda: step((rig.rig_ns - start_ns) * 1e-9)


def identified(plant: RandomPlant, gap_s: float | None = None) -> Result:
    """``gap_s``: of `pause`."""
    settings, gains = _as_filed()
    with lockstep(built(settings, plant), gains) as rig:
        if not plant.slack:
            rig.rig.plant.preload(plant.tension_n)
        rig.run(0.3)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.2)
        rig.read_records()
        if gap_s is not None:
            pause(rig, plant, gap_s)
        answer = rig.command(Verb.IDENTIFY, limit_s=LIMIT_S)
        records = rig.read_records()
    span_n = float(np.ptp(records["tension_n"]))
    if answer is not Refusal.NONE:
        return _refused(plant, span_n, answer.name.lower())
    records = records[records["t_ns"] > rig.reply["t_ns"] - round(float(rig.reply["duration_s"]) * 1e9)]
    try:
        found = proposal.rows(proposal.signals_of(records, 1e-3), settings)
    except IdentificationError as error:
        return _refused(plant, span_n, str(error))
    rows = {row["key"]: row for row in found}
    return Result(plant, {name: rows[key] for name, key in KEYS.items()}, span_n)


def _refused(plant: RandomPlant, span_n: float, why: str) -> Result:
    return Result(plant, {name: {"found": None, "error": None, "why": why} for name in KEYS}, span_n, why)


def identify_all(found: list[RandomPlant], gap_s: float | None = None) -> list[Result]:
    """Identify each in a process of its own, as many at once as there are processors."""
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(functools.partial(identified, gap_s=gap_s), found))


def in_words(result: Result) -> str:
    plant, words = result.plant, [f"{result.plant.tension_n:5.1f} N, changed by {result.span_n:4.1f} N"]
    for name, row in result.rows.items():
        factor = 1e3 if name in ("lag", "delay") else 1.0
        said = f"{name} {factor * plant.truth(name):.4g}"
        if not result.told(name):
            words.append(f"{said}: {row['why']}")
        else:
            mark = "" if result.inside(name) else " OUTSIDE"
            words.append(f"{said} {factor * result.off(name):+.2g} +- {factor * row['error']:.2g}{mark}")
    return " | ".join(words)


def main(seed: str = "1", count: str = "20", wide: str = "") -> None:
    results = identify_all(plants(int(seed), int(count), wide=wide == "wide"))
    for result in results:
        print(in_words(result))
    for name in KEYS:
        told = [result for result in results if result.told(name)]
        print(f"{name}: {sum(result.inside(name) for result in told)} of {len(told)} told are inside the uncertainty")


if __name__ == "__main__":
    main(*sys.argv[1:])
