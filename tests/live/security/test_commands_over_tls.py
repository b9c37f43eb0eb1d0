"""Operators with certificates who have no key of the daemon's run: another user, and another network namespace.

The lease comes from an X25519 exchange, and commands are proven under it; nobody else goes on with it.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator

import msgspec
import pytest

from rigctl.gateway.lease_service import IN_FORCE
from rigctl.wire.keys import Keys
from tests.builders.certified import CertifiedDaemon, certified
from tests.builders.intruder import let_others_in
from tests.builders.miniature import until
from tests.builders.namespace import HERE
from tests.builders.remote_operator import RemoteOperator

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


@pytest.fixture(autouse=True)
def reachable_folder(tmp_path: pathlib.Path) -> None:
    let_others_in(tmp_path)


def given(daemon: CertifiedDaemon) -> int:
    """Number of commands that the loop got so far."""
    return daemon.runtime.commands.reader().head


def refused(daemon: CertifiedDaemon, reason: str) -> int:
    """How many refusals with this reason are on record for the audit log."""
    slots = daemon.runtime.requests.reader(from_start=True).read()
    return sum(bool(slot["answered"]) and slot["reason"] == reason.encode() for slot in slots)


def test_a_lease_comes_by_exchange_is_lost_to_another_person_with_a_reason_and_given_back(
    own: CertifiedDaemon, opened: Opened
) -> None:
    kim, max_ = opened("kim"), opened("max")
    taken = kim.do("take", "")
    assert (taken["accepted"], taken["operator"], taken["has_operator_key"]) == (True, "kim", False)
    assert taken["lease"]["id"]
    assert kim.do("command", "target", 310.0)["accepted"]
    assert own.runtime.read_json(IN_FORCE)["holder"] == "kim"

    before = given(own)
    for answer in (max_.do("command", "target", 320.0), max_.do("take", "")):
        assert (answer["accepted"], answer["reason"]) == (False, "lease_held")
    assert given(own) == before

    over = max_.do("take", "kim has gone home")
    assert (over["accepted"], over["lease"]["holder"]) == (True, "max")
    lost = kim.do("command", "target", 330.0)
    assert (lost["accepted"], lost["reason"]) == (False, "lease_held")
    assert "max holds the lease" in lost["text"]
    assert not kim.do("return")["accepted"]
    assert given(own) == before
    assert max_.do("command", "target", 340.0)["accepted"]
    assert max_.do("return")["accepted"]
    assert kim.do("take", "")["accepted"]


def test_what_was_sent_counts_once_and_unchanged(own: CertifiedDaemon, opened: Opened) -> None:
    """With her certificate, by a session that has everything she sent but not the lease's key."""
    kim, thief, max_ = opened("kim"), opened("kim"), opened("max")
    assert kim.do("take", "")["accepted"]
    assert kim.do("command", "target", 310.0)["accepted"]
    sent = kim.do("sent")
    key, payload, attachment = sent["key"], bytes.fromhex(sent["payload"]), bytes.fromhex(sent["attachment"])
    before = given(own)
    for forger in (kim, thief):
        assert forger.do("raw", key, payload.hex(), attachment.hex())["reason"] == "proof_old"
    stamped = msgspec.json.decode(attachment)
    newer = stamped | {"stamp": stamped["stamp"] + 1}
    without = {name: value for name, value in newer.items() if name != "public"}
    assert thief.do("raw", key, payload.replace(b"310", b"349").hex(), attachment.hex())["reason"] == "proof_old"
    tries = [
        (newer, "lease_held"),
        (without, "no_proof"),
        (without | {"lease": "0" * 64}, "no_proof"),
        ({}, "no_proof"),
    ]
    for number, (proofs, reason) in enumerate(tries):
        fresh = msgspec.json.encode(proofs | {"nonce": f"{number:032x}"}) if proofs else b""
        answer = thief.do("raw", key, payload.hex(), fresh.hex())
        assert (answer["accepted"], answer["reason"]) == (False, reason), proofs
    released = thief.do("raw", key.replace("target", "release"), b'{"operator":"kim"}'.hex(), attachment.hex())
    assert not released["accepted"]
    others = max_.do("raw", Keys("paper_rig", "max").command("target"), payload.hex(), attachment.hex())
    assert not others["accepted"]
    assert max_.do("raw", key, payload.hex(), attachment.hex())["reason"] == "no answer"  # not her key
    assert given(own) == before
    until(lambda: refused(own, "no_proof") >= 3 and refused(own, "proof_old") >= 3, "the refusals on record")
    assert kim.do("command", "target", 305.0)["accepted"]


def test_a_lease_outlives_the_gateway_but_not_the_program_that_has_its_key(
    own: CertifiedDaemon, opened: Opened
) -> None:
    kim = opened("kim")
    assert kim.do("take", "")["accepted"]
    assert kim.do("command", "target", 310.0)["accepted"]
    sent = kim.do("sent")
    own.kill_gateway()
    own.start_gateway()
    own.client_of("vera").close()
    again = opened("kim")
    old = again.do("raw", sent["key"], sent["payload"], sent["attachment"])
    assert (old["accepted"], old["reason"]) == (False, "proof_old")
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
