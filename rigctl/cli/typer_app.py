"""The commands as a `typer` program: one command, or all of them."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterable
from typing import Annotated, cast

import typer

from rigctl import __version__
from rigctl.cli import json_file
from rigctl.cli.verb_table import VERBS, VerbRow, row_of
from rigctl.config.one_line import complaint, wrong_usage

# click's class; where typer keeps its click depends on typer's version.
_UsageError = cast("type[typer.BadParameter]", typer.BadParameter.__bases__[0])
_INTERRUPTED = 130
"""What typer gives in place of the interruption."""


def _show_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"rigctl {__version__}\n")
        raise typer.Exit


def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and end.")
    ] = False,
    key: Annotated[
        str | None, typer.Option(metavar="FILE", help="Your key file, for an endpoint tls/HOST:PORT [RIGCTL_KEY].")
    ] = None,
) -> None:
    if key is not None:
        os.environ["RIGCTL_KEY"] = key  # for every client of this process and of those it starts


def program(rows: Iterable[VerbRow] = VERBS) -> typer.Typer:
    """The program ``rigctl`` with these commands, whose modules are loaded now."""
    app = typer.Typer(
        name="rigctl",
        help="Active suspension rig: run it, watch it, command it.",
        context_settings={"help_option_names": ["-h", "--help"]},
        no_args_is_help=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_options)
    for row in rows:
        module, _, name = row.place.partition(":")
        found = getattr(importlib.import_module(f"rigctl.cli.{module}"), name)
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=row.name)
        else:
            app.command(row.name, context_settings={"ignore_unknown_options": True} if row.signed else None)(found)
    return app


def run(name: str, words: list[str]) -> int | None:
    """Run the words of a command line whose command is ``name``; returns the exit code, None for 0.

    Raises:
        KeyboardInterrupt: Ctrl-C, or an answer that ended the command.
    """
    row = row_of(name)
    words = json_file.with_files(words) if row is not None and row.json_file else words
    try:
        code: int | None = program(VERBS if row is None else (row,))(args=words, standalone_mode=False)
    except _UsageError as error:
        text = wrong_usage(error.format_message())
        own = f"rigctl {row.name}" if row is not None else "rigctl"
        sys.stderr.write(f"{complaint(f'rigctl: {text}')} (see {own} --help)\n")
        return 2
    except typer.Abort:
        raise KeyboardInterrupt from None
    if code == _INTERRUPTED:
        raise KeyboardInterrupt
    return code
