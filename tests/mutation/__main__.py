"""``python -m tests.mutation``: mutants of modes, safety and tension against their tests; see docs/mutation.md.

Exit code 1 when fewer than 90 % are killed in a module, or a survivor is not argued in that file.
"""

from __future__ import annotations

import argparse
import pathlib
import sys
import tempfile
from collections import Counter

from tests.builders.paths import ROOT
from tests.mutation import page
from tests.mutation.mutants import Change, Workshop
from tests.mutation.run import SAME, SURVIVED, Runner, copy_tree

PAGE = ROOT / "docs/mutation.md"
TESTS = {
    "rigctl/control/modes.py": ("test_tables", "test_modes", "test_diagram"),
    "rigctl/control/safety.py": ("test_tables", "test_safety", "test_limits"),
    "rigctl/control/tension.py": ("test_law", "test_tension"),
}
LEAST = 0.9


def main() -> int:
    """Run the requested modules, print a line for each survivor and the score of each module."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("modules", nargs="*", help="modes, safety, tension; all without a word")
    parser.add_argument("--write", action="store_true", help="bring docs/mutation.md up to date, keeping its arguments")
    parser.add_argument("--parallel", type=int, default=2, metavar="N", help="mutants at once")
    asked = parser.parse_args()
    chosen = [file for file in TESTS if not asked.modules or pathlib.Path(file).stem in asked.modules]
    if not chosen or len(chosen) < len(set(asked.modules)) or asked.parallel < 1:
        parser.error(f"found {asked.modules}, expected {', '.join(pathlib.Path(file).stem for file in TESTS)}")
    if asked.write and len(chosen) < len(TESTS):
        parser.error("--write needs all modules")
    with tempfile.TemporaryDirectory(prefix="rigctl-mutation-", dir="/dev/shm") as name:
        folder = pathlib.Path(name)
        copy_tree(ROOT, folder)
        results = [_module(folder, file, asked.parallel) for file in chosen]
    arguments = page.arguments(PAGE.read_text()) if PAGE.exists() else {}
    if asked.write:
        PAGE.write_text(page.document(results, arguments))
    unargued = [(file, change) for file, _, changes in results for change in changes
                if (file, change.before, change.after) not in arguments]  # fmt: skip
    for file, change in unargued:
        print(f"not argued in {PAGE.relative_to(ROOT)}: {file}:{change.line}: {change.before}  ->  {change.after}")
    good = not unargued
    for file, ends, _ in results:
        total = ends.total()
        killed = total - ends[SURVIVED]
        good &= killed >= LEAST * total
        print(f"{file}: {killed} of {total} killed, {killed / total:.1%} (allowed {LEAST:.0%} or more)")
    return 0 if good else 1


def _module(folder: pathlib.Path, file: str, parallel: int) -> page.Result:
    sources = {name: (folder / name).read_text() for name in TESTS}
    workshop = Workshop(sources)
    tests = {name: [f"tests/unit/control/{test}.py" for test in found] for name, found in TESTS.items()}
    runner = Runner(folder, workshop, tests)
    if not runner.passes_unchanged(file):
        sys.exit(f"{file}: its tests fail as it is: {' '.join(tests[file])}")
    ends: Counter[str] = Counter()
    changes: list[Change] = []
    for mutant, end in runner.run(workshop.mutants(file), parallel):
        if end == SAME:
            continue
        ends[end] += 1
        if end == SURVIVED:
            changes.append(workshop.change_of(mutant))
            print(f"{file}:{changes[-1].line}: {changes[-1].before}  ->  {changes[-1].after}", flush=True)
    return file, ends, sorted(changes, key=lambda change: change.line)


if __name__ == "__main__":
    sys.exit(main())
