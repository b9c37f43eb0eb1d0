"""Page process of a daemon: ``python -m rigctl.page RUNTIME_DIR``, started by the supervisor. Read-only."""

from __future__ import annotations

import os
import pathlib
import signal
import socket
import sys
import time

import msgspec
from pydantic import ValidationError

from rigctl.config.address import Address, CannotListenError
from rigctl.config.settings import RigSettings
from rigctl.control.realtime import die_with_parent
from rigctl.ipc import standard_output
from rigctl.ipc.progress import Progress
from rigctl.ipc.runtime_folder import ACTIVE, FolderError, Runtime
from rigctl.page import certificate
from rigctl.page.guard import PLAIN_HTTP, Guard
from rigctl.page.link_socket import path_in
from rigctl.page.serve import serve

NICENESS = 10  # the page is the least urgent process
RETRY_S, TURN_S = 2.0, 0.2


def _listen(address: Address, progress: Progress) -> socket.socket:
    """A listening socket; while the address is in use, warn once and try again."""
    warned = False
    while True:
        try:
            listening = address.listen()
        except CannotListenError as error:
            if not warned:
                _print(f"WARNING: page: {error}; it is tried again, the loop is unaffected")
            warned = True
            for _ in range(round(RETRY_S / TURN_S)):
                progress.step()
                time.sleep(TURN_S)
            continue
        return listening


def _print(text: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {text}\n")
    sys.stdout.flush()


def main(arguments: list[str]) -> int:
    """Serve the page of the daemon whose runtime folder is named; returns the exit code."""
    standard_output.never_wait()
    if len(arguments) != 1:
        sys.stderr.write("usage: python -m rigctl.page RUNTIME_DIR\n")
        return 2
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent(signal.SIGTERM)
    os.nice(NICENESS)
    try:
        runtime = Runtime.entered(pathlib.Path(arguments[0]))
    except FolderError as error:
        sys.stderr.write(f"page: {error}\n")
        return 1
    try:
        settings = RigSettings.model_validate(runtime.read_json(ACTIVE).get("settings"))
    except (OSError, ValidationError, msgspec.MsgspecError):
        sys.stderr.write("page: active.json holds no valid settings\n")
        return 1
    if settings.page is None:
        sys.stderr.write("page: the settings have no page section\n")
        return 1
    page, tls = settings.page, None
    if page.tls_cert is not None and page.tls_key is not None:
        try:
            tls = certificate.context(settings.file(page.tls_cert), settings.file(page.tls_key))
        except certificate.CertificateError as error:
            sys.stderr.write(f"page: {error}\n")
            return 1
    guard = Guard.of(page.address, sign_in=page.sign_in, tls=tls is not None)
    progress = Progress(runtime, "page")
    listening = _listen(page.address, progress)
    signs_in = "; sign in by a link of rigctl page --link" if guard.needs_links else ""
    _print(f"page: {guard.url} (read-only{signs_in})")
    if tls is None and not page.address.is_loopback:
        _print(f"WARNING: page: {PLAIN_HTTP}")
    named = Runtime(arguments[0])  # the page shows the socket's path
    links = path_in(named.directory, page.address.port)
    return serve(
        listening,
        f"unixsock-stream/{named.gateway_socket}",
        settings.rig,
        guard,
        tls=tls,
        links=links,
        turn=progress.step,
    )


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
