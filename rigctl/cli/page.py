"""``rigctl page``: the live page in a process of its own."""

from __future__ import annotations

import contextlib
import pathlib
import ssl
from typing import Annotated

import typer

from rigctl.cli import lease_file
from rigctl.cli.options import BAD, USAGE, Connect, Rig, end, say, wrong_usage
from rigctl.config.address import DEFAULT, Address, AddressError, CannotListenError
from rigctl.ipc import standard_output
from rigctl.ipc.service_manager import Watchdog

Listen = Annotated[str, typer.Option("--listen", metavar="HOST:PORT", help="Where the page is served.")]
Rights = Annotated[
    str | None,
    typer.Option("--operator", metavar="NAME", help="Give operator rights: commands, under the lease, as NAME."),
]
Remote = Annotated[
    bool, typer.Option("--remote-operator", help="Allow operator rights on an address other computers reach.")
]
Certificate = Annotated[
    pathlib.Path | None, typer.Option("--tls-cert", metavar="FILE", help="Serve HTTPS with this certificate (PEM).")
]
CertificateKey = Annotated[
    pathlib.Path | None, typer.Option("--tls-key", metavar="FILE", help="The certificate's key (PEM, mode 0600).")
]
SignsIn = Annotated[
    bool, typer.Option("--sign-in", help="Reading needs a sign-in on loopback too; beyond loopback it always does.")
]
Link = Annotated[
    bool, typer.Option("--link", help="Print another one-time link of your page server that listens there, and end.")
]


def page(
    listen: Listen = str(DEFAULT),
    operator: Rights = None,
    remote_operator: Remote = False,
    tls_cert: Certificate = None,
    tls_key: CertificateKey = None,
    sign_in: SignsIn = False,
    link: Link = False,
    connect: Connect = None,
    rig: Rig = None,
) -> None:
    """Serve the live page until Ctrl-C: charts, mode, limits, events; read-only unless --operator is given."""
    try:
        address = Address.parse(listen)
    except AddressError as error:
        end(USAGE, f"--listen: {error}")
    if link:
        _print_link(address)
    name = _checked(operator)
    if name is not None and not address.is_loopback and not remote_operator:
        end(USAGE, f"--listen {address} with --operator: other computers reach it; allowed with --remote-operator")
    if remote_operator and name is None:
        end(USAGE, "found --remote-operator, expected with --operator NAME")
    tls = _https(tls_cert, tls_key)
    endpoint, known = _daemon(connect, rig)
    if name is not None:
        name = _person(endpoint) or name
    try:
        listening = address.listen()
    except CannotListenError as error:
        end(BAD, str(error))
    from rigctl.page.guard import PLAIN_HTTP, Guard
    from rigctl.page.link_socket import path_in
    from rigctl.page.serve import serve

    address = Address(address.host, listening.getsockname()[1])
    guard = Guard.of(address, operator=name, sign_in=sign_in, tls=tls is not None)
    standard_output.never_wait()
    rights = f"commands as {name}" if name is not None else "read-only"
    say(f"page: {guard.link() if guard.needs_links else guard.url} ({rights}), {known}")
    if tls is None and not address.is_loopback:
        say(f"WARNING: {PLAIN_HTTP}" + ("; whoever does can command the rig" if name is not None else ""))
    folder = _own_folder() if guard.needs_links else None
    links = path_in(folder, address.port) if folder else None
    serve(listening, endpoint, rig, guard, tls=tls, links=links, turn=Watchdog().feed)


def _https(cert: pathlib.Path | None, key: pathlib.Path | None) -> ssl.SSLContext | None:
    if cert is None or key is None:
        if cert is not key:
            end(USAGE, "found one of --tls-cert and --tls-key, expected both or neither")
        return None
    from rigctl.page import certificate

    with wrong_usage(certificate.CertificateError):
        return certificate.context(cert, key)


def _own_folder() -> pathlib.Path | None:
    """This user's own folder for the socket of links, or None where another user could reach it."""
    folder = lease_file.folder()
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if lease_file.is_ours(folder):
            return folder
    return None


def _print_link(address: Address) -> None:
    """Print a new link of this user's page server at the address' port, a daemon's own page included, and end."""
    from rigctl.ipc import runtime_folder
    from rigctl.page.link_socket import new_link, path_in

    folders = [lease_file.folder(), *(runtime_folder.Runtime.of(rig).directory for rig, _ in runtime_folder.daemons())]
    for folder in folders:
        with contextlib.suppress(OSError):
            if lease_file.is_ours(folder) and (found := new_link(path_in(folder, address.port))):
                say(found)
                raise typer.Exit
    end(BAD, f"no page server of this user with sign-in listens at port {address.port} (--listen names another)")


def _checked(operator: str | None) -> str | None:
    from rigctl.wire.command_request import RequestError, operator_of

    if operator is None:
        return None
    try:
        return operator_of(operator)
    except RequestError as error:
        end(USAGE, f"--operator: {error}")


def _person(endpoint: str) -> str:
    """The name in this user's key file, by which a daemon with certificates knows the page; else empty."""
    from rigctl.client.connection import credentials_of

    owned = credentials_of(endpoint, None)
    return owned.name if owned is not None else ""


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
