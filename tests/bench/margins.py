"""``python -m tests.bench margins``: Ms measured in each minute against that of the true plant, over rigs and seeds.

The rigs: each spring of the paper, and with the first one a mechanism of 60 N/mm, a drive that answers twice as late,
and a spring 20 % stiffer than believed.
"""

from __future__ import annotations

import argparse
import json
import pathlib
from typing import Any

import numpy as np
from rich.console import Console

from rigctl.cli.progress import progress
from rigctl.commission.identification import IdentificationError
from rigctl.config import rig_file as config
from rigctl.config.margins_section import MarginsSettings
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import GROW_S, WINDOW_S
from rigctl.design.gains import design
from rigctl.model.states import Mode
from rigctl.operations.evaluation import law_response, margins
from tests.builders import daemons
from tests.builders.excited import built, tensioned
from tests.builders.linear_plant import true_plant, true_sensitivities

WITHIN = 0.1
FINE_HZ = np.geomspace(0.05, 499.0, 6000)
SPRINGS_N_MM = (6.0, 13.0, 20.0, 27.0, 34.0)
AS_BUILT: tuple[dict[str, Any], ...] = ({"mechanism": 60.0}, {"delay_scale": 2.0}, {"stiffness_scale": 1.2})


def true_ms(real: RigSettings, believed: RigSettings) -> float:
    """Sensitivity peak of the law that the loop runs, with the plant as built."""
    acting = law_response(believed, design(believed))(FINE_HZ)
    return float(np.abs(true_sensitivities(true_plant(real), *acting, FINE_HZ)).max())


def windows(spring_n_mm: float, as_built: dict[str, Any], seed: int, count: int) -> list[dict[str, Any]]:
    """``count`` minutes of one rig: what was measured (None: nothing), its uncertainty, and the truth."""
    paper = config.load(daemons.PAPER)
    plant = paper.plant.model_copy(update={"spring_n_mm": spring_n_mm})
    settings = paper.model_copy(update={"plant": plant, "margins": MarginsSettings()})
    real, gains, found = built(settings, seed=seed, **as_built), design(settings), []
    truth = true_ms(real, settings)
    with tensioned(real, gains, Mode.COMPENSATING) as run:
        run.run(GROW_S + 4.0)
        for _ in range(count):
            records = run.run(WINDOW_S + 0.1)
            try:
                measured = margins(settings, gains, records)
            except IdentificationError:
                measured = {"ms": None, "error": None}
            found.append({"ms": measured["ms"], "error": measured["error"], "true": truth})
    return [{"spring_n_mm": spring_n_mm, **as_built, "seed": seed, **window} for window in found]


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench margins", description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--minutes", type=int, default=2, help="of each rig")
    options = parser.parse_args(arguments)
    rigs: list[tuple[float, dict[str, Any]]] = [(spring, {}) for spring in SPRINGS_N_MM] + [
        (SPRINGS_N_MM[0], as_built) for as_built in AS_BUILT
    ]
    found: list[dict[str, Any]] = []
    with progress("margins", float(len(rigs) * options.seeds)) as advance:
        for spring, as_built in rigs:
            for seed in range(1, options.seeds + 1):
                found += windows(spring, as_built, seed, options.minutes)
                advance(1.0, f"k {spring:g} N/mm")
    judged = [window for window in found if window["ms"] is not None]
    apart = np.array([abs(window["ms"] - window["true"]) for window in judged])
    Console().print(
        f"{len(found)} windows of {len(rigs)} rigs, {len(found) - len(judged)} without a figure; within {WITHIN:g} of "
        f"the true Ms: {int((apart <= WITHIN).sum())} of {len(judged)}; "
        f"apart: median {np.median(apart):.3f}, 95 % {np.percentile(apart, 95.0):.3f}, most {apart.max():.3f}",
        highlight=False,
    )
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n")
    return 0
