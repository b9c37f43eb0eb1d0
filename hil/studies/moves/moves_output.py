"""Table, document and picture of the repeated moves."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from hil.runs.result_table import table
from hil.studies.moves.repeated_moves import SPRINGS_N_MM, RepeatedResult, Variant
from hil.studies.plotting import label, panels, save

PICTURE = "learning.png"
LEARNING, PLAIN = "learning", "plain"

Results = Mapping[tuple[str, float], RepeatedResult]


def show(found: Results, chosen: Sequence[Variant], to: Console) -> None:
    """Largest and rms error of the last move of each variant, then those of each move learnt from."""
    columns = [f"k {k:g}: {name}" for k in SPRINGS_N_MM for name in ("max %", "rms %")]
    rows = table("last move", columns, "true vertical error less its mean over the move")
    for variant in chosen:
        cells = []
        for k in SPRINGS_N_MM:
            result = found.get((variant.name, k))
            last = result.moves[-1] if result is not None else None
            cells += ["", ""] if last is None else [f"{last.most_pct:.4f}", f"{last.spread_pct:.4f}"]
        rows.add_row(variant.title, *cells)
    to.print(rows)
    for k in SPRINGS_N_MM:
        learnt = found.get((LEARNING, k))
        if learnt is not None:
            each = ", ".join(f"{figures.spread_pct:.4f}" for figures in learnt.moves)
            to.print(f"learning, {k:g} N/mm, rms of each move: {each} %")


def document(found: Results) -> dict[str, Any]:
    """The figures as JSON values."""
    return {
        f"{name}_k{k:g}": {"ended": result.ended, "moves": [figures._asdict() for figures in result.moves]}
        for (name, k), result in found.items()
    }


def draw(found: Results, folder: pathlib.Path) -> pathlib.Path | None:
    """The error of the second and the last move with learning, and the rms of each move; None without those runs."""
    springs = [k for k in SPRINGS_N_MM if (LEARNING, k) in found]
    if not springs:
        return None
    figure, axes = panels(2, len(springs), (11.0, 6.5), "the same move again and again", sharey="row")
    for column, k in enumerate(springs):
        learnt, plain = found[LEARNING, k], found.get((PLAIN, k))
        over, under = axes[0][column], axes[1][column]
        over.plot(
            learnt.t_s, learnt.errors_pct[1][: len(learnt.t_s)], color="0.6", lw=1.0, label="move 2, nothing learnt"
        )
        over.plot(learnt.t_s, learnt.errors_pct[-1][: len(learnt.t_s)], lw=1.0, label=f"move {len(learnt.moves)}")
        over.set_title(f"k = {k:g} N/mm", fontsize=10)
        label(over, "time since the mark, s", "true error less its mean, %" if not column else "")
        over.legend(fontsize=8)
        if plain is not None:
            spread = [figures.spread_pct for figures in plain.moves]
            under.plot(range(1, len(spread) + 1), spread, "o--", color="0.6", label="as it is")
        spread = [figures.spread_pct for figures in learnt.moves]
        under.plot(range(1, len(spread) + 1), spread, "o-", label="learning")
        under.set_xticks(range(1, len(spread) + 1))
        label(under, "move", "rms, %" if not column else "")
        under.legend(fontsize=8)
    axes[1][0].set_ylim(bottom=0.0)  # the axes of a row are one; a limit set earlier would leave the others out
    return save(figure, folder / PICTURE)
