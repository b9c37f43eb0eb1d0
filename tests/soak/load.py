"""What works on the daemon during a soak: an operator, clients that come and go, a reader of the page, a full disk."""

from __future__ import annotations

import abc
import contextlib
import errno
import os
import pathlib
import random
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect as open_socket
from websockets.typing import Origin

from rigctl.client import Rig, connect
from rigctl.client.connection import Client, NoDaemonError
from rigctl.model.lease_acts import Denial
from tests.builders import pages
from tests.soak import plan

OPERATOR = "soak"
BETWEEN_S = (0.1, 1.5)
NICENESS = 10  # of the browser: the rig's computer has none
MEASURE_S = 10.0
_KILLED = "ERR_CONNECTION_(REFUSED|RESET|CLOSED)|ERR_EMPTY_RESPONSE"
"""What a browser reports of a page server that was killed."""


class Worker(threading.Thread, abc.ABC):
    """A thread that works while it is ``active`` until it is ended; an error is kept for the result."""

    def __init__(self, name: str) -> None:
        super().__init__(name=name, daemon=True)
        self.active, self._over = threading.Event(), threading.Event()
        self.error = ""

    @property
    def going(self) -> bool:
        """Whether it is to work now."""
        return self.active.is_set() and not self._over.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait; returns whether the thread is to end."""
        return self._over.wait(seconds)

    def run(self) -> None:
        """See `threading.Thread`."""
        while not self._over.is_set():
            if not self.active.is_set():
                self._over.wait(0.1)
                continue
            try:
                self.work()
            except Exception as error:  # noqa: BLE001 - a worker's failure is a finding, not the end of the soak
                self.error = self.error or f"{type(error).__name__}: {error}"
                self._over.wait(1.0)

    @abc.abstractmethod
    def work(self) -> None:
        """Work while ``going``."""

    def end(self) -> None:
        """End the thread."""
        self._over.set()
        self.join(20.0)


class Commander(Worker):
    """Gives random commands, as one operator with the lease."""

    def __init__(self, endpoint: str, rig: str, chance: random.Random) -> None:
        super().__init__("operator")
        self._endpoint, self._rig, self._chance = endpoint, rig, chance
        self.counts: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()

    def work(self) -> None:
        """See `Worker`."""
        try:
            with Client(self._endpoint, self._rig) as client:
                while self.going:
                    self._give(client)
                    self.wait(self._chance.uniform(*BETWEEN_S))
                self._rest(client)
        except NoDaemonError:  # the gateway is being killed
            self.counts["unanswered"] += 1
            self.wait(0.2)

    def _give(self, client: Client) -> None:
        verb, value = plan.command(str(client.state().get("mode")), self._chance)
        answer = client.command(verb, OPERATOR, value)
        self.counts["accepted" if answer.get("accepted") else "refused"] += 1
        if answer.get("reason") == Denial.HELD.value:  # by this operator, before the gateway was killed
            client.take_lease(OPERATOR, "soak")
        if not answer.get("accepted"):
            self.reasons[f"{verb}: {answer.get('reason')}"] += 1

    @staticmethod
    def _rest(client: Client) -> None:
        client.command("hold", OPERATOR)
        client.return_lease(OPERATOR)


class Visitors(Worker):
    """Clients that come, read some of the streams, and go; some do not read what they subscribed to."""

    def __init__(self, endpoint: str, rig: str, chance: random.Random) -> None:
        super().__init__("visitors")
        self._endpoint, self._rig, self._chance = endpoint, rig, chance
        self.came = 0

    def work(self) -> None:
        """See `Worker`."""
        wanted = plan.clients(self._chance)
        here: list[Rig] = []
        try:
            while self.going:
                count = next(wanted)
                while len(here) > count:
                    here.pop(self._chance.randrange(len(here))).close()
                while len(here) < count and self.going:
                    with contextlib.suppress(NoDaemonError):
                        here.append(found := connect(self._endpoint, self._rig))
                        self.came += 1
                        self._chance.choice((found.states, found.fast, found.events))()
                    self.wait(0.1)
                self.wait(self._chance.uniform(1.0, 5.0))
        finally:
            for one in here:
                one.close()


class Listener(Worker):
    """One client that takes every record, and counts those that it never got."""

    def __init__(self, endpoint: str, rig: str) -> None:
        super().__init__("listener")
        self._endpoint, self._rig = endpoint, rig
        self.received = self.lost = 0

    def work(self) -> None:
        """See `Worker`."""
        try:
            with Client(self._endpoint, self._rig) as client:
                stream = client.blocks()
                while self.going:
                    for _ in stream.arrived():
                        pass
                    self.wait(0.02)
                self.received += stream.count.received
                self.lost += stream.count.lost
        except NoDaemonError:
            self.wait(0.2)


class PageReader(Worker):
    """A browser's web socket to the page, opened again whenever it ends."""

    def __init__(self, address: str) -> None:
        super().__init__("page")
        self._address = address
        self.frames = self.opened = 0

    def work(self) -> None:
        """See `Worker`."""
        try:
            with open_socket(f"ws://{self._address}/stream", origin=Origin(f"http://{self._address}")) as stream:
                self.opened += 1
                while self.going:
                    stream.recv(timeout=10.0)
                    self.frames += 1
        except (OSError, TimeoutError, WebSocketException):
            self.wait(0.5)


