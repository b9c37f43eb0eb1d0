"""The page's Zenoh client: keeps a picture up to date, also across restarts or without a daemon."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

import numpy as np
import zenoh

from rigctl.client.connection import ChoiceError, Client, NoDaemonError
from rigctl.client.decoding import SchemaError
from rigctl.client.rig_view import RigFollower
from rigctl.page.chart_signals import FIELDS
from rigctl.page.picture import Picture

PERIOD_S = 0.033
RETRY_S = 0.5
GIVE_UP_S = 6.0  # without data: Zenoh reconnects by itself, but another daemon may have taken the endpoint
_NEEDED = {"t_ns", "skipped", "lateness_ns"} | FIELDS


def check_charted(record: np.dtype[Any]) -> None:
    """Check that a record has what the charts show, because the daemon may be older or newer than this page.

    Raises:
        SchemaError: it lacks a field.
    """
    for name in sorted(_NEEDED):
        if name not in (record.names or ()) or record[name].kind not in "iuf":
            raise SchemaError(f"meta/schema cannot be used: found no number {name}, expected the records of a rig")


class ChartRecords:
    """Every record for the charts, from the oldest that the daemon's ring holds."""

    def __init__(self, client: Client, picture: Picture) -> None:
        self._client, self._picture = client, picture
        self._samples = client.samples(past=True)
        self._record: np.dtype[Any] | None = None
        self._streams = 0
        self._wall_offset_ns: int | None = None

    def update(self) -> None:
        """Take all records that arrived.

        Raises:
            SchemaError: they are not those of a rig.
            NoDaemonError: no answer.
        """
        for records in self._samples.arrived():
            if records.dtype != self._record:
                check_charted(records.dtype)
                self._record = records.dtype
            if self._samples.count.streams != self._streams or self._wall_offset_ns is None:
                self._read_clock()  # the daemon was restarted
                self._streams = self._samples.count.streams
            if self._wall_offset_ns is not None:
                self._picture.add_records(records, self._wall_offset_ns)
        self._picture.samples_lost = self._samples.count.lost

    def _read_clock(self) -> None:
        state = self._client.state()
        if "t_ns" in state:
            self._wall_offset_ns = int(state["wall_ns"]) - int(state["t_ns"])


class RigReader(threading.Thread):
    """Connects, follows, and connects again until ``stop``."""

    def __init__(self, picture: Picture, rig: str | None, stop: threading.Event) -> None:
        super().__init__(name="rig reader", daemon=True)
        self._picture, self._rig, self._ended = picture, rig, stop

    def run(self) -> None:
        """Connect and follow until ``stop``; the page shows why a connection ended."""
        while not self._ended.is_set():
            try:
                with Client(self._picture.endpoint, self._rig) as client:
                    self._follow(RigFollower(client, self._picture), ChartRecords(client, self._picture))
            except (NoDaemonError, ChoiceError, SchemaError, zenoh.ZError) as error:
                self._picture.trouble = str(error).splitlines()[0]
            self._ended.wait(RETRY_S)

    def _follow(self, follower: RigFollower, charts: ChartRecords) -> None:
        started = time.monotonic()
        while not self._ended.is_set():
            follower.update()
            with contextlib.suppress(NoDaemonError):  # the gateway is away; the next turn repeats the query
                charts.update()
            if min(self._picture.silent_s, time.monotonic() - started) > GIVE_UP_S:
                raise NoDaemonError(f"no data from {self._picture.endpoint}")
            self._picture.trouble = f"no data from {self._picture.endpoint}"
            self._ended.wait(PERIOD_S)
