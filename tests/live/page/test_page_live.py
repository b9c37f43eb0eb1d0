"""The page in a real browser, over real sessions: charts that move, restarts that it survives, stale data."""

from __future__ import annotations

import contextlib
import re
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Browser

from rigctl.ipc.record import RECORD
from rigctl.page.history import WINDOWS_S
from tests.builders.miniature import Daemon, free_port, running
from tests.builders.pages import PageView, Server, look, serving

TENSION = "rigctl.strips.charts[0]"
EXTREMES = "(y) => [Math.min(...y.filter((v) => v != null)), Math.max(...y.filter((v) => v != null))]"
DRAWN = f"{TENSION}.u.ctx.canvas.toDataURL()"


@contextlib.contextmanager
def view(chromium: Browser, server: Server, width: int = 1280, height: int = 800) -> Iterator[PageView]:
    found = look(chromium, server.address, width, height)
    try:
        found.live()
        yield found
    finally:
        found.page.close()


def test_charts_move_with_the_data(chromium: Browser, readonly: Server) -> None:
    with view(chromium, readonly) as seen:
        newest, drawn = seen.run("rigctl.store.newestMs"), seen.run(DRAWN)
        seen.until(f"rigctl.store.newestMs > {newest} + 1000")
        assert seen.run(DRAWN) != drawn
        assert not seen.errors


def test_no_other_host_gets_a_request(chromium: Browser, readonly: Server) -> None:
    with view(chromium, readonly) as seen:
        for window in range(len(WINDOWS_S)):
            seen.page.click(f"#windows button:nth-child({window + 1})")
            seen.until(f"rigctl.store.window === {window}")
        seen.page.click("#theme")
        hosts = {url.split("/")[2] for url in seen.asked}
        assert hosts == {f"127.0.0.1:{readonly.port}"}
        assert len(seen.asked) > 10
        assert not seen.errors


def test_what_the_page_says_is_what_the_daemon_says(chromium: Browser, readonly: Server, daemon: Daemon) -> None:
    with daemon.client() as client:
        state = client.state()
        text = client.past_events()[0]["text"]
    with view(chromium, readonly) as seen:
        assert seen.text("#mode") == state["mode"]
        assert seen.text("#value-target_n") == f"{state['target_n']:.1f} N"
        assert seen.text("#rig") == daemon.settings.rig
        assert text in seen.text("#event-list")
        assert "nobody holds it" in seen.text("#rows")
        for words in state["warnings"]:
            assert words in seen.text("#record-rows")
        assert seen.run("document.querySelector('#commands').hidden")


def test_a_page_opened_late_shows_the_past_at_once(chromium: Browser, readonly: Server) -> None:
    """It has the server's history and, before the server's start, the content of the daemon's rings."""
    with view(chromium, readonly) as seen:
        seconds = seen.run("rigctl.store.low[0].filter((value) => value === value).length") * 0.05
        oldest = seen.run("performance.now()") / 1000
        assert seconds > oldest + 1


def test_both_themes_are_the_readers_choice(chromium: Browser, readonly: Server) -> None:
    back = "getComputedStyle(document.body).backgroundColor"
    for preferred in ("light", "dark"):
        seen = look(chromium, readonly.address, theme=preferred)
        assert seen.run("document.documentElement.dataset.theme") == preferred
        before = seen.run(back)
        seen.page.click("#theme")
        assert seen.run("document.documentElement.dataset.theme") != preferred
        assert seen.run(back) != before
        seen.page.reload()
        assert seen.run("document.documentElement.dataset.theme") != preferred
        seen.run("localStorage.clear()")
        seen.page.close()


@pytest.fixture
def own() -> Iterator[Daemon]:
    yield from running()


