"""A sample's mutants against the tests that execute their lines, the cheapest and likeliest first."""

from __future__ import annotations

import ast
import importlib
import json
import os
import pathlib
import pickle
import re
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

import pytest

from tests.mutation.mutants import Workshop
from tests.mutation.reach import Reach
from tests.mutation.run import enter, fork, preload, put_in, run_tests
from tests.mutation.sample import Place

SHORT = 5  # names of functions up to this length are anywhere
FIRST = 3  # tests of each file to begin with
WHOLE_S, NAMING_WHOLE_S = 1.0, 4.0  # a file that takes no longer is run whole; one that names the changed thing
BUDGET_S = 40.0  # of tests a mutant, by their measured time: a survivor may have outlived these only
PAPER = "config/paper_rig.yaml"
_LIBRARIES_OF = (
    "hil.lockstep",
    "rigctl.gateway.gateway_process",
    "rigctl.recorder.recorder_process",
    "rigctl.commission.identification",
    "rigctl.design.margins",
    "scipy.linalg",
    "mcap.reader",
)
"""Loaded once, for the libraries that they load."""
_KEPT = ("rigctl.config", "hil.plant", "hil.truth")
"""Below the packages of the sample, so no mutant is in what they import, and loaded once."""


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant; ``by``: the test that failed first; ``tests``: number of tests that it met."""

    number: str
    file: str
    function: str
    operator: str
    line: int
    before: str
    after: str
    killed: bool
    by: str
    tests: int


def tests_of(
    place: Place, sources: Mapping[str, str], reaches: Sequence[Reach], folder: pathlib.Path, budget_s: float
) -> list[str]:
    """Node ids of the tests that execute the mutant's line, as many as take ``budget_s``, the likeliest first."""
    file, names = place.mutant.file, _names_given(place.line, sources[place.mutant.file])
    if names:  # outside functions: the tests that execute a line with a name that the statement gives
        pattern = re.compile(rf"\b({'|'.join(sorted(names))})\b")
        lines = {name: {n for n, text in enumerate(source.splitlines(), 1) if pattern.search(text)}
                 for name, source in sources.items() if name == file or pattern.search(source)}  # fmt: skip
    else:
        pattern, lines = None, {file: _statement(place.line, sources[file])}
    found: set[tuple[float, str]] = set()
    for reach in reaches:
        numbers = {n for name, at in lines.items() for line in at for n in reach.lines.get(name, {}).get(line, ())}
        if not numbers:
            numbers = {n for tests in reach.lines.get(file, {}).values() for n in tests}
        found |= {(reach.seconds[n], reach.tests[n]) for n in numbers}
    if pattern is None and len(place.function) > SHORT and not place.function.startswith("__"):
        pattern = re.compile(rf"\b{place.function}\b")
    saying = set()
    if pattern is not None:  # also tests of what was executed when their module was imported
        for reach in reaches:
            texts = {name: (folder / name).read_text() for name in {test.partition("::")[0] for test in reach.tests}}
            saying |= {name for name, text in texts.items() if pattern.search(text)}
            pairs = zip(reach.seconds, reach.tests, strict=True)
            found |= {
                item for item in pairs if item[1].startswith("tests/unit") and item[1].partition("::")[0] in saying
            }
    return _in_order(file, found, saying, budget_s)


def _in_order(file: str, found: set[tuple[float, str]], saying: set[str], budget_s: float) -> list[str]:
    """First files that name the module or what it gives, then unit tests; one test of each in turn, shortest first.

    The own file of tests is run whole, and so is a short one: what kills a mutant is often a file's longest test, or
    any of fifty.
    """
    queues: dict[str, list[tuple[float, str]]] = defaultdict(list)
    for item in sorted(found):
        queues[item[1].partition("::")[0]].append(item)
    own = pathlib.Path(file).stem

    def rank(name: str) -> tuple[bool, bool, bool, float]:
        return name not in saying, "tests/unit" not in name, own not in name, queues[name][0][0]

    def whole(name: str) -> bool:
        takes_s = sum(seconds for seconds, _ in queues[name])
        names = name in saying or own in name
        return pathlib.Path(name).name == f"test_{own}.py" or takes_s <= (NAMING_WHOLE_S if names else WHOLE_S)

    order = sorted(queues, key=rank)
    chosen: list[str] = []
    spent, first = 0.0, True
    while any(queues.values()) and spent < budget_s:
        for name in order:
            if spent >= budget_s:  # what takes thrice as long counts as a mutant that never ends
                break
            taken = queues[name][: None if whole(name) else FIRST if first else 1]
            del queues[name][: len(taken)]
            chosen += [test for _, test in taken]
            spent += sum(seconds for seconds, _ in taken)
        first = False
    return chosen


