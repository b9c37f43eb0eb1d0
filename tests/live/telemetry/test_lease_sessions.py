"""Leases over real sessions: refusals, notices, what survives a restart; and none of it moves the rig."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgspec

from rigctl.client.connection import Client
from rigctl.client.shapes import Message
from rigctl.client.stream import Stream
from rigctl.gateway.command_socket import PER_USER
from rigctl.gateway.lease_service import IN_FORCE
from rigctl.gateway.published_position import SENT_NS
from rigctl.model.verbs import Verb
from tests.builders.miniature import Daemon
from tests.builders.operators import ANNA, KIM
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

HOW = "to take it over: rigctl lease take --reason TEXT"


def shorten(daemon: Daemon, left_s: float) -> None:
    """Restart the gateway on a lease with this much time left."""
    daemon.kill_gateway()
    written = daemon.runtime.read_json(IN_FORCE)
    daemon.runtime.write_json(IN_FORCE, {**written, "until_ns": time.monotonic_ns() + round(left_s * 1e9)})
    daemon.start_gateway()


def commands(daemon: Daemon) -> int:
    """Number of commands given to the loop so far."""
    return daemon.runtime.commands.reader().head


def gateways_hold(client: Client, operator: str) -> dict[str, Any]:
    """HOLD by way of the gateway, as over the network."""
    _, found = client.ask(client.keys.command("hold"), msgspec.json.encode({"operator": operator}))
    return dict(msgspec.json.decode(found))


def of_kind(feed: Stream[Message], kind: str) -> Callable[[], dict[str, Any] | None]:
    def newest() -> dict[str, Any] | None:
        event = feed.take()
        return event if event is not None and event["kind"] == kind else None

    return newest


def test_a_second_operator_is_refused_by_name_and_may_hold(own: Daemon) -> None:
    with own.client() as anna, own.client() as kim:
        events = anna.follow(anna.keys.event("*"))
        armed = anna.command("arm", "anna")
        lease = armed["lease"]
        assert (lease["holder"], len(lease["id"])) == (ANNA, 32)
        assert 295 < lease["left_s"] <= 300
        assert lease["until_ns"] > time.monotonic_ns()
        given = commands(own)
        for verb in Verb:
            if verb is Verb.HOLD:
                continue
            more: dict[str, Any] = (
                {"value": 280.0} if verb in (Verb.TARGET, Verb.CONFIRM_STROKE, Verb.MOVE, Verb.CARRY) else {}
            )
            more |= {"options": {"gain_file": "x", "name": "x"}} if verb is Verb.GAINS else {}
            more |= {"options": {"supported": True}} if verb is Verb.BRAKE_TEST else {}
            options = more.pop("options", {})
            refused = kim.command(verb.name.lower(), "kim", **more, **options)
            assert refused["accepted"] is False
            if refused["reason"] == "not_possible":  # for every operator on this rig
                continue
            assert refused["reason"] == "lease_held", (verb, refused["text"])
            assert refused["text"].startswith(f"{verb.name} refused: {ANNA} holds the lease, since ")
            assert refused["text"].endswith(HOW)
            assert refused["lease"]["holder"] == ANNA
            assert "id" not in refused["lease"]
        assert commands(own) == given  # none of them reached the loop
        assert anna.command("tension", "anna")["accepted"]
        held = gateways_hold(kim, "kim")
        assert held["accepted"]
        assert held["text"].startswith("HOLD: stroke held at")
        assert held["lease"]["holder"] == ANNA
        assert "id" not in held["lease"]
        event = until(of_kind(events, "HOLD_WITHOUT_LEASE"), "the note")
        assert (event["severity"], event["source"]) == ("warning", "gateway")
        assert event["text"] == f"HOLD given by {KIM} without the lease, which {ANNA} holds"
        assert anna.command("tension", "anna")["accepted"]  # still her lease
        state = own.state(kim)
        assert state["lease"]["holder"] == ANNA
        assert "id" not in state["lease"]  # the state is public
        assert lease["id"] not in msgspec.json.encode([state, kim.active(), kim.past_events()]).decode()


def test_a_lapse_is_noted_and_moves_nothing(own: Daemon) -> None:
    with own.client() as client:
        client.command("arm", "anna")
        client.command("tension", "anna")
        given = commands(own)
        shorten(own, 1.0)
        own.answers(client)
        (event,) = until(lambda: [e for e in client.past_events() if e["kind"] == "LEASE_LAPSED"], "the lapse")
        assert event["severity"] == "warning"
        assert event["text"] == f"the lease of {ANNA} has lapsed; the rig goes on as it is"
        until(lambda: client.state()["mode"] == "COMPENSATING", "the end of the ramp")
        assert own.state(client)["lease"] is None
        assert commands(own) == given
        assert client.command("release", "anna")["reason"] == "lease_lapsed"
        with own.client() as kim:
            assert kim.command("hold", "kim")["accepted"]
            until(lambda: client.state()["mode"] == "HOLD", "the hold")
            assert client.state()["lease"] is None  # hold takes no lease
            assert kim.command("release", "kim")["lease"]["holder"] == KIM


def test_a_dead_terminal_leaves_the_rig_as_it_is_and_the_lease_to_the_next(own: Daemon) -> None:
    with own.client() as client:
        command = [sys.executable, "-m", "rigctl.cli.app", "target", "111", "--operator", "anna"]
        waiting = subprocess.Popen(command, cwd=ROOT, env=own.environment())  # the loop does not answer this command
        given_to_loop = own.runtime.commands.reader(from_start=True)
        until(lambda: 111.0 in given_to_loop.read()["target_n"], "the lease to be taken, kept, and the command given")
        waiting.kill()
        waiting.wait()
        assert own.cli("arm", "--operator", "anna").returncode == 0
        command = [sys.executable, "-m", "rigctl.cli.app", "tension", "--wait", "--operator", "anna"]
        waiting = subprocess.Popen(command, cwd=ROOT, env=own.environment(), stdout=subprocess.PIPE)
        assert waiting.stdout is not None
        assert b"ramping" in waiting.stdout.readline()
        given = commands(own)
        waiting.kill()
        waiting.communicate()
        state = until(lambda: (s := client.state())["mode"] == "COMPENSATING" and s, "the end of the ramp")
        assert (commands(own), state["target_n"]) == (given, 300.0)
        assert state["lease"]["holder"] == ANNA
        stranger = own.cli("release", "--operator", "anna", user="stranger")
        assert stranger.stderr.startswith(f"rigctl: RELEASE refused: {ANNA} holds the lease in another terminal")
        assert own.cli("release", "--operator", "anna").stdout.startswith("RELEASE: ramping")


def test_a_lease_survives_the_gateway(own: Daemon) -> None:
    with own.client() as anna:
        events = anna.follow(anna.keys.event("*"))
        before = anna.command("arm", "anna")["lease"]
        until(of_kind(events, "LEASE_TAKEN"), "the note")
        noted = anna.state()["seq"]
        noting = 3 * SENT_NS // 1_000_000  # records: events just before a kill are repeated
        until(lambda: anna.state()["seq"] > noted + noting, "the gateway to note how far it has come")
        own.kill_gateway()
        own.start_gateway()
        own.answers(anna)
        with own.client() as kim:
            assert kim.command("tension", "kim")["reason"] == "lease_held"
        after = anna.command("tension", "anna")
        assert after["accepted"]
        assert (after["lease"]["id"], after["lease"]["since_ns"]) == (before["id"], before["since_ns"])
        assert [e["kind"] for e in anna.past_events() if e["source"] == "gateway"] == ["LEASE_TAKEN"]
        anna.return_lease("anna")
        note = until(lambda: (e := events.take()) and e["source"] == "gateway" and e, "the next note")
        assert note["kind"] == "LEASE_RETURNED"  # the earlier notice is not repeated


def test_hold_comes_through_a_crowd(own: Daemon) -> None:
    """With as many unanswered commands as a user has connections for, HOLD is answered."""
    with own.client() as client:
        client.command("arm", "anna")
        lease, key = client.leases[ANNA], client.keys.command("target")
        body = msgspec.json.encode({"operator": "anna", "value": 111.0, "lease": lease})  # never answered
        with ThreadPoolExecutor(PER_USER - 2) as asking:  # a connection each; beside them those of client and kim
            asked = [asking.submit(client.ask, key, body, patience_s()) for _ in range(PER_USER - 2)]
            with own.client() as kim:
                assert gateways_hold(kim, "kim")["accepted"]
            answers = [msgspec.json.decode(one.result()[1]) for one in asked]
        assert {answer["reason"] for answer in answers} == {"no_answer"}


def test_the_lease_typed(own: Daemon) -> None:
    own.client().close()
    show = own.cli("lease")
    assert (show.returncode, show.stdout) == (0, "lease: nobody holds it\n")
    assert own.cli("lease", "--json").stdout == "null\n"
    own.cli("arm", "--operator", "anna")
    line = own.cli("lease", "show", user="kim").stdout
    assert line.startswith(f"lease: {ANNA}, since ")
    assert " s\n" in line
    shown = json.loads(own.cli("lease", "--json").stdout)
    assert (shown["holder"], "id" in shown) == (ANNA, False)
    for reader in ("status", "lease"):
        assert f"{ANNA}, since " in own.cli(reader, user="kim").stdout

    refused = own.cli("lease", "take", "--operator", "kim", user="kim")
    assert (refused.returncode, refused.stdout) == (1, "")
    assert refused.stderr.startswith(f"rigctl: LEASE refused: {ANNA} holds the lease, since ")
    assert refused.stderr.endswith(f"{HOW}\n")
    taken = own.cli("lease", "take", "--reason", "tea", "--operator", "kim", user="kim")
    assert (taken.returncode, taken.stderr) == (0, "")
    assert taken.stdout == f"LEASE: {KIM} holds the lease, until 300 s after the last command\n"
    assert own.cli("disarm", "--operator", "anna").stderr.startswith(f"rigctl: DISARM refused: {KIM} holds the lease, ")
    assert own.cli("disarm", "--operator", "kim", user="kim").returncode == 0
    assert own.cli("lease", "return", "--operator", "kim", user="kim").returncode == 0
    nothing = own.cli("lease", "return", "--operator", "kim", user="kim")
    assert (nothing.returncode, nothing.stderr) == (1, "rigctl: LEASE refused: nobody holds the lease\n")
    # Her lease id has long expired; an operator who types a command watches the rig.
    assert own.cli("arm", "--operator", "anna").stdout.startswith("ARM: armed")
    with Client(own.endpoint) as client:
        texts = [event["text"] for event in client.past_events() if event["source"] == "gateway"]
    assert texts == [
        f"{ANNA} takes the lease",
        f"{KIM} takes the lease over from {ANNA}: tea",
        f"{KIM} gives the lease back; the rig goes on as it is",
        f"{ANNA} takes the lease",
    ]