def test_the_page_survives_a_killed_gateway(chromium: Browser, own: Daemon) -> None:
    own.client().close()
    with serving(own.endpoint) as server, view(chromium, server) as seen:
        own.kill_gateway()
        seen.until("rigctl.stale")
        assert seen.text("#stale-what").startswith("NO DATA FOR ")
        assert own.endpoint in seen.text("#stale-why")
        seen.until("document.querySelector('#stale-why').textContent.includes('HOLD')")  # whether it works
        assert seen.text("#entry") == "KEEP OUT"
        assert float(seen.run("getComputedStyle(document.querySelector('#next')).opacity")) == 1.0  # instructions live
        assert float(seen.run("getComputedStyle(document.querySelector('main')).opacity")) < 0.5
        before, draws = seen.run("rigctl.store.newestMs"), seen.run("rigctl.draws")
        own.start_gateway()
        seen.until(f"!rigctl.stale && rigctl.store.newestMs > {before} + 2000 && rigctl.draws > {draws}")
        assert seen.run("rigctl.state.samples_lost") == 0  # the gap was queried again, and filled
        assert seen.run("rigctl.link.opened") == 1
        assert not seen.errors


def test_the_page_survives_a_killed_page_server(chromium: Browser, daemon: Daemon) -> None:
    port = free_port()
    with serving(daemon.endpoint, port=port) as first, view(chromium, first) as seen:
        first.end(signal.SIGKILL)
        seen.until("rigctl.stale")
        # A server that was silent itself before its end is named once it is silent for longer.
        seen.until("document.querySelector('#stale-why').textContent.includes('page server')")
        # Stale data do not move the charts; a busy browser draws the last frame a little later.
        drawn = [seen.run(DRAWN)]
        while len(drawn) < 6 and (len(drawn) < 2 or drawn[-1] != drawn[-2]):
            time.sleep(0.5)
            drawn.append(seen.run(DRAWN))
        assert drawn[-1] == drawn[-2]
        with serving(daemon.endpoint, port=port):
            before = seen.run("rigctl.store.newestMs")
            seen.until(f"!rigctl.stale && rigctl.link.opened === 2 && rigctl.store.newestMs > {before} + 1000")
            # A request that was under way at the kill is reset.
            others = [error for error in seen.errors if not re.search("ERR_CONNECTION_(REFUSED|RESET)", error)]
            assert not others


def test_a_link_that_took_long_to_open_is_kept(chromium: Browser, readonly: Server) -> None:
    """A page server that starts on a busy computer accepts at once and answers seconds later."""
    with view(chromium, readonly) as seen:
        state = seen.run("((link) => { link.heard -= 60000; link.socket.onopen(); link.look(); "
                         "return link.socket.readyState; })(rigctl.link)")  # fmt: skip
        assert state == 1, "found a link that is closed as silent, expected an open one"


def test_without_a_daemon_the_page_says_so_and_waits_for_one(chromium: Browser) -> None:
    own = Daemon()
    try:
        with serving(own.endpoint) as server:
            assert f"no daemon answers at {own.endpoint}" in server.said
            seen = look(chromium, server.address)
            seen.until("document.querySelector('#stale-why').textContent.includes('no daemon answers')")
            assert seen.text("#stale-what") == "NO DATA"
            own.start_loop()
            own.start_gateway()
            seen.live()
            assert seen.text("#mode") == "DISARMED"
            seen.page.close()
            assert server.end() == (0, "")
    finally:
        own.close()


def test_a_spike_of_one_tick_is_seen_in_every_window(chromium: Browser) -> None:
    own = Daemon()
    try:
        writer = own.runtime.records.writer()
        own.start_gateway()
        values = dict.fromkeys((field.name for field in RECORD.fields), 0)
        start = time.monotonic_ns() - 4_000_000_000
        with serving(own.endpoint) as server:
            seen = look(chromium, server.address)
            for tick in range(4000):
                spike = {1000: 777.0, 2500: -55.0}.get(tick, 100.0)
                now = {"t_ns": start + tick * 1_000_000, "tick": tick, "vertical_n": spike, "target_n": 300.0}
                writer.write(*(values | now).values())
            for window in range(len(WINDOWS_S)):
                seen.until("window.rigctl && rigctl.signal('vertical_n') === 0")
                seen.run(f"rigctl.choose({window})")
                seen.until(f"rigctl.store.window === {window} && rigctl.store.newest > 0")
                seen.until("JSON.stringify(rigctl.store.extremes(0)) === '[-55,777]'")
                seen.until(f"JSON.stringify(({EXTREMES})({TENSION}.y)) === '[-55,777]'")
                low, high = np.array(seen.run(f"{TENSION}.range"))
                assert low <= -55
                assert high >= 777
            seen.page.close()
    finally:
        own.close()
