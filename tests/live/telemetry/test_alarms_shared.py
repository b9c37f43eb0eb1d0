"""Alarms of a real gateway: what one terminal decides, every other sees, also after the gateway was killed."""

from __future__ import annotations

import json
import time

import pytest

from rigctl.cli import completion
from rigctl.ipc.notes import Note
from rigctl.wire.alarms import AlarmAct, Alarms
from tests.builders.miniature import Daemon
from tests.builders.operators import ANNA, KIM
from tests.builders.stand_in import TRIP_N
from tests.builders.waiting import until


def test_a_session_with_an_alarm(own: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    own.client().close()
    assert own.cli("alarms").stdout == "no alarms\n"
    for verb in (("arm",), ("target", str(TRIP_N))):
        own.cli(*verb)
    result = own.cli("alarms")
    assert result.returncode == 0  # the stand-in's trip is a moment's: nothing stands
    head, words, remedy = result.stdout.splitlines()
    cause = head.split()[1]
    assert "not acknowledged" in head
    assert "N above 400.0 N" in words
    assert remedy.strip().startswith("-> ")
    result = own.cli("status", "--all")
    for label in ("does now", "blocks reset", "next step", "entry", "alarm"):
        assert any(line.startswith(label) for line in result.stdout.splitlines()), label
    monkeypatch.setenv("RIGCTL_CONNECT", own.endpoint)
    assert completion.causes(cause[:2]) == [cause]
    assert completion.causes("NONE") == []
    assert own.cli("alarms", "acknowledge", "NONE").returncode == 2
    assert own.cli("alarms", "shelve", cause).returncode == 2
    with own.client() as client:
        answer = client.decide_alarm(AlarmAct.SHELVE, "anna", cause, "tea", 600)
        assert answer["accepted"]
        assert client.state()["lease"]["holder"] != ANNA  # a decision takes no lease
    own.kill_gateway()
    own.start_gateway()
    with own.client() as client:
        own.answers(client)
        state = client.state()
        (row,) = Alarms(client.past_events()).rows(state, state["wall_ns"])
    assert (row.cause, row.acknowledged) == (cause, "")
    assert row.shelf is not None
    assert (row.shelf.operator, row.shelf.reason) == (ANNA, "tea")
    (told,) = json.loads(own.cli("alarms", "--json").stdout)
    assert told["shelved"]["operator"] == ANNA
    assert own.cli("alarms", "unshelve", cause).returncode == 0
    result = own.cli("alarms", "acknowledge", cause, "--operator", "kim")
    assert (result.returncode, result.stdout) == (0, f"{KIM} acknowledges the alarm {cause}\n")
    assert f"(latched, acknowledged by {KIM})" in own.cli("alarms").stdout  # until the reset
    assert own.cli("reset").returncode == 0
    assert own.cli("alarms").stdout == "no alarms\n"


def test_all_open_alarms_are_acknowledged_at_once_each_on_record(own: Daemon) -> None:
    own.client().close()
    done = own.cli("alarms", "acknowledge", "--all")
    assert (done.returncode, done.stdout) == (0, "every alarm is acknowledged\n")
    for verb in (("arm",), ("target", str(TRIP_N))):
        own.cli(*verb)
    own.kill_gateway()  # whose ring it is; the port is free again for the next one, so that the alarm is cleared
    own.runtime.notes.writer().write(time.monotonic_ns(), int(Note.ENDPOINT_TAKEN), b"", own.endpoint.encode(), b"")
    own.start_gateway()
    own.client().close()
    rows = until(lambda: len(found := json.loads(own.cli("alarms", "--json").stdout)) == 2 and found, "two alarms")
    assert own.cli("alarms", "shelve", rows[1]["cause"], "--reason", "tea", "--for", "9").returncode == 0
    done = own.cli("alarms", "acknowledge", "--all", "--operator", "kim")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [f"{KIM} acknowledges the alarm {row['cause']}" for row in rows]
    (latched,) = json.loads(own.cli("alarms", "--json").stdout)  # the other one is closed, being cleared
    assert (latched["cause"], latched["latched"], latched["acknowledged"]) == (rows[0]["cause"], True, KIM)
    with own.client() as client:
        noted = [event for event in client.past_events() if event["kind"] == "ALARM_ACKNOWLEDGED"]
    assert [(event["other"], event["operator"]) for event in noted] == [(row["cause"], KIM) for row in rows]
    done = own.cli("alarms", "acknowledge", "--all", "--json")
    assert (done.returncode, json.loads(done.stdout)) == (0, [])


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("acknowledge",), "found no cause, expected acknowledge CAUSE or acknowledge --all"),
        (("acknowledge", "E_STOP", "--all"), "found the cause 'E_STOP' and --all, expected one of them"),
        (("shelve", "--all"), "found --all, expected acknowledge with it, not shelve"),
        (("--all",), "found --all, expected acknowledge with it, not show"),
    ],
)
def test_which_alarms_is_said_one_way(shared: Daemon, words: tuple[str, ...], line: str) -> None:
    done = shared.cli("alarms", *words)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"rigctl: {line}\n")
