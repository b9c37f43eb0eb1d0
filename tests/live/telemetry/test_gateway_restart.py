"""The gateway is killed and comes back: no listener loses data."""

from __future__ import annotations

import json
import os
import signal
import time

import pytest
import zenoh

from rigctl.client.connection import ASK_S, NoDaemonError
from rigctl.control.modes import command_slot
from rigctl.ipc.record import RECORD
from rigctl.model.verbs import Verb
from rigctl.wire.block import decode
from tests.builders.miniature import Daemon
from tests.builders.waiting import patience_s, until


def test_a_reading_query_waits_for_the_gateway_that_starts_anew(own: Daemon) -> None:
    """Without a link Zenoh ends a query at once."""
    with own.client() as client:
        assert client.state()["loop_alive"]
        own.kill_gateway()
        before = time.monotonic()
        with pytest.raises(NoDaemonError):
            client.state()
        assert time.monotonic() - before >= ASK_S
        own.start_gateway()
        own.answers(client)


def test_killed_gateway_costs_no_sample_and_no_event(own: Daemon) -> None:
    with own.client() as client:
        fast = client.blocks()
        plain = client.session.declare_subscriber(client.keys.fast, zenoh.handlers.RingChannel(4096))
        events = client.follow(client.keys.event("*"), 1000)
        # Long enough that the gateway has recorded its listeners.
        until(lambda: list(fast.arrived()) and fast.count.blocks > 10, "the stream")
        for _ in range(3):
            own.kill_gateway()
            time.sleep(0.5)
            list(fast.arrived())  # blocks still on their way
            own.start_gateway()
            until(lambda: list(fast.arrived()), "the stream to go on")
            until(lambda: client.state()["loop_alive"], "the gateway to answer")
            # A gateway killed right after these may not have published them; the next one does.
            for verb in ("arm", "disarm"):
                assert (answer := client.command(verb, "kim"))["accepted"], answer
        head = client.state()["seq"]
        until(lambda: list(fast.arrived()) and fast.count.last_seq >= head, "the last records")
        count = fast.count
        sequence: list[int] = []

        def six_events() -> bool:
            while (event := events.take()) is not None:
                if event["source"] == "loop":
                    sequence.append(event["seq"])
            return len(set(sequence)) >= 6  # killed between publishing and recording it: published again

        until(six_events, "two events each time")
        numbers: list[int] = []
        while (sample := plain.try_recv()) is not None:
            block = decode(bytes(sample.payload))
            numbers += range(block.first_seq, block.last_seq + 1)
    assert count.lost == 0
    assert count.received == count.produced == count.last_seq - count.first_seq + 1
    assert count.streams == 1  # the same daemon throughout
    assert sorted(set(sequence)) == list(range(min(sequence), max(sequence) + 1))
    # Even without queries: the new gateway goes on where the killed one stopped, once its listener is back.
    assert len(set(numbers)) >= 0.9 * (numbers[-1] - numbers[0] + 1)


def test_events_made_while_no_gateway_runs_come_with_the_next(own: Daemon) -> None:
    with own.client() as client:
        events = client.follow(client.keys.event("*"))
        client.command("arm", "kim")
        first = until(lambda: (e := events.take()) and e["source"] == "loop" and e, "an event: it knows that we listen")
        own.kill_gateway()
        disarm = command_slot(time.monotonic_ns(), 1, Verb.DISARM)
        own.runtime.commands.writer().write(*disarm)  # no other process writes now
        head = own.runtime.events.reader()
        until(lambda: head.head > first["seq"], "the event")
        own.start_gateway()
        disarmed = "HOLD -> DISARMED: disarm commanded"
        event = until(lambda: (e := events.take()) and e["text"] == disarmed and e, "the event")
    assert event["seq"] > first["seq"]


def test_records_overwritten_before_they_were_published_are_counted() -> None:
    daemon = Daemon()
    nothing = [0] * len(RECORD.fields)
    capacity = daemon.settings.loop.rate_hz * daemon.settings.telemetry.history_s
    try:
        writer = daemon.runtime.records.writer()
        for _ in range(100):
            writer.write(*nothing)
        daemon.start_gateway()
        with daemon.client() as client:
            fast = client.blocks()
            client.state()  # the gateway knows of the subscription before the record is written
            writer.write(*nothing)
            until(lambda: list(fast.arrived()), "the record")
            age_ms = client.state()["age_ms"]
            until(lambda: client.state()["age_ms"] != age_ms, "the gateway to note how far it has come")
            daemon.kill_gateway()
            for _ in range(capacity + 1000):
                writer.write(*nothing)
            daemon.start_gateway()
            until(lambda: list(fast.arrived()) and fast.count.last_seq == writer.head, "the newest record")
            lost = client.state()["samples_lost"]
            block = decode(client.ask(f"{client.keys.fast}?after=0")[1])
    finally:
        daemon.close()
    # Of the newest `capacity` slots one is being overwritten.
    assert lost == fast.count.lost == writer.head - 101 - (capacity - 1)
    assert fast.count.produced == writer.head - 100
    assert fast.count.received == fast.count.produced - lost
    assert block.first_seq == writer.head - capacity + 2


def test_counter_process_counts_everything(own: Daemon) -> None:
    own.client().close()
    counter = own.spawn("-m", "rigctl.client.counter", "--connect", own.endpoint)
    assert counter.stdout is not None
    assert json.loads(counter.stdout.readline())["ready"] is True
    own.kill_gateway()
    own.start_gateway()
    own.client().close()
    head = own.runtime.records.reader().head
    counter.send_signal(signal.SIGTERM)
    figures = json.loads(counter.stdout.readline())
    assert counter.wait(patience_s()) == 0
    assert figures["received"] == figures["produced"] == figures["last_seq"] - figures["first_seq"] + 1
    assert figures["last_seq"] >= head
    assert figures["lost"] == 0


def test_counter_without_a_daemon_is_one_line(own: Daemon) -> None:
    import subprocess

    own.client().close()
    own.kill_gateway()
    counter = own.spawn("-m", "rigctl.client.counter", "--connect", own.endpoint, stderr=subprocess.PIPE)
    _, complaint = counter.communicate(timeout=patience_s())
    assert counter.returncode == 1
    assert complaint == f"no daemon answers at {own.endpoint} (absent, or not allowed)\n"


@pytest.mark.parametrize("damage", [b"\xff", b"[" * 100_000, b"", b"9" * 5000, None])
def test_a_gateway_comes_back_with_whatever_stands_in_the_place_of_its_files(own: Daemon, damage: bytes | None) -> None:
    with own.client() as client:
        assert client.command("arm", "kim")["accepted"]
    own.kill_gateway()
    for name in ("lease.json", "gateway.cursor", "calibration.json", "recorder.json", "control.json"):
        file = own.runtime.directory / name
        file.unlink(missing_ok=True)
        if damage is None:
            os.mkfifo(file)
        else:
            file.write_bytes(damage)
    own.start_gateway()
    with own.client() as client:
        assert own.state(client)["lease"] is None
        events = client.past_events()
        assert "lease.json holds no lease to be believed; nobody holds it" in [event["text"] for event in events]
        assert client.command("hold", "kim")["accepted"]
        assert own.gateway is not None
        assert own.gateway.poll() is None
