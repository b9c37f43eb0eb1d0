"""Which test executes which line: the tests are run once with coverage, each test in a context of its own.

A test that goes on from a start runs in a forked process (`tests.builders.branches`), which leaves a file of its lines.
"""

from __future__ import annotations

import json
import os
import pathlib
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

import coverage
import pytest

from tests.mutation.sample import PACKAGES

MARKED = "not real_time and not study"


@dataclass(frozen=True)
class Reach:
    """``lines``: for each file, the numbers of the tests by line. ``seconds``: of each test, which passed."""

    tests: list[str]
    seconds: list[float]
    lines: dict[str, dict[int, list[int]]]

    @classmethod
    def load(cls, file: pathlib.Path) -> Reach:
        """Read what `main` wrote."""
        data = json.loads(file.read_text())
        lines = {name: {int(line): tests for line, tests in found.items()} for name, found in data["lines"].items()}
        return cls(data["tests"], data["seconds"], lines)


class _Contexts:
    """Gives each test its context, and notes how long it took."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self._measured = measured
        self.seconds: dict[str, float] = defaultdict(float)
        self.failed: set[str] = set()
        self.test = ""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Switch the context; what a fixture does belongs to the test that needed it first."""
        self.test = item.nodeid
        self._measured.switch_context(item.nodeid)
        return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Sum set-up, call and end."""
        self.seconds[report.nodeid] += report.duration
        if report.outcome != "passed":
            self.failed.add(report.nodeid)


def main(result: pathlib.Path, folders: Sequence[str]) -> None:
    """Run the tests of ``folders`` in the working directory and write the map to ``result``."""
    root = pathlib.Path.cwd()
    measured = coverage.Coverage(data_file=None, include=[f"{name}/*" for name in PACKAGES], config_file=False)
    contexts = _Contexts(measured)
    with tempfile.TemporaryDirectory() as name:
        _keep_lines_of_forks(measured, contexts, pathlib.Path(name))
        measured.start()
        pytest.main(["-q", "-p", "no:cacheprovider", "-m", MARKED, *folders], plugins=[contexts])
        measured.stop()
        forked = [json.loads(file.read_text()) for file in pathlib.Path(name).iterdir()]
    tests = [test for test in contexts.seconds if test not in contexts.failed]
    number = {test: i for i, test in enumerate(tests)}
    data = measured.get_data()
    found: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for file in data.measured_files():
        for line, by in data.contexts_by_lineno(file).items():
            found[file][line] |= {number[test] for test in by if test in number}
    for test, executed in forked:
        for file, at in executed.items():
            for line in at:
                found[file][line] |= {number[test]} if test in number else set()
    lines = {
        pathlib.Path(file).relative_to(root).as_posix(): {line: sorted(by) for line, by in sorted(of_file.items())}
        for file, of_file in sorted(found.items())
    }
    seconds = [round(contexts.seconds[test], 3) for test in tests]
    result.write_text(json.dumps({"tests": tests, "seconds": seconds, "lines": lines}))


def _keep_lines_of_forks(measured: coverage.Coverage, contexts: _Contexts, folder: pathlib.Path) -> None:
    """Have a forked process, which ends by `os._exit`, write its test and the lines it has executed to ``folder``."""
    first, end = os.getpid(), os._exit

    def ending(status: int) -> NoReturn:
        if os.getpid() != first:
            measured.stop()
            data = measured.get_data()
            executed = {file: data.lines(file) for file in data.measured_files()}
            (folder / str(os.getpid())).write_text(json.dumps((contexts.test, executed)))
        end(status)

    os._exit = ending


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), sys.argv[2:])
