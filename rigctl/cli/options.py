"""Options shared by the operator's commands, and how the commands end."""

from __future__ import annotations

import contextlib
import pathlib
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from rigctl.config import one_line
from rigctl.config.typed_number import TypedNumber
from rigctl.ipc import output_file

if TYPE_CHECKING:
    from rigctl.client.connection import Client
    from rigctl.config.settings import RigSettings

DONE, BAD, USAGE = 0, 1, 2


def _said(value: str | None) -> str | None:
    """Refuse an empty option: it comes from a script's variable that was never set."""
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
    typer.Option(metavar="NAME", help="Who gives the command, beside the user [RIGCTL_OPERATOR].", callback=_said),
]


SEED = TypedNumber("", 0, 2**31, whole=True)


def number_option(number: TypedNumber, *names: str, metavar: str, help: str) -> Any:
    """An option with a number; its help shows the bounds."""
    return typer.Option(*names, metavar=metavar, parser=number.read, min=number.least, max=number.most, help=help)


def number_argument(number: TypedNumber, metavar: str, help: str) -> Any:
    """An argument that is a number."""
    return typer.Argument(metavar=metavar, parser=number.read, help=help)


Wait = Annotated[bool, typer.Option("--wait", help="Return when it is over, or has failed.")]


def say(text: str) -> None:
    """Print one line."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def say_json(message: Any) -> None:
    """Print one line of JSON."""
    import msgspec

    say(msgspec.json.encode(message).decode())


def end(code: int, complaint: str | None = None) -> NoReturn:
    """End the command, with ``complaint`` as one line on standard error if given."""
    if complaint is not None:
        sys.stderr.write(f"rigctl: {one_line.complaint(complaint)}\n")
    raise typer.Exit(code)


def end_with_answer(answer: dict[str, Any], json: bool) -> NoReturn:
    """Print the answer to a command and end: 0 accepted, 1 refused."""
    accepted = bool(answer.get("accepted"))
    if json:
        say_json(answer)
    elif accepted:
        say(str(answer["text"]))
    end(DONE if accepted else BAD, None if accepted or json else str(answer.get("text", answer)))


@contextlib.contextmanager
def wrong_usage(*errors: type[Exception]) -> Iterator[None]:
    """A block of which these errors end the command, with their one line."""
    try:
        yield
    except errors as error:
        end(USAGE, str(error))


def load_rig_file(file: pathlib.Path, *, study: bool = False) -> RigSettings:
    """Settings of a rig file; an invalid one ends the command. ``study``: see `rigctl.config.rig_file.load`."""
    from rigctl.config import rig_file as config

    try:
        return config.load(file, study=study)
    except config.ConfigError as error:
        end(USAGE, "\nrigctl: ".join(error.findings))


def check_output(option: str, file: pathlib.Path | None) -> None:
    """End the command if an output file cannot be written."""
    if file is not None:
        with wrong_usage(output_file.OutputError):
            output_file.check(option, file)


@contextlib.contextmanager
def daemon(
    connect: str | None, rig: str | None, otherwise: Callable[[str, Exception], NoReturn] | None = None
) -> Iterator[Client]:
    """A client; without a daemon, or with a wrong endpoint or rig, the command ends with one line.

    ``otherwise``: ends it in place of the line where nothing answers at the endpoint, or the key for it is missing.
    """
    from rigctl.client.connection import ChoiceError, Client, NoDaemonError, NoKeyError, OtherRigError, endpoint_of

    try:
        with Client(connect, rig) as client:
            if words := client.route.words(client.rig):
                sys.stderr.write(f"rigctl: {words}\n")
            yield client
    except NoDaemonError as error:
        if otherwise is not None and not isinstance(error, OtherRigError):
            otherwise(endpoint_of(connect), error)
        end(BAD, str(error))
    except ChoiceError as error:
        if otherwise is not None and isinstance(error, NoKeyError):
            otherwise(endpoint_of(connect), error)
        end(USAGE, str(error))
