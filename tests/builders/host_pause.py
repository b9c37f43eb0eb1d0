"""A real-time test that fails while the host paused the loop is repeated once; one that fails without a pause fails.

The loop measures the pause itself: the periods of its grid that it had to skip are events, and so lines of the daemon's
log, which the tests keep beside their files.
"""

from __future__ import annotations

import contextlib
import pathlib
import re
import threading
import time
from collections.abc import Generator, Iterator

import pytest
from _pytest.runner import runtestprotocol

from tests.builders import smoke

PAUSE_MS = 20
"""Fewer skipped periods of 1 ms are within what a loaded machine does, and no test depends on them."""
_SKIPPED = re.compile(r"(\d+) ticks skipped")
PAUSED_MS = "paused_ms"
"""Property of a test's report: the pause for which it was repeated."""
_PAUSED = pytest.StashKey[int]()


def longest_pause_ms(folder: pathlib.Path) -> int:
    """The most periods of 1 ms that a loop skipped at once or tripped over, by the logs in a folder."""
    texts = (file.read_text(errors="replace") for file in folder.rglob("*.log"))
    return max((int(ticks) for text in texts for ticks in _SKIPPED.findall(text)), default=0)


@contextlib.contextmanager
def late_wake_ups() -> Iterator[list[float]]:
    """Milliseconds by which a thread of this process woke up late during the block, for a rig whose loop kept time."""
    late_ms, over = [0.0], threading.Event()

    def watch() -> None:
        before = time.monotonic()
        while not over.wait(0.005):
            now = time.monotonic()
            late_ms.append((now - before) * 1000.0 - 5.0)
            before = now

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield late_ms
    finally:
        over.set()
        thread.join()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note the pause while the test's folder is there."""
    report = yield
    folder = getattr(item, "funcargs", {}).get("tmp_path")
    if report.failed and folder is not None:
        item.stash[_PAUSED] = max(item.stash.get(_PAUSED, 0), longest_pause_ms(folder))
    return report


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test of real processes, and again where it failed and may be repeated."""
    if item.get_closest_marker("real_time") is None and item.get_closest_marker("smoke") is None:
        return None
    where = {"nodeid": item.nodeid, "location": item.location}
    item.ihook.pytest_runtest_logstart(**where)
    reports = runtestprotocol(item, log=False, nextitem=nextitem)
    runs = 1
    while any(report.failed for report in reports) and (smoke.repeatable(item, reports, runs) or _paused(item, runs)):
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        runs += 1
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(**where)
    return True


def _paused(item: pytest.Item, runs: int) -> bool:
    """Whether a real-time test is repeated because the host paused its loop in its only run."""
    paused_ms = item.stash.get(_PAUSED, 0)
    if item.get_closest_marker("smoke") is not None or runs > 1 or paused_ms < PAUSE_MS:
        return False
    item.user_properties.append((PAUSED_MS, paused_ms))
    terminal = item.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        terminal.write_line(f"\n{item.nodeid}: failed while the host paused the loop for {paused_ms} ms; once more")
    return True
