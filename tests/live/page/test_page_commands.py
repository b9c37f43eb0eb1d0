"""Commands given in the browser to a real daemon on the simulated rig, and the page that a daemon restarts itself."""

from __future__ import annotations

import os
import pathlib
import signal
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from playwright.sync_api import Browser

from tests.builders import daemons
from tests.builders.miniature import free_port
from tests.builders.operators import ANNA, KIM
from tests.builders.pages import PageView, Server, look, serving
from tests.builders.waiting import until

pytestmark = pytest.mark.real_time


@dataclass
class Running:
    """A daemon with a page of its own, and a page with operator rights beside it."""

    file: pathlib.Path
    log: pathlib.Path
    page_port: int
    server: Server


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("page")
    file, log, port = daemons.slow_rig_file(folder), folder / "daemon.log", free_port()
    with (
        daemons.simulated_rig(file, folder / "rig.log"),
        daemons.process("rigctl", "run", str(file), "--page-listen", f"127.0.0.1:{port}", log=log) as child,
    ):
        until(lambda: child.poll() is not None or b": DISARMED," in log.read_bytes(), log=log)
        assert child.poll() is None, log.read_text()
        with serving(daemons.endpoint(file), "--operator", "kim") as server:
            yield Running(file, log, port, server)


@pytest.fixture
def seen(chromium: Browser, running: Running) -> Iterator[PageView]:
    found = look(chromium, running.server.address)
    found.live()
    found.until("!document.querySelector('#commands').hidden")
    yield found
    found.page.close()
    running.server.command("lease", {"act": "return"})


def said(seen: PageView, words: str) -> None:
    seen.until(f"document.querySelector('#said').textContent.includes({words!r})")


def listed(seen: PageView, words: str) -> None:
    seen.until(f"document.querySelector('#event-list').textContent.includes({words!r})")


def give(seen: PageView, verb: str) -> None:
    """Click a command, read the question and confirm it."""
    seen.until(f"!document.querySelector('[data-verb={verb}]').dataset.why")
    seen.page.click(f"[data-verb={verb}]")
    seen.until("!document.querySelector('#confirm').hidden")
    assert seen.text("#confirm-text").startswith(f"{verb.upper()}: ")
    seen.page.click("#confirm-yes")


def mode(seen: PageView, wanted: str) -> None:
    seen.until(f"rigctl.state.mode === {wanted!r}")


@pytest.mark.smoke
def test_commands_go_through_lease_and_confirmation(seen: PageView, running: Running) -> None:
    assert not seen.run("document.querySelector('#hold').disabled")
    assert "kim" in seen.text("#rights")
    seen.until("!document.querySelector('[data-verb=arm]').dataset.why")

    seen.page.click("[data-verb=arm]")  # takes the free lease
    seen.until("!document.querySelector('#confirm').hidden")
    seen.page.click("#confirm-no")
    assert seen.run("rigctl.state.mode") == "DISARMED"  # it was not confirmed
    seen.until("rigctl.state.lease.mine")

    seen.page.press("[data-verb=tension]", "Enter")  # not live, but it can be reached, and says why
    said(seen, "TENSION: tension is not possible in DISARMED: arm first")
    assert "TENSION: not possible in DISARMED: arm first" in seen.text("#why-not")
    give(seen, "arm")
    said(seen, "ARM: armed, HOLD")
    mode(seen, "HOLD")
    seen.page.fill("#newtons", "1000")
    seen.page.click("[data-verb=target]")
    said(seen, "TARGET refused: found 1000, expected 50 to 350 N")  # before it is to be confirmed
    assert seen.run("document.querySelector('#confirm').hidden")
    seen.page.fill("#newtons", "60")
    give(seen, "target")
    said(seen, "TARGET: 60 N")
    give(seen, "tension")
    mode(seen, "COMPENSATING")
    said(seen, "TENSION has ended: COMPENSATING")
    assert "no emergency stop" in seen.text("#hold")
    assert seen.run("rigctl.store.extremes(rigctl.signal('error_pct')) !== null")

    seen.page.click("#hold")  # no confirmation
    said(seen, "HOLD: stroke held")
    mode(seen, "HOLD")
    give(seen, "release")
    seen.until("rigctl.state.mode === 'HOLD' && rigctl.state.values.tension_n < 6")
    give(seen, "disarm")
    mode(seen, "DISARMED")
    seen.page.click("#return")
    said(seen, "given back")
    seen.until("rigctl.state.lease.text === 'nobody holds it'")
    listed(seen, "HOLD -> DISARMED")
    errors = [error for error in seen.errors if "409" not in error]  # the browser logs each refusal
    assert not errors
    assert running.server.process.poll() is None


def test_hold_is_taken_from_the_page_whoever_holds_the_lease(seen: PageView, running: Running) -> None:
    answer = daemons.rigctl("lease", "take", "--operator", "anna", file=running.file)
    assert answer.returncode == 0, answer.stderr
    try:
        seen.until("rigctl.state.lease.text.startsWith('anna')")
        seen.page.click("#hold")
        said(seen, "HOLD refused: hold is not possible in DISARMED")  # by the loop, not for lack of a lease
        seen.page.click("[data-verb=arm]")
        seen.until(f"document.querySelector('#confirm-text').textContent.includes('{ANNA} holds the lease')")
        seen.page.fill("#reason", "she has gone home")
        seen.page.click("#confirm-yes")
        seen.until("document.querySelector('#confirm-text').textContent.startsWith('ARM: ')")
        seen.page.click("#confirm-no")
        seen.until("rigctl.state.lease.mine")
        listed(seen, f"{KIM} takes the lease over from {ANNA}: she has gone home")
    finally:
        daemons.rigctl("lease", "return", "--operator", "anna", file=running.file)


