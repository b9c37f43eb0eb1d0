"""Subscribers that stop or are too slow, each in a process of its own: the healthy ones are not affected."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from rigctl.ipc.record import RECORD
from rigctl.ipc.ring import RingReader
from tests.builders.miniature import Daemon, stop
from tests.builders.waiting import patience_s, until

HEALTHY = 3
_SLOW = """
import json, sys, time
from rigctl.client import connect
endpoint, depth, pause = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
with connect(endpoint) as rig, rig.fast(depth) as samples:
    numbers = []
    end = None
    while end is None or len(numbers) < end:
        block = samples.read(40.0)
        numbers += block["seq"].tolist()
        if len(numbers) == len(block):
            print("ready", flush=True)
        if end is None and numbers[-1] - numbers[0] > 4000:
            end, pause = len(numbers) + 1, 0.0
        time.sleep(pause)
    gaps = [b - a - 1 for a, b in zip(numbers, numbers[1:])]
    count = samples.count
    print(json.dumps({"received": count.received, "lost": count.lost, "recovered": count.recovered,
                      "missing": sum(gaps), "ordered": min(gaps) >= 0, "read": len(numbers),
                      "span": numbers[-1] - numbers[0] + 1}))
"""


@pytest.fixture
def silent() -> Iterator[Daemon]:
    """Rings without a loop."""
    daemon = Daemon()
    yield daemon
    daemon.close()


@contextlib.contextmanager
def filling(daemon: Daemon) -> Iterator[RingReader]:
    """Write empty records at 5 kHz."""
    stop, writer, nothing = threading.Event(), daemon.runtime.records.writer(), [0] * len(RECORD.fields)

    def write() -> None:
        while not stop.wait(0.01):
            for _ in range(50):
                writer.write(*nothing)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield daemon.runtime.records.reader()
    finally:
        stop.set()
        thread.join()


def counters(daemon: Daemon, number: int) -> list[subprocess.Popen[str]]:
    processes = [daemon.spawn("-m", "rigctl.client.counter", "--connect", daemon.endpoint) for _ in range(number)]
    for process in processes:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["ready"] is True
    return processes


def figures_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=patience_s())
    return dict(json.loads(out.splitlines()[-1]))


def nothing_missing(figures: dict[str, Any]) -> bool:
    return bool(figures["received"] == figures["produced"] == figures["last_seq"] - figures["first_seq"] + 1)


def test_one_that_is_stopped_costs_the_others_no_sample_and_itself_none_the_ring_holds(own: Daemon) -> None:
    own.rig().close()
    stalled, *healthy = counters(own, HEALTHY + 1)
    stop(stalled)
    start = own.runtime.records.reader().head
    until(lambda: own.runtime.records.reader().head > start + 8000, "eight seconds: more than any queue takes")
    figures = [figures_of(process) for process in healthy]
    stalled.send_signal(signal.SIGCONT)
    its = figures_of(stalled)
    for one in figures:
        assert nothing_missing(one)
        assert (one["lost"], one["recovered"]) == (0, 0)  # by publication alone, without a query
        assert one["last_seq"] > start + 7900
    assert its["lost"] == 0
    assert nothing_missing(its)
    assert its["last_seq"] > start + 8000


def test_one_stopped_for_longer_than_the_ring_holds_counts_just_what_is_gone(silent: Daemon) -> None:
    """At five times the usual rate, records fill the ring, and every queue on the way, sooner."""
    with filling(silent) as records:
        silent.start_gateway()
        silent.rig().close()
        stalled, healthy = counters(silent, 2)
        held = silent.settings.loop.rate_hz * silent.settings.telemetry.history_s
        stop(stalled)
        start = records.head
        until(lambda: records.head > start + 3 * held, "the ring to be written over, and TCP's buffers")
        assert figures_of(healthy)["lost"] == 0
        stalled.send_signal(signal.SIGCONT)
        its = figures_of(stalled)
    assert its["lost"] > 0
    assert its["received"] + its["lost"] == its["produced"] == its["last_seq"] - its["first_seq"] + 1
    assert its["last_seq"] > start + 3 * held
    assert its["recovered"] > 0  # what the ring still held when it asked


def test_a_slow_one_gets_everything_from_the_ring_and_the_others_all_they_want(own: Daemon) -> None:
    """Ten blocks may wait, and the subscriber reads one in 60 ms, a third of the rate."""
    own.rig().close()
    healthy = counters(own, HEALTHY)
    slow = own.spawn("-c", _SLOW, own.endpoint, "10", "0.06")
    assert slow.stdout is not None
    assert slow.stdout.readline() == "ready\n"
    its = json.loads(slow.stdout.readline())
    assert its["ordered"]
    assert (its["missing"], its["lost"]) == (0, 0)
    assert its["read"] == its["span"] <= its["received"]
    assert its["recovered"] > 1000
    for process in healthy:
        figures = figures_of(process)
        assert nothing_missing(figures)
        assert (figures["lost"], figures["recovered"]) == (0, 0)


def test_clients_of_all_kinds_come_back_by_themselves_after_a_restart(own: Daemon) -> None:
    """Counters, a slow one and one that is stopped while the gateway is away lose no sample that the ring held."""
    own.rig().close()
    stopped, *others = counters(own, HEALTHY)
    slow = own.spawn("-c", _SLOW, own.endpoint, "50", "0.03")
    assert slow.stdout is not None
    slow.stdout.readline()
    stop(stopped)
    for _ in range(2):
        own.kill_gateway()
        time.sleep(0.5)
        own.start_gateway()
        own.rig().close()
        time.sleep(1.0)
    stopped.send_signal(signal.SIGCONT)
    its = json.loads(slow.stdout.readline())
    assert (its["missing"], its["lost"]) == (0, 0)
    for process in (stopped, *others):
        figures = figures_of(process)
        assert nothing_missing(figures)
        assert (figures["lost"], figures["streams"]) == (0, 1)
        assert figures["produced"] > 2000
