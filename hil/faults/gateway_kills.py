"""The gateway killed repeatedly in COMPENSATING: the loop must be unaffected, and no listener may lose a record."""

from __future__ import annotations

import signal
import time
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from hil.faults.rows.live_rows_rig import GATEWAY, Live, LiveError, give, live
from hil.scenario.play import Advance
from rigctl.client.connection import Client
from rigctl.client.samples import Blocks
from rigctl.config.settings import RigSettings
from rigctl.ipc.ring import RingReader
from rigctl.model import quantity
from rigctl.model.states import Mode

QUIET_S = 15.0
"""Time without kills, before and after: enough ticks for the 99.9th percentile."""
BETWEEN_S = 0.5
BACK_S = 30.0
CHANGE = 0.2
"""Share by which the lateness with kills may exceed that without ..."""
FLOOR_US = 5.0
"""... or this much, where that is small."""
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Figures:
    """Lateness in us; records by their sequence numbers."""

    kills: int
    quiet_p999_us: float
    killed_p999_us: float
    skipped: int
    records: int
    lost: int  # records that a listener never received
    left_compensating: bool

    @property
    def ok(self) -> bool:
        """Whether the loop was unaffected and no record is missing."""
        allowed = max((1.0 + CHANGE) * self.quiet_p999_us, self.quiet_p999_us + FLOOR_US)
        return self.killed_p999_us <= allowed and self.lost == 0 and not self.left_compensating

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {**asdict(self), "ok": self.ok}


class _Lateness:
    """Lateness of the loop's records."""

    def __init__(self, records: RingReader) -> None:
        self._records = records
        self._parts: list[Ints] = []
        self.left = False
        self.first_skipped = self.last_skipped = -1

    def follow(self) -> None:
        """Read the new records."""
        slots = self._records.read()
        if len(slots):
            self._parts.append(slots["lateness_ns"].astype(np.int64))
            self.left |= bool(np.any(slots["mode"] != Mode.COMPENSATING))
            self.last_skipped = int(slots["skipped"][-1])
            if self.first_skipped < 0:
                self.first_skipped = self.last_skipped

    def take(self) -> Ints:
        """Lateness since the last call, ns."""
        parts, self._parts = self._parts, []
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def play(settings: RigSettings, count: int, advance: Advance) -> Figures:
    """Kill the gateway ``count`` times.

    Raises:
        ScenarioError: rig and daemon do not come up, or the gateway does not come back (1).
    """
    with live(settings) as rig:
        rig.enter(Mode.COMPENSATING)
        time.sleep(1.0)
        with Client(rig.endpoint) as client:
            return _play(rig, client, count, advance)


def _play(rig: Live, client: Client, count: int, advance: Advance) -> Figures:
    stream = client.blocks()
    loop = _Lateness(rig.runtime.records.reader())
    _listen(stream, loop, QUIET_S)
    quiet = [loop.take()]
    for i in range(count):
        advance(1.0, f"gateway killed {quantity.count(i + 1, 'time')}")
        _kill(rig, stream, loop)
        _listen(stream, loop, BETWEEN_S)
    killed = loop.take()
    _listen(stream, loop, QUIET_S)
    quiet.append(loop.take())
    counted = stream.count
    return Figures(
        count,
        _p999_us(np.concatenate(quiet)),
        _p999_us(killed),
        loop.last_skipped - loop.first_skipped,
        counted.received,
        counted.lost,
        loop.left,
    )


def _kill(rig: Live, stream: Blocks, loop: _Lateness) -> None:
    """Kill the gateway and wait until the next one publishes."""
    give(rig.pid(GATEWAY), signal.SIGKILL)
    _listen(stream, loop, 0.1)
    blocks, until = stream.count.blocks, time.monotonic() + BACK_S
    while stream.count.blocks == blocks:
        if time.monotonic() > until:
            raise LiveError("the gateway does not come back")
        _listen(stream, loop, 0.1)


def _listen(stream: Blocks, loop: _Lateness, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        for _ in stream.arrived():
            pass
        loop.follow()
        time.sleep(0.02)


def _p999_us(lateness_ns: Ints) -> float:
    return float(np.percentile(lateness_ns, 99.9)) * 1e-3 if len(lateness_ns) else 0.0
