"""Certificates at the real gateway: whose name is on record, whose lease it is, and what a revocation does."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

import rigctl.client
from rigctl.client.connection import ChoiceError, Client, NoDaemonError
from rigctl.client.samples import Samples
from rigctl.identity.roles import Role
from tests.builders.certified import NAMES, CertifiedDaemon, certified
from tests.builders.waiting import patience_s, until

REFUSED = r"of vera is not answered at tls/127\.0\.0\.1:\d+ \(absent, or not allowed\)"


@pytest.fixture(scope="module")
def shared() -> Iterator[CertifiedDaemon]:
    yield from certified()


@pytest.fixture
def own() -> Iterator[CertifiedDaemon]:
    yield from certified()


def test_the_name_on_record_is_the_certificates_whatever_was_typed(shared: CertifiedDaemon) -> None:
    with shared.client_of("kim") as kim:
        taken = kim.take_lease("the boss")
        assert (taken["accepted"], taken["operator"], taken["lease"]["holder"]) == (True, "kim", "kim")
        answer = kim.command("target", "max", 310.0)
        assert (answer["accepted"], answer["operator"]) == (True, "kim")
        assert shared.state(kim)["lease"]["holder"] == "kim"
        assert kim.return_lease("anybody")["accepted"]
        notes = [event for event in kim.past_events() if event["source"] == "gateway"]
    assert {event["operator"] for event in notes} == {"kim"}
    given = shared.runtime.requests.reader(from_start=True).read()
    assert {slot["operator"].decode() for slot in given if slot["operator"]} == {"kim"}


def test_what_a_role_may_not_ends_in_one_line(shared: CertifiedDaemon) -> None:
    with shared.client_of("vera") as vera, shared.client_of("kim") as kim:
        assert vera.state()["mode"] == "DISARMED"
        with pytest.raises(NoDaemonError, match=REFUSED):
            vera.command("hold", "vera")
        with pytest.raises(NoDaemonError, match=REFUSED):
            vera.take_lease("kim", "because")
        with pytest.raises(NoDaemonError, match=r"calibrate of kim is not answered .* \(absent, or not allowed\)"):
            kim.command("calibrate", "kim", 300.0)
        assert kim.command("hold", "kim")["operator"] == "kim"  # answered: there is nothing to hold while DISARMED
    done = shared.cli("--key", str(shared.key("vera")), "disarm")
    assert done.returncode == 1 and re.fullmatch(f"rigctl: lease_take {REFUSED}\n", done.stderr)
    done = shared.cli("--key", str(shared.key("vera")), "hold")  # on this computer by the loop's socket, as every user
    assert (done.returncode, done.stderr) == (1, "rigctl: HOLD refused: hold is not possible in DISARMED: arm first\n")
    assert shared.cli("status", RIGCTL_KEY=str(shared.key("vera"))).returncode == 0


def test_a_malformed_command_is_on_record_under_the_certificates_name(shared: CertifiedDaemon) -> None:
    with shared.client_of("max") as client:
        answered, raw = client.ask(client.keys.command("target"), b'{"operator": "kim"')
    assert not answered and b'"operator":"max"' in raw
    given = shared.runtime.requests.reader(from_start=True)

    def recorded() -> bool:
        return any((slot["operator"], slot["reason"]) == (b"max", b"bad_request") for slot in given.read())

    until(recorded, "the refusal on record")


def test_a_command_line_without_a_usable_key_is_told_in_one_line(shared: CertifiedDaemon) -> None:
    opened = shared.runtime.directory / "open.pem"
    opened.write_text(shared.key("kim").read_text())
    opened.chmod(0o644)
    stale = shared.runtime.directory / "stale.pem"
    stale.write_text(re.sub(r"until: \S+", "until: 2020-01-01T00:00:00+00:00", shared.key("kim").read_text()))
    stale.chmod(0o600)
    for key, expected in (
        ("/nowhere/kim.pem", "/nowhere/kim.pem: cannot be read: No such file or directory"),
        (str(opened), "found mode 0644, expected 0600"),
        (str(stale), "expired on 2020-01-01: rigctl keys renew kim"),
        (str(shared.keys.folder.access), "found no key, expected a key file from rigctl keys add"),
    ):
        done = shared.cli("status", RIGCTL_KEY=key)
        assert done.returncode == 2 and expected in done.stderr and done.stderr.count("\n") == 1
    elsewhere = "tls/127.0.0.2:7447"
    done = shared.cli("status", "--connect", elsewhere, RIGCTL_KEY="")
    assert done.returncode == 2 and f"found no key for {elsewhere}" in done.stderr and done.stderr.count("\n") == 1
    with pytest.raises(ChoiceError, match="found no key"):
        Client(elsewhere)


def test_the_rigs_own_user_needs_no_key(shared: CertifiedDaemon) -> None:
    shared.client_of("vera").close()
    done = shared.cli("status", RIGCTL_KEY="")
    assert (done.returncode, done.stderr) == (0, "")
    with Client(shared.endpoint) as client:
        assert (client.rig, client.person, client.route.is_local) == ("paper_rig", "", True)


def test_the_public_client_takes_credentials(shared: CertifiedDaemon) -> None:
    with rigctl.client.connect(shared.endpoint, timeout_s=patience_s(), credentials=shared.key("kim")) as rig:
        assert rig.command("target", 299.0, operator="anyone")["operator"] == "kim"
        assert rig.return_lease("anyone")["accepted"]
        assert rig.schema()["commands"]["verbs"]["arm"]["key"] == "rigctl/paper_rig/cmd/*/arm"
    assert rigctl.client.rigs(shared.endpoint, shared.key("vera")) == ["paper_rig"]


def received(samples: Samples, more: int) -> None:
    """Read on until ``more`` records have come that do not wait here already."""
    samples.newest()
    wanted = samples.count.received + more

    def come() -> bool:
        samples.read(0.1)
        return samples.count.received >= wanted

    until(come, f"{more} records")


def test_a_revoked_person_is_refused_and_the_others_lose_nothing(own: CertifiedDaemon) -> None:
    """Five times over: each time every subscription is renewed at a gateway with another access list."""
    with own.client_of("vera") as vera, own.client_of("kim") as kim:
        samples, states = vera.samples(), vera.follow(vera.keys.state)
        received(samples, 100)
        assert kim.take_lease("kim")["accepted"]
        own.keys.revoke("kim")
        own.renewed_gateway()
        received(samples, 1000)
        with pytest.raises(NoDaemonError, match=r"\(absent, or not allowed\)"):
            kim.command("hold", "kim")
        with pytest.raises(NoDaemonError, match=r"\(absent, or not allowed\)"):
            Client(own.endpoint, own.settings.rig, key=own.key("kim"))
        assert vera.state()["lease"]["holder"] == "kim"  # until it lapses, or somebody takes it over with a reason
        for turn in range(4):
            own.keys.add(f"eva{turn}", Role.OPERATOR)
            own.renewed_gateway()
            received(samples, 1000)
            until(lambda: states.read(0.1), "a state")
            with own.client_of(f"eva{turn}") as eva:
                assert eva.command("hold", "eva")["operator"] == f"eva{turn}"
        assert (samples.count.lost, samples.count.streams) == (0, 1)


def test_a_name_that_got_a_new_key_is_served_and_its_stolen_one_is_not(own: CertifiedDaemon) -> None:
    stolen = own.runtime.directory / "stolen.pem"
    own.client_of("kim").close()
    stolen.write_text(own.key("kim").read_text())
    stolen.chmod(0o600)
    own.keys.revoke("kim")
    own.keys.add("kim", NAMES["kim"])
    own.renewed_gateway()
    with own.client_of("kim") as kim:
        assert kim.command("hold", "kim")["operator"] == "kim"  # answered: there is nothing to hold while DISARMED
    with pytest.raises(NoDaemonError):
        Client(own.endpoint, own.settings.rig, key=stolen)


def test_a_gateway_with_a_damaged_access_list_does_not_start(own: CertifiedDaemon) -> None:
    own.client_of("kim").close()
    own.keys.folder.access.write_text("{")
    gateway = own.gateway
    assert gateway is not None
    until(lambda: gateway.poll() is not None, "the gateway to end")
    own.start_gateway()
    assert own.gateway is not None
    assert own.gateway.wait(patience_s()) == 1
    with pytest.raises(NoDaemonError):
        Client(own.endpoint, own.settings.rig, key=own.key("kim"))
