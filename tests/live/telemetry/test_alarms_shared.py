"""Alarms of a real gateway: what one terminal decides, every other sees, also after the gateway was killed."""

from __future__ import annotations

import json

from rigctl.wire.alarms import AlarmAct, Alarms
from tests.builders.miniature import Daemon
from tests.builders.operators import ANNA, KIM
from tests.builders.stand_in import TRIP_N


def test_a_session_with_an_alarm(own: Daemon) -> None:
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
