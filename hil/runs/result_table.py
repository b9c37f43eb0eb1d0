"""Tables of the studies on a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text


def table(first: str, right: Sequence[str], title: str | None = None) -> Table:
    """A table without lines: a column of names, then columns of numbers."""
    found = Table(first, title=title, title_justify="left", box=None, pad_edge=False)
    for column in right:
        found.add_column(column, justify="right", no_wrap=True)
    return found


def verdict(ok: bool, good: str, bad: str) -> Text:
    """The verdict on a row, in its colour."""
    return Text(good, "green") if ok else Text(bad, "red")


def console(width: int) -> Console:
    """Standard output: a terminal's own width up to ``width``, and that elsewhere."""
    terminal = Console()
    return terminal if terminal.is_terminal and terminal.width <= width else Console(width=width)
