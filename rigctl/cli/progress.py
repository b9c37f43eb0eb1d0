"""A progress bar on standard error for anything that takes longer than a moment."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

APPEARS_S = 1.0
"""A task that ends before this shows no bar."""

Advance = Callable[[float, str], None]
"""Called with the work done since the last call, in the unit of the total, and the name of the current step."""


@contextlib.contextmanager
def progress(title: str, total: float) -> Iterator[Advance]:
    """A bar from 0 to ``total``, removed when the block ends. Without a terminal on standard error nothing is shown.

    Args:
        title: text in front of the bar.
        total: total work, in seconds of simulated time or any other unit.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _unseen
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


def _unseen(_done: float, _doing: str = "") -> None:
    """Stand-in without a display."""
