"""Progress on standard error of what takes longer than a moment: a bar on a terminal, elsewhere a line each 10 s."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

APPEARS_S = 1.0
"""A task that ends before this shows no bar."""
LINE_EVERY_S = 10.0
"""Between two lines of a task without a terminal."""

Advance = Callable[[float, str], None]
"""Called with the work done since the last call, in the unit of the total, and the name of the current step."""


@contextlib.contextmanager
def progress(title: str, total: float | None) -> Iterator[Advance]:
    """A bar from 0 to ``total``, removed when the block ends; without a terminal a line each 10 s, with its share.

    Args:
        title: text in front of the bar.
        total: total work, in seconds of simulated time or any other unit; None: not known.
    """
    console = Console(stderr=True)
    with _bar(console, title, total) if console.is_terminal else _lines(title, total) as advance:
        yield advance


@contextlib.contextmanager
def _bar(console: Console, title: str, total: float | None) -> Iterator[Advance]:
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[doing]}"),
        console=console,
        transient=True,
    )
    task = bar.add_task(title, total=total, doing="")
    later = threading.Timer(APPEARS_S, bar.start)
    later.daemon = True
    later.start()

    def advance(done: float, doing: str = "") -> None:
        bar.update(task, advance=done)
        if doing:
            bar.update(task, doing=doing)

    try:
        yield advance
    finally:
        later.cancel()
        later.join()
        bar.stop()


@contextlib.contextmanager
def _lines(title: str, total: float | None) -> Iterator[Advance]:
    done, doing, ended, lock = 0.0, "", threading.Event(), threading.Lock()

    def advance(part: float, now_doing: str = "") -> None:
        nonlocal done, doing
        with lock:
            done += part
            doing = now_doing or doing

    def write() -> None:
        passed_s = 0.0
        while not ended.wait(LINE_EVERY_S):
            passed_s += LINE_EVERY_S
            share = f"{min(100.0, 100.0 * done / total):.0f} %" if total else f"{passed_s:.0f} s"
            with contextlib.suppress(OSError):  # the work goes on without its reader
                sys.stderr.write(f"{title}: {share}{f', {doing}' if doing else ''}\n")
                sys.stderr.flush()

    writer = threading.Thread(target=write, name="progress", daemon=True)
    writer.start()
    try:
        yield advance
    finally:
        ended.set()
        writer.join()