def test_a_length_is_that_of_the_release_that_takes_the_lease_over(seen: PageView, running: Running) -> None:
    """It had been dropped with the question for the reason, and what was confirmed was a ramp to a slack rope."""
    give(seen, "arm")
    mode(seen, "HOLD")
    take = daemons.rigctl("lease", "take", "--reason", "test", "--operator", "anna", file=running.file)
    assert take.returncode == 0, take.stderr
    try:
        seen.until("rigctl.state.lease.text.startsWith('anna')")
        seen.page.fill("#millimetres", "5")
        seen.page.click("[data-verb=release]")
        seen.until(f"document.querySelector('#confirm-text').textContent.includes('{ANNA} holds the lease')")
        seen.page.fill("#reason", "the rope is too short")
        seen.page.click("#confirm-yes")
        seen.until("document.querySelector('#confirm-text').textContent.startsWith('RELEASE: ')")
        assert seen.text("#confirm-text").startswith("RELEASE: pay out 5.0 mm of the slack rope")
        seen.page.click("#confirm-no")
        give(seen, "disarm")
        mode(seen, "DISARMED")
    finally:
        daemons.rigctl("lease", "return", "--operator", "anna", file=running.file)


def test_a_confirmation_holds_for_the_rig_as_it_was(seen: PageView, running: Running) -> None:
    server = running.server
    assert server.command("lease", {"act": "take"})[0] == 200
    try:
        status, first = server.command("command", {"verb": "arm"})
        assert (status, first["accepted"]) == (200, True)
        status, second = server.command("command", {"verb": "arm"})
        status, answer = server.command("confirm", {"confirm": first["confirm"]})
        assert status == 409  # another command waits
        assert "ask again" in answer["text"]
        assert server.command("confirm", {"confirm": second["confirm"]})[0] == 409  # and is spent
        status, answer = server.command("command", {"verb": "disarm"})
        assert status == 409  # what the loop would refuse is not to be confirmed first
        assert "already DISARMED" in answer["text"]
        arm = daemons.rigctl("arm", "--operator", "kim", file=running.file)
        assert arm.returncode == 1  # the name alone is not the lease
        _, arming = server.command("command", {"verb": "arm"})
        _, done = server.command("confirm", {"confirm": arming["confirm"]})
        assert done["accepted"], done
        mode(seen, "HOLD")  # the page's server has received the mode that the browser shows
        _, waiting = server.command("command", {"verb": "tension"})
        take = daemons.rigctl("lease", "take", "--reason", "test", "--operator", "anna", file=running.file)
        assert take.returncode == 0, take.stderr
        assert daemons.rigctl("disarm", "--operator", "anna", file=running.file).returncode == 0
        mode(seen, "DISARMED")
        status, answer = server.command("confirm", {"confirm": waiting["confirm"]})
        assert status == 409
        assert answer["text"] == "TENSION not given: it was HOLD, now it is DISARMED"
    finally:
        daemons.rigctl("lease", "return", "--operator", "anna", file=running.file)


def own_page(running: Running) -> int:
    return daemons.process_with("rigctl.page", daemons.name_of(running.file))


def test_the_daemons_own_page_is_read_only_and_comes_back(chromium: Browser, running: Running) -> None:
    address = f"http://127.0.0.1:{running.page_port}/"
    seen = look(chromium, address)
    seen.live()
    assert seen.text("#rights") == "read-only"
    before, lost = daemons.state(running.file), daemons.frames_lost(running.file)
    os.kill(own_page(running), signal.SIGKILL)
    seen.until("!rigctl.stale && rigctl.link.opened > 1")  # the page may be back before it has shown the data as stale
    os.kill(daemons.process_with("rigctl.gateway.gateway_process", daemons.name_of(running.file)), signal.SIGKILL)
    newest = seen.run("rigctl.store.newestMs")
    seen.until(f"!rigctl.stale && rigctl.store.newestMs > {newest} + 3000")
    seen.page.close()
    after = daemons.state(running.file)
    assert after["tick"] > before["tick"]
    assert daemons.frames_lost(running.file) == lost
    assert "page process killed by signal 9; comes back in 0.2 s; the loop is unaffected" in running.log.read_text()


def test_a_page_whose_port_is_taken_warns_once_and_waits(running: Running) -> None:
    found = own_page(running)
    already = running.log.read_text().count("it is in use")
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        os.kill(found, signal.SIGKILL)
        until(lambda: _bound(taken, running.page_port), "the port")
        taken.listen()
        until(lambda: running.log.read_text().count("it is in use") > already, "the warning")
        waiting = own_page(running)
        time.sleep(3.0)  # longer than the wait between two attempts
        assert running.log.read_text().count("it is in use") == already + 1
        assert own_page(running) == waiting
    until(lambda: running.log.read_text().count(f"page: http://127.0.0.1:{running.page_port}/") >= 2, "the page")


def _bound(taken: socket.socket, port: int) -> Any:
    try:
        taken.bind(("127.0.0.1", port))
    except OSError:
        return False
    return True
