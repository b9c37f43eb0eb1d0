"""The gateway's publications and replies, over real sessions between processes."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time

import msgspec
import numpy as np
import pytest
import zenoh

from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import Runtime
from rigctl.wire.session import close, open_client
from tests.builders.miniature import DESIGN, Daemon, free_port
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until


@pytest.mark.smoke
def test_fast_stream_is_in_order_and_its_losses_are_counted(shared: Daemon) -> None:
    with shared.client() as client:
        reader = client.blocks(recover=False)  # the publications alone, which a busy host may drop
        ticks: list[int] = []

        def enough() -> bool:
            for block in reader.arrived():
                ticks.extend(np.frombuffer(block.data, RECORD.dtype)["tick"].tolist())
            return len(ticks) >= 4000

        until(enough, "4000 records")
        count = reader.count
    assert all(np.diff(ticks) > 0)
    assert (count.repeated, count.malformed, count.streams) == (0, 0, 1)
    assert count.received == len(ticks)
    assert count.received + count.lost == count.last_seq - count.first_seq + 1


def test_fast_stream_is_decoded_by_the_schema_alone(shared: Daemon) -> None:
    """A plain Zenoh client with nothing of this package but the keys and the JSON schema."""
    shared.client().close()
    session = open_client(shared.endpoint)
    try:
        (reply,) = session.get("rigctl/paper_rig/meta/schema")
        assert reply.ok is not None
        schema = msgspec.json.decode(bytes(reply.ok.payload))
        blocks = session.declare_subscriber("rigctl/paper_rig/tele/fast", zenoh.handlers.RingChannel(100))
        payload = bytes(until(blocks.try_recv, "a block").payload)
        (state,) = session.get("rigctl/paper_rig/tele/state")
        assert state.ok is not None
        newest = msgspec.json.decode(bytes(state.ok.payload))
    finally:
        close(session)

    header = schema["fast"]["header"]
    names = [field["name"] for field in header["fields"]]
    head = dict(zip(names, struct.unpack_from(header["struct"], payload), strict=True))
    fields = schema["fast"]["record"]["fields"]
    dtype = np.dtype(
        {
            "names": [field["name"] for field in fields],
            "formats": [field["type"] for field in fields],
            "offsets": [field["offset"] for field in fields],
            "itemsize": head["record_size"],
        }
    )
    records = np.frombuffer(payload, dtype, head["count"], head["header_size"])
    assert head["magic"] == b"RGF1"
    assert records["seq"].tolist() == list(range(head["first_seq"], head["first_seq"] + head["count"]))
    assert np.all(np.diff(records["t_ns"]) == 1_000_000)
    assert np.all(records["target_n"] == newest["target_n"])
    units = {field["name"]: field["unit"] for field in fields}
    assert units["tension_n"] == "N"
    assert units["stroke_mm"] == "mm"
    assert schema["enums"]["modes"]["COMPENSATING"] == 3


def test_state_follows_the_loop(shared: Daemon) -> None:
    with shared.client() as client:
        feed = client.follow(client.keys.state)
        first = until(feed.take, "a state")
        later = until(lambda: (s := feed.take()) and s["tick"] > first["tick"] + 500 and s, "half a second")
        assert client.state()["tick"] >= later["tick"]
    assert later["rig"] == "paper_rig"
    assert later["loop_alive"] is True
    assert later["mode"] == "DISARMED"
    assert later["error_n"] is None
    assert later["error_pct"] is None
    assert later["normal_rad"] is None  # NaN
    assert later["quality"] == {"tension": "good", "inclination": "stale", "drive": "good"}
    assert later["lateness_us"].keys() == {"p50", "p99", "p999", "max"}
    assert later["warnings"] == ["SCHED_FIFO 80 refused: not permitted"]
    assert later["samples_lost"] == 0
    assert abs(later["wall_ns"] - time.time_ns()) < 60e9


def test_active_configuration_is_answered(shared: Daemon) -> None:
    with shared.client() as client:
        active = client.active()
    assert active["settings"]["rig"] == "paper_rig"
    assert active["design"] == DESIGN
    assert active["control"]["warnings"]


def test_liveliness_names_the_rig(shared: Daemon) -> None:
    with shared.client() as client:
        replies = client.session.liveliness().get("rigctl/*/live/daemon", timeout=5)
        found = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    assert found == ["rigctl/paper_rig/live/daemon"]


@pytest.mark.parametrize("after", ["-1", "x", "1e9", "99999999999999999999"])
def test_nonsense_history_is_refused(shared: Daemon, after: str) -> None:
    with shared.client() as client:
        answered, payload = client.ask(f"{client.keys.fast}?after={after}")
    assert not answered
    assert b"expected a sequence number" in payload


def test_stopped_loop_shows_as_not_alive(own: Daemon) -> None:
    with own.client() as client:
        assert client.state()["loop_alive"]
        own.processes[0].send_signal(signal.SIGSTOP)
        state = until(lambda: (s := client.state()) and not s["loop_alive"] and s, "the loop to be missed")
        assert state["age_ms"] > 200
        own.processes[0].send_signal(signal.SIGCONT)
        until(lambda: client.state()["loop_alive"], "the loop to be back")


def test_sigterm_ends_it_and_sigint_does_not(own: Daemon) -> None:
    own.client().close()
    assert own.gateway is not None
    own.gateway.send_signal(signal.SIGINT)
    with own.client() as client:
        assert client.state()["loop_alive"]
    own.gateway.terminate()
    assert own.gateway.wait(patience_s()) == 0


def test_it_ends_with_its_parent() -> None:
    daemon = Daemon()
    try:
        daemon.start_loop()
        parent = "import subprocess, sys; p = subprocess.Popen(sys.argv[1:]); print(p.pid, flush=True); p.wait()"
        gateway = [sys.executable, "-m", "rigctl.gateway.gateway_process", str(daemon.runtime.directory)]
        process = daemon.spawn("-c", parent, *gateway)
        daemon.client().close()
        process.kill()
        session = open_client(daemon.endpoint)
        close(session)
    except RuntimeError:
        pass  # gone already
    else:
        until(lambda: not daemon._reachable(), "the gateway to end")
    finally:
        daemon.close()


@pytest.mark.parametrize("which", ["no such host", "another daemon's"])
def test_endpoint_it_cannot_have_is_one_line(which: str) -> None:
    daemon = Daemon()
    try:
        listen, why = "tcp/nosuchhost.invalid:7447", "cannot listen on tcp/nosuchhost.invalid:7447: "
        with contextlib.ExitStack() as stack:
            if which != "no such host":
                taken = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
                port = taken.getsockname()[1]
                listen, why = f"tcp/127.0.0.1:{port}", "in use: the daemon of other_rig has it; give one of them"
                folder = tempfile.TemporaryDirectory(prefix="rigctl-test-", dir="/dev/shm")
                other = Runtime(stack.enter_context(folder))
                other.write_json("public.json", {"rig": "other_rig", "listen": f"tcp/localhost:{port}"})
                other.place("lock").write_text(str(os.getpid()))
            settings = daemon.settings.model_dump(mode="json")
            settings["telemetry"] |= {"listen": listen, "listen_waiver": "a name that does not exist"}
            daemon.runtime.write_json("active.json", {"settings": settings})
            result = run_gateway(str(daemon.runtime.directory))
    finally:
        daemon.close()
    assert result.returncode == 1
    assert why in result.stderr
    assert result.stderr.count("\n") == 1


def run_gateway(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rigctl.gateway.gateway_process", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience_s(), check=False)


def test_folder_without_a_daemon_is_one_line() -> None:
    folder = f"/dev/shm/rigctl-none-{free_port()}"
    result = run_gateway(folder)
    assert result.returncode == 1
    assert result.stderr == f"gateway: {folder} cannot be entered: No such file or directory\n"
    assert run_gateway().returncode == 2
