"""Tables of the studies in which every law keeps the same limits, and of the random rigs."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.compare.equal_limits import EqualLimits
from hil.compare.random_rigs import ASSUMED, RigRow, summary
from hil.compare.rivals import LAWS, OURS
from hil.study.result_table import table
from rigctl.config.quantity import count


def show_equal_limits(found: EqualLimits, console: Console) -> None:
    """Print rms and largest error by run and law, residual acceleration, and where ours has the least rms."""
    design = found.rig.design
    console.print(
        f"Every law tuned for the identified plant by one optimiser: Ms at most {design.ms_max:g} over its family, "
        f"command noise at most {design.command_noise_max_mm_s:g} mm/s rms", highlight=False,
    )  # fmt: skip
    quantities = (("eta_rms_pct", "The error's root mean square, %"), ("eta_max_pct", "Largest error, %"),
                  ("settle_s", "Time until the error stays within 0.1 %, s"),
                  ("micro_g", "Residual acceleration, rms, micro-g"))  # fmt: skip
    titles = [LAWS[law].title for law in found.laws]
    for key, title in quantities:
        rows = table("scenario", titles, f"\n{title}")
        for run in found.runs:
            if key == "settle_s" and run.event_s is None:
                continue
            values = [getattr(found.outcomes[run.name, law], key) for law in found.laws]
            best = min((value for value in values if value is not None), default=None)
            rows.add_row(run.title, *("-" if v is None else f"{v:.4g}{'*' if v == best else ' '}" for v in values))
        console.print(rows, highlight=False)
    console.print(_searches(found), highlight=False)
    above = [f"{law} in {run} {ms:.2f}" for (run, law), ms in found.true_ms.items() if ms > design.ms_max]
    if above:
        console.print(f"Ms on the rig as built above {design.ms_max:g}: {', '.join(above)}", highlight=False)
    missed = [f"{law} in {run}" for (run, law), tuning in found.tunings.items() if not tuning.within]
    if missed:
        console.print(f"no parameters within the limits: {', '.join(missed)}", highlight=False)
    if OURS in found.laws:
        won = dict(found.wins())
        console.print(
            f"\nours has the least rms in {sum(won.values())} of {count(len(won), 'scenario')}", highlight=False
        )
        if lost := [name for name, ours in won.items() if not ours]:
            console.print(f"not in: {', '.join(lost)}", highlight=False)


def _searches(found: EqualLimits) -> Table:
    """Per law: what its starts differ by, and the largest Ms over the family and on the rigs as built."""
    rows = table(
        "law", ("starts in all", "within the limits", "spread, %: median", "largest", "Ms, family", "Ms, as built"),
        "\nSearches of each law: error of the worst start over that of the best, and the largest Ms of all scenarios",
    )  # fmt: skip
    for law in found.laws:
        tunings = [found.tunings[run.name, law] for run in found.runs]
        costs = [cost for tuning in tunings for cost in tuning.costs]
        spreads = sorted(spread for tuning in tunings if (spread := tuning.spread_pct) is not None)
        rows.add_row(
            LAWS[law].title, str(len(costs)), str(sum(map(math.isfinite, costs))),
            f"{statistics.median(spreads):.1f}" if spreads else "-", f"{spreads[-1]:.1f}" if spreads else "-",
            f"{max(tuning.ms for tuning in tunings):.2f}",
            f"{max(found.true_ms[run.name, law] for run in found.runs):.2f}",
        )  # fmt: skip
    return rows


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
