"""Table of the random rigs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console

from hil.runs.result_table import table
from hil.studies.compare.random_rigs import ASSUMED, RigRow, summary
from hil.studies.compare.rivals import LAWS


def show_random(rows: Sequence[RigRow], ms_max: float, console: Console) -> None:
    """Print medians and worst cases by law."""
    found = table(
        "law", ("rigs", "ended early", f"Ms > {ms_max:g}", "Ms med", "worst", "max % med", "p95", "worst", "rms % med",
                "p95", "worst", "micro-g med", "worst"), "Random rigs, Ms measured on each",
    )  # fmt: skip
    for law, said in summary(rows, ms_max).items():
        title = "ours, not identified" if law == ASSUMED else LAWS[law].title
        found.add_row(
            title, str(said["rigs"]), str(said["ended_early"]), str(said["ms_above"]),
            *_figures(said, "ms", ("median", "worst"), ".2f"),
            *_figures(said, "eta_max_pct", ("median", "p95", "worst"), ".4f"),
            *_figures(said, "eta_rms_pct", ("median", "p95", "worst"), ".4f"),
            *_figures(said, "micro_g", ("median", "worst"), ".0f"),
        )  # fmt: skip
    console.print(found, highlight=False)


def _figures(said: dict[str, Any], key: str, names: Sequence[str], form: str) -> list[str]:
    return ["-" if said[key][name] is None else format(said[key][name], form) for name in names]
