"""``python -m tests.bench.subscriber``: one subscriber of the fast stream, its losses and the age of its records.

``--plain``: a Zenoh callback without our client. Prints ``{"ready": true}`` with the first block, restarts its figures
on SIGUSR1, and prints them on SIGTERM.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import signal
import sys
import threading
import time
from typing import Any

import numpy as np
import numpy.typing as npt
import zenoh

from rigctl.client import connect

BIN_US, BINS = 100, 20_000  # ages up to 2 s


class Ages:
    """Histogram of each record's age when it was handed over."""

    def __init__(self) -> None:
        self.bins = np.zeros(BINS, np.int64)

    def add(self, t_ns: npt.NDArray[np.int64]) -> None:
        age = (time.monotonic_ns() - t_ns) // (1000 * BIN_US)
        self.bins += np.bincount(np.clip(age, 0, BINS - 1), minlength=BINS)

    def sparse(self) -> dict[str, int]:
        return {str(number): int(self.bins[number]) for number in np.flatnonzero(self.bins)}


def _say(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _client(endpoint: str, stop: threading.Event, again: threading.Event) -> dict[str, Any]:
    ages, ready = Ages(), False
    with connect(endpoint, timeout_s=60.0) as rig, rig.fast() as samples:
        before = dataclasses.asdict(samples.count)
        while not stop.is_set():
            block = samples.read(0.1)
            if block is None:
                continue
            ages.add(block["t_ns"])
            if not ready:
                ready = True
                _say({"ready": True})
            if again.is_set():
                again.clear()
                ages, before = Ages(), dataclasses.asdict(samples.count)
        now = dataclasses.asdict(samples.count)
    return {"count": {name: now[name] - before[name] for name in ("received", "lost", "recovered", "repeated")},
            "ages": ages.sparse()}  # fmt: skip


class Plain:
    """Counts in Zenoh's own callback."""

    def __init__(self, schema: dict[str, Any], again: threading.Event) -> None:
        record, self._start = schema["fast"]["record"], schema["fast"]["header"]["size"]
        offsets = {field["name"]: field["offset"] for field in record["fields"]}
        self._layout = np.dtype(
            {"names": ["seq", "t_ns"], "formats": ["<u8", "<i8"], "offsets": [offsets["seq"], offsets["t_ns"]],
             "itemsize": record["size"]}
        )  # fmt: skip
        self._again, self._last = again, 0
        self._begin()

    def _begin(self) -> None:
        self.ages, self.received, self.lost = Ages(), 0, 0

    def take(self, sample: zenoh.Sample) -> None:
        found = np.frombuffer(bytes(sample.payload), self._layout, offset=self._start)
        if self._again.is_set():
            self._again.clear()
            self._begin()
        if not self._last:
            _say({"ready": True})
        else:
            self.lost += int(found["seq"][0]) - self._last - 1
        self._last = int(found["seq"][-1])
        self.received += len(found)
        self.ages.add(found["t_ns"])


def _plain(endpoint: str, stop: threading.Event, again: threading.Event) -> dict[str, Any]:
    with connect(endpoint, timeout_s=60.0) as rig:  # for the session and the schema; the rest uses Zenoh
        plain = Plain(rig.schema(), again)
        subscriber = rig.connection.session.declare_subscriber(rig.connection.keys.fast, plain.take)
        stop.wait()
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    count = {"received": plain.received, "lost": plain.lost, "recovered": 0, "repeated": 0}
    return {"count": count, "ages": plain.ages.sparse()}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.subscriber", description=__doc__)
    parser.add_argument("endpoint")
    parser.add_argument("--plain", action="store_true")
    arguments = parser.parse_args()
    stop, again = threading.Event(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGUSR1, lambda *_: again.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _say((_plain if arguments.plain else _client)(arguments.endpoint, stop, again))
    return 0


if __name__ == "__main__":
    sys.exit(main())
