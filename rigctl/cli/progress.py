"""Progress on standard error of anything that takes longer than a moment: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

APPEARS_S = 1.0
"""A task that ends before this shows no bar."""
STEPS = 50
"""Lines of a task without a terminal."""

Advance = Callable[[float, str], None]
"""Called with the work done since the last call, in the unit of the total, and the name of the current step."""


@contextlib.contextmanager
def progress(title: str, total: float, *, lines: bool = False) -> Iterator[Advance]:
    """A bar from 0 to ``total``, removed when the block ends.

    Args:
        title: text in front of the bar.
        total: total work, in seconds of simulated time or any other unit.
        lines: of work that takes minutes: without a terminal a line for every 2 % of it; else nothing is shown.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _line_by_line(title, total) if lines else _unseen
        return
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


def _line_by_line(title: str, total: float) -> Advance:
    done, shown, lock = 0.0, -1, threading.Lock()

    def advance(part: float, doing: str = "") -> None:
        nonlocal done, shown
        with lock:
            done += part
            step = min(STEPS, int(STEPS * done / total)) if total > 0.0 else STEPS
            if step > shown:
                shown = step
                with contextlib.suppress(OSError):  # the work goes on without its reader
                    sys.stderr.write(f"{title}: {100 * step // STEPS} %{f', {doing}' if doing else ''}\n")
                    sys.stderr.flush()

    advance(0.0)
    return advance


def _unseen(_done: float, _doing: str = "") -> None:
    """Stand-in without a display."""
