"""A local user reads every command of the operator and gives commands of his own: the rig carries out none of them."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator

import msgspec
import pytest

from rigctl.client.connection import Client, NoDaemonError
from rigctl.gateway.lease_service import IN_FORCE
from rigctl.wire.keys import Keys
from rigctl.wire.run_keys import GATEWAY_KEY, OPERATOR_KEY
from tests.builders.intruder import NOBODY, Intruder
from tests.builders.miniature import PATIENCE_S, Daemon, until
from tests.builders.paths import ROOT

KEYS = Keys("paper_rig")


def commands(daemon: Daemon) -> int:
    """Number of commands given to the loop so far."""
    return daemon.runtime.commands.reader().head


def recorded(daemon: Daemon, reason: str) -> list[str]:
    """Texts of the refusals with this reason that were put on record for the audit log."""
    slots = daemon.runtime.requests.reader(from_start=True).read()
    return [bytes(slot["text"]).decode() for slot in slots if slot["answered"] and slot["reason"] == reason.encode()]


def compensating(daemon: Daemon) -> Client:
    client = daemon.client()
    assert client.command("arm", "anna")["accepted"]
    assert client.command("tension", "anna")["accepted"]
    return client


@pytest.fixture
def intruder(own: Daemon) -> Iterator[Intruder]:
    """He has seen one command of anna."""
    own.client().close()
    with Intruder(own.endpoint, "paper_rig", "answers") as found:
        yield found


def test_nothing_that_crosses_the_network_is_a_lease_or_a_key(own: Daemon, intruder: Intruder) -> None:
    with compensating(own) as anna:
        lease = anna.leases["anna"]
        assert anna.take_lease("anna")["lease"]["id"] == lease
        until(lambda: sum("/cmd/" in one.get("key", "") for one in intruder.seen) >= 3, "her commands")
        secrets = [lease, *(str(own.runtime.read_json(name)["key"]) for name in (GATEWAY_KEY, OPERATOR_KEY))]
        for one in intruder.seen:
            for secret in secrets:
                assert secret not in bytes.fromhex(one.get("payload", "")).decode()
                assert secret not in bytes.fromhex(one.get("attachment", "")).decode()


@pytest.mark.parametrize(
    ("verb", "body"),
    [
        ("disarm", {}), ("release", {}), ("target", {"value": 349.0}), ("gains", {"gain_file": "x", "name": "x"}),
        ("lease_take", {"reason": "maintenance"}), ("lease_return", {}),
    ],
)  # fmt: skip
def test_a_command_without_proof_is_refused_and_put_on_record(own: Daemon, verb: str, body: dict[str, object]) -> None:
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig") as intruder:
        given = commands(own)
        answer = intruder.ask(KEYS.command(verb), json.dumps({"operator": "anna", **body}).encode())
        assert not answer["good"]
        (line,) = until(lambda: recorded(own, "no_proof"), "the record")
        what = "LEASE" if verb.startswith("lease") else verb.upper()
        assert line.startswith(f"{what} refused: found no proof of who gives it, expected one with the operator key")
        assert commands(own) == given
        assert own.state(anna)["lease"]["holder"] == "anna"
        assert anna.command("target", "anna", 290.0)["accepted"]


def test_what_he_has_read_proves_nothing_a_second_time(own: Daemon, intruder: Intruder) -> None:
    """He gives her command again, another one with its proofs, and another verb with them."""
    with compensating(own) as anna:
        assert anna.command("target", "anna", 290.0)["accepted"]
        seen = intruder.wait("query", key=KEYS.command("target"))
        payload, attachment = bytes.fromhex(seen["payload"]), bytes.fromhex(seen["attachment"])
        given = commands(own)
        intruder.ask(KEYS.command("target"), payload, attachment)
        until(lambda: recorded(own, "proof_old"), "the refusal of the repeated command")
        intruder.ask(KEYS.command("target"), payload.replace(b"290", b"349"), attachment)
        until(lambda: len(recorded(own, "no_proof")) == 1, "the refusal of the changed command")
        intruder.ask(KEYS.command("release"), b'{"operator":"anna"}', attachment)
        until(lambda: len(recorded(own, "no_proof")) == 2, "the refusal of the other verb")
        later = msgspec.json.encode(msgspec.json.decode(attachment) | {"stamp": own.state(anna)["t_ns"]})
        intruder.ask(KEYS.command("target"), payload, later)
        until(lambda: len(recorded(own, "no_proof")) == 3, "the refusal of the changed stamp")
        own.kill_gateway()
        own.start_gateway()
        own.client().close()
        with Intruder(own.endpoint, "paper_rig") as again:
            assert "old" in again.ask(KEYS.command("target"), payload, attachment)["text"]
        assert commands(own) - given <= 1  # the new gateway sends the loop its host checks
        own.answers(anna)
        assert anna.take_lease("anna")["accepted"]


def test_a_client_goes_on_with_the_keys_of_the_next_run(own: Daemon) -> None:
    with compensating(own) as anna:
        before = own.runtime.read_json(OPERATOR_KEY)["key"]
        own.kill_gateway()
        own.runtime.write_json("active.json", {**own.runtime.read_json("active.json"), "run_id": "another"})
        own.start_gateway()
        own.client().close()
        assert own.runtime.read_json(OPERATOR_KEY)["key"] != before

        def answered() -> dict[str, object] | None:
            with contextlib.suppress(NoDaemonError):  # her session finds the new gateway by itself
                return anna.command("target", "anna", 290.0)
            return None

        assert until(answered, "an answer")["accepted"]
        assert anna.state()["rig"] == "paper_rig"


def test_hold_is_taken_from_him_and_from_everyone(own: Daemon) -> None:
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig") as intruder:
        answer = intruder.ask(KEYS.command("hold"), b'{"operator": "kim"}')
        assert answer["good"]
        assert own.state(anna)["mode"] == "HOLD"


def test_his_flood_uses_up_no_operators_share(own: Daemon) -> None:
    with compensating(own) as anna, Intruder(own.endpoint, "paper_rig") as intruder:
        for _ in range(450):
            intruder.ask(KEYS.command("lease_take"), b'{"operator": "kim", "reason": "x"}')
        assert len(recorded(own, "no_proof")) <= 450
        with own.client() as kim:
            assert kim.take_lease("kim", "tea")["accepted"]
        assert anna.command("target", "anna", 290.0)["reason"] == "lease_held"


def test_another_user_reads_the_rig_is_told_so_and_commands_nothing(own: Daemon) -> None:
    """The command line of a user who may not read the run-time folder."""
    with compensating(own) as anna:
        environment = {**own.environment(), "HOME": "/", "XDG_RUNTIME_DIR": ""}

        def typed(*words: str) -> subprocess.CompletedProcess[str]:
            become = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
            return subprocess.run(
                [*become, sys.executable, "-m", "rigctl.cli.app", *words], cwd=ROOT, env=environment,
                capture_output=True, text=True, timeout=PATIENCE_S * 2, check=False,
            )  # fmt: skip

        status = typed("status")
        assert (status.returncode, status.stderr.count("\n")) == (0, 1)
        assert "is not verified, and its daemon takes no command but HOLD from here" in status.stderr
        refused = typed("release", "--operator", "anna")
        assert refused.returncode == 1
        assert "RELEASE refused: found no proof of who gives it" in refused.stderr
        assert own.state(anna)["lease"]["holder"] == "anna"
        assert typed("hold", "--operator", "kim").stdout.startswith("HOLD: stroke held at")


def test_the_files_of_the_run_are_closed_to_others(own: Daemon) -> None:
    with compensating(own):
        for name in (GATEWAY_KEY, OPERATOR_KEY, IN_FORCE):
            assert (own.runtime.directory / name).stat().st_mode & 0o077 == 0
