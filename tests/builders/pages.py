"""Page servers in processes of their own, and the browser that shows them."""

from __future__ import annotations

import contextlib
import functools
import http.client
import json
import os
import pathlib
import re
import shutil
import signal
import ssl
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from playwright.sync_api import Browser, ConsoleMessage, Page, Request, WebSocket, sync_playwright

from rigctl.page.link_socket import new_link, path_in
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

CHROMIUM = "/usr/bin/chromium"
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
# A browser and a 1 kHz loop share one small machine: these tests do not judge lateness.
PATIENT: dict[str, dict[str, Any]] = {
    "safety": {
        "stale_ms": 500,
        "bus_silent_ms": 500,
        "inclination_stale_ms": 2000,
        "overrun_ticks": 1000,
        "waiver": "a simulated rig on a busy machine",
    },
    "cylinder": {"heartbeat_timeout_ms": 1000, "command_deadline_ms": 1000},
}


class Server:
    """``rigctl page``, its output, and a session with it."""

    def __init__(self, endpoint: str, *options: str, port: int = 0, tls: ssl.SSLContext | None = None) -> None:
        """``tls``: trusts the server's certificate."""
        listen = () if "--listen" in options else ("--listen", f"127.0.0.1:{port}")
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="rigctl-page-"))
        self.environment = {**os.environ, "XDG_RUNTIME_DIR": str(self.folder)}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rigctl", "page", "--connect", endpoint, *listen, *options],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self.environment,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.said = self.process.stdout.readline()
        found = re.search(r"(https?)://(\S+?):(\d+)/(?:#link=(\S+))?", self.said)
        assert found, self.process.communicate()
        self.scheme, self.port, self.code, self._tls = found[1], int(found[3]), found[4] or "", tls

    @property
    def base(self) -> str:
        return f"{self.scheme}://127.0.0.1:{self.port}"

    @property
    def address(self) -> str:
        """An address that an operator opens, with a link of its own."""
        return f"{self.base}/#link={self.new_code()}" if self.code else f"{self.base}/"

    def new_code(self) -> str:
        """A link's code, as ``rigctl page --link`` gets it."""
        path = path_in(self.folder / "rigctl", self.port)
        link = until(lambda: new_link(path), "the socket of links")
        return str(link).partition("#link=")[2]

    @functools.cached_property
    def session(self) -> dict[str, str]:
        """Headers that prove a session, which the link printed at the start made."""
        return self.sign_in(self.code)

    def sign_in(self, code: str) -> dict[str, str]:
        """Headers of a new session."""
        status, headers, body = self.ask("POST", "/api/sign-in", {"link": code})
        assert status == 200, body
        return {"Cookie": headers["set-cookie"].partition(";")[0], "X-Rigctl-Key": json.loads(body)["key"]}

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, dict[str, str], bytes]:
        """One request as this server's own page makes it, except for ``headers``: status, headers, body."""
        own = {"Host": f"127.0.0.1:{self.port}", "Origin": self.base}
        own |= {name.capitalize(): value for name, value in headers.items()}
        where: dict[str, Any] = {"host": "127.0.0.1", "port": self.port, "timeout": patience_s()}
        secured = self.scheme == "https"
        connection = http.client.HTTPSConnection(**where, context=self._tls) if secured else None
        with contextlib.closing(connection or http.client.HTTPConnection(**where)) as one:
            one.request(method, path, json.dumps(body) if body is not None else None, own)
            reply = one.getresponse()
            return reply.status, {name.lower(): value for name, value in reply.getheaders()}, reply.read()

    def command(
        self, what: str, body: Any, *, session: dict[str, str] | None = None, **headers: str
    ) -> tuple[int, dict[str, Any]]:
        """A POST to ``/api/what``: status and answer. ``session``: other headers than those of `session`."""
        if session is None:
            session = self.session if self.code else {}
        status, _, answer = self.ask("POST", f"/api/{what}", body, **session, **headers)
        return status, dict(json.loads(answer))

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Exit code and standard error."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        _, error = self.process.communicate(timeout=patience_s())
        shutil.rmtree(self.folder, ignore_errors=True)
        return self.process.returncode, error


@contextlib.contextmanager
def serving(endpoint: str, *options: str, port: int = 0, tls: ssl.SSLContext | None = None) -> Iterator[Server]:
    """A page server within the context."""
    server = Server(endpoint, *options, port=port, tls=tls)
    try:
        yield server
    finally:
        server.end(signal.SIGKILL)


@dataclass
class PageView:
    """A page in the browser, and what the browser logged about it."""

    page: Page
    errors: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        return self.page.evaluate(script)

    def until(self, script: str) -> Any:
        """Wait until an expression is true. (Playwright's own wait needs eval, which the page forbids.)"""
        try:
            return until(lambda: self.run(script), script)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.errors}; the page says: {self.text('#stale')}") from None

    def text(self, selector: str) -> str:
        """Text of an element."""
        return str(self.run(f"document.querySelector({selector!r}).textContent"))

    def live(self) -> None:
        """Wait until charts are drawn from fresh data."""
        self.until("window.rigctl && rigctl.draws > 1 && !rigctl.stale")


@contextlib.contextmanager
def browser() -> Iterator[Browser]:
    """Debian's Chromium, without a window."""
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS), timeout=_patience_ms())
        try:
            yield found
        finally:
            found.close()


def new_page(browser: Browser, **options: Any) -> Page:
    """A page in a context of its own, which ends with it. Its waits last as long as all others of a test."""
    page = browser.new_page(**options)
    page.set_default_timeout(_patience_ms())
    return page


def _patience_ms() -> float:
    return 1000.0 * patience_s()


def look(browser: Browser, address: str, width: int = 1280, height: int = 800, theme: Any = "light") -> PageView:
    """Open an address; the page's errors and every request are logged."""
    view = PageView(new_page(browser, viewport={"width": width, "height": height}, color_scheme=theme))

    def said(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            view.errors.append(message.text)

    def requested(request: Request) -> None:
        view.asked.append(request.url)

    def connected(socket: WebSocket) -> None:
        view.asked.append(socket.url)

    view.page.on("console", said)
    view.page.on("pageerror", lambda error: view.errors.append(str(error)))
    view.page.on("request", requested)
    view.page.on("websocket", connected)
    view.page.goto(address)
    return view