def _statement(line: int, source: str) -> set[int]:
    """The lines of a simple statement, or the line itself."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(
            node, ast.Assign | ast.AnnAssign | ast.AugAssign | ast.Expr | ast.Return | ast.Raise | ast.Assert
        ):
            last = node.end_lineno or node.lineno
            if node.lineno <= line <= last:
                return set(range(node.lineno, last + 1))
    return {line}


def _names_given(line: int, source: str) -> set[str]:
    """Names that a statement outside functions gives a value; none for a line in a function."""
    given: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        last = getattr(node, "end_lineno", None) or 0
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.body[0].lineno <= line <= last:
            return set()
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.lineno <= line <= last:
            given |= {
                name.id for name in ast.walk(node) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
            }
    return given


class _FirstFailure:
    """Notes the first test that failed and how many ran."""

    def __init__(self) -> None:
        self.by, self.tests = "", 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note the failure."""
        self.tests += report.when == "call"
        if report.failed and not self.by:
            self.by = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A module that cannot be imported fails every test."""
        if report.failed and not self.by:
            self.by = f"{report.nodeid} (collection)"


class Judge:
    """Runs mutants on a copy of the tree in ``folder``, several at once; ``budget_s``: tests that each meets."""

    def __init__(
        self, folder: pathlib.Path, workshop: Workshop, reaches: Sequence[Reach], budget_s: float = BUDGET_S
    ) -> None:
        self._folder, self._workshop, self._reaches = folder, workshop, reaches
        self._budget_s = budget_s
        preload(folder)
        for name in _LIBRARIES_OF:
            importlib.import_module(name)
        self._design = _designed(folder)
        own = ("rigctl", "hil", "tests")
        self._keep = frozenset(
            name for name in sys.modules if name.split(".")[0] not in own or name.startswith(_KEPT) or name in own
        )

    def verdicts(self, mutants: Iterable[tuple[Place, str]], at_once: int) -> Iterator[Verdict]:
        """The verdicts of mutants, given with their text, as they come."""
        running: dict[int, tuple[Place, pathlib.Path, float]] = {}
        left = iter(mutants)
        while True:
            for place, source in islice(left, at_once - len(running)):
                result = self._folder / f"verdict-{place.number[:16]}.json"
                running[self._start(place, source, result)] = place, result, time.monotonic() + 20.0 * self._budget_s
            if not running:
                return
            time.sleep(0.02)
            for pid, (place, result, until) in list(running.items()):
                if os.waitpid(pid, os.WNOHANG)[0]:
                    del running[pid]
                    yield self._verdict(place, result)
                elif time.monotonic() > until:  # it waits for ever, which takes no time of the processor
                    os.kill(pid, signal.SIGKILL)

    def fails_unchanged(self, tests: Sequence[str]) -> str:
        """The first of the tests that fails without a mutant; empty if none does."""
        result = self._folder / "unchanged.json"
        pid = fork(lambda: self._run(None, "", tests, result, 3600))
        os.waitpid(pid, 0)
        return str(json.loads(result.read_text())["by"])

    def _start(self, place: Place, source: str, result: pathlib.Path) -> int:
        tests = tests_of(place, self._workshop.sources, self._reaches, self._folder, self._budget_s)
        return fork(lambda: self._run(place.mutant.file, source, tests, result, round(3.0 * self._budget_s)))

    def _verdict(self, place: Place, result: pathlib.Path) -> Verdict:
        found: dict[str, Any] = {"by": "(died or took too long)", "tests": 0}
        if result.exists():
            found = json.loads(result.read_text())
        change = self._workshop.change_of(place.mutant)
        return Verdict(
            place.number, place.mutant.file, place.function, place.mutant.operator, change.line, change.before,
            change.after, bool(found["by"]), found["by"], found["tests"],
        )  # fmt: skip

    def _run(self, file: str | None, source: str, tests: Sequence[str], result: pathlib.Path, limit_s: int) -> int:
        enter(self._folder, self._keep, limit_s)
        if file is not None:
            put_in(self._folder, file, source)
        if any(test.startswith("tests/loop") for test in tests):
            _know_design(self._folder, self._design)
        first = _FirstFailure()
        code = run_tests(self._folder, tests, first) if tests else 0
        if code == pytest.ExitCode.USAGE_ERROR and not first.by:  # the mutant has changed the name of a test's case
            code = run_tests(self._folder, list(dict.fromkeys(test.partition("[")[0] for test in tests)), first)
        if code and not first.by:
            first.by = f"(pytest ended with {code})"
        part = result.with_suffix(".part")
        part.write_text(json.dumps({"by": first.by, "tests": first.tests}))
        part.rename(result)
        return 0


def _designed(folder: pathlib.Path) -> bytes:
    """The design of the paper's rig, pickled: it takes longer than most tests in lockstep."""
    from rigctl.config.rig_file import load
    from rigctl.design.margins import design_and_check

    return pickle.dumps(design_and_check(load(folder / PAPER)))


def _know_design(folder: pathlib.Path, pickled: bytes) -> None:
    """Have the design of the paper's rig known, of the classes that this process has loaded."""
    from rigctl.config.rig_file import load
    from rigctl.design import margins

    paper, design = load(folder / PAPER), margins.design_and_check

    def known(settings: Any, *rest: Any, **words: Any) -> Any:
        if settings == paper and not rest and not words:
            return pickle.loads(pickled)
        return design(settings, *rest, **words)

    margins.design_and_check = known


def read(file: pathlib.Path) -> list[Verdict]:
    """What `write` wrote; none if there is no file."""
    return [Verdict(**item) for item in json.loads(file.read_text())["verdicts"]] if file.exists() else []


def write(file: pathlib.Path, verdicts: Sequence[Verdict]) -> None:
    """Write the verdicts in the order of the draw."""
    found = sorted((asdict(verdict) for verdict in verdicts), key=lambda item: item["number"])
    killed = sum(item["killed"] for item in found)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({"mutants": len(found), "killed": killed, "verdicts": found}, indent=1) + "\n")
