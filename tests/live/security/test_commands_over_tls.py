"""Operators with certificates who may not open the daemon's socket: another user, and another network namespace.

The lease's id is drawn by the gateway and sent to its taker alone; nobody else goes on with it.
"""

from __future__ import annotations

import json
import pathlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rigctl.client.connection import Client
from rigctl.wire.keys import Keys
from tests.builders.certified import CertifiedDaemon, certified
from tests.builders.namespace import HERE
from tests.builders.operators import ANNA
from tests.builders.refusals import Refused
from tests.builders.remote_operator import RemoteOperator
from tests.builders.waiting import patience_s

Opened = Callable[[str], RemoteOperator]


@pytest.fixture(params=["another user", "another network namespace"])
def namespace(request: pytest.FixtureRequest) -> tuple[str, ...]:
    return tuple(request.getfixturevalue("elsewhere")) if "network" in request.param else ()


@pytest.fixture
def own(namespace: tuple[str, ...]) -> Iterator[CertifiedDaemon]:
    for daemon in certified(HERE if namespace else "127.0.0.1"):
        daemon.client_of("vera").close()
        yield daemon


@pytest.fixture
def opened(own: CertifiedDaemon, namespace: tuple[str, ...], tmp_path: pathlib.Path) -> Iterator[Opened]:
    """Starts the program of a person there."""
    people: list[RemoteOperator] = []

    def start(name: str) -> RemoteOperator:
        folder = tmp_path / f"{name}{len(people)}"
        folder.mkdir()
        people.append(RemoteOperator(own.endpoint, own.settings.rig, own.key(name), folder, namespace))
        return people[-1]

    yield start
    for person in people:
        person.close()


def given(daemon: CertifiedDaemon) -> int:
    """Number of commands that the loop got so far."""
    return daemon.runtime.commands.reader().head


def test_a_person_without_the_leases_id_and_another_person_with_it_command_nothing(
    own: CertifiedDaemon, opened: Opened
) -> None:
    """A session with her certificate has everything of hers but the id; another person has all that she sent."""
    kim, thief, max_ = opened("kim"), opened("kim"), opened("max")
    taken = kim.do("take", "")["lease"]
    assert kim.do("command", "target", 310.0)["accepted"]
    sent = kim.do("sent")
    key, payload = sent["key"], json.loads(bytes.fromhex(sent["payload"]))
    assert payload["lease"] == taken["id"]
    before, refusals = given(own), Refused(own)

    def raw(person: RemoteOperator, on: str, **body: object) -> dict[str, Any]:
        return person.do("raw", on, json.dumps(body).encode().hex())

    without = {name: value for name, value in payload.items() if name != "lease"}
    for body in (without, payload | {"lease": "0" * 32}):
        answer = raw(thief, key, **body)
        assert (answer["accepted"], answer["reason"]) == (False, "lease_held")
        assert taken["id"] not in json.dumps(answer)
    hers, his = Keys("paper_rig", "kim"), Keys("paper_rig", "max")
    assert raw(max_, his.command("target"), **payload)["reason"] == "lease_held"
    assert raw(max_, his.command("lease_return"), operator="kim", lease=taken["id"])["reason"] == "lease_held"
    for on in (key, hers.command("release"), Keys("paper_rig").command("target"), his.command("*")):
        assert raw(max_, on, **payload)["reason"] == "no answer"
    assert " by max (certificate max." in refusals.line("query of rigctl/paper_rig/cmd/")
    assert given(own) == before
    assert kim.do("command", "target", 305.0)["accepted"]


def test_on_the_rigs_own_computer_the_socket_is_an_operators_without_a_key(own: CertifiedDaemon) -> None:
    """Under the name that its user types; and no person's key, which the socket may not use."""
    own.client_of("vera").close()
    with Client(own.endpoint, "paper_rig") as anna:
        assert (anna.route.is_local, anna.person) == (True, "")
        assert anna.command("target", "anna", 290.0)["lease"]["holder"] == ANNA
        refusals = Refused(own)
        for person in ("", "kim"):
            key = Keys("paper_rig", person).command("lease_take")
            assert list(anna.session.get(key, payload=b'{"operator":"kim","reason":"x"}', timeout=patience_s())) == []
            assert "by an unknown client (a process on the gateway's socket)" in refusals.line(f"query of {key}")
        with own.client_of("kim") as kim:
            assert kim.command("target", "kim", 280.0)["reason"] == "lease_held"
            assert kim.command("hold", "kim")["text"]
        assert anna.return_lease("anna")["accepted"]


def test_a_lease_outlives_the_gateway_but_not_the_program_that_has_its_id(own: CertifiedDaemon, opened: Opened) -> None:
    kim = opened("kim")
    assert kim.do("take", "")["accepted"]
    assert kim.do("command", "target", 310.0)["accepted"]
    own.kill_gateway()
    own.start_gateway()
    own.client_of("vera").close()
    again = opened("kim")
    refusal = again.do("command", "target", 320.0)
    assert (refusal["accepted"], refusal["reason"]) == (False, "lease_held")
    assert "in another terminal or program" in refusal["text"]

    kim.do("connected")
    assert kim.do("command", "target", 305.0)["accepted"]
    own.keys.revoke("kim")
    own.renewed_gateway()
    own.client_of("vera").close()
    own.keys.add("kim", own.keys.folder.certificates()[-1].role)
    own.renewed_gateway()
    own.client_of("vera").close()
    newer = opened("kim")
    assert newer.do("command", "target", 320.0)["reason"] == "lease_held"
    assert newer.do("take", "my key was stolen")["accepted"]
