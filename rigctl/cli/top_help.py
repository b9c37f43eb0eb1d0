"""``rigctl --help``, written from the table of commands without loading any of them."""

from __future__ import annotations

import shutil
import textwrap

from rigctl.cli.verb_table import GROUPS, VERBS, VerbRow

WIDEST = 100
_NARROWEST = 40
HEAD = """\
Usage: rigctl [OPTIONS] COMMAND [ARGS]...

  Active suspension rig: run it, watch it, command it.

Options:
  --version             Show the version and end.
  --key FILE            Your key file, for an endpoint tls/HOST:PORT
                        [RIGCTL_KEY].
  --install-completion  Install completion for the current shell.
  --show-completion     Show completion for the current shell, to copy it or
                        customize the installation.
  -h, --help            Show this message and exit.
"""


def top_help() -> str:
    """The help of ``rigctl``, as wide as the terminal."""
    width = max(min(shutil.get_terminal_size().columns, WIDEST) - 2, _NARROWEST)
    column = max(len(row.name) for row in VERBS) + 4
    return HEAD + "".join(
        f"\n{title}:\n" + "".join(f"{_line(row, column, width)}\n" for row in rows) for title, rows in GROUPS.items()
    )


def _line(row: VerbRow, column: int, width: int) -> str:
    return textwrap.fill(
        row.line, width, initial_indent=f"  {row.name}".ljust(column), subsequent_indent=" " * column,
        break_on_hyphens=False,
    )  # fmt: skip
