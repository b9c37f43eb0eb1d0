"""A local user looks for the operator's commands and gives some of his own: the rig takes none but HOLD."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys

import msgspec
import pytest

from rigctl.client.connection import NoDaemonError
from rigctl.gateway.lease_service import IN_FORCE
from rigctl.ipc.folder_places import COMMAND_SOCKET
from rigctl.wire.keys import Keys
from tests.builders.intruder import NOBODY, Intruder
from tests.builders.miniature import Daemon
from tests.builders.operators import ANNA
from tests.builders.paths import ROOT
from tests.builders.refusals import Refused
from tests.builders.waiting import patience_s, until

KEYS = Keys("paper_rig")


def commands(daemon: Daemon) -> int:
    """Number of commands given to the loop so far."""
    return daemon.runtime.commands.reader().head


def test_her_commands_and_her_lease_do_not_come_to_him(own: Daemon) -> None:
    """He answers on every key, and subscribes to all that he may; the id is in nothing that others may read."""
    with (
        own.compensating() as anna,
        Intruder(own.endpoint, "paper_rig", "answers", "replays") as intruder,
        Intruder(own.endpoint, "paper_rig") as another,
    ):
        lease = anna.leases[ANNA]
        assert anna.take_lease("anna")["lease"]["id"] == lease
        assert anna.command("target", "anna", 290.0)["accepted"]
        assert not another.ask(KEYS.command("hold"), b'{"operator": "kim"}')["good"]
        assert not intruder.was_asked
        public = [anna.state(), anna.active(), anna.past_events(), anna.schema(), intruder.seen]
        assert lease not in msgspec.json.encode(public).decode()
        for ring in (own.runtime.notes, own.runtime.requests):  # of these the audit log is made
            assert lease.encode() not in ring.reader(from_start=True).read().tobytes()


@pytest.mark.parametrize(
    ("verb", "body"),
    [
        ("disarm", {}), ("release", {}), ("target", {"value": 349.0}), ("gains", {"gain_file": "x", "name": "x"}),
        ("lease_take", {"reason": "maintenance"}), ("lease_return", {}), ("alarm_shelve", {"cause": "x"}), ("hold", {}),
    ],
)  # fmt: skip
def test_a_command_by_tcp_is_refused_and_put_on_record(own: Daemon, verb: str, body: dict[str, object]) -> None:
    """Also with the lease's id, which he has from somewhere."""
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig") as intruder:
        given, refused = commands(own), Refused(own)
        for shown in ({}, {"lease": anna.leases[ANNA]}):
            answer = intruder.ask(KEYS.command(verb), json.dumps({"operator": "anna", **body, **shown}).encode())
            assert (answer["good"], answer["text"]) == (False, "")
        line = refused.line(f"query of rigctl/paper_rig/cmd/{verb}")
        assert "by an unknown client (no certificate, tcp/127.0.0.1:" in line
        assert line.endswith(") refused: not allowed")
        assert commands(own) == given
        assert own.state(anna)["lease"]["holder"] == ANNA
        assert anna.command("target", "anna", 290.0)["accepted"]


@pytest.mark.parametrize(
    "key", ["rigctl/*/cmd/release", "rigctl/paper_rig/cmd/*", "**", "rigctl/**", "rigctl/*/cmd/**"]
)
def test_a_command_for_every_rig_or_every_verb_is_none(own: Daemon, key: str) -> None:
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig") as intruder:
        given = commands(own)
        assert not intruder.ask(key, json.dumps({"operator": "anna", "lease": anna.leases[ANNA]}).encode())["good"]
        assert commands(own) == given


def test_a_client_goes_on_with_the_next_run(own: Daemon) -> None:
    with own.compensating() as anna:
        own.kill_gateway()
        own.runtime.write_json("active.json", {**own.runtime.read_json("active.json"), "run_id": "another"})
        own.start_gateway()
        own.client().close()

        def answered() -> dict[str, object] | None:
            with contextlib.suppress(NoDaemonError):  # her session finds the new gateway by itself
                return anna.command("target", "anna", 290.0)
            return None

        assert until(answered, "an answer")["accepted"]
        assert anna.state()["rig"] == "paper_rig"


def test_his_flood_uses_up_no_operators_share(own: Daemon) -> None:
    with own.compensating() as anna, Intruder(own.endpoint, "paper_rig") as intruder:
        refused = Refused(own)
        for _ in range(450):
            assert not intruder.ask(KEYS.command("lease_take"), b'{"operator": "kim", "reason": "x"}')["good"]
        refused.line("query of rigctl/paper_rig/cmd/lease_take")
        assert len(refused.read()) <= 3
        with own.client() as kim:
            assert kim.take_lease("kim", "tea")["accepted"]
        assert anna.command("target", "anna", 290.0)["reason"] == "lease_held"


def test_another_user_reads_the_rig_is_told_so_and_commands_nothing(own: Daemon) -> None:
    """The command line of a user who may only enter the run-time folder: HOLD goes by the loop's socket there."""
    with own.compensating() as anna:
        environment = {**own.environment(), "HOME": "/", "XDG_RUNTIME_DIR": ""}

        def typed(*words: str) -> subprocess.CompletedProcess[str]:
            become = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
            return subprocess.run(
                [*become, sys.executable, "-m", "rigctl.cli.app", *words], cwd=ROOT, env=environment,
                capture_output=True, text=True, timeout=patience_s() * 2, check=False,
            )  # fmt: skip

        status = typed("status")
        assert (status.returncode, status.stderr.count("\n")) == (0, 1)
        assert "is not verified, and takes no command from here" in status.stderr
        refused = typed("release", "--operator", "anna")
        assert refused.returncode == 1
        assert "RELEASE refused: " in refused.stderr.splitlines()[-1]
        assert "this user finds no daemon of it here" in refused.stderr
        assert own.state(anna)["lease"]["holder"] == ANNA
        held = typed("hold", "--operator", "kim", "--json")
        answer = json.loads(held.stdout)
        assert answer["via"] == "local socket", held.stderr
        assert answer["text"].endswith("(the daemon is of root)")
        assert own.state(anna)["mode"] == "HOLD"


def test_the_files_and_the_socket_of_the_run_are_closed_to_others(own: Daemon) -> None:
    with own.compensating():
        for place in (own.runtime.place(IN_FORCE), own.runtime.gateway_socket, own.runtime.place(COMMAND_SOCKET)):
            assert place.stat().st_mode & 0o077 == 0
