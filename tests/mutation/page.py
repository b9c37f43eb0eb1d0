"""docs/mutation.md: the survivors with an argument each, which a run keeps and never writes itself."""

from __future__ import annotations

import re
from collections import Counter, defaultdict

from tests.mutation.judge import Verdict
from tests.mutation.mutants import Change
from tests.mutation.run import SURVIVED
from tests.mutation.sample import SIZE

Result = tuple[str, "Counter[str]", list[Change]]
MISSING = "**not argued**"
_HEAD = """\
# Mutation testing

`make mutation` changes the modes, the safety table and the tension law in one place at a time and runs their unit tests
against each; of the other packages of the loop it takes a sample. The operators are those of [Cosmic
Ray](https://cosmic-ray.readthedocs.io), and two more: a member of an enumeration becomes the next one, and a statement
that only has an effect is left out. The tree itself is not touched. It fails below 90 % killed in a module, below 85 %
in the sample, or when a survivor has no argument here.

The sample is the same every time: 300 places of `control` (but for these three modules), `devices`, `ipc`, `gateway`,
`recorder`, `commission` and `hil/nodes`, chosen by a hash of function, operator and text of the line. A mutant meets
the tests of `tests/unit` and `tests/loop` that execute its line, 40 s of tests at most (`--seconds`), the likeliest
first; one that only real processes execute meets `tests/live` (`--no-live`: it counts as a survivor).
`results/mutation/sample.json` names the test that killed each; `python -m tests.mutation sample --again` runs only
those that survived, `--package rigctl/control` those of one package.

To refresh: `python -m tests.mutation --write` writes this page and keeps the arguments of survivors that are still
there; write one for each that says "not argued", or better a test that kills it.

| module | mutants | killed | score |
|---|---|---|---|
"""
_ROW = re.compile(r"\| \d+ \| `` (.*?) `` \| `` (.*?) `` \| (.*) \|\Z")


def document(results: list[Result], sample: list[Verdict], known: dict[tuple[str, str, str], str]) -> str:
    """The whole page."""
    parts = [_HEAD]
    for file, ends, _ in results:
        total = ends.total()
        killed = total - ends[SURVIVED]
        parts.append(f"| `{file}` | {total} | {killed} | {killed / total:.1%} |\n")
    packages = Counter(_package(found.file) for found in sample)
    for package, total in sorted(packages.items()):
        killed = sum(found.killed for found in sample if _package(found.file) == package)
        parts.append(f"| sample of `{package}` | {total} | {killed} | {killed / total:.1%} |\n")
    if sample:
        killed = sum(found.killed for found in sample)
        what = "sample" if len(sample) == SIZE else f"first {len(sample)} of the sample"
        parts.append(f"| {what} | {len(sample)} | {killed} | {killed / len(sample):.1%} |\n")
    survivors: dict[str, list[Change]] = defaultdict(list)
    for found in sorted(sample, key=lambda found: (found.file, found.line)):
        if not found.killed:
            survivors[found.file].append(Change(found.line, found.before, found.after))
    of_sample = [(file, Counter[str](), changes) for file, changes in survivors.items()]
    for file, _, changes in [*results, *of_sample]:
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


def _package(file: str) -> str:
    return "/".join(file.split("/")[:2])


def _cell(code: str) -> str:
    return code.replace("|", "\\|")


def _plain(cell: str) -> str:
    return cell.replace("\\|", "|")
