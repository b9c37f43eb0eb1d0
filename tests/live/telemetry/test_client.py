"""The public client against real gateways: samples with units, states, events, commands, settings, presence."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import rigctl.client
from rigctl.ipc.ledger import IN_FORCE, Standing
from rigctl.ipc.record import RECORD
from tests.builders.miniature import Daemon
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until


def test_samples_come_complete_as_arrays_with_units(shared: Daemon) -> None:
    with shared.rig() as rig, rig.fast() as samples:
        assert rig.name == "paper_rig"
        assert {name: field.unit for name, field in rig.fields.items()} == {
            "seq": "",
            **{field.name: field.unit for field in RECORD.fields},
        }
        assert all(field.description for field in rig.fields.values())
        blocks = []
        for block in samples:
            blocks.append(block)
            if sum(map(len, blocks)) >= 2000:
                break
        count = samples.count
    whole = np.concatenate(blocks)
    assert whole.dtype.names == tuple(rig.fields)
    assert np.array_equal(whole["tick"], np.arange(whole["tick"][0], whole["tick"][0] + len(whole)))
    assert np.all(np.diff(whole["t_ns"]) == 1_000_000)
    assert np.all(whole["target_n"] == 300.0)
    assert (count.received, count.lost, count.streams) == (len(whole), 0, 1)


def test_state_config_and_schema_are_answered_and_followed(shared: Daemon) -> None:
    with shared.rig() as rig, rig.states() as states:
        ticks = [state["tick"] for state in (states.read(patience_s()) for _ in range(10)) if state is not None]
        assert len(ticks) == 10
        assert ticks == sorted(ticks)  # a loop without a processor for 20 ms gives two states of one tick
        assert ticks[-1] > ticks[0]
        assert rig.state()["tick"] >= ticks[-1]
        assert rig.config()["settings"]["rig"] == "paper_rig"
        assert rig.schema()["fast"]["record"]["size"] == RECORD.dtype.itemsize


def test_what_happens_after_a_command_is_not_missed_by_a_late_wait(own: Daemon) -> None:
    with own.rig() as rig:
        answer = rig.command("arm", operator="kim")
        assert answer["accepted"]
        time.sleep(0.3)  # the event is long past
        event = rig.wait_event(kind="MODE", timeout_s=patience_s())
        assert event is not None
        assert event["text"] == "DISARMED -> HOLD: drive enabled"
        rig.command("target", 222.0, operator="kim")  # the stand-in trips
        trip = rig.wait_event(severity="error", where=lambda e: e["value"] > 400, timeout_s=patience_s())
        assert trip is not None
        assert (trip["kind"], trip["limit"]) == ("TRIP", 400.0)
        assert rig.wait_event(kind="TRIP", timeout_s=0.2) is None  # each event is examined once
        assert rig.command("reset", operator="kim")["accepted"]
        assert rig.wait_event(kind="TRIP", timeout_s=0.2) is None  # older than the command
        with rig.events(past=True) as events:
            texts = [event["kind"] for event in iter(lambda: events.read(0.5), None) if event["source"] == "loop"]
        assert texts == ["STARTED", "MODE", "TRIP", "MODE", "MODE", "RESET"]


def test_one_lease_is_shown_by_two_connections(own: Daemon) -> None:
    with own.rig() as rig, own.rig() as other:
        lease = rig.take_lease("kim")["lease"]["id"]
        refused = other.command("arm", operator="kim")
        assert (refused["accepted"], refused["reason"]) == (False, "lease_held")
        assert other.command("arm", operator="kim", lease=lease)["accepted"]
        assert rig.return_lease("kim")["accepted"]
        until(lambda: rig.state()["lease"] is None, "nobody to hold it")


def test_events_of_a_time_without_gateway_are_published_later(own: Daemon) -> None:
    """While the gateway is away; the very first event after connecting is among those not published to this client."""
    with own.remote_rig() as rig, rig.events() as events:
        assert events.read(0.2) is None  # sets the client's position in the sequences
        own.kill_gateway()
        until(lambda: not rig.alive, "the token to go")
        with own.replaced_gateway() as other:  # publishes to another listener, then ends
            other.command("arm", operator="kim")
            other.command("disarm", operator="kim")
            assert other.wait_event(kind="MODE", timeout_s=patience_s())
            assert not rig.alive
        own.start_gateway()
        assert rig.wait_alive(patience_s())
        with own.rig() as commanding:
            commanding.take_lease("lee", "kim is gone")
            assert commanding.command("target", 222.0, operator="lee")["accepted"]
        seen = []
        while "TRIP" not in seen:
            event = events.read(patience_s())
            assert event is not None
            if event["source"] == "loop":
                seen.append(event["kind"])
    assert seen == ["MODE", "MODE", "TRIP"]


def test_liveliness_follows_the_gateway(own: Daemon) -> None:
    with own.rig() as rig:
        until(lambda: rig.alive, "the token")
        own.kill_gateway()
        until(lambda: not rig.alive, "the token to go")
        assert not rig.wait_alive(0.1)
        own.start_gateway()
        assert rig.wait_alive(patience_s())
        assert rig.state()["loop_alive"]


def test_connecting_waits_for_a_daemon_that_is_not_there_yet(own: Daemon) -> None:
    own.rig().close()
    own.kill_gateway()
    with pytest.raises(rigctl.client.NoDaemonError, match="no daemon answers at"):
        rigctl.client.connect(own.endpoint)
    threading.Timer(0.5, own.start_gateway).start()
    with rigctl.client.connect(own.endpoint, timeout_s=patience_s()) as rig:
        assert rig.name == "paper_rig"


def test_the_active_configuration_is_published_when_it_changes(own: Daemon) -> None:
    with own.rig() as rig, rig.configs() as configs:
        before = own.runtime.read_json("active.json")
        gains = {"k_tension": 1.5, "k_speed": 0.1, "k_integral": 1.0}
        own.runtime.write_json("active.json", {**before, "design": {**before["design"], "gains": gains}})
        changed = until(lambda: (c := configs.read(1.0)) and "gains" in c["design"] and c, "other gains")
        assert changed["design"]["gains"] == gains
        assert rig.config() == changed
        own.runtime.write_json(IN_FORCE, Standing(zero_n=0.25, scale=1.001))
        changed = until(lambda: (c := configs.read(1.0)) and c["calibration"] and c, "another calibration")
        assert (changed["calibration"]["zero_n"], changed["calibration"]["scale"]) == (0.25, 1.001)
        assert rig.config() == changed
        assert configs.read(1.2) is None  # and at no other time


def test_closing_ends_an_iteration_in_another_thread(shared: Daemon) -> None:
    rig = shared.rig()
    blocks: list[int] = []
    samples, events = rig.fast(), rig.events()
    threads = [threading.Thread(target=lambda: blocks.extend(len(block) for block in samples))]
    threads.append(threading.Thread(target=lambda: list(events)))
    for thread in threads:
        thread.start()
    until(lambda: blocks, "a block")
    rig.close()
    for thread in threads:
        thread.join(patience_s())
        assert not thread.is_alive()


def test_a_newer_daemon_with_more_fields_is_read() -> None:
    daemon = Daemon()
    try:
        daemon.spawn("-m", "tests.builders.another_version", str(daemon.runtime.directory))
        with daemon.rig() as rig, rig.fast() as samples:
            assert rig.fields["gusts_mm_s"].unit == "mm/s"
            assert "tag" not in rig.fields  # of an unknown type
            block = samples.read(patience_s())
            assert block is not None
            assert np.all(block["tension_n"] == 300.0)
            assert np.array_equal(block["gusts_mm_s"], block["tick"] / 2)
    finally:
        daemon.close()


def test_a_daemon_replaced_by_a_newer_one_is_read_on(own: Daemon) -> None:
    with own.rig() as rig, rig.fast() as samples:
        first = samples.read(patience_s())
        assert first is not None
        assert "gusts_mm_s" not in (first.dtype.names or ())
        for process in own.processes:
            process.kill()
            process.wait()
        own.spawn("-m", "tests.builders.another_version", str(own.runtime.directory))

        def newer() -> bool:
            block = samples.read(0.5)
            return block is not None and "gusts_mm_s" in (block.dtype.names or ())

        until(newer, "samples of the other version")
        assert samples.count.streams == 2


def test_an_unknown_schema_version_is_refused_in_one_line() -> None:
    daemon = Daemon()
    try:
        daemon.spawn("-m", "tests.builders.another_version", str(daemon.runtime.directory), "99")
        daemon.client().close()
        with pytest.raises(rigctl.client.SchemaError) as refused:
            rigctl.client.connect(daemon.endpoint)
    finally:
        daemon.close()
    assert str(refused.value) == "found schema version 99, this client knows 2: use that daemon's own client"


def test_importing_it_brings_nothing_heavy() -> None:
    code = "import sys; from rigctl.client import connect; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"numpy", "zenoh", "msgspec"} <= loaded
    heavy = {
        "scipy",
        "control",
        "matplotlib",
        "pydantic",
        "yaml",
        "can",
        "canopen",
        "cantools",
        "mcap",
        "rich",
        "typer",
    }
    assert not loaded & (heavy | {"filterpy", "numba", "starlette", "google", "pyarrow"})


def test_whatever_is_in_a_state_or_a_configuration_is_in_the_schema(shared: Daemon) -> None:
    with shared.rig() as rig:
        schema, state, config = rig.schema(), rig.state(), rig.config()
    fields = {row["name"]: row["json"] for row in schema["state"]["fields"]}
    assert set(state) == set(fields)
    kinds: dict[str, type | tuple[type, ...]] = {
        "number": (int, float),
        "integer": int,
        "string": str,
        "boolean": bool,
        "array": list,
        "object": dict,
    }
    for name, value in state.items():
        kind = fields[name]
        assert (value is None and kind.endswith("?")) or isinstance(value, kinds[kind.rstrip("?")]), name
    assert set(config) <= {row["name"] for row in schema["active"]["fields"]}
    assert schema["liveliness"]["key"] == "rigctl/paper_rig/live/daemon"
