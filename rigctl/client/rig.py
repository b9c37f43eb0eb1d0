"""The public face of a rig: samples, states, events, commands. Every call blocks; see `rigctl.client.rig_async`."""

from __future__ import annotations

import contextlib
import pathlib
import time
from collections.abc import Callable, Mapping
from typing import Self

from rigctl.client.block_order import DEPTH_BLOCKS
from rigctl.client.connection import Client, NoDaemonError
from rigctl.client.decoding import SampleField, layout_of
from rigctl.client.liveliness import Liveliness
from rigctl.client.samples import Samples
from rigctl.client.shapes import Message
from rigctl.client.stream import AGAIN_S, Stream


class Rig:
    """Connection to one rig's daemon; it reconnects by itself after a restart of the gateway. See `connect`."""

    def __init__(self, connection: Client) -> None:
        """Take over an open connection.

        Raises:
            SchemaError: the daemon serves a schema this client does not know.
            NoDaemonError: no answer.
        """
        self.connection = connection
        self._layout = layout_of(connection.schema())
        self._liveliness = Liveliness(connection.session, connection.keys.daemon)
        self.new_events = connection.events()
        """Events since the last command given here, or since connecting; for `wait_event`."""

    @property
    def name(self) -> str:
        """Name of the rig."""
        return self.connection.rig

    @property
    def fields(self) -> Mapping[str, SampleField]:
        """Fields of a sample by name: ``rig.fields["tension_n"].unit`` is ``"N"``."""
        return self._layout.fields

    # -- data -----------------------------------------------------------------------------------------------
    def state(self) -> Message:
        """The newest state.

        Raises:
            NoDaemonError: no answer.
        """
        return self.connection.state()

    def config(self) -> Message:
        """The active configuration: settings, design with gains, calibration, versions, devices. Raises as `state`."""
        return self.connection.active()

    def schema(self) -> Message:
        """The schema of all messages, as served at ``meta/schema``. Raises as `state`."""
        return self.connection.schema()

    def fast(self, depth: int = DEPTH_BLOCKS) -> Samples:
        """Every tick from now on; ``depth``: blocks (50 a second) that may wait before the oldest are dropped."""
        return self.connection.samples(self._layout, depth=depth)

    def states(self) -> Stream[Message]:
        """States from now on, 50 a second; a slow reader misses the oldest."""
        return self.connection.follow(self.connection.keys.state)

    def configs(self) -> Stream[Message]:
        """Active configurations from now on, one at every change."""
        return self.connection.follow(self.connection.keys.active)

    def events(self, *, past: bool = False) -> Stream[Message]:
        """Events from now on, or from the oldest held (``past``); each once, also across a restart."""
        return self.connection.events(past=past)

    def wait_event(
        self,
        kind: str | None = None,
        severity: str | None = None,
        where: Callable[[Message], bool] | None = None,
        timeout_s: float | None = None,
    ) -> Message | None:
        """The first event of this kind, severity and condition; None after ``timeout_s``.

        Each event is considered once, from the last command given here (or the connection) on, so that an event between
        a command and this call is not missed.
        """
        until = None if timeout_s is None else time.monotonic() + timeout_s
        left_s = timeout_s
        while (event := self.new_events.read(left_s)) is not None:
            if fits(event, kind, severity, where):
                return event
            left_s = None if until is None else max(0.0, until - time.monotonic())
        return None

    # -- liveliness -----------------------------------------------------------------------------------------
    @property
    def refused(self) -> int:
        """Messages refused so far because they did not have the shape of a daemon's."""
        return self.connection.refusals.count

    @property
    def alive(self) -> bool:
        """Whether the daemon's gateway is alive; ``state()["loop_alive"]`` is about its loop."""
        return self._liveliness.alive

    def wait_alive(self, timeout_s: float | None = None) -> bool:
        """Wait for the daemon; returns whether it is alive within ``timeout_s``."""
        return self._liveliness.wait(True, timeout_s)

    # -- commands -------------------------------------------------------------------------------------------
    def command(
        self, verb: str, value: float | None = None, *, operator: str, lease: str | None = None, **options: bool | str
    ) -> Message:
        """Give a command; ``accepted``, ``reason`` and ``text`` of the answer say what happened.

        It is given under ``lease``, else under the lease of an earlier answer; without one the lease is taken if
        nobody holds it. The operator is the person in a certificate, else this user with the name given before his.
        ``value`` and ``options``: see ``schema()["commands"]``.

        Raises:
            NoDaemonError: no answer; whether the command was carried out is unknown.
        """
        self.new_events.restart()
        if lease is not None:
            self.connection.leases[self.connection.operator(operator)] = lease
        return self.connection.command(verb, operator, value, **options)

    def take_lease(self, operator: str, reason: str = "") -> Message:
        """Take or renew the lease, from another only with a ``reason``. The answer's ``lease`` has its ``id``."""
        return self.connection.take_lease(operator, reason)

    def return_lease(self, operator: str) -> Message:
        """Give the lease back."""
        return self.connection.return_lease(operator)

    def close(self) -> None:
        """End every stream and the session."""
        self._liveliness.close()
        self.connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def fits(
    event: Message, kind: str | None, severity: str | None, where: Callable[[Message], bool] | None = None
) -> bool:
    """Whether an event is of a kind and severity, and meets a condition; None stands for any."""
    return (
        kind in (None, event.get("kind")) and severity in (None, event.get("severity")) and (not where or where(event))
    )


def connect(
    endpoint: str | None = None,
    rig: str | None = None,
    *,
    timeout_s: float = 0.0,
    credentials: pathlib.Path | str | None = None,
) -> Rig:
    """Connect to a rig's daemon.

    ``endpoint``: e.g. ``tcp/192.168.1.10:7447``, else ``RIGCTL_CONNECT``, else this computer's. ``rig``: its name, else
    ``RIGCTL_RIG``, else the only one. ``timeout_s``: how long to wait for a daemon that does not run or answer yet.
    ``credentials``: key file from ``rigctl keys``, else ``RIGCTL_KEY``, for an endpoint ``tls/HOST:PORT``.

    Raises:
        NoDaemonError: no daemon answers, or access is not allowed.
        ChoiceError: endpoint, name or key file is not valid, or several rigs answer and none is chosen.
        SchemaError: the daemon has a schema version this client does not know.
    """
    until = time.monotonic() + timeout_s
    while True:
        try:
            return _connected(endpoint, rig, credentials)
        except NoDaemonError:
            if time.monotonic() >= until:
                raise
        time.sleep(AGAIN_S)


def _connected(endpoint: str | None, rig: str | None, credentials: pathlib.Path | str | None) -> Rig:
    with contextlib.ExitStack() as opened:
        found = Rig(opened.enter_context(Client(endpoint, rig, key=credentials)))
        opened.pop_all()  # the rig closes it
    return found
