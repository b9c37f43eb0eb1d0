"""What holds for every test: hypothesis judges results, not how long a busy machine took for them.

Tests that run real processes in real time (``real_time``) run two at a time, those that judge a time (``alone``) one
after the other; all others share the machine.
"""

from __future__ import annotations

import gc
import json
import os
import pathlib
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator

import pytest
from hypothesis import HealthCheck, settings

from tests.builders.host_pause import pytest_runtest_makereport, pytest_runtest_protocol
from tests.builders.smoke import pytest_terminal_summary

__all__ = ["pytest_runtest_makereport", "pytest_runtest_protocol", "pytest_terminal_summary"]

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in rigctl and hil; the workers of xdist inherit it
HERE = pathlib.Path(__file__).parent
Command = Callable[..., "subprocess.CompletedProcess[str]"]
REAL_TIME = ("guest", "live/system")
"""Folders whose tests are, but those marked ``simulated_time``; elsewhere a file says so itself."""
STUDIES = ("studies", "loop/test_identify.py", "loop/test_uneven_rail.py", "loop/test_devices_as_sold.py", "live")
"""Where tests take minutes of simulated time, or start processes that no pause of the host can trip."""

# What a change is judged by is the same every time, and short; `make fuzz` looks for more.
# `deadline` and the health check `too_slow` measure this computer's clock.
settings.register_profile(
    "rigctl", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True, max_examples=40
)
settings.register_profile("search", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("rigctl")


_DURATIONS: dict[str, float] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up the seconds of each test file, for `tests.check`."""
    file = report.location[0]
    _DURATIONS[file] = _DURATIONS.get(file, 0.0) + report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep the seconds of the test files in the file named by ``TEST_DURATIONS``."""
    name = os.environ.get("TEST_DURATIONS")
    if name and not hasattr(session.config, "workerinput"):
        rounded = {file: round(seconds, 1) for file, seconds in sorted(_DURATIONS.items())}
        pathlib.Path(name).write_text(json.dumps(rounded, indent=0) + "\n")


def pytest_sessionstart() -> None:
    """A shell's background job ignores SIGINT, one of `nohup` SIGHUP, and so would every process started here."""
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, usual)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Nothing is garbage while tests are collected, and to look for it takes longer than all the rest."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what lies in the folders of real-time tests."""
    for item in items:
        where = item.path.relative_to(HERE).as_posix()
        marked_real = item.get_closest_marker("real_time") is not None
        if where.startswith(REAL_TIME) and not item.get_closest_marker("simulated_time"):
            item.add_marker(pytest.mark.real_time)
        elif where.startswith(STUDIES):
            if not item.get_closest_marker("gate"):
                item.add_marker(pytest.mark.study)
        elif marked_real and item.path.name != "test_pytest_plugin.py":
            raise pytest.UsageError(f"{where}: a real-time test outside tests/live, where `make test-live` runs it")
    _leave_rows_to_the_studies(items)


def _leave_rows_to_the_studies(items: list[pytest.Item]) -> None:
    """Of a test marked ``gate("row", ...)`` these rows judge each change, the others are studies."""
    rows: dict[str, list[tuple[pytest.Item, bool]]] = {}
    for item in items:
        mark = item.get_closest_marker("gate")
        if mark is not None and mark.args and isinstance(item, pytest.Function):
            kept = item.callspec.id in mark.args
            rows.setdefault(item.nodeid.partition("[")[0], []).append((item, kept))
            if not kept:
                item.add_marker(pytest.mark.study)
    for test, found in rows.items():
        names = {row for item, _ in found for row in item.get_closest_marker("gate").args}  # type: ignore[union-attr]
        if len(found) > len(names) > sum(kept for _, kept in found):
            raise pytest.UsageError(f"{test}: not every row that its mark `gate` names is there")


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """``in_process("rigctl" | "hil", *words)``: the command without a process of its own, which proves as much.

    It is run in the project's folder, for a reader without a terminal, 80 columns wide, and without the lines of
    progress, which come by this computer's clock.
    """

    def run(program: str, *words: object) -> subprocess.CompletedProcess[str]:
        from hil.__main__ import main as hil
        from rigctl.cli import progress
        from rigctl.cli.app import main as rigctl

        arguments = [str(word) for word in words]
        monkeypatch.chdir(HERE.parent)
        monkeypatch.setenv("COLUMNS", "80")
        monkeypatch.setattr(progress, "LINE_EVERY_S", threading.TIMEOUT_MAX)
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        capsys.readouterr()
        if program == "hil":
            code: int | str | None = hil()
        else:
            with pytest.raises(SystemExit) as ended:
                rigctl(arguments)
            code = ended.value.code
        said = capsys.readouterr()
        return subprocess.CompletedProcess([program, *arguments], int(code or 0), said.out, said.err)

    return run
