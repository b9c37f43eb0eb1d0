"""Options the operator's commands share, and how they end."""

from __future__ import annotations

import contextlib
import getpass
import os
import pathlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from rigctl.ipc import output_file

if TYPE_CHECKING:
    from rigctl.client.connection import Client

DONE, BAD, USAGE = 0, 1, 2


def _said(value: str | None) -> str | None:
    """An option that is given says something: an empty one is a script's variable that was never set."""
    if value is not None and not value.strip():
        raise typer.BadParameter("found nothing, expected a value (or leave the option out)")
    return value


Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Connect = Annotated[
    str | None,
    typer.Option(metavar="ENDPOINT", help="Daemon's endpoint [RIGCTL_CONNECT, tcp/127.0.0.1:7447].", callback=_said),
]
Rig = Annotated[
    str | None, typer.Option(metavar="NAME", help="Rig, where several answer [RIGCTL_RIG].", callback=_said)
]
Operator = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Who gives the command [RIGCTL_OPERATOR, login name].", callback=_said),
]
Wait = Annotated[bool, typer.Option("--wait", help="Return when it is over, or has failed.")]


def operator_name(given: str | None) -> str:
    """Who gives a command."""
    if given := given or os.environ.get("RIGCTL_OPERATOR"):
        return given.encode(errors="replace").decode()
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # no login name, as in a bare container
        return f"uid {os.getuid()}"


def say(text: str) -> None:
    """One line for whoever reads standard output."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def say_json(message: Any) -> None:
    """One line of JSON."""
    import msgspec

    say(msgspec.json.encode(message).decode())


def end(code: int, complaint: str | None = None) -> NoReturn:
    """End the command, with one line on standard error if there is something to complain about."""
    if complaint is not None:
        sys.stderr.write(f"rigctl: {complaint}\n")
    raise typer.Exit(code)


def check_output(option: str, file: pathlib.Path | None) -> None:
    """End the command if a file it is to write could not be written."""
    try:
        if file is not None:
            output_file.check(option, file)
    except output_file.OutputError as error:
        end(USAGE, str(error))


@contextlib.contextmanager
def daemon(connect: str | None, rig: str | None) -> Iterator[Client]:
    """A client; without a daemon, or with a wrong choice of one, the command ends in one line."""
    from rigctl.client.connection import ChoiceError, Client, NoDaemonError

    try:
        with Client(connect, rig) as client:
            yield client
    except NoDaemonError as error:
        end(BAD, str(error))
    except ChoiceError as error:
        end(USAGE, str(error))
