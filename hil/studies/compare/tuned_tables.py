"""Tables of the studies in which every law keeps the same limits, and of the random rigs."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.runs.result_table import table
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.equal_limits import EqualLimits
from hil.studies.compare.random_rigs import ASSUMED, RigRow, summary
from hil.studies.compare.rivals import LAWS, OURS
from rigctl.model.quantity import count

Figure = Callable[[tuple[str, str]], float | None]
"""Of a run and law, by their names."""


def show_equal_limits(found: EqualLimits, console: Console) -> None:
    """Print errors, residual acceleration and what was minimised by run and law, and where ours has the least rms."""
    design = found.rig.design
    console.print(
        f"Every law tuned for the identified plant by one optimiser: Ms at most {design.ms_max:g} over its family, "
        f"command noise at most {design.command_noise_max_mm_s:g} mm/s rms", highlight=False,
    )  # fmt: skip
    events = [run for run in found.runs if run.event_s is not None]
    outcomes, tunings = found.outcomes, found.tunings
    tables: tuple[tuple[str, Sequence[ComparedRun], Figure], ...] = (
        ("The error's root mean square, %", found.runs, lambda place: outcomes[place].eta_rms_pct),
        ("Largest error, %", found.runs, lambda place: outcomes[place].eta_max_pct),
        ("Time until the error stays within 0.1 %, s", events, lambda place: outcomes[place].settle_s),
        ("Residual acceleration, rms, micro-g", found.runs, lambda place: outcomes[place].micro_g),
        ("What the searches minimise: the largest of the groups over what one law reaches there", found.runs,
         lambda place: math.exp(tunings[place].cost) if math.isfinite(tunings[place].cost) else None),
    )  # fmt: skip
    for title, runs, figure in tables:
        console.print(_by_run(found.laws, title, runs, figure), highlight=False)
    console.print(_searches(found), highlight=False)
    peaks = [(f"{law} in {run}", peak) for (run, law), peak in found.true_ms.items()]
    if above := [f"{where} {p.ms:.2f}" for where, p in peaks if p is not None and p.ms - p.error > design.ms_max]:
        console.print(f"measured Ms above {design.ms_max:g}: {', '.join(above)}", highlight=False)
    if unmeasured := [where for where, peak in peaks if peak is None]:
        console.print(f"Ms not measured, the rig trips meanwhile: {', '.join(unmeasured)}", highlight=False)
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


def _by_run(laws: Sequence[str], title: str, runs: Sequence[ComparedRun], figure: Figure) -> Table:
    """A figure by run and law, and its geometric mean over the runs; the least of each row has a star."""
    rows = table("scenario", [LAWS[law].title for law in laws], f"\n{title}")
    lines = [(run.title, [figure((run.name, law)) for law in laws]) for run in runs]
    if len(lines) > 1:
        columns = zip(*(values for _, values in lines), strict=True)
        lines.append(("geometric mean", [_geometric_mean(column) for column in columns]))
    for name, values in lines:
        best = min((value for value in values if value is not None), default=None)
        rows.add_row(name, *("-" if v is None else f"{v:.4g}{'*' if v == best else ' '}" for v in values))
    return rows


def _geometric_mean(values: Sequence[float | None]) -> float | None:
    """None where a run has no figure: a law that does not reach the end has no mean."""
    known = [value for value in values if value is not None]
    return statistics.geometric_mean(known) if len(known) == len(values) else None


def _searches(found: EqualLimits) -> Table:
    """Per law: what its starts differ by, and the largest Ms over the family and as measured."""
    rows = table(
        "law", ("starts in all", "within the limits", "spread, %: median", "largest", "Ms, family", "measured"),
        "\nSearches of each law: error of the worst start over that of the best, and the largest Ms of all scenarios",
    )  # fmt: skip
    for law in found.laws:
        tunings = [found.tunings[run.name, law] for run in found.runs]
        costs = [cost for tuning in tunings for cost in tuning.costs]
        peaks = [peak for run in found.runs if (peak := found.true_ms[run.name, law]) is not None]
        peak = max(peaks, key=lambda peak: peak.ms, default=None)
        spreads = sorted(spread for tuning in tunings if (spread := tuning.spread_pct) is not None)
        rows.add_row(
            LAWS[law].title, str(len(costs)), str(sum(map(math.isfinite, costs))),
            f"{statistics.median(spreads):.1f}" if spreads else "-", f"{spreads[-1]:.1f}" if spreads else "-",
            f"{max(tuning.ms for tuning in tunings):.2f}",
            "-" if peak is None else f"{peak.ms:.2f} +- {peak.error:.2f}",
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
