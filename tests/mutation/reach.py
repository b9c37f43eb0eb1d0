"""Which test executes which line: the tests are run once with a count of each statement, for each test anew.

When they are imported, the modules of the sample get, before each statement, one that notes it: a tracer of lines makes
the loop several times slower. A test that goes on from a start runs in a forked process (`tests.builders.branches`),
which leaves a file of its statements.
"""

from __future__ import annotations

import ast
import builtins
import importlib.machinery
import json
import os
import pathlib
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import CodeType, ModuleType
from typing import Any, NoReturn

import pytest

from tests.mutation.sample import PACKAGES

MARKED = "not real_time and not study and not long"
_EXECUTED = "_executed_statements"
_BODIES = ("body", "orelse", "finalbody")


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


class Statements:
    """Numbers the statements of the modules under ``root``, and holds those that have been executed."""

    def __init__(self, root: pathlib.Path) -> None:
        self._root = root
        self._lines: list[tuple[str, range]] = []
        self.executed: set[int] = set()

    def begin(self) -> None:
        """Count in every module that is imported from now on."""
        setattr(builtins, _EXECUTED, self.executed)
        sys.meta_path.insert(0, self)

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """The import system's search, for the modules of the sample alone."""
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        file = pathlib.Path(spec.origin)
        if not file.is_relative_to(self._root) or not file.relative_to(self._root).as_posix().startswith(PACKAGES):
            return None
        spec.loader = _Counting(name, spec.origin, self)
        return spec

    def counted(self, file: str, source: bytes) -> ast.Module:
        """The module's tree, with a note before each statement but doc strings and what has to come first."""
        module = ast.parse(source)
        name = pathlib.Path(file).relative_to(self._root).as_posix()
        for node in list(ast.walk(module)):
            for field in _BODIES:
                body = getattr(node, field, None)
                if isinstance(body, list) and body and isinstance(body[0], ast.stmt):
                    setattr(node, field, list(self._with_notes(name, body)))
        return ast.fix_missing_locations(module)

    def lines(self, executed: set[int]) -> Iterator[tuple[str, int]]:
        """File and number of each line of these statements."""
        for number in executed:
            file, lines = self._lines[number]
            yield from ((file, line) for line in lines)

    def _with_notes(self, file: str, body: list[ast.stmt]) -> Iterator[ast.stmt]:
        for place, statement in enumerate(body):
            first = isinstance(statement, ast.ImportFrom) and statement.module == "__future__"
            doc = place == 0 and isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            if not (first or doc):
                note = ast.parse(f"{_EXECUTED}.add({len(self._lines)})").body[0]
                yield ast.copy_location(note, statement)
                self._lines.append((file, range(statement.lineno, _last_line(statement) + 1)))
            yield statement


class _Counting(importlib.machinery.SourceFileLoader):
    """Loads a module with its notes; bytecode without them is neither read nor written."""

    def __init__(self, name: str, path: str, statements: Statements) -> None:
        super().__init__(name, path)
        self._statements = statements

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002 - the import system's signature
        """Compile the module anew."""
        tree: Any = self._statements.counted(self.path, self.get_data(self.path))
        code: CodeType = compile(tree, self.path, "exec", dont_inherit=True)
        return code


class _Tests:
    """Empties the statements before each test, keeps them after it, and notes how long it took."""

    def __init__(self, statements: Statements) -> None:
        self._statements = statements
        self.seconds: dict[str, float] = defaultdict(float)
        self.executed: list[tuple[str, set[int]]] = []
        self.failed: set[str] = set()
        self.test = ""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """What a fixture does belongs to the test that needed it first."""
        self.test = item.nodeid
        self._statements.executed.clear()
        result = yield
        self.executed.append((item.nodeid, set(self._statements.executed)))
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Sum set-up, call and end."""
        self.seconds[report.nodeid] += report.duration
        if report.outcome != "passed":
            self.failed.add(report.nodeid)


def main(result: pathlib.Path, folders: Sequence[str]) -> None:
    """Run the tests of ``folders`` in the working directory and write the map to ``result``."""
    statements = Statements(pathlib.Path.cwd())
    run = _Tests(statements)
    with tempfile.TemporaryDirectory() as name:
        _keep_statements_of_forks(run, statements, pathlib.Path(name))
        statements.begin()
        # Plain assertions, since pytest would load the modules of a plugin's package, which are ours, by itself.
        pytest.main(["-q", "--assert=plain", "-p", "no:cacheprovider", "-m", MARKED, *folders], plugins=[run])
        forked = [json.loads(file.read_text()) for file in pathlib.Path(name).iterdir()]
    run.executed += [(test, set(executed)) for test, executed in forked]
    tests = [test for test in run.seconds if test not in run.failed]
    number = {test: i for i, test in enumerate(tests)}
    found: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for test, executed in run.executed:
        for file, line in statements.lines(executed) if test in number else ():
            found[file][line].add(number[test])
    lines = {
        file: {line: sorted(by) for line, by in sorted(of_file.items())} for file, of_file in sorted(found.items())
    }
    seconds = [round(run.seconds[test], 3) for test in tests]
    result.write_text(json.dumps({"tests": tests, "seconds": seconds, "lines": lines}))


def _last_line(statement: ast.stmt) -> int:
    """Of a compound statement, the line before its body."""
    bodies = [getattr(statement, field, None) for field in (*_BODIES, "handlers", "cases")]
    first = [body[0] for body in bodies if isinstance(body, list) and body]
    lines = [getattr(part, "lineno", None) or part.pattern.lineno for part in first]
    return max(statement.lineno, min(lines) - 1) if lines else statement.end_lineno or statement.lineno


def _keep_statements_of_forks(run: _Tests, statements: Statements, folder: pathlib.Path) -> None:
    """Have a forked process, which ends by `os._exit`, write its test and what it has executed to ``folder``."""
    first, end = os.getpid(), os._exit

    def ending(status: int) -> NoReturn:
        if os.getpid() != first:
            (folder / str(os.getpid())).write_text(json.dumps((run.test, sorted(statements.executed))))
        end(status)

    os._exit = ending


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), sys.argv[2:])
