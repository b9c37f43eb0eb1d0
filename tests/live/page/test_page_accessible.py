"""The page for everyone: WCAG 2.2 AA by axe, every command by keyboard, HOLD in reach on every screen."""

from __future__ import annotations

import pathlib
from typing import Any

import axe_playwright_python
import pytest
from playwright.sync_api import Browser

from tests.builders.operators import KIM
from tests.builders.pages import PageView, Server, look, new_page
from tests.builders.stand_in import TRIP_N

AXE = pathlib.Path(axe_playwright_python.__file__).with_name("axe.min.js")
WCAG = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
PHONE_PX = 900
"""Up to here the page scrolls as a whole below its bar of commands."""
SIZES = [(1920, 1080), (1180, 820), (1024, 768), (390, 844)]
VIEWS = ("rig", "drawing", "timing", "history")


def violations(seen: PageView) -> list[str]:
    """What axe finds, one line for each rule and place."""
    if not seen.run("'axe' in window"):
        seen.page.context.new_cdp_session(seen.page).send("Runtime.evaluate", {"expression": AXE.read_text()})
    found: dict[str, Any] = seen.page.evaluate("(tags) => axe.run({ runOnly: { type: 'tag', values: tags } })", WCAG)
    return [
        f"{rule['id']}: {node['target']} {node.get('failureSummary', '')[:300]}"
        for rule in found["violations"]
        for node in rule["nodes"]
    ]


@pytest.mark.parametrize(
    ("width", "height", "theme"),
    [
        pytest.param(*size, theme, marks=() if (number + dark) % 2 else pytest.mark.long)
        for number, size in enumerate(SIZES)
        for dark, theme in enumerate(("light", "dark"))
    ],
)
def test_axe_finds_nothing_wrong(chromium: Browser, commanding: Server, width: int, height: int, theme: str) -> None:
    seen = look(chromium, commanding.address, width, height, theme)
    seen.live()
    seen.until("!document.querySelector('#commands').hidden")
    for view in VIEWS:
        seen.run(f"rigctl.see({view!r})")
        assert violations(seen) == [], view
    seen.page.close()


def test_axe_sees_what_is_wrong(chromium: Browser, readonly: Server) -> None:
    """The test above would fail: a button without a name and grey on grey are found."""
    seen = look(chromium, readonly.address)
    seen.live()
    seen.run("document.querySelector('main').append(document.createElement('button'))")
    seen.run("document.querySelector('#rig').style.color = '#c8c8c8'")
    rules = {line.partition(":")[0] for line in violations(seen)}
    assert {"button-name", "color-contrast"} <= rules
    seen.page.close()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_hold_is_in_sight_and_covers_nothing(chromium: Browser, commanding: Server, width: int, height: int) -> None:
    seen = look(chromium, commanding.address, width, height)
    seen.live()
    seen.until("!document.querySelector('#commands').hidden")
    for scroll in (0, 10_000):
        for view in VIEWS:
            seen.run(f"(rigctl.see({view!r}), document.querySelector('main').scrollTo(0, {scroll}))")
            hold = seen.run("document.querySelector('#hold').getBoundingClientRect().toJSON()")
            assert hold["top"] >= 0
            assert hold["bottom"] <= height
            assert hold["width"] >= 60
            assert hold["height"] >= 40
            above = seen.run(
                "(({ left, top, width, height }) => document.elementFromPoint(left + width / 2, top + height / 2).id)"
                "(document.querySelector('#hold').getBoundingClientRect())"
            )
            assert above == "hold"
            overlaps = seen.run(
                """(() => { scrollTo(0, document.body.scrollHeight); // a phone's page scrolls under the bar
                const main = document.querySelector("main").getBoundingClientRect();
                const footer = document.querySelector("footer").getBoundingClientRect();
                return main.bottom > footer.top + 1; })()"""
            )
            assert not overlaps
    if width > PHONE_PX:
        assert seen.run("document.documentElement.scrollHeight <= innerHeight + 1")
    assert seen.run("document.documentElement.scrollWidth <= innerWidth")
    seen.page.close()


def tab_to(seen: PageView, selector: str) -> None:
    """Reach an element by the Tab key alone."""
    for _ in range(80):
        seen.page.keyboard.press("Tab")
        if seen.run(f"document.activeElement?.matches({selector!r})"):
            return
    raise AssertionError(f"{selector} is not reached by Tab")


