"""docs/mutation.md: the survivors with an argument each, which a run keeps and never writes itself."""

from __future__ import annotations

import re
from collections import Counter

from tests.mutation.mutants import Change
from tests.mutation.run import SURVIVED

Result = tuple[str, "Counter[str]", list[Change]]
MISSING = "**not argued**"
_HEAD = """\
# Mutation testing

`make mutation` changes the modes, the safety table and the tension law in one place at a time and runs their unit
tests against each. The operators are those of [Cosmic Ray](https://cosmic-ray.readthedocs.io) (numbers by one,
comparisons, arithmetic, conditions, decorators), and two more: a member of an enumeration becomes the next one, which
is what can go wrong in a table, and a statement that only has an effect is left out. The tree itself is not touched.
It fails below 90 % killed in a module, or when a survivor has no argument here.

To refresh: `python -m tests.mutation --write` writes this page anew and keeps the arguments of survivors that are
still there; write one for each that says "not argued", or better a test that kills it.

| module | mutants | killed | score |
|---|---|---|---|
"""
_ROW = re.compile(r"\| \d+ \| `` (.*?) `` \| `` (.*?) `` \| (.*) \|\Z")


def document(results: list[Result], known: dict[tuple[str, str, str], str]) -> str:
    """The whole page."""
    parts = [_HEAD]
    for file, ends, _ in results:
        total = ends.total()
        killed = total - ends[SURVIVED]
        parts.append(f"| `{file}` | {total} | {killed} | {killed / total:.1%} |\n")
    for file, _, changes in results:
        parts.append(f"\n## {file}\n\n| line | as it is | survivor | why it may live |\n|---|---|---|---|\n")
        rows = {(change.before, change.after): change for change in changes}
        for change in rows.values():
            why = known.get((file, change.before, change.after), MISSING)
            parts.append(f"| {change.line} | `` {_cell(change.before)} `` | `` {_cell(change.after)} `` | {why} |\n")
    return "".join(parts)


def arguments(text: str) -> dict[tuple[str, str, str], str]:
    """The arguments of a page, by module and change."""
    found, file = {}, ""
    for line in text.splitlines():
        if line.startswith("## "):
            file = line[3:]
        elif (row := _ROW.match(line)) and row[3] != MISSING:
            found[file, _plain(row[1]), _plain(row[2])] = row[3]
    return found


def _cell(code: str) -> str:
    return code.replace("|", "\\|")


def _plain(cell: str) -> str:
    return cell.replace("\\|", "|")
