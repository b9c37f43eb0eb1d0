"""Which test executes which line: the tests are run once with coverage, each test in a context of its own."""

from __future__ import annotations

import json
import pathlib
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Switch the context; what a fixture does belongs to the test that needed it first."""
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
    measured.start()
    pytest.main(["-q", "-p", "no:cacheprovider", "-m", MARKED, *folders], plugins=[contexts])
    measured.stop()
    tests = [test for test in contexts.seconds if test not in contexts.failed]
    number = {test: i for i, test in enumerate(tests)}
    data = measured.get_data()
    lines: dict[str, dict[int, list[int]]] = {}
    for file in sorted(data.measured_files()):
        found = data.contexts_by_lineno(file)
        lines[pathlib.Path(file).relative_to(root).as_posix()] = {
            line: sorted(number[test] for test in by if test in number) for line, by in sorted(found.items())
        }
    seconds = [round(contexts.seconds[test], 3) for test in tests]
    result.write_text(json.dumps({"tests": tests, "seconds": seconds, "lines": lines}))


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), sys.argv[2:])
