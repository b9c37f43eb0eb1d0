"""The study's results: a table per figure for people, rows for programs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.runs.result_table import table, verdict
from hil.studies.paper.cases import cases
from hil.studies.paper.claims import BROAD, TARGET_N, Claim, ClaimResult
from hil.studies.paper.paper_study import PaperStudy

_TITLES = {
    "4": "Figure 4: with (k = 6 N/mm) and without (k = 1000 N/mm) the spring",
    "5/6": "Figures 5 and 6: stiffness of the spring, N/mm",
    "7": "Figure 7: deployment speed, 0.25, 0.5, 1 and 2 deg/s, k = 6 N/mm",
    "9": "Figure 9: 13 deg out and back, the paper's experiment",
}


def show(rows: list[ClaimResult], study: PaperStudy, console: Console) -> None:
    """Print a table per figure with the remarks on its rows, then the closed loop."""
    for figure, title in _TITLES.items():
        found = table("quantity", ("paper", "ours", "difference", "expected"), title)
        found.add_column("")
        marks: dict[str, int] = {}
        for row in (row for row in rows if row.claim.figure == figure):
            claim, note = row.claim, remark(row)
            mark = f" [{marks.setdefault(note, len(marks) + 1)}]" if note else ""
            name = claim.quantity + (f", {claim.unit}" if claim.unit else "") + mark
            paper = "trend" if claim.paper is None else f"{claim.paper:g}"
            found.add_row(
                name.replace("[", "\\["), paper, _figure(row.model), _difference(row), _range(claim),
                verdict(row.ok, "agrees", "DIFFERS"),
            )  # fmt: skip
        console.print(found, highlight=False)
        for note, number in marks.items():
            console.print(f"[{number}] {note}", highlight=False, markup=False, style="dim")
        console.print()
    console.print(_closed(study), highlight=False)
    good = sum(row.ok for row in rows)
    console.print(f"{good} of {len(rows)} agree, one parameter set", highlight=False)


def document(rows: list[ClaimResult], study: PaperStudy) -> dict[str, Any]:
    """Everything that is printed, for JSON: ``rows``, ``ok_count``, ``total`` and ``closed_loop``."""
    return {
        "rows": [
            {
                **{name: getattr(row.claim, name) for name in ("id", "figure", "quantity", "unit", "paper")},
                "model": row.model if math.isfinite(row.model) else None,
                "low": row.claim.low,
                "high": row.claim.high,
                "ok": row.ok,
                "note": remark(row),
            }
            for row in rows
        ],
        "ok_count": sum(row.ok for row in rows),
        "total": len(rows),
        "closed_loop": {
            name: {key: value for key, value in run._asdict().items() if key != "truth"}
            for name, run in study.closed.items()
        },
    }


def remark(row: ClaimResult) -> str:
    """Remarks on a row: where the paper contradicts itself, and why the model differs."""
    notes = [row.claim.note] if row.claim.note else []
    if not row.ok and row.claim.shortfall:
        notes.append(f"ours differs: {row.claim.shortfall}")
    return "; ".join(notes)


def _closed(study: PaperStudy) -> Table:
    title = "The same cases locked and with the loop closed: error of Fz in %, cylinder in mm/s and mm"
    found = table("case", ("locked, max", "closed, max", "rms", "speed", "stroke"), title)
    found.add_column("", no_wrap=True)
    for case in cases():
        run = study.closed[case.name]
        passive = float(np.max(np.abs(study.passive[case.name].eta_pct(TARGET_N))))
        ended = "" if run.ended == "COMPENSATING" else f"[red]{run.ended}[/]"
        found.add_row(
            case.title, f"{passive:.3f}", f"{run.eta_max_pct:.4f}", f"{run.eta_rms_pct:.4f}",
            f"{run.speed_max_mm_s:.2f}", f"{run.stroke_mm:.2f}", ended or ("waived" if run.waived else ""),
        )  # fmt: skip
    return found


def _figure(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000.0 else f"{value:.1f}"


def _difference(row: ClaimResult) -> str:
    if row.claim.paper is None:
        return ""
    return f"{100.0 * (row.model - row.claim.paper) / row.claim.paper:+.1f} %"


def _range(claim: Claim) -> str:
    return f"> {claim.low:g}" if claim.high == BROAD else f"{claim.low:g} to {claim.high:g}"
