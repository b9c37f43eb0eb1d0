"""The catalogue's result as a table, rows with findings first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.faults.expected import Expected, InjectedFault, Reaction
from hil.faults.judging.judge import FaultResult
from hil.faults.judging.naming import NamedRow, Naming, confusion, shares
from hil.faults.processes import ProcessFault
from hil.runs.result_table import console
from rigctl.model.quantity import count
from rigctl.model.states import Mode

WIDTH = 150


def show(rows: Sequence[FaultResult]) -> None:
    """Print all rows and a line with their counts."""
    terminal = console(WIDTH)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name, justify in _COLUMNS:
        table.add_column(name, justify=justify, no_wrap=name in _NAMES, overflow="fold")
    for row in sorted(rows, key=lambda row: row.ok):
        table.add_row(*_cells(row), style="" if row.ok else "red")
    terminal.print(table)
    bad = sum(not row.ok for row in rows)
    faults = len({row.id for row in rows})
    verdict = "all as expected" if not bad else f"{bad} not as expected"
    terminal.print(f"{count(len(rows), 'row')} of {count(faults, 'fault')}: {verdict}")


def show_named(rows: Sequence[NamedRow], unplayed: Sequence[str]) -> None:
    """Print how the culprits were named: what is not right, the confusion matrix, and the counts."""
    terminal = Console(soft_wrap=True, highlight=False)
    for row in rows:
        if row.naming not in (Naming.RIGHT, Naming.TWO):
            states, named = (" or ".join(parts) or "-" for parts in (row.states, row.named))
            terminal.print(f"{row.id} in {row.mode}: {row.naming}: {states}, named {named}: {row.text}", markup=False)
    for line in unplayed:
        terminal.print(f"not played: {line}", markup=False)
    for line in confusion_lines(rows):
        terminal.print(line, markup=False)
    counted = ", ".join(f"{number} {kind}" for kind, number in shares(rows).items())
    terminal.print(f"{count(len(rows), 'row')} that trip: {counted}")


def confusion_lines(rows: Sequence[NamedRow]) -> list[str]:
    """The confusion matrix as a table of Markdown: the part stated, rows, and what was named how often."""
    lines = ["| part stated | rows | named first |", "|---|---|---|"]
    for part, counted in confusion(rows).items():
        named = ", ".join(f"{name} {number}" for name, number in counted.most_common())
        lines.append(f"| {part} | {counted.total()} | {named} |")
    return lines


def show_kills(found: Mapping[str, object]) -> None:
    """Print kills with findings, and the figures by name."""
    terminal = Console(soft_wrap=True)
    for name, value in found.items():
        if isinstance(value, list):
            for kill in value:
                if kill["findings"]:
                    terminal.print(
                        f"{kill['signal']} {kill['victim']} in {kill['mode']}: {'; '.join(kill['findings'])}"
                    )
        else:
            terminal.print(f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}")


def show_list(faults: Sequence[InjectedFault | ProcessFault]) -> None:
    """Print every fault, its description, and the expected reaction in each mode."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("fault", "what", "expected"):
        table.add_column(name, no_wrap=name == "fault", overflow="fold")
    for fault in faults:
        table.add_row(*map(Text, (fault.id, fault.what, worded(fault.expected))))
    Console(width=WIDTH).print(table)


def page_row(fault: InjectedFault | ProcessFault) -> str:
    """The fault's row in docs/faults.md."""
    what = f"{fault.what}; {fault.why}" if fault.why else fault.what
    bound = f"{fault.band_n:g}" if fault.carried else "-"
    if isinstance(fault, InjectedFault) and fault.against_cut:
        bound = "cut + 10 %"
    return f"| `{fault.id}` | {fault.place} | {what} | {worded(fault.expected)} | {bound} |"


def worded(expected: Expected) -> str:
    """The expected reactions in words, modes with the same one together."""
    reactions: dict[Reaction, list[str]] = {}
    for mode in Mode:
        if mode in expected:
            reactions.setdefault(expected[mode], []).append(mode.name)
    return "; ".join(f"{reaction}: {', '.join(modes)}" for reaction, modes in reactions.items())


_COLUMNS: tuple[tuple[str, Literal["left", "right"]], ...] = (
    ("fault", "left"), ("mode", "left"), ("expected", "left"), ("reaction", "left"), ("latched", "left"),
    ("detected ms", "right"), ("reacts ms", "right"), ("tension N", "right"), ("off N", "right"),
    ("stroke mm", "right"), ("carried", "left"), ("not as expected", "left"),
)  # fmt: skip
_NAMES = ("fault", "mode", "latched")  # looked for in the output, so in one piece


def _cells(row: FaultResult) -> list[Text]:
    words = [
        row.id,
        row.mode,
        row.expected,
        row.reaction,
        "" if row.fault == "NONE" else row.fault,
        _number(row.detection_ms, 0),
        _number(row.latency_ms, 0),
        f"{_number(row.tension_min_n, 0)}..{_number(row.tension_max_n, 0)}",
        _number(row.tension_error_n, 1),
        _number(row.stroke_mm, 2),
        "yes" if row.load_carried else "no",
        "; ".join(row.findings),
    ]
    return [Text(word) for word in words]


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"
