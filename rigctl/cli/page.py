"""``rigctl page``: the live page in a process of its own."""

from __future__ import annotations

import secrets
from typing import Annotated

import typer

from rigctl.cli.options import BAD, USAGE, Connect, Rig, end, say
from rigctl.config.page_address import DEFAULT, Address, AddressError, CannotListenError

Listen = Annotated[str, typer.Option("--listen", metavar="HOST:PORT", help="Where the page is served.")]
Rights = Annotated[
    str | None,
    typer.Option("--operator", metavar="NAME", help="Give operator rights: commands, under the lease, as NAME."),
]
Remote = Annotated[
    bool, typer.Option("--remote-operator", help="Allow operator rights on an address other computers reach.")
]


def page(
    listen: Listen = str(DEFAULT),
    operator: Rights = None,
    remote_operator: Remote = False,
    connect: Connect = None,
    rig: Rig = None,
) -> None:
    """Serve the live page until Ctrl-C: charts, mode, limits, events; read-only unless --operator is given."""
    try:
        address = Address.parse(listen)
    except AddressError as error:
        end(USAGE, f"--listen: {error}")
    name = _checked(operator)
    if name is not None and not address.is_loopback and not remote_operator:
        end(USAGE, f"--listen {address} with --operator: other computers reach it; allowed with --remote-operator")
    if remote_operator and name is None:
        end(USAGE, "found --remote-operator, expected with --operator NAME")
    endpoint, known = _daemon(connect, rig)
    try:
        listening = address.listen()
    except CannotListenError as error:
        end(BAD, str(error))
    from rigctl.page.guard import Guard
    from rigctl.page.serve import serve

    address = Address(address.host, listening.getsockname()[1])
    token = secrets.token_urlsafe(24) if name is not None else None
    say(f"page: http://{address}/" + (f"#token={token}" if token else "") + f" ({_rights(name)}), {known}")
    if name is not None and not address.is_loopback:
        say("WARNING: whoever has this address, and whoever listens on the network, can command the rig")
    serve(listening, endpoint, rig, Guard(address, token), name)


def _rights(operator: str | None) -> str:
    return f"commands as {operator}" if operator is not None else "read-only"


def _checked(operator: str | None) -> str | None:
    from rigctl.wire.command_request import RequestError, operator_of

    if operator is None:
        return None
    try:
        return operator_of(operator)
    except RequestError as error:
        end(USAGE, f"--operator: {error}")


def _daemon(connect: str | None, rig: str | None) -> tuple[str, str]:
    """Endpoint, and a text on the daemon there; the page starts without a daemon, too."""
    from rigctl.client.connection import ChoiceError, Client, NoDaemonError, endpoint_of

    try:
        endpoint = endpoint_of(connect)
        with Client(endpoint, rig) as client:
            return endpoint, f"{client.rig} at {endpoint}"
    except NoDaemonError as error:
        return endpoint, f"{error}; the page waits for one"
    except ChoiceError as error:
        end(USAGE, str(error))
