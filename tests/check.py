"""``python -m tests.check``: the tests that a change touches, within two minutes.

The change is what differs from the merge base with main, or from ``--base``, with what is not committed. Tests of the
folder that mirrors each changed file run first, a changed test runs itself, and `ELSEWHERE` has the folders that mirror
nothing. What does not fit into two minutes, by the times in ``results/durations.json`` of the last `make test`, is
named and not run.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Iterable, Sequence

from tests.builders.paths import ROOT

BUDGET_S = 120.0
UNKNOWN_S = 5.0
"""Of a test file that no run has timed yet."""
DURATIONS = ROOT / "results/durations.json"
ELSEWHERE: dict[str, tuple[str, ...]] = {
    "rigctl/page/static": ("tests/unit/page",),
    "rigctl/control": ("tests/unit/control", "tests/loop"),
    "rigctl/devices": ("tests/unit/devices", "tests/loop"),
    "hil/plant": ("tests/unit/hil", "tests/plant"),
    "hil/faults": ("tests/unit/hil", "tests/studies/test_faults.py"),
    "config": ("tests/unit/config",),
    "deploy": ("tests/unit/cli/test_units.py", "tests/unit/cli/test_install.py", "tests/unit/test_release.py"),
    "docs": ("tests/unit/test_docs.py",),
    "tests/builders": ("tests/unit",),
}
"""Tests of a folder that has no mirror, or more than its mirror; the longest prefix counts."""
NO_TESTS = 5
"""pytest's exit code where it has selected none."""


def git(*words: str) -> list[str]:
    """Lines of a git command's output."""
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()


def changed(base: str) -> list[str]:
    """Files that differ from the merge base with ``base``, and those that git does not know yet."""
    (ancestor,) = git("merge-base", base, "HEAD")
    return sorted({*git("diff", "--name-only", ancestor), *git("ls-files", "--others", "--exclude-standard")})


def mirrored(file: str) -> list[str]:
    """Paths of tests that a changed file has, the nearest first."""
    path = pathlib.PurePosixPath(file)
    if path.name.startswith("test_") and path.suffix == ".py":
        return [file] if (ROOT / file).exists() else []
    folders = [parent.as_posix() for parent in path.parents]
    named = next((ELSEWHERE[folder] for folder in folders if folder in ELSEWHERE), ())
    package = path.parts[1] if len(path.parts) > 2 else ""
    near = {"rigctl": f"tests/unit/{package}", "hil": "tests/unit/hil", "tests": path.parent.as_posix()}
    folder = near.get(path.parts[0], "") if not named else ""
    own = f"{named[0] if named else folder}/test_{path.stem}.py"
    found = [own, *named, *([folder] if folder and package else [])]
    return [place for place in found if (ROOT / place).exists()]


def files_of(places: Iterable[str]) -> list[str]:
    """Test files of the places, each once, in this order."""
    found: dict[str, None] = {}
    for place in places:
        path = ROOT / place
        inside = sorted(path.rglob("test_*.py")) if path.is_dir() else [path]
        found |= dict.fromkeys(file.relative_to(ROOT).as_posix() for file in inside)
    return list(found)


def within(files: Iterable[str], seconds: dict[str, float], budget_s: float) -> tuple[list[str], list[str]]:
    """The files that fit into the budget of processor time, and those that do not."""
    run, left = [], []
    for file in files:
        cost = seconds.get(file, UNKNOWN_S)
        if cost <= budget_s:
            budget_s -= cost
            run.append(file)
        else:
            left.append(file)
    return run, left


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tests of the change; pytest's exit code, 0 where there is nothing to run."""
    parser = argparse.ArgumentParser(prog="python -m tests.check", description=__doc__)
    parser.add_argument("--base", default="main", help="compare with the merge base of this commit [main]")
    parser.add_argument("--file", action="append", default=[], help="tests of this file instead of the change's")
    parser.add_argument("--marks", default="", help="pytest's expression of the gate's tests")
    chosen = parser.parse_args(arguments)
    change = chosen.file or changed(chosen.base)
    if missing := [file for file in chosen.file if not (ROOT / file).exists()]:
        sys.stderr.write(f"tests.check: {missing[0]}: no such file in the project\n")
        return 2
    places = [mirrored(file) for file in change]
    nearest_first = [place for rank in range(4) for found in places for place in found[rank : rank + 1]]
    seconds = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
    run, left = within(files_of(nearest_first), seconds, BUDGET_S * (os.cpu_count() or 1))
    for file in left:
        sys.stdout.write(f"not run: {file}: {seconds.get(file, UNKNOWN_S):.0f} s\n")
    if not run:
        sys.stdout.write(f"{len(change)} changed files have no tests to run\n")
        return 0
    sys.stdout.write(f"{len(change)} changed files: {len(run)} test files, {len(left)} more do not fit\n")
    sys.stdout.flush()
    words = ["-m", "pytest", *run, "-m", chosen.marks, "--numprocesses", "auto", "--dist", "worksteal"]
    environment = {name: value for name, value in os.environ.items() if name != "TEST_DURATIONS"}  # of the whole run
    code = subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, check=False).returncode
    return 0 if code == NO_TESTS else code  # none of them belongs to the gate


if __name__ == "__main__":
    sys.exit(main())