def test_every_command_is_given_by_keyboard(chromium: Browser, own_page: Server) -> None:
    """Lease, arm, target, tension, alarm, reset and HOLD without a mouse; the focus is never lost."""
    seen = look(chromium, own_page.address)
    seen.live()
    seen.until("!document.querySelector('#commands').hidden")
    keys = seen.page.keyboard

    def said(words: str) -> None:
        seen.until(f"document.querySelector('#said').textContent.includes({words!r})")

    def ask(verb: str) -> None:
        seen.until(f"!document.querySelector('[data-verb={verb}]').dataset.why")  # the state follows the answer
        tab_to(seen, f"[data-verb={verb}]")
        keys.press("Enter")
        seen.until("document.activeElement.id === 'confirm-yes'")

    def give(verb: str, words: str) -> None:
        ask(verb)
        keys.press("Enter")
        said(words)

    give("arm", "ARM: armed")
    ask("tension")
    keys.press("Escape")
    seen.until("document.querySelector('#confirm').hidden")
    assert seen.run("document.activeElement.id") == "hold"
    keys.press("Enter")
    said("HOLD")
    tab_to(seen, "#newtons")
    keys.type(str(TRIP_N))
    keys.press("Enter")  # this target trips the loop's stand-in
    seen.until("document.activeElement.id === 'confirm-yes'")
    keys.press("Enter")
    seen.until("rigctl.state.mode === 'FAULT'")
    seen.until("document.querySelector('#banner').dataset.tone === 'fault'")
    for words in ("TENSION_HIGH", "limit 400.0 N"):
        seen.until(f"document.querySelector('#alarm').textContent.includes({words!r})")
    assert "RESET." in seen.text("#steps")
    tab_to(seen, "[data-act=shelve]")
    keys.press("Enter")
    seen.until("document.activeElement.id === 'shelve-reason'")
    keys.type("a test")
    keys.press("Enter")
    said(f"{KIM} shelves the alarm TENSION_HIGH for 1800 s: a test")
    seen.until("rigctl.state.alarms[0].shelved !== null")
    tab_to(seen, "[data-act=unshelve]")
    keys.press("Enter")
    said("from the shelf")
    give("reset", "RESET")
    seen.until("rigctl.state.mode !== 'FAULT' && document.querySelector('#banner').dataset.tone === 'calm'")
    tab_to(seen, "#views [data-view=history]")
    keys.press("Enter")
    assert seen.run("document.querySelector('#events').checkVisibility()")
    seen.page.close()


def test_the_charts_are_worked_by_keyboard(chromium: Browser, readonly: Server) -> None:
    seen = look(chromium, readonly.address)
    seen.live()
    tab_to(seen, "#pause")
    seen.page.keyboard.press("Enter")
    assert seen.run("rigctl.strips.paused")
    seen.until("rigctl.strips.settled")
    before, draws = seen.run("rigctl.strips.charts[0].u.scales.x.max"), seen.run("rigctl.draws")
    newest = seen.run("rigctl.store.newestMs")
    seen.until(f"rigctl.store.newestMs > {newest} + 1000")
    assert seen.run("rigctl.strips.charts[0].u.scales.x.max") == before
    assert seen.run("rigctl.draws") - draws <= 2
    seen.page.focus("#strips")
    seen.page.keyboard.press("ArrowLeft")
    seen.until("document.querySelector('#cursor').textContent.includes('stroke')")
    seen.page.click("#closer")
    seen.until("rigctl.strips.span === 30")
    seen.page.click("#back")
    seen.until(f"rigctl.strips.charts[0].u.scales.x.max < {before}")
    seen.page.click("#marker")
    assert seen.run("rigctl.strips.marks.length") == 1
    seen.page.focus("#strips")
    seen.page.keyboard.press("Escape")
    seen.until("!rigctl.strips.paused")
    seen.page.close()


def test_a_scroll_back_beyond_the_window_asks_for_older_data(chromium: Browser, readonly: Server) -> None:
    seen = look(chromium, readonly.address)
    seen.live()
    for _ in range(3):
        seen.page.click("#back")
    seen.until("rigctl.store.window === 1")
    assert seen.run("rigctl.strips.paused")
    seen.page.click("#pause")
    seen.until("rigctl.store.window === 0")
    seen.page.close()


def test_the_window_is_kept(chromium: Browser, readonly: Server) -> None:
    page = new_page(chromium)
    seen = PageView(page)
    page.goto(readonly.address)
    seen.live()
    page.click("#windows button:nth-child(3)")
    page.reload()
    seen.until("window.rigctl && rigctl.store.window === 2")
    assert seen.run("document.querySelector('#windows [aria-pressed=true]').textContent") == "15 min"
    page.close()


def test_the_history_leaves_timing_out_until_it_is_asked_for(chromium: Browser, readonly: Server) -> None:
    seen = look(chromium, readonly.address)
    seen.live()
    seen.run("""rigctl.events.take([
      { severity: "warning", text: "3 ticks skipped at once", wall_ms: 1, kind: "CLOCK", timing: true },
      { severity: "error", text: "trip", wall_ms: 2, kind: "TRIP", timing: false },
      { severity: "info", text: "armed", wall_ms: 3, kind: "MODE", timing: false }])""")
    assert "skipped" not in seen.text("#event-list")
    seen.run("rigctl.see('history')")
    seen.page.check("#show-timing")
    assert "skipped" in seen.text("#event-list")
    seen.page.uncheck("#show-info")
    assert "armed" not in seen.text("#event-list")
    seen.page.fill("#show-text", "TRIP")
    assert seen.run("document.querySelector('#event-list').children.length") == 1
    seen.page.close()
