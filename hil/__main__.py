"""``python -m hil``: the simulated rig's commands."""

from __future__ import annotations

import pathlib
import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from hil.serve import ServeError, serve

app = typer.Typer(add_completion=False, help="The simulated rig.")


@app.callback()
def _commands() -> None:
    """The simulated rig."""


@app.command("serve")
def _serve(
    file: Annotated[pathlib.Path, typer.Argument(help="rig file")],
    truth: Annotated[pathlib.Path | None, typer.Option(help="write the plant's true state here, 1 kHz")] = None,
) -> None:
    """Serve the rig of FILE on its CAN bus until interrupted."""
    serve(file, truth, _announce)


def _announce(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    """Run; every refusal is one line on stderr. Exit code 0 good, 1 no bus, 2 usage or input."""
    try:
        return int(app(standalone_mode=False) or 0)
    except ServeError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    except TyperException as error:
        sys.stderr.write(f"hil: {error} (see python -m hil --help)\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
