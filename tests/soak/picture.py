"""A picture of a soak: memory and descriptors of every process, strikes, and lateness with and without clients."""

from __future__ import annotations

import pathlib
from typing import Any

from matplotlib.figure import Figure

from tests.soak.sampling import Processes

COLOURS = {
    "supervisor": "#000000", "control": "#D55E00", "gateway": "#0072B2", "recorder": "#009E73", "hold": "#CC79A7",
    "page": "#E69F00",
}  # fmt: skip


def draw(results: dict[str, Any], processes: Processes, file: pathlib.Path) -> None:
    """Draw it into ``file``."""
    figure = Figure((11.0, 8.0), layout="constrained")
    memory, handles, late = figure.subplots(3, 1, height_ratios=(3, 2, 2))
    scale, unit = (60.0, "min") if results["duration_s"] >= 300 else (1.0, "s")
    seen: set[str] = set()
    for life in processes.lives:
        t_s, mib, count = life.table.T
        label = life.name if life.name not in seen else None
        seen.add(life.name)
        memory.plot(t_s / scale, mib, color=COLOURS.get(life.name), label=label, linewidth=1.2)
        handles.plot(t_s / scale, count, color=COLOURS.get(life.name), linewidth=1.2)
    for axes in (memory, handles):
        for strike in results["strikes"]:
            axes.axvline(
                strike["at_s"] / scale, color=COLOURS.get(strike["what"], "#888888"), alpha=0.35, linewidth=0.8
            )
        axes.set_xlabel(unit)
        axes.set_ylim(bottom=0)
    memory.set_ylabel("private memory, MiB")
    memory.legend(ncols=6, fontsize=8, loc="upper center")
    handles.set_ylabel("file handles")
    memory.set_title(
        f"{results['duration_s'] / 60:.0f} min, seed {results['seed']}: {results['records']} records, "
        f"{sum(results['lost'].values())} lost, {results['trips']['count']} trips, "
        f"{len(results['trips']['unexplained'])} without a cause; lines: process killed, or disk full (grey)",
        fontsize=9,
    )
    names = ["p50_us", "p99_us", "p999_us", "worst_us"]
    for offset, (kind, figures) in enumerate(results["lateness"].items()):
        late.barh(
            [index + 0.4 * offset for index in range(len(names))], [figures[name] for name in names], 0.38,
            label="without clients" if kind == "alone" else "with clients, commands, kills, full disk",
            color=("#56B4E9", "#D55E00")[offset],
        )  # fmt: skip
    late.set_yticks([index + 0.2 for index in range(len(names))], [name.removesuffix("_us") for name in names])
    late.set_xscale("log")
    late.set_xlabel("lateness of the loop, us")
    late.legend(fontsize=8)
    figure.savefig(file, dpi=90)
