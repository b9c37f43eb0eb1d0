"""``python -m tests.bench peaks``: the largest |S| as the search finds it, against python-control, over drawn loops.

The loops (`tests.builders.drawn_loops`) have mechanisms of 6 to 3000 N/mm with 0.5 to 2 % of damping. Once S is known
exactly at each line, once with normal errors.
"""

from __future__ import annotations

import argparse
import json
import pathlib
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.studies.compare.peak_search import largest
from rigctl.cli.progress import progress
from tests.builders.drawn_loops import TOP_HZ, Loop, drawn

ROUNDING = 1e-6


def searched(loop: Loop, error: float) -> dict[str, Any]:
    """What the search finds of a loop whose lines have this error (half of a 95 % interval), and the truth."""
    rng = np.random.default_rng(loop.number)
    found = largest(lambda excitation: loop.measure(excitation, error, rng), loop.spans(), TOP_HZ)
    true, hz = loop.true
    missed = true - found.ms
    return {
        "loop": loop.number, "mechanism_n_mm": loop.plant.mechanism, "damping": loop.plant.mechanism_damping,
        "stiffness_n_mm": loop.plant.stiffness, "true": true, "true_hz": hz, "ms": found.ms, "hz": found.hz,
        "error": found.error, "missed": missed, "inside": abs(missed) <= found.error + ROUNDING,
        "seconds": found.seconds,
    }  # fmt: skip


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench peaks", description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    parser.add_argument("--loops", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--errors", type=float, nargs="+", default=[0.0, 0.01], help="of a line, half of 95 %%")
    options = parser.parse_args(arguments)
    loops, console = drawn(options.seed, options.loops), Console(width=120)
    found: dict[float, list[dict[str, Any]]] = {}
    with progress("peaks", float(len(options.errors) * len(loops))) as advance:
        for error in options.errors:
            found[error] = []
            for loop in loops:
                found[error].append(searched(loop, error))
                advance(1.0, f"loop {loop.number}")
    for error, rows in found.items():
        table = Table("loop", "k", "K_m", "damping %", "true", "at Hz", "found", "+-", "at Hz", "missed", "s", box=None)
        for row in rows:
            table.add_row(
                str(row["loop"]), f"{row['stiffness_n_mm']:.1f}", f"{row['mechanism_n_mm']:.1f}",
                f"{100.0 * row['damping']:.1f}", f"{row['true']:.4f}", f"{row['true_hz']:.3g}", f"{row['ms']:.4f}",
                f"{row['error']:.4f}", f"{row['hz']:.3g}", f"{row['missed']:+.4f}{'' if row['inside'] else ' OUTSIDE'}",
                f"{row['seconds']:.0f}",
            )  # fmt: skip
        console.print(table, highlight=False)
        console.print(
            f"lines known to +- {error:g}: of {len(rows)} loops {sum(row['inside'] for row in rows)} are inside the "
            f"interval; missed at most {max(row['missed'] for row in rows):.4f}, off at most "
            f"{max(abs(row['missed']) for row in rows):.4f}; widest interval +- "
            f"{max(row['error'] for row in rows):.4f}; at most {max(row['seconds'] for row in rows):.0f} s",
            highlight=False,
        )
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n")
    return 0
