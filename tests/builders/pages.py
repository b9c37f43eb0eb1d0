"""Page servers in processes of their own, and the browser that shows them."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from playwright.sync_api import Browser, ConsoleMessage, Page, Request, WebSocket, sync_playwright

from tests.builders.paths import ROOT

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
PATIENCE_S = 40.0  # far above any expected time: only a hang fails


def until(true: Callable[[], Any], what: str) -> Any:
    """Wait for a truthy value."""
    end = time.monotonic() + PATIENCE_S
    while not (value := true()):
        assert time.monotonic() < end, f"waited {PATIENCE_S:.0f} s for {what}"
        time.sleep(0.05)
    return value


class Server:
    """``rigctl page`` and its output."""

    def __init__(self, endpoint: str, *options: str, port: int = 0) -> None:
        listen = () if "--listen" in options else ("--listen", f"127.0.0.1:{port}")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rigctl", "page", "--connect", endpoint, *listen, *options],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.said = self.process.stdout.readline()
        found = re.search(r"http://(\S+?):(\d+)/(?:#token=(\S+))?", self.said)
        assert found, self.process.communicate()
        self.port, self.token = int(found[2]), found[3] or ""

    @property
    def base(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def address(self) -> str:
        """The address that an operator opens."""
        return f"{self.base}/#token={self.token}" if self.token else f"{self.base}/"

    def ask(
        self, method: str, path: str, body: Any = None, *, token: str | None = None, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """One request as this server's own page makes it, except for ``headers``: status, headers, body."""
        own = {"Host": f"127.0.0.1:{self.port}", "Origin": self.base}
        own |= {"X-Rigctl-Token": token} if token is not None else {}
        own |= {name.capitalize(): value for name, value in headers.items()}
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        with contextlib.closing(connection):
            connection.request(method, path, json.dumps(body) if body is not None else None, own)
            reply = connection.getresponse()
            return reply.status, {name.lower(): value for name, value in reply.getheaders()}, reply.read()

    def command(self, what: str, body: Any, *, token: str | None = None, **headers: str) -> tuple[int, dict[str, Any]]:
        """A POST to ``/api/what``: status and answer."""
        status, _, answer = self.ask(
            "POST", f"/api/{what}", body, token=self.token if token is None else token, **headers
        )
        return status, dict(json.loads(answer))

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Exit code and standard error."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        _, error = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, error


@contextlib.contextmanager
def serving(endpoint: str, *options: str, port: int = 0) -> Iterator[Server]:
    """A page server within the context."""
    server = Server(endpoint, *options, port=port)
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
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        try:
            yield found
        finally:
            found.close()


def look(browser: Browser, address: str, width: int = 1280, height: int = 800, theme: Any = "light") -> PageView:
    """Open an address; the page's errors and every request are logged."""
    view = PageView(browser.new_page(viewport={"width": width, "height": height}, color_scheme=theme))

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
