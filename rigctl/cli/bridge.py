"""``rigctl bridge``: a running rig in Foxglove, Lichtblick, Prometheus; the layouts for them and for PlotJuggler."""

from __future__ import annotations

import pathlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.options import BAD, DONE, USAGE, Connect, Rig, end, load_rig_file, number_option, say, wrong_usage
from rigctl.config.address import Address, AddressError, CannotListenError, here
from rigctl.config.typed_number import TypedNumber
from rigctl.ipc import standard_output

if TYPE_CHECKING:
    from rigctl import client

RETRY_S = 0.5


class BridgeTo(Enum):
    """Programs that are served, or that read a recording with our layout."""

    FOXGLOVE = "foxglove"
    PROMETHEUS = "prometheus"
    PLOTJUGGLER = "plotjuggler"


LISTEN = {BridgeTo.FOXGLOVE: "127.0.0.1:8765", BridgeTo.PROMETHEUS: "127.0.0.1:9477"}
LAYOUTS = {
    BridgeTo.FOXGLOVE: "foxglove.json",
    BridgeTo.PROMETHEUS: "grafana.json",
    BridgeTo.PLOTJUGGLER: "plotjuggler.xml",
}
What = Annotated[BridgeTo, typer.Argument(metavar="|".join(to.value for to in BridgeTo), help="Which tool.")]
File = Annotated[
    pathlib.Path | None,
    typer.Argument(
        metavar="[FILE]", help="Rig file, for name and endpoint [--connect, --rig].", autocompletion=rig_files
    ),
]
Listen = Annotated[
    str | None,
    typer.Option("--listen", metavar="HOST:PORT", help="Where it is served [127.0.0.1:8765, prometheus :9477]."),
]
Rate = Annotated[
    float,
    number_option(
        TypedNumber("hertz", 0.1, 4000.0),
        "--rate",
        metavar="HZ",
        help="foxglove: of the records; every tick at the most.",
    ),
]
Origins = Annotated[
    list[str] | None,
    typer.Option("--origin", metavar="URL", help="foxglove: a web page of elsewhere that may connect; several times."),
]
Layout = Annotated[
    pathlib.Path | None,
    typer.Option("--layout", metavar="FILE", help="Write the tool's layout for a rig there (-: print it), and end."),
]


@dataclass(frozen=True)
class _Asked:
    address: Address
    rate_hz: float
    origins: list[str]


def bridge(
    to: What,
    file: File = None,
    listen: Listen = None,
    rate: Rate = 100.0,
    origin: Origins = None,
    layout: Layout = None,
    connect: Connect = None,
    rig: Rig = None,
) -> None:
    """Serve a running rig to other tools, read-only, until Ctrl-C; waits for a daemon."""
    if layout is not None:
        _write_layout(to, layout)
        end(DONE)
    if to not in LISTEN:
        end(USAGE, f"{to.value} opens recordings: found no --layout, expected --layout FILE for its layout")
    try:
        address = Address.parse(listen or LISTEN[to])
    except AddressError as error:
        end(USAGE, f"--listen: {error}")
    if file is not None:
        settings = load_rig_file(file)
        connect, rig = connect or here(settings.telemetry.listen), rig or settings.rig
    if not address.is_loopback:
        say("WARNING: unencrypted and without sign-in: whoever reaches the address reads the rig")
    try:
        _SERVERS[to](_Asked(address, rate, origin or []), connect, rig)
    except CannotListenError as error:
        end(BAD, str(error))
    except KeyboardInterrupt:  # also while it waits for a daemon
        end(DONE)
    end(DONE)


def _write_layout(to: BridgeTo, file: pathlib.Path) -> None:
    from rigctl.bridge import layouts
    from rigctl.ipc import output_file

    text = layouts.text_of(LAYOUTS[to])
    if str(file) == "-":
        say(text.rstrip("\n"))
    else:
        with wrong_usage(output_file.OutputError):
            output_file.replace(file, text)


def _foxglove(asked: _Asked, connect: str | None, rig: str | None) -> None:
    from rigctl.bridge.foxglove_bridge import serve

    listening = asked.address.listen()
    address = Address(asked.address.host, listening.getsockname()[1])
    with _daemon(connect, rig) as found:
        say(f"foxglove: ws://{address}, {found.name} at {found.connection.endpoint}, records at {asked.rate_hz:g} Hz")
        complaint = serve(found, listening, address, asked.origins, asked.rate_hz)
    end(DONE if complaint is None else BAD, complaint)


def _prometheus(asked: _Asked, connect: str | None, rig: str | None) -> None:
    from rigctl.bridge.prometheus_bridge import serve
    from rigctl.client import SchemaError

    with _daemon(connect, rig) as found:

        def told(address: Address) -> None:
            say(f"prometheus: http://{address}/metrics, {found.name} at {found.connection.endpoint}")

        try:
            serve(found, asked.address, told, standard_output.nobody_reads)
        except SchemaError as error:
            end(BAD, str(error))


_SERVERS: dict[BridgeTo, Callable[[_Asked, str | None, str | None], None]] = {
    BridgeTo.FOXGLOVE: _foxglove,
    BridgeTo.PROMETHEUS: _prometheus,
}


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
