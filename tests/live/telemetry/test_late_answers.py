"""A daemon that is slow at the start: every client that waits for a daemon waits for its first answers, too."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator

import pytest

from rigctl.client import connect
from rigctl.client.connection import ASK_S
from rigctl.page.picture import Picture
from rigctl.page.rig_reader import RigReader
from tests.builders.foxglove_client import FoxgloveClient
from tests.builders.late_link import LateLink, late_link
from tests.builders.miniature import Daemon, free_port
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

LATE_S = ASK_S + 1.0
QUERIES = ("meta/schema", "cfg/active", "event/**?", "tele/state?", "tele/fast?")


@pytest.fixture
def late(own: Daemon) -> Iterator[LateLink]:
    """The first query of each kind is answered after the client has given it up."""
    own.client().close()
    with late_link(own.endpoint, QUERIES, LATE_S) as found:
        yield found


@contextlib.contextmanager
def command(daemon: Daemon, link: LateLink, *words: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "rigctl", *words], cwd=ROOT, env=daemon.environment(RIGCTL_CONNECT=link.endpoint),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    assert process.stderr is not None
    line = process.stdout.readline()
    assert line, process.stderr.read()
    return line


def ended(process: subprocess.Popen[str]) -> None:
    """End the command as a service manager does."""
    process.terminate()
    _, said = process.communicate(timeout=patience_s())
    assert process.returncode == 0, said
    assert "Traceback" not in said


def test_prometheus_gets_its_metrics(own: Daemon, late: LateLink) -> None:
    with command(own, late, "bridge", "prometheus", "--listen", "127.0.0.1:0") as bridge:
        line = first_line(bridge)
        found = re.search(r"http://\S+", line)
        assert found, line

        def up() -> bool:
            with urllib.request.urlopen(found[0], timeout=patience_s()) as page:
                return b"\nrigctl_up 1.0\n" in page.read()

        until(up, "a state")
        assert not {"meta/schema", "cfg/active"} & late.unasked
        ended(bridge)


def test_foxglove_gets_every_channel(own: Daemon, late: LateLink) -> None:
    with command(own, late, "bridge", "foxglove", "--listen", "127.0.0.1:0") as bridge:
        found = re.match(r"foxglove: ws://127\.0\.0\.1:(\d+), ", first_line(bridge))
        assert found
        with FoxgloveClient(int(found[1])) as client:
            client.send(op="getParameters", parameterNames=["rig"], id="first")
            assert client.told("parameterValues")["parameters"], "no client is served before the settings are known"
            client.subscribe("/records", 1)
            client.subscribe("/state", 2)
            assert {client.message()[0] for _ in range(200)} == {1, 2}
        assert not {"meta/schema", "cfg/active"} & late.unasked
        ended(bridge)


@pytest.mark.parametrize("to", ["prometheus", "foxglove"])
def test_a_bridge_without_a_daemon_waits_and_ends_with_a_signal(to: str) -> None:
    nowhere = f"tcp/127.0.0.1:{free_port()}"
    command_line = [sys.executable, "-m", "rigctl", "bridge", to, "--listen", "127.0.0.1:0", "--connect", nowhere]
    bridge = subprocess.Popen(command_line, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    try:
        assert bridge.stderr is not None
        assert bridge.stderr.readline().endswith("waiting for one, Ctrl-C ends\n")
        ended(bridge)
    finally:
        bridge.kill()


def test_prometheus_ends_in_one_line_where_the_next_daemon_is_of_an_unknown_version(own: Daemon) -> None:
    own.client().close()
    with (
        late_link(own.endpoint, (), 0.0) as link,
        command(own, link, "bridge", "prometheus", "--listen", "127.0.0.1:0") as bridge,
    ):
        first_line(bridge)
        for process in own.processes:
            process.kill()
            process.wait()
        own.spawn("-m", "tests.builders.another_version", str(own.runtime.directory), "99")
        _, said = bridge.communicate(timeout=patience_s() * 2)
    assert bridge.returncode == 1
    assert said == "rigctl: found schema version 99, this client knows 2: use that daemon's own client\n"


def test_watch_prints_states(own: Daemon, late: LateLink) -> None:
    with command(own, late, "watch", "--json") as watch:
        assert json.loads(first_line(watch))["rig"] == "paper_rig"
        until(lambda: "cfg/active" not in late.unasked and first_line(watch), "a state after the late answer")
        ended(watch)


def test_the_page_shows_settings_events_and_charts(late: LateLink) -> None:
    picture, stop = Picture(late.endpoint), threading.Event()
    reader = RigReader(picture, None, stop)
    reader.start()
    try:
        until(lambda: picture.settings and picture.events and picture.history.newest_ns, "settings, events and charts")
        assert not picture.is_silent
    finally:
        stop.set()
        reader.join(patience_s())


def test_a_program_that_waits_for_a_daemon_is_connected(late: LateLink) -> None:
    with connect(late.endpoint, timeout_s=patience_s()) as rig:
        assert rig.state()["rig"] == "paper_rig"
    assert "meta/schema" not in late.unasked
