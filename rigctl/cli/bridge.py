"""``rigctl bridge``: a running rig in Foxglove, Lichtblick, Prometheus; the layouts for them and for PlotJuggler."""

from __future__ import annotations

import pathlib
import sys
import time
from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli import standard_output
from rigctl.cli.options import BAD, DONE, USAGE, Connect, Rig, end, load_rig_file, say
from rigctl.config.address import Address, AddressError, CannotListenError, here

if TYPE_CHECKING:
    from rigctl import client

RETRY_S = 0.5


class BridgeTo(Enum):
    """Programs that are served."""

    FOXGLOVE = "foxglove"


LISTEN = {BridgeTo.FOXGLOVE: "127.0.0.1:8765"}
What = Annotated[BridgeTo, typer.Argument(metavar="foxglove", help="Which tool.")]
File = Annotated[
    pathlib.Path | None, typer.Argument(metavar="[FILE]", help="Rig file, for name and endpoint [--connect, --rig].")
]
Listen = Annotated[
    str | None, typer.Option("--listen", metavar="HOST:PORT", help="Where it is served [127.0.0.1:8765].")
]
Rate = Annotated[
    float, typer.Option("--rate", metavar="HZ", min=0.1, max=4000.0, help="Of the records; every tick at the most.")
]
Origins = Annotated[
    list[str] | None,
    typer.Option("--origin", metavar="URL", help="A web page of elsewhere that may connect; may be repeated."),
]


def bridge(
    to: What,
    file: File = None,
    listen: Listen = None,
    rate: Rate = 100.0,
    origin: Origins = None,
    connect: Connect = None,
    rig: Rig = None,
) -> None:
    """Serve a running rig to other tools, read-only, until Ctrl-C; waits for a daemon."""
    try:
        address = Address.parse(listen or LISTEN[to])
    except AddressError as error:
        end(USAGE, f"--listen: {error}")
    if file is not None:
        settings = load_rig_file(file)
        connect, rig = connect or here(settings.telemetry.listen), rig or settings.rig
    try:
        listening = address.listen()
    except CannotListenError as error:
        end(BAD, str(error))
    address = Address(address.host, listening.getsockname()[1])
    with _daemon(connect, rig) as found:
        if not address.is_loopback:
            say("WARNING: unencrypted and without sign-in: whoever reaches the address reads the rig")
        from rigctl.bridge.foxglove_bridge import serve

        say(f"foxglove: ws://{address}, {found.name} at {found.connection.endpoint}, records at {rate:g} Hz")
        complaint = serve(found, listening, address, origin or [], rate)
    end(DONE if complaint is None else BAD, complaint)


def _daemon(connect: str | None, rig: str | None) -> client.Rig:
    """The rig, as soon as its daemon runs; a wrong endpoint or name ends the command with one line."""
    from rigctl import client

    waiting = False
    while True:
        try:
            return client.connect(connect, rig)
        except client.NoDaemonError as error:
            if not waiting:
                sys.stderr.write(f"{error}; waiting for one, Ctrl-C ends\n")
                sys.stderr.flush()
            waiting = True
            time.sleep(RETRY_S)
        except (client.ChoiceError, client.SchemaError) as error:
            end(USAGE, str(error))
        if standard_output.nobody_reads():
            end(DONE)
