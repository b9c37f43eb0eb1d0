"""An attacker in another network namespace, joined by a cable: what plain TCP gives him, and what it does not."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from rigctl.wire.keys import Keys
from tests.builders.intruder import FORGED, Intruder
from tests.builders.miniature import Daemon
from tests.builders.namespace import HERE
from tests.builders.operators import ANNA
from tests.builders.refusals import Refused

KEYS = Keys("paper_rig")


@pytest.fixture
def open_daemon() -> Iterator[Daemon]:
    """A daemon that listens on every address of this computer, without TLS."""
    daemon = Daemon()
    try:
        active = daemon.runtime.read_json("active.json")
        port = daemon.endpoint.rpartition(":")[2]
        active["settings"]["telemetry"] |= {"listen": f"tcp/0.0.0.0:{port}", "listen_waiver": "to be attacked here"}
        daemon.runtime.write_json("active.json", active)
        daemon.start_loop()
        daemon.start_gateway()
        yield daemon
    finally:
        daemon.close()


def at(daemon: Daemon) -> str:
    """The daemon's endpoint as seen from the other namespace."""
    return f"tcp/{HERE}:{daemon.endpoint.rpartition(':')[2]}"


def test_a_loopback_address_does_not_answer_there(own: Daemon, elsewhere: tuple[str, ...]) -> None:
    with own.compensating(), pytest.raises(AssertionError):
        Intruder(at(own), "paper_rig", namespace=elsewhere, patience=0.1)


def test_no_command_is_taken_from_there(open_daemon: Daemon, elsewhere: tuple[str, ...]) -> None:
    own = open_daemon
    with own.compensating() as anna, Intruder(at(own), "paper_rig", namespace=elsewhere) as intruder:
        for verb, body in (
            ("lease_take", {"reason": "mine"}),
            ("release", {}),
            ("hold", {}),
            ("target", {"value": 349.0}),
        ):
            answer = intruder.ask(KEYS.command(verb), json.dumps({"operator": "anna", **body}).encode())
            assert (answer["good"], answer["text"]) == (False, "")
        assert "by an unknown client (no certificate, tcp/" in Refused(own).line("query of rigctl/paper_rig/cmd/")
        assert own.state(anna)["lease"]["holder"] == ANNA
        assert own.state(anna)["mode"] in ("TENSIONING", "COMPENSATING")


def test_his_answers_and_tokens_do_not_come_here(open_daemon: Daemon, elsewhere: tuple[str, ...]) -> None:
    own = open_daemon
    with own.compensating(), Intruder(at(own), "paper_rig", "answers", "tokens", namespace=elsewhere) as intruder:
        done = own.cli("hold", "--operator", "kim")
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("HOLD: stroke held at")
        assert FORGED not in done.stdout
        assert not intruder.was_asked
