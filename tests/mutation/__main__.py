"""``python -m tests.mutation``: mutants against their tests; see docs/mutation.md.

All mutants of modes, stages, safety table and tension law, and a fixed random sample of the other packages.
Exit code 1 when too few are killed, or a survivor is not argued in that file.
"""

from __future__ import annotations

import argparse
import pathlib
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import replace

from tests.builders.paths import ROOT
from tests.mutation import live, page, sample
from tests.mutation.judge import BUDGET_S, Judge, Verdict, read, write
from tests.mutation.mutants import Change, Workshop
from tests.mutation.reach import Reach
from tests.mutation.run import SAME, SURVIVED, Runner, copy_tree

PAGE = ROOT / "docs/mutation.md"
VERDICTS = ROOT / "results/mutation/sample.json"
TESTS = {
    "rigctl/control/modes.py": ("test_modes", "test_numbers_on_record", "test_diagram"),
    "rigctl/control/power/stage.py": ("test_stage", "test_modes", "test_stateful"),
    "rigctl/control/watch/safety.py": ("test_safety_table", "test_safety", "test_limits", "test_numbers_on_record"),
    "rigctl/control/law/tension.py": ("test_law", "test_tension"),
}
MAPS = {"unit": ("tests/unit",), "loop": ("tests/loop",)}
"""Tests whose lines are found out at the same time."""
LEAST, LEAST_OF_SAMPLE = 0.9, 0.85
SAMPLE = "sample"


def main() -> int:
    """Run the requested modules and the sample, print a line for each survivor and each score."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    words = [*(pathlib.Path(file).stem for file in TESTS), SAMPLE]
    parser.add_argument("parts", nargs="*", help=f"{', '.join(words)}; all without a word")
    parser.add_argument("--write", action="store_true", help="bring docs/mutation.md up to date, keeping its arguments")
    parser.add_argument("--parallel", type=int, default=2, metavar="N", help="mutants at once")
    parser.add_argument("--again", action="store_true", help="of the sample, only what has survived the last time")
    parser.add_argument("--no-live", action="store_true", help="leave out the real-time tests, so what only these meet")
    parser.add_argument("--size", type=int, default=sample.SIZE, metavar="N", help="the first N of the sample")
    parser.add_argument("--seconds", type=float, default=BUDGET_S, metavar="S", help="of tests a mutant of the sample")
    parser.add_argument("--package", choices=sample.PACKAGES, help="of the sample, only what lies in this package")
    given = parser.parse_args()
    chosen = set(given.parts or words)
    if not chosen <= set(words) or given.parallel < 1:
        parser.error(f"found {given.parts}, expected {', '.join(words)}")
    if given.write and (chosen != set(words) or given.package):
        parser.error("--write needs all")
    with tempfile.TemporaryDirectory(prefix="rigctl-mutation-", dir="/dev/shm") as name:
        folder = pathlib.Path(name)
        copy_tree(ROOT, folder)
        full = [_module(folder, file, given.parallel) for file in TESTS if pathlib.Path(file).stem in chosen]
        known = read(VERDICTS) if given.again else []
        drawn = _sample(folder, given, known) if SAMPLE in chosen else []
    arguments = page.arguments(PAGE.read_text()) if PAGE.exists() else {}
    if given.write:
        PAGE.write_text(page.document(full, drawn, arguments))
    survivors = [(file, change) for file, _, changes in full for change in changes]
    survivors += [(found.file, Change(found.line, found.before, found.after)) for found in drawn if not found.killed]
    unargued = [(file, change) for file, change in survivors if (file, change.before, change.after) not in arguments]
    for file, change in unargued:
        print(f"not argued in {PAGE.relative_to(ROOT)}: {file}:{change.line}: {change.before}  ->  {change.after}")
    scores = [(file, ends.total() - ends[SURVIVED], ends.total(), LEAST) for file, ends, _ in full]
    if drawn:
        scores.append((SAMPLE, sum(found.killed for found in drawn), len(drawn), LEAST_OF_SAMPLE))
    for what, killed, total, least in scores:
        print(f"{what}: {killed} of {total} killed, {killed / total:.1%} (allowed {least:.0%} or more)")
    return 0 if not unargued and all(killed >= least * total for _, killed, total, least in scores) else 1


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


def _sample(folder: pathlib.Path, given: argparse.Namespace, known: list[Verdict]) -> list[Verdict]:
    """Verdicts of the sample, those of ``known`` that were killed taken as they are; written as they come."""
    reaches = _maps(folder, given.parallel)
    sources = sample.sources_of(folder, set(TESTS))
    workshop = sample.workshop(folder, sources)
    judge = Judge(folder, workshop, reaches, given.seconds)
    drawn = {
        place.number: (place, text)
        for place, text in sample.first(workshop, given.size)
        if given.package is None or place.mutant.file.startswith(f"{given.package}/")
    }
    verdicts = [verdict for verdict in known if verdict.killed and verdict.number in drawn]
    done = {verdict.number for verdict in verdicts}
    unmet = []

    def note(found: Verdict) -> None:
        verdicts.append(found)
        write(VERDICTS, verdicts)
        if not found.killed or "::" not in found.by:  # what no test has failed is looked at
            print(f"{found.file}:{found.line}: {found.before}  ->  {found.after}  {found.by}", flush=True)

    left = [mutant for number, mutant in drawn.items() if number not in done]
    for verdict in judge.verdicts(left, given.parallel):
        if verdict.killed or verdict.tests or not live.tests_of(verdict.file):
            note(verdict)
        else:
            unmet.append(verdict)
    for verdict in unmet:  # alone and last: real time, and minutes each
        _, text = drawn[verdict.number]
        by, tests = live.first_failure(folder, verdict.file, text) if not given.no_live else ("", 0)
        note(replace(verdict, killed=bool(by), by=by, tests=tests))
    killers = sorted({found.by for found in verdicts if "::" in found.by and not found.by.startswith("tests/live")})
    if wrong := judge.fails_unchanged(killers):
        sys.exit(f"{wrong} fails without a mutant too")
    return sorted(verdicts, key=lambda found: found.number)


def _maps(folder: pathlib.Path, at_once: int) -> list[Reach]:
    """Run the tests once to find out which executes which line."""
    running: list[subprocess.Popen[bytes]] = []
    for name, tests in MAPS.items():
        if len(running) >= at_once:
            running.pop(0).wait()
        command = [sys.executable, "-m", "tests.mutation.reach", str(folder / f"{name}.json"), *tests]
        running.append(subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL))
    for process in running:
        process.wait()
    if missing := [name for name in MAPS if not (folder / f"{name}.json").exists()]:
        sys.exit(f"the tests of {', '.join(missing)} could not be run")
    return [Reach.load(folder / f"{name}.json") for name in MAPS]


if __name__ == "__main__":
    sys.exit(main())
