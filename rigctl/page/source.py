"""The page's Zenoh client: keeps a picture up to date, also across restarts or without a daemon."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

import numpy.typing as npt
import zenoh

from rigctl.client import decoding
from rigctl.client.connection import ChoiceError, Client, NoDaemonError
from rigctl.client.decoding import Layout, SchemaError
from rigctl.client.fast import FastReader
from rigctl.client.ordering import block as block_of
from rigctl.page.picture import EVENTS_HELD, Picture
from rigctl.page.signals import FIELDS
from rigctl.wire.block import Block

PERIOD_S = 0.033
RETRY_S = 0.5
_LAST = 200  # an answer with fewer records ends with the newest
GIVE_UP_S = 6.0  # without data: Zenoh reconnects by itself, but another daemon may have taken the endpoint


_NEEDED = {"t_ns", "skipped", "lateness_ns"} | FIELDS


def layout_of(schema: dict[str, Any]) -> Layout:
    """Layout of a record by ``meta/schema``, because the daemon may be older or newer than this page.

    Raises:
        SchemaError: the schema cannot be used, or lacks a field that the charts show.
    """
    layout = decoding.layout_of(schema)
    for name in sorted(_NEEDED):
        if name not in layout.fields or layout.dtype[name].kind not in "iuf":
            raise SchemaError(f"meta/schema cannot be used: found no number {name}, expected the records of a rig")
    return layout


class Connection:
    """One client and its subscriptions."""

    def __init__(self, client: Client, picture: Picture) -> None:
        self.client, self._picture = client, picture
        self._states = client.follow(client.keys.state)
        self._events = client.follow(client.keys.event("*"), EVENTS_HELD)
        self._reader = FastReader(client)
        self._layout = layout_of(client.schema())
        self._stream = self._last_seq = 0
        self._offset_ns: int | None = None
        self._gateway = 0
        self._take_history()

    def _take_history(self) -> None:
        """Read the records that the daemon's ring holds, so that the charts begin before the page's start."""
        self._look_at_clock()
        last = 0
        while True:
            answered, payload = self.client.ask(f"{self.client.keys.fast}?after={last}", check=block_of)
            block = block_of(payload) if answered else None
            if block is None or not block.count:
                return
            self._add(block)
            if block.count < _LAST:
                return
            last = block.last_seq

    def _look_at_clock(self) -> None:
        state = self.client.state()
        if "t_ns" in state:
            self._offset_ns = int(state["wall_ns"]) - int(state["t_ns"])

    def take(self) -> None:
        """Take all data that arrived since the last call."""
        state = self._states.newest()
        for block in self._reader.read():
            self._add(block)
        if state is not None:
            if state.get("gateway_wall_ns", 0) != self._gateway:
                self._catch_up(int(state.get("gateway_wall_ns", 0)))
            self._picture.take_state(state)
        events = []
        while (event := self._events.take()) is not None:
            events.append(event)
        if events:
            self._picture.add_events(events)
        self._picture.refused = self.client.refusals.words
        self._picture.samples_lost = self._reader.count.lost

    def _add(self, block: Block) -> None:
        if block.stream != self._stream or self._offset_ns is None:  # the daemon was restarted
            self._look_at_clock()
            self._stream, self._last_seq = block.stream, 0
        new = block.part(max(block.first_seq, self._last_seq + 1), block.last_seq)
        if not new.count or self._offset_ns is None:
            return
        if new.record_size != self._layout.dtype.itemsize:
            raise SchemaError("the daemon was replaced by one with another schema")
        records: npt.NDArray[Any] = self._layout.decode(new)
        self._picture.add_records(records, self._offset_ns)
        self._last_seq = new.last_seq

    def _catch_up(self, gateway: int) -> None:
        """Read active configuration and past events from a gateway that has just started."""
        self._picture.take_active(self.client.active())
        self._picture.add_events(self.client.past_events(), anew=True)
        self._gateway = gateway


class Source(threading.Thread):
    """Connects, follows, and connects again until ``stop``."""

    def __init__(self, picture: Picture, rig: str | None, stop: threading.Event) -> None:
        super().__init__(name="source", daemon=True)
        self._picture, self._rig, self._ended = picture, rig, stop

    def run(self) -> None:
        """Connect and follow until ``stop``; the page shows why a connection ended."""
        while not self._ended.is_set():
            try:
                with Client(self._picture.endpoint, self._rig) as client:
                    self._follow(Connection(client, self._picture))
            except (NoDaemonError, ChoiceError, SchemaError, zenoh.ZError) as error:
                self._picture.trouble = str(error).splitlines()[0]
            self._ended.wait(RETRY_S)

    def _follow(self, connection: Connection) -> None:
        started = time.monotonic()
        while not self._ended.is_set():
            with contextlib.suppress(NoDaemonError):  # the gateway is away; the next turn repeats the query
                connection.take()
            if min(self._picture.silent_s, time.monotonic() - started) > GIVE_UP_S:
                raise NoDaemonError(f"no data from {self._picture.endpoint}")
            self._picture.trouble = f"no data from {self._picture.endpoint}"
            self._ended.wait(PERIOD_S)
