"""A peer publishes and answers invalid data on the rig's keys: `rigctl watch` and programs still show the real rig.

The router here refuses nothing: what a client that cannot verify anything has to take.
"""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from tests.builders.hostile import NOT_JSON, Hostile, blocks, hostile, schemas, wronged
from tests.builders.miniature import Daemon, running
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    for found in running(lets_all=True):
        found.client().close()
        yield found


def send_everything(intruder: Hostile, daemon: Daemon) -> int:
    """Send every kind of message on every key; returns their number."""
    keys = intruder.keys
    with daemon.client() as client:
        state, schema = client.state(), client.schema()
        stream = state["stream"]
        size = schema["fast"]["record"]["size"]
        past = client.past_events()
    kinds = [*NOT_JSON.values(), *(msgspec.json.encode(wrong) for _, wrong in list(wronged(state))[::40])]
    kinds += [msgspec.json.encode(wrong) for _, wrong in wronged(past[-1])] if past else []
    for payload in kinds:
        for key in (keys.state, keys.active, keys.schema, *map(keys.event, ("info", "error")), keys.fast):
            intruder.put(key, payload)
        time.sleep(0.002)
    for payload in blocks(size, stream).values():
        intruder.put(keys.fast, payload)
    return len(kinds)


def answers(daemon: Daemon) -> list[bytes]:
    with daemon.client() as client:
        return [*NOT_JSON.values(), *schemas(client.schema()).values()]


class Watch:
    """`rigctl watch`, on a terminal or not."""

    def __init__(self, daemon: Daemon, *, terminal: bool) -> None:
        self._read, write = pty.openpty() if terminal else os.pipe()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rigctl.cli.app", "watch"], cwd=ROOT, stdout=write, stderr=subprocess.PIPE,
            env=daemon.environment(TERM="xterm", COLUMNS="100", LINES="40"),
        )  # fmt: skip
        os.close(write)
        self.said = b""

    def hears(self, *words: bytes) -> bool:
        """Whether one of these words is printed from now on."""
        self.said, end = b"", time.monotonic() + patience_s()
        while time.monotonic() < end and not all(word in self.said for word in words):
            if select.select([self._read], [], [], 0.1)[0]:
                self.said += os.read(self._read, 65536)
            if self.process.poll() is not None:
                return False
        return all(word in self.said for word in words)

    def close(self) -> bytes:
        if self._read >= 0:
            self.process.terminate()
            os.close(self._read)
            self._read, self._error = -1, self.process.communicate(timeout=patience_s())[1]
        return self._error


@pytest.mark.parametrize("terminal", [False, True])
def test_watch_goes_on_showing_the_rig(daemon: Daemon, terminal: bool) -> None:
    watch, real = Watch(daemon, terminal=terminal), b"lateness" if terminal else b"late p99"
    try:
        assert watch.hears(real), (watch.said, watch.close())
        with hostile(daemon.endpoint, "paper_rig") as intruder:
            sent = send_everything(intruder, daemon)
            assert sent >= 14
            assert watch.hears(b"messages refused"), watch.close()
            assert b"owned" not in watch.said.replace(rb"\x1b]0;owned", b"")
            assert b"\x1b]0;" not in watch.said
        assert watch.hears(real)
    finally:
        error = watch.close()
    assert b"Traceback" not in error


def test_a_client_goes_on_hearing_the_rig(daemon: Daemon) -> None:
    with daemon.rig() as rig, hostile(daemon.endpoint, "paper_rig") as intruder:
        fast, states, events = rig.fast(), rig.states(), rig.events(past=True)
        assert fast.read(patience_s()) is not None
        send_everything(intruder, daemon)
        until(lambda: fast.read(patience_s()) is not None and rig.refused > 20, "refusals")
        end = time.monotonic_ns()
        last = seq = 0
        while last < end:
            found = fast.read(patience_s())
            assert found is not None
            assert not last or int(found["seq"][0]) == seq + 1
            last, seq = int(found["t_ns"][-1]), int(found["seq"][-1])
        until(lambda: (state := states.read(patience_s())) is not None and state["t_ns"] > end, "a state of now")
        assert events.read(patience_s()) is not None
        assert fast.count.lost == 0


def test_an_answer_that_is_none_is_passed_over(daemon: Daemon) -> None:
    wrong: list[Any] = answers(daemon)
    with hostile(daemon.endpoint, "paper_rig") as intruder:
        keys = intruder.keys
        for key in (keys.state, keys.schema, keys.active, keys.events_past, keys.fast, keys.command("hold")):
            intruder.answer(key, wrong)
        intruder.appear("\x1b[2J")
        intruder.appear("Not_A_Rig")
        with daemon.rig() as rig:
            assert rig.name == "paper_rig"
            assert rig.state()["rig"] == "paper_rig"
            assert rig.config()["settings"]["rig"] == "paper_rig"
            assert len(rig.fields) > 50
            assert isinstance(rig.connection.past_events(), list)
            assert "verb" in rig.command("hold", operator="kim")
        for command in ("status", "hold"):
            done = daemon.cli(command, "--rig", "paper_rig")
            assert "Traceback" not in done.stderr
            assert "paper_rig" in done.stdout or "HOLD" in done.stdout + done.stderr
            assert "\x1b" not in done.stdout + done.stderr
