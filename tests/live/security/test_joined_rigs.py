"""Where rigs join, messages of others pass: none of them states anything of the rig whose router it is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rigctl.client
from rigctl.client import local_daemons, local_hold, route
from rigctl.client.connection import Client, NoDaemonError
from rigctl.wire.keys import Keys
from tests.builders.intruder import Intruder
from tests.builders.miniature import Daemon, free_port
from tests.builders.waiting import patience_s, until


@pytest.fixture
def two() -> Iterator[tuple[Daemon, Daemon]]:
    port = free_port()
    first = Daemon("north_rig", join=[f"tcp/127.0.0.1:{port}"])
    second = Daemon("south_rig", port, join=[first.endpoint])

    def seen() -> bool:
        try:
            return rigctl.client.rigs(first.endpoint) == ["north_rig", "south_rig"]
        except NoDaemonError:
            return False

    try:
        for daemon in (first, second):
            daemon.start_loop()
            daemon.start_gateway()
        until(seen, "both to be seen")
        yield first, second
    finally:
        first.close()
        second.close()


def test_who_speaks_for_the_rig_or_for_every_rig_is_not_shown_and_hears_no_command(two: tuple[Daemon, Daemon]) -> None:
    first, _ = two
    with (
        first.client() as anna,
        Intruder(first.endpoint, "north_rig", "publishes", "answers", "token=north_rig") as intruder,
    ):
        states, events = anna.follow(anna.keys.state), anna.follow(anna.keys.event("*"))  # by the socket, by Zenoh
        until(lambda: anna.refusals.count > 50, "what he puts on the keys of every rig")
        assert "more than one key" in anna.refusals.words
        assert anna.command("arm", "anna")["accepted"]
        for _ in range(20):
            state = states.read(patience_s())
            assert state is not None
            assert (state["rig"], state["fault"]) == ("north_rig", None)
        assert first.state(anna)["mode"] == "HOLD"
        assert "forged" not in {event["text"] for event in events.arrived()}
        assert not intruder.was_asked


def test_by_another_rigs_router_no_command_is_given(
    two: tuple[Daemon, Daemon], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = two
    given = second.runtime.commands.reader()
    every = local_daemons.local_daemons
    monkeypatch.setattr(route, "local_daemons", lambda: [one for one in every() if one.rig != "south_rig"])
    monkeypatch.setattr(local_hold, "local_daemons", lambda **_others: [])
    with Client(first.endpoint, "south_rig") as lee:
        assert (lee.route.rig, lee.state()["rig"]) == ("north_rig", "south_rig")
        before = given.head
        for verb in ("arm", "hold"):
            refused = lee.command(verb, "lee")
            assert (refused["accepted"], refused["reason"]) == (False, "not_allowed")
            assert refused["text"].endswith("north_rig relays it")
            key = Keys("south_rig").command(verb)
            assert list(lee.session.get(key, payload=b'{"operator":"lee"}', timeout=patience_s())) == []
        assert given.head == before
