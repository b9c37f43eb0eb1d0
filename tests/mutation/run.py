"""Each mutant against the tests, in a process forked from one with the libraries loaded; nothing on disk changes."""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import pathlib
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import ModuleType

import hypothesis
import pytest

from tests.mutation.mutants import Mutant, Workshop

LIMIT_CPU_S = 60  # far above the time of all tests of a module: a mutant that takes longer hangs
PARTS = ("rigctl", "hil", "tests", "config", "docs", "pyproject.toml")
_HEAVY = ("numpy", "yaml", "msgspec", "can", "hypothesis.strategies", "rigctl.config.rig_file", "rigctl.ipc.record")
SURVIVED, KILLED, SAME = "survived", "killed", "the same program"
_SAME_CODE = 77


def copy_tree(root: pathlib.Path, folder: pathlib.Path) -> None:
    """Copy the files that the tests need: the tests run on the copy, so later changes of the tree do not matter."""
    leave = shutil.ignore_patterns("__pycache__", "*.mcap")
    for part in PARTS:
        if (root / part).is_dir():
            shutil.copytree(root / part, folder / part, ignore=leave)
        else:
            shutil.copy(root / part, folder / part)


class Instead(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Loads one module from a text instead of its file."""

    def __init__(self, name: str, source: str, file: pathlib.Path) -> None:
        self._name, self._source, self._file = name, source, file

    def find_spec(self, fullname: str, _path: object, _target: object = None) -> importlib.machinery.ModuleSpec | None:
        """The spec of that module, None for others."""
        if fullname != self._name:
            return None
        return importlib.util.spec_from_file_location(fullname, self._file, loader=self)

    def get_source(self, _fullname: str) -> str:
        """The module's text."""
        return self._source

    def exec_module(self, module: ModuleType) -> None:
        """Run the module's text."""
        exec(compile(self._source, str(self._file), "exec"), module.__dict__)


class Repeatable:
    """Hypothesis makes the same examples for every mutant, and stores none."""

    def pytest_sessionstart(self) -> None:
        """Register the profile after that of conftest.py."""
        hypothesis.settings.register_profile("mutation", deadline=None, derandomize=True, database=None)
        hypothesis.settings.load_profile("mutation")


class Runner:
    """Runs mutants on a copy of the tree in ``folder``, several at once."""

    def __init__(self, folder: pathlib.Path, workshop: Workshop, tests: Mapping[str, Sequence[str]]) -> None:
        """``tests``: for each module, the files that test it."""
        self._folder, self._workshop, self._tests = folder, workshop, tests
        preload(folder)
        self._loaded = frozenset(sys.modules)

    def passes_unchanged(self, file: str) -> bool:
        """Whether the tests of a module pass without a mutant; this also leaves their byte code in the copy."""
        _, status = os.waitpid(fork(lambda: self._test(file, None)), 0)
        return status == 0

    def run(self, mutants: Iterable[Mutant], at_once: int) -> Iterator[tuple[Mutant, str]]:
        """Each mutant with its outcome, in the order in which they end."""
        running: dict[int, Mutant] = {}
        for mutant in mutants:
            if len(running) >= at_once:
                yield self._next(running)
            running[fork(lambda mutant=mutant: self._judge(mutant))] = mutant  # type: ignore[misc]
        while running:
            yield self._next(running)

    def _next(self, running: dict[int, Mutant]) -> tuple[Mutant, str]:
        while True:
            for pid in running:
                found, status = os.waitpid(pid, os.WNOHANG)
                if found:
                    code = os.waitstatus_to_exitcode(status)
                    return running.pop(pid), {0: SURVIVED, _SAME_CODE: SAME}.get(code, KILLED)
            time.sleep(0.01)

    def _judge(self, mutant: Mutant) -> int:
        source = self._workshop.source_of(mutant)
        return _SAME_CODE if source is None else self._test(mutant.file, source)

    def _test(self, file: str, source: str | None) -> int:
        enter(self._folder, self._loaded, LIMIT_CPU_S)
        if source is not None:
            put_in(self._folder, file, source)
        return run_tests(self._folder, self._tests[file])


def fork(work: Callable[[], int]) -> int:
    """Do the work in a process of its own, which ends with its result as exit code; returns the process' id."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        code = 3
        try:
            code = work()
        finally:
            os._exit(code)
    return pid


def enter(folder: pathlib.Path, loaded: frozenset[str], limit_s: int) -> None:
    """Make the forked process one of the copy in ``folder``: silent, bounded in time, with only ``loaded`` modules."""
    os.chdir(folder)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))
    forget(but=loaded)


def put_in(folder: pathlib.Path, file: str, source: str) -> None:
    """Have a module loaded from the mutant's source."""
    module = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    sys.meta_path.insert(0, Instead(module, source, folder / file))


def run_tests(folder: pathlib.Path, tests: Sequence[str], *plugins: object) -> int:
    """pytest's exit code; it ends at the first failure."""
    arguments = ["-x", "-q", "-p", "no:cacheprovider", "-W", "ignore", "--rootdir", str(folder)]
    return int(pytest.main([*arguments, *tests], plugins=[Repeatable(), *plugins]))


def preload(folder: pathlib.Path) -> None:
    """Load the libraries, and from the copy in ``folder`` what every test needs."""
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    sys.path.insert(0, str(folder))
    forget()
    for name in _HEAVY:
        importlib.import_module(name)


def forget(but: frozenset[str] = frozenset()) -> None:
    """Unload the project's own modules, so that they are loaded again from the copy."""
    own = [name for name in sys.modules if name.split(".")[0] in ("rigctl", "hil", "tests") and name not in but]
    for name in own:
        if not name.startswith("tests.mutation"):
            del sys.modules[name]
