"""A local user answers the operator's queries, publishes, and shows tokens on the rig's keys: nobody believes him."""

from __future__ import annotations

import pytest

from rigctl.client.connection import Client, NoDaemonError
from rigctl.ipc.notes import note_message
from tests.builders.intruder import FORGED, Intruder
from tests.builders.miniature import PATIENCE_S, Daemon, until


def compensating(daemon: Daemon) -> Client:
    """A client of anna, who has tensioned the rig."""
    client = daemon.client()
    assert client.command("arm", "anna")["accepted"]
    assert client.command("tension", "anna")["accepted"]
    return client


@pytest.mark.parametrize("verb", ["hold", "release"])
def test_a_forged_answer_is_not_printed_and_the_rigs_own_is(own: Daemon, verb: str) -> None:
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig", "answers") as intruder:
        operator = "kim" if verb == "hold" else "anna"
        if verb == "release":
            anna.return_lease("anna")
        done = own.cli(verb, "--operator", operator)
        intruder.wait("query")  # he had the operator's command, and answered it
        assert FORGED not in done.stdout + done.stderr
        assert (done.returncode, done.stderr) == (0, "")
        goal = {"hold": ("HOLD",), "release": ("RELEASING", "HOLD")}[verb]
        assert own.state(anna)["mode"] in goal


def test_an_answer_that_comes_alone_is_not_believed(own: Daemon) -> None:
    """He answers on ``cmd/**``; here a key on which the daemon does not answer."""
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig", "answers"):
        with pytest.raises(NoDaemonError):
            anna.ask(anna.keys.command("hold") + "/now", b"{}", 1.0)
        assert "an answer that the daemon did not sign" in anna.refusals.words


def test_forged_and_repeated_messages_are_not_shown(own: Daemon) -> None:
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig", "publishes", "replays"):
        states, events = anna.follow(anna.keys.state), anna.events()
        until(lambda: anna.refusals.count > 300, "his messages")
        newest = 0
        for _ in range(100):
            state = states.read(PATIENCE_S)
            assert state is not None
            assert state["mode"] in ("TENSIONING", "COMPENSATING")
            assert state["t_ns"] >= newest
            newest = state["t_ns"]
        assert anna.command("hold", "kim")["accepted"]
        while (event := events.read(2.0)) is not None:
            assert event["text"] != "forged"


def test_tokens_of_other_rigs_do_not_hide_this_one(own: Daemon) -> None:
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig", "tokens", "answers"):
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
        with compensating(own), Intruder(own.endpoint, "other_rig", "token=other_rig", "answers"):
            done = own.cli("hold", "--operator", "kim")
            assert (done.returncode, done.stderr) == (0, "")
            assert done.stdout.startswith("HOLD: stroke held at")
    finally:
        other.close()


def on_record(daemon: Daemon) -> list[str]:
    """Texts of the gateway's notes about foreign messages, for the audit log."""
    notes = [note_message(note, 0)[1] for note in daemon.runtime.notes.reader(from_start=True).read()]
    return [note["text"] for note in notes if note["kind"] == "FOREIGN_MESSAGE"]


def test_what_he_publishes_and_answers_is_on_record_in_one_line_of_a_kind(own: Daemon) -> None:
    with compensating(own) as anna:
        assert on_record(own) == []  # nothing that the daemon and its clients do
        with (
            Intruder(own.endpoint, "paper_rig", "publishes"),
            Intruder(own.endpoint, "paper_rig", "answers"),
        ):
            until(lambda: len(on_record(own)) >= 5, "the notes")
            states = anna.follow(anna.keys.state)
            until(lambda: states.read(0.1) and anna.refusals.count > 300, "his messages")
        found = on_record(own)
    assert any(line.startswith("a message on rigctl/paper_rig/") for line in found)
    for tail in ("cmd/*", "tele/state", "meta/schema", "cfg/active"):
        (line,) = [one for one in found if one.startswith(f"answers to queries of rigctl/paper_rig/{tail} ")]
        assert line.endswith("by somebody other than the daemon: not believed on this computer")
    assert len(found) <= 6  # thousands of messages, one line now and one for the rest


def test_what_is_put_from_the_clients_side_of_a_restart_is_not_foreign(own: Daemon) -> None:
    with compensating(own):
        own.kill_gateway()
        own.start_gateway()
        own.client().close()
        assert own.cli("status").stdout.startswith("rig")
        assert on_record(own) == []
