"""Options the operator's commands share, and how they end."""

from __future__ import annotations

import contextlib
import getpass
import os
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from rigctl.telemetry.client import Client

DONE, BAD, USAGE = 0, 1, 2

Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Connect = Annotated[
    str | None, typer.Option(metavar="ENDPOINT", help="Daemon's endpoint [RIGCTL_CONNECT, tcp/127.0.0.1:7447].")
]
Rig = Annotated[str | None, typer.Option(metavar="NAME", help="Rig, where several answer [RIGCTL_RIG].")]
Operator = Annotated[
    str | None, typer.Option(metavar="NAME", help="Who gives the command [RIGCTL_OPERATOR, login name].")
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
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read it has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(DONE) from None


def say_json(message: Any) -> None:
    """One line of JSON."""
    import msgspec

    say(msgspec.json.encode(message).decode())


def end(code: int, complaint: str | None = None) -> NoReturn:
    """End the command, with one line on standard error if there is something to complain about."""
    if complaint is not None:
        sys.stderr.write(f"rigctl: {complaint}\n")
    raise typer.Exit(code)


@contextlib.contextmanager
def daemon(connect: str | None, rig: str | None) -> Iterator[Client]:
    """A client; without a daemon, or with a wrong choice of one, the command ends in one line."""
    from rigctl.telemetry.client import ChoiceError, Client, NoDaemonError

    try:
        with Client(connect, rig) as client:
            yield client
    except NoDaemonError as error:
        end(BAD, str(error))
    except ChoiceError as error:
        end(USAGE, str(error))
