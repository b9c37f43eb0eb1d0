"""``python -m hil roll-back``: how far the load moves between brake and motor, and whether a preload keeps it."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping
from typing import Any

from rich.table import Table

from hil.cli.files import check_outputs, publish, simulated_rig
from hil.runs.result_table import console, table, verdict
from hil.scenario.play import accepted_design
from hil.studies.roll_back import study
from hil.studies.roll_back.study import LIMIT_MM, Moved, RollBackCase
from rigctl.cli.progress import progress

WIDTH = 110


def run(rig_file: pathlib.Path, draws: int, seed: int, json: pathlib.Path | None) -> int:
    """Play the cases, print them, write the requested file.

    Returns:
        0 when no load with a preload moved farther than the limit and every one was held; else 1.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: the file cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_outputs({"--json": json}, [rig_file])
    gains = accepted_design(rig).gains
    with progress("loads", len(study.cases(draws, seed))) as advance:
        found = study.study(rig, gains, draws, seed, advance)
    publish(json, document(found), lambda: console(WIDTH).print(_table(found), highlight=False))
    return 0 if all(_good(case, moved) for case, moved in found.items() if case.error_pct is not None) else 1


def _good(case: RollBackCase, moved: Moved) -> bool:
    return moved.most_mm <= LIMIT_MM and moved.ended == "HOLD" if case.error_pct is not None else True


def _table(found: Mapping[RollBackCase, Moved]) -> Table:
    title = f"True way of the load when the motor takes it from the brake; at most {LIMIT_MM:g} mm with a preload"
    columns = ("load N", "preload", "sinks mm", "rises mm", "to the brake mm", "then", "")
    shown = table("spring N/mm", columns, title)
    for case, moved in found.items():
        preload = "none" if case.error_pct is None else f"{-case.error_pct:+.1f} %"
        judged = "stated" if case.error_pct is None else verdict(_good(case, moved), "met", "MISSED")
        shown.add_row(
            f"{case.spring_n_mm:g}", f"{case.load_n:g}", preload, f"{moved.sank_mm:.3f}", f"{moved.rose_mm:.3f}",
            f"{moved.braked_mm:.3f}", moved.ended, judged,
        )  # fmt: skip
    return shown


def document(found: Mapping[RollBackCase, Moved]) -> dict[str, Any]:
    """Everything that is printed, for JSON."""
    rows = [{**case._asdict(), **moved._asdict(), "met": _good(case, moved)} for case, moved in found.items()]
    return {"limit_mm": LIMIT_MM, "rows": rows}