class Onlooker(Worker):
    """The page in a real browser, left open; its memory is what its own scripts use, after a collection."""

    def __init__(self, address: str) -> None:
        super().__init__("browser")
        self._address = address
        self.there = pathlib.Path(pages.CHROMIUM).exists()
        self.draws = 0
        self.open_s = 0.0
        self.memory: list[tuple[float, float]] = []  # time.monotonic() and MiB
        self.errors: Counter[str] = Counter()

    def work(self) -> None:
        """See `Worker`."""
        if not self.there:
            self.wait(1.0)
            return
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)  # the browser inherits it
        with pages.browser() as chromium:
            seen = pages.look(chromium, f"http://{self._address}/")
            scripts = seen.page.context.new_cdp_session(seen.page)
            opened, measured = time.monotonic(), 0.0
            while self.going:
                seen.page.wait_for_timeout(500)
                if (now := time.monotonic()) - measured >= MEASURE_S:
                    measured = now
                    scripts.send("HeapProfiler.collectGarbage")
                    self.memory.append((now, scripts.send("Runtime.getHeapUsage")["usedSize"] / 2**20))
                    self.draws = max(self.draws, seen.run("window.rigctl ? rigctl.draws : 0"))
                self.open_s = now - opened
            self.errors.update(error for error in seen.errors if not re.search(_KILLED, error))


@contextlib.contextmanager
def filled(disk: pathlib.Path) -> Iterator[None]:
    """Not a byte free on a small disk within the block."""
    filler = disk / "filler"
    try:
        with filler.open("wb", buffering=0) as out, contextlib.suppress(OSError):
            while True:
                out.write(bytes(1 << 16))
        yield
    finally:
        filler.unlink(missing_ok=True)


@contextlib.contextmanager
def small_disk(folder: pathlib.Path, mib: int, run: Callable[..., Any]) -> Iterator[pathlib.Path | None]:
    """A tmpfs of this size, mounted by root; None for another user, whose disk is not filled."""
    if os.geteuid() != 0:
        yield None
        return
    folder.mkdir(exist_ok=True)
    mounted = run(["mount", "-t", "tmpfs", "-o", f"size={mib}m", "tmpfs", str(folder)], check=False)
    if mounted.returncode:
        raise OSError(errno.EPERM, "a small disk cannot be mounted", str(folder))
    try:
        yield folder
    finally:
        run(["umount", "-l", str(folder)], check=False)
