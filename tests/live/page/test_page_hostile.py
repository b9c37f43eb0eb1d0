"""A peer publishes invalid data on the rig's keys: the page goes on showing the real rig, and reports the refusals."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.builders.hostile import hostile
from tests.builders.miniature import Daemon, running
from tests.builders.pages import Server, look
from tests.live.telemetry.test_hostile_network import answers, send_everything


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    for found in running(lets_all=True):
        found.client().close()
        yield found


def test_the_page_goes_on_showing_the_rig(chromium: Browser, readonly: Server, daemon: Daemon) -> None:
    seen = look(chromium, readonly.address)
    seen.live()
    wrong = answers(daemon)
    with hostile(daemon.endpoint, "paper_rig") as intruder:
        for key in (intruder.keys.state, intruder.keys.active, intruder.keys.events_past, intruder.keys.fast):
            intruder.answer(key, wrong)
        assert send_everything(intruder, daemon) >= 14
        seen.until("document.body.textContent.includes('messages refused')")
    newest = seen.run("rigctl.store.newestMs")
    seen.until(f"rigctl.store.newestMs > {newest} + 1000")
    with daemon.client() as client:
        daemon.answers(client)  # a query that went to the peer as it ended has no answer
        assert seen.text("#mode") == client.state()["mode"]
    assert not seen.errors
    assert readonly.process.poll() is None
    seen.page.close()
