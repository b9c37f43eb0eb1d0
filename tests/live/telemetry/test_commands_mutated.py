"""Mutated commands over a real session: every one gets a reply in words, and the gateway goes on."""

from __future__ import annotations

import contextlib
import random

import msgspec

from rigctl.control.modes import FILED
from rigctl.model.states import Mode
from rigctl.wire.session import MESSAGE_BYTES
from tests.builders.miniature import Daemon
from tests.builders.operators import ANNA
from tests.fuzz import commands

SEED, COUNT, EACH_S = 11, 150, 30.0


def with_lease(payload: bytes | None, lease: str) -> bytes | None:
    """A payload under the lease of anna, if it is an object that names none."""
    with contextlib.suppress(ValueError, RecursionError, msgspec.MsgspecError):
        if isinstance(found := msgspec.json.decode(payload or b""), dict):
            return msgspec.json.encode({"lease": lease} | found)
    return payload


def test_every_mutated_command_is_answered_and_none_ends_the_gateway(own: Daemon) -> None:
    chance = random.Random(SEED)
    with own.client() as client:
        before = client.state()["seq"]
        assert client.command("hold", "anna")["text"]
        assert client.take_lease("anna")["accepted"]
        lease = client.leases[ANNA]
        kinds = set()
        for _ in range(COUNT):
            name, payload = commands.query(chance, chance.choice(list(Mode)))
            if "*" in name or "/" in name or name.lower() in (verb.name.lower() for verb in FILED):
                continue  # several at once, or another key; trials take time
            if len(payload or b"") > MESSAGE_BYTES:
                continue  # the socket takes no such message
            good, found = client.ask(client.keys.command(name), with_lease(payload, lease) or b"", EACH_S)
            said = msgspec.json.decode(found)
            assert isinstance(said["text"], str), (name, payload)
            assert "Traceback" not in said["text"]
            assert len(said["text"].splitlines()) == 1, (name, said["text"])
            kinds.add((good, said.get("reason")))
        assert len(kinds) > 4  # carried out, and refused for several reasons
        assert client.state()["seq"] > before
        assert own.gateway is not None
        assert own.gateway.poll() is None
