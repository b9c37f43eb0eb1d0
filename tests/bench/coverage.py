"""``python -m tests.bench coverage``: how often stated 95 % intervals hold the truth while the computer is busy.

Random rigs (`tests.builders.random_plants`) are identified by steps in lockstep, and every few of them by a frequency
response in HOLD, while pauses of 0.2 to 15 ms are injected into the loop. Exit code 1 if fewer than 93 % of the figures
lie within their intervals, or an interval is wider than it need be: half of it over the error that 95 % stay below.
"""

from __future__ import annotations

import argparse
import json
import pathlib
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from rigctl.cli.progress import progress
from rigctl.commission.identification import IdentificationError
from rigctl.config import rig_file as config
from rigctl.control.modes import Mode, Refusal
from rigctl.design.gains import design
from rigctl.gateway.evaluation import response
from tests.builders import daemons
from tests.builders.excited import built, respond, tensioned
from tests.builders.linear_plant import true_plant
from tests.builders.random_plants import STEP_US, RandomPlant, identified, pause, plants

LEAST, WIDEST = 0.93, 1.5
KINDS = {"steps": 7.0, "response": 70.0}
"""Simulated seconds, for the progress."""


class Figure(NamedTuple):
    """One figure of one rig: how far it is from the truth, and the half width of its interval."""

    kind: str
    name: str
    seed: int
    off: float
    error: float


def by_steps(plant: RandomPlant, gap_s: float | None) -> tuple[list[Figure], str]:
    """Figures, or the reason why there are none."""
    result = identified(plant, gap_s)
    told = [name for name in result.rows if result.told(name)]
    return [
        Figure("steps", name, plant.seed, result.off(name), float(result.rows[name]["error"])) for name in told
    ], result.refused  # fmt: skip


def by_response(plant: RandomPlant, gap_s: float | None) -> tuple[list[Figure], str]:
    """The same of a frequency response in HOLD."""
    settings = config.load(daemons.PAPER)
    filed, gains = settings.plant, design(settings)
    real = built(
        settings, stiffness=plant.stiffness, lag_scale=plant.lag / filed.cylinder_lag_s,
        delay_scale=plant.delay / filed.command_delay_s, seed=1 + plant.seed, step_us=STEP_US,
    )  # fmt: skip
    with tensioned(real, gains, Mode.HOLD, max(150.0, plant.tension_n)) as rig:
        if gap_s is not None:
            pause(rig, plant, gap_s)
        ended, records = respond(rig)
    if ended is not Refusal.NONE:
        return [], ended.name.lower()
    try:
        found = response(settings, gains, records)["figures"]["plant"]
    except IdentificationError as error:
        return [], str(error)
    true = true_plant(real)
    truth = {
        "stiffness_n_mm": true.stiffness, "lag_s": true.lag, "delay_s": true.delay, "damping_n_s_mm": true.damping,
    }  # fmt: skip
    return [
        Figure("response", name, plant.seed, found[name]["value"] - value, found[name]["error"])
        for name, value in truth.items()
    ], ""


def table(figures: list[Figure]) -> tuple[Table, bool]:
    """A row for each kind of figure and one for all, and whether they meet the limits."""
    shown = Table("identified by", "figure", "drawn", "inside", "width / spread", "median +-", "largest miss", box=None)
    good = True
    for kind, name in dict.fromkeys((each.kind, each.name) for each in figures):
        part = [each for each in figures if (each.kind, each.name) == (kind, name)]
        shares = np.abs([each.off / each.error for each in part])
        wide = 1.0 / float(np.percentile(shares, 95.0))
        good &= wide <= WIDEST
        shown.add_row(
            kind, name, str(len(part)), f"{100.0 * np.mean(shares <= 1.0):.1f} %", f"{wide:.2f}",
            f"{np.median([each.error for each in part]):.2g}", f"{shares.max():.2f}",
        )  # fmt: skip
    inside = float(np.mean([abs(each.off) <= each.error for each in figures]))
    shown.add_row("all", "", str(len(figures)), f"{100.0 * inside:.1f} %", "", "", "")
    return shown, good and inside >= LEAST


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench coverage", description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    parser.add_argument("--count", type=int, default=200, help="rigs drawn; each is identified by steps")
    parser.add_argument("--responses", type=int, default=12, help="of them, by a frequency response too")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="leave out the rigs drawn before this one")
    parser.add_argument("--gap-s", type=float, default=1.5, help="mean time between pauses in steps; 0: no pauses")
    parser.add_argument("--response-gap-s", type=float, default=15.0, help="the same in a response")
    options = parser.parse_args(arguments)
    drawn = plants(options.seed, options.count)[options.first :]
    figures: list[Figure] = []
    refused: list[str] = []
    total = KINDS["steps"] * len(drawn) + KINDS["response"] * options.responses
    with progress("coverage", total) as advance:
        for kind, play, gap_s, rigs in (
            ("steps", by_steps, options.gap_s, drawn),
            ("response", by_response, options.response_gap_s, drawn[: options.responses]),
        ):
            for plant in rigs:
                found, why = play(plant, gap_s or None)
                figures += found
                refused += [why] if why else []
                advance(KINDS[kind], f"rig {plant.seed}")
                if options.json:
                    options.json.write_text(json.dumps([each._asdict() for each in figures], indent=2) + "\n")
    if not figures:
        Console().print("no figures: every identification was refused", highlight=False)
        return 1
    shown, good = table(figures)
    Console().print(shown, highlight=False)
    for why in dict.fromkeys(refused):
        Console().print(f"refused {refused.count(why)} of {len(drawn)}: {why}", highlight=False)
    return 0 if good else 1
