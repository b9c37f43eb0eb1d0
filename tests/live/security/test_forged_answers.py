"""A local user answers the operator's queries, publishes, and shows tokens on the rig's keys: the router takes none."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import pytest

import rigctl.client
from rigctl.client.connection import Client, NoDaemonError
from rigctl.wire.keys import Keys
from rigctl.wire.session import SessionError, close, open_client
from tests.builders.intruder import FORGED, Intruder
from tests.builders.miniature import Daemon
from tests.builders.refusals import Refused
from tests.builders.waiting import patience_s, until


@pytest.mark.parametrize("verb", ["hold", "release"])
def test_a_forged_answer_is_not_printed_and_the_rigs_own_is(own: Daemon, verb: str) -> None:
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig", "answers") as intruder:
        Refused(own).line("declare queryable of rigctl/")
        operator = "kim" if verb == "hold" else "anna"
        if verb == "release":
            anna.return_lease("anna")
        done = own.cli(verb, "--operator", operator)
        assert FORGED not in done.stdout + done.stderr
        assert (done.returncode, done.stderr) == (0, "")
        goal = {"hold": ("HOLD",), "release": ("RELEASING", "HOLD")}[verb]
        assert own.state(anna)["mode"] in goal
        assert not intruder.was_asked


def test_an_answer_that_comes_alone_does_not_come(own: Daemon) -> None:
    """He answers on ``cmd/**``; here a key on which the daemon does not answer."""
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig", "answers") as intruder:
        with pytest.raises(NoDaemonError):
            anna.ask(anna.keys.command("hold") + "/now", b"{}", 1.0)
        assert not intruder.was_asked


def test_forged_and_repeated_messages_are_not_shown(own: Daemon) -> None:
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig", "publishes", "replays"):
        states, events = anna.follow(anna.keys.state), anna.events()
        Refused(own).line("put of rigctl/")
        newest = 0
        for _ in range(100):
            state = states.read(patience_s())
            assert state is not None
            assert state["mode"] in ("TENSIONING", "COMPENSATING")
            assert state["t_ns"] >= newest
            newest = state["t_ns"]
        assert anna.command("hold", "kim")["accepted"]
        while (event := events.read(2.0)) is not None:
            assert event["text"] != "forged"
        assert anna.refusals.count == 0


def test_tokens_of_other_rigs_do_not_hide_this_one(own: Daemon) -> None:
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig", "tokens", "answers"):
        Refused(own).line("liveliness token of rigctl/")
        assert rigctl.client.rigs(own.endpoint) == ["paper_rig"]
        done = own.cli("hold", "--operator", "kim")
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("HOLD: stroke held at")
        assert FORGED not in done.stdout
        assert own.state(anna)["mode"] == "HOLD"


def test_the_token_of_another_own_rig_does_not_hide_this_one(own: Daemon) -> None:
    """He shows the token of a rig that this user runs too, at another endpoint, and answers for it."""
    other = Daemon("other_rig")
    try:
        other.start_loop()
        other.start_gateway()
        other.client().close()
        with own.compensating(), Intruder(own.endpoint, "other_rig", "token=other_rig", "answers"):
            done = own.cli("hold", "--operator", "kim")
            assert (done.returncode, done.stderr) == (0, "")
            assert done.stdout.startswith("HOLD: stroke held at")
    finally:
        other.close()


def test_what_he_publishes_and_answers_is_on_record_in_one_line_of_a_kind(own: Daemon) -> None:
    with own.compensating() as anna:
        refused = Refused(own)
        assert refused.read() == []  # nothing that the daemon and its clients do
        with (
            Intruder(own.endpoint, "paper_rig", "publishes"),
            Intruder(own.endpoint, "paper_rig", "answers", "token=paper_rig"),
        ):
            lines = [refused.line(words) for words in ("put of", "declare queryable of", "liveliness token of")]
            states = anna.follow(anna.keys.state)
            for _ in range(20):
                assert states.read(patience_s()) is not None
        for line in lines:
            assert "rigctl/" in line
            assert " by an unknown client (no certificate, tcp/127.0.0.1:" in line
            assert line.endswith(") refused: not allowed")
        assert len(refused.read()) <= 6  # thousands of messages, one line of a kind now and one for the rest


def test_what_is_put_from_the_clients_side_of_a_restart_is_not_foreign(own: Daemon) -> None:
    with own.compensating():
        own.kill_gateway()
        own.start_gateway()
        own.client().close()
        assert own.cli("status").stdout.startswith("rig")
        assert Refused(own).read() == []


def test_who_takes_the_port_while_the_gateway_is_started_anew_gets_nothing(own: Daemon) -> None:
    """He has the daemon's port with a router of his own, its token, states and answers; then the gateway is back."""
    with own.compensating() as anna:
        states = anna.follow(anna.keys.state)
        with Intruder(own.endpoint, "paper_rig", "takes_port") as intruder:
            own.kill_gateway()
            intruder.wait("port")
            stranger = open_client(own.endpoint)  # believes him, as every plain Zenoh program

            def forged() -> bool:
                return any(
                    reply.ok is not None and b'"RELEASING"' in bytes(reply.ok.payload)
                    for reply in stranger.get(anna.keys.state, payload=b"stranger", timeout=patience_s())
                )

            until(forged, "his answer")
            with pytest.raises(NoDaemonError):
                anna.command("release", "anna")
            with pytest.raises(NoDaemonError):
                Client(own.endpoint, "paper_rig")
            done = own.cli("release", "--operator", "anna")
            assert (done.returncode, done.stdout) == (1, "")
            assert done.stderr == f"rigctl: no daemon answers at {own.endpoint} (absent, or not allowed)\n"
            done = own.cli("status")
            assert (done.returncode, done.stderr) == (1, "")
            assert "gateway    it has ended: nothing is published" in done.stdout
            assert "RELEASING" not in done.stdout
            asked = [one for one in intruder.seen if bytes.fromhex(one.get("payload", "")) != b"stranger"]
            assert [one["what"] for one in asked] == ["port"]  # no query of ours
            close(stranger)
        own.start_gateway()
        own.answers(anna)
        for _ in range(20):
            state = states.read(patience_s())
            assert state is not None
            assert state["mode"] in ("TENSIONING", "COMPENSATING")
            assert state["tension_n"] > 1.0 or state["mode"] == "TENSIONING"
        answer: dict[str, Any] = {}

        def commanded() -> bool:
            with contextlib.suppress(NoDaemonError):
                answer.update(anna.command("target", "anna", 290.0))
            return bool(answer)

        until(commanded, "an answer")
        assert answer["accepted"]  # her lease has outlived it
        assert anna.refusals.count == 0


def test_who_keeps_the_port_stops_nobody_on_this_computer(own: Daemon) -> None:
    """The gateway is started anew without it, the next one too, and one has it again when he has gone."""

    def noted(client: Client) -> list[str]:
        return [event["kind"] for event in client.past_events() if event["kind"].startswith("ENDPOINT_")]

    with own.compensating() as anna:
        states = anna.follow(anna.keys.state)
        with Intruder(own.endpoint, "paper_rig", "takes_port") as intruder:
            own.kill_gateway()
            intruder.wait("port")
            for _ in range(2):
                own.start_gateway()
                own.answers(anna)
                until(lambda: noted(anna) == ["ENDPOINT_TAKEN"])
                assert anna.command("target", "anna", 290.0)["accepted"]
                list(states.arrived())
                assert until(states.take)["mode"] in ("TENSIONING", "COMPENSATING")
                assert "ENDPOINT_TAKEN" in own.cli("alarms").stdout
                assert own.gateway is not None
                own.gateway.terminate()
                assert own.gateway.wait(patience_s()) == 0
        own.start_gateway()
        own.answers(anna)
        until(lambda: noted(anna) == ["ENDPOINT_TAKEN", "ENDPOINT_BACK"])
        (row,) = json.loads(own.cli("alarms", "--json").stdout)
        assert (row["cause"], row["stands"]) == ("ENDPOINT_TAKEN", False)
        assert until(lambda: reads(own))


def reads(daemon: Daemon) -> bool:
    """Whether a plain Zenoh program gets the daemon's state at its port."""
    with contextlib.suppress(SessionError):
        session = open_client(daemon.endpoint)
        replies = list(session.get(Keys("paper_rig").state, timeout=patience_s()))
        close(session)
        return [reply.ok is not None and b'"loop_alive"' in bytes(reply.ok.payload) for reply in replies] == [True]
    return False


def test_the_port_is_the_routers_again_as_soon_as_it_is_free(own: Daemon) -> None:
    with own.compensating() as anna:
        with Intruder(own.endpoint, "paper_rig", "takes_port") as intruder:
            own.kill_gateway()
            intruder.wait("port")
            own.start_gateway()
            own.answers(anna)
        assert until(lambda: reads(own))


def test_a_first_gateway_goes_on_without_a_port_that_another_program_has(own: Daemon) -> None:
    """It is on record at once; the router has the port as soon as it is free."""
    with own.compensating() as anna:
        with Intruder(own.endpoint, "paper_rig", "takes_port") as intruder:
            own.kill_gateway()
            intruder.wait("port")
            active = own.runtime.read_json("active.json")
            own.runtime.write_json("active.json", {**active, "run_id": "another"})
            own.start_gateway()
            own.answers(anna)
            assert [one["kind"] for one in anna.past_events() if one["kind"].startswith("ENDPOINT")] == [
                "ENDPOINT_TAKEN"
            ]
        until(lambda: reads(own))
