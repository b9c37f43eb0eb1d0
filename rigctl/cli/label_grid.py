"""A table of labels and values for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

LABEL_COLUMNS = 9


def grid(first: Sequence[tuple[str, Text]]) -> Table:
    """A table of labels and values that begins with ``first``."""
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True, min_width=LABEL_COLUMNS)
    table.add_column(overflow="fold")
    for row in first:
        table.add_row(*row)
    return table
