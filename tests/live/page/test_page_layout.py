"""Every view, size and theme in a real browser: nothing empty, cut or overlapping; legible from 3 m; nothing jumps."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser

from rigctl.model.faults import Fault
from rigctl.model.states import HeldBy, Mode
from rigctl.page.picture import Picture
from tests.builders.exclusions import contradictions
from tests.builders.page_states import Shown, charted, page_of, picture_of, show, state, tripped
from tests.builders.pages import PageView, look

SIZES = [(1920, 1080), (1440, 900), (1024, 768), (820, 1180), (390, 844)]
VIEWS = {"rig": ("#mimic", "#alarms", "#charts", "#figures"), "timing": ("#lateness", "#polar", "#timing", "#records"),
         "history": ("#events",)}  # fmt: skip
_A_DAY_S = 86_340.0  # the longest of words for how long ago
CALM = Shown("calm", state(Mode.COMPENSATING))
SILENT = Shown("bus silent", state(Mode.FAULT, fault=Fault.BUS_SILENT), tripped(Fault.BUS_SILENT))
LONG = Shown(
    "supervision", state(Mode.FAULT, fault=Fault.SUPERVISION_LOST), tripped(Fault.SUPERVISION_LOST, ago_s=_A_DAY_S)
)
MISSED = Shown("not following", state(Mode.FAULT, fault=Fault.DRIVE_NOT_FOLLOWING), tripped(Fault.DRIVE_NOT_FOLLOWING))
STATES = (CALM, SILENT, LONG, MISSED, Shown("held", state(Mode.HOLD)), Shown("disarmed", state(Mode.DISARMED)))
CAP_SHARE = 0.729  # height of a capital of DejaVu Sans, of its size

FLAWS = """(places) => {
  const flaws = [], name = (node) => node.id || node.className || node.tagName;
  const seen = (node) => node.checkVisibility({ visibilityProperty: true });
  const always = ["header", "#mode-box", "#entry-box", ".tension", "#next", "footer"];
  const areas = [...always, ...places].map((at) => document.querySelector(at));
  areas.push([...document.querySelectorAll("#alarm, #stale")].find(seen));
  for (const area of areas) {
    const box = area.getBoundingClientRect();
    if (!seen(area) || box.width < 60 || box.height < 20) flaws.push(`empty: ${name(area)} ${box.height} high`);
  }
  for (const area of document.querySelectorAll("main > section")) {
    if (seen(area) !== places.some((at) => area.matches(at))) flaws.push(`${name(area)} in another view`);
  }
  const boxes = areas.map((area) => [name(area), area.getBoundingClientRect()]);
  boxes.forEach(([a, p], i) => boxes.slice(0, i).forEach(([b, q]) => {
    const inMain = (n) => places.includes(`#${n}`);
    if (inMain(a) !== inMain(b)) return; // what scrolls is under what does not
    const across = p.left < q.right - 1 && q.left < p.right - 1, along = p.top < q.bottom - 1 && q.top < p.bottom - 1;
    if (across && along) flaws.push(`overlap: ${a} and ${b}`);
  }));
  const texts = ".big, .under, .caption, #steps, #cause-text, #stale-why, .strip .plot, .panel, header, footer";
  for (const node of document.querySelectorAll(`${texts}, footer button`)) {
    if (!seen(node)) continue;
    const scrolls = ["auto", "scroll"].includes(getComputedStyle(node).overflowY);
    const high = !node.matches(".big") && node.scrollHeight > node.clientHeight + 2;
    if (!scrolls && (high || node.scrollWidth > node.clientWidth + 2)) {
      const sizes = [node.scrollWidth, node.scrollHeight, node.clientWidth, node.clientHeight];
      flaws.push(`cut: ${name(node)} ${sizes}`);
    }
  }
  for (const plot of document.querySelectorAll(".strip .plot")) {
    if (seen(plot) && plot.clientHeight < 28) flaws.push(`chart of ${plot.clientHeight} px`);
  }
  for (const button of document.querySelectorAll("footer button, header button")) {
    const box = button.getBoundingClientRect();
    const outside = box.right > innerWidth + 1 || box.bottom > innerHeight + 1;
    if (seen(button) && outside) flaws.push(`outside: ${name(button)}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) flaws.push("wider than the screen");
  const main = document.querySelector("main");
  if (main.clientHeight < 150) flaws.push(`main is ${main.clientHeight} px high`);
  return flaws;
}"""


@pytest.fixture(scope="module")
def picture() -> Picture:
    found = picture_of(CALM)
    charted(found)
    return found


@pytest.fixture(scope="module")
def address(picture: Picture) -> Iterator[Callable[[], str]]:
    with page_of(picture) as found:
        yield found


def opened(chromium: Browser, address: str, size: tuple[int, int], theme: str = "light") -> PageView:
    seen = look(chromium, address, *size, theme)
    seen.live()
    seen.until("!document.querySelector('#commands').hidden")
    return seen


def shows(seen: PageView, picture: Picture, shown: Shown) -> None:
    """Wait until the page shows a state."""
    show(picture, shown)
    fault = shown.state["fault"] or "NONE"
    cause = f"document.querySelector('#cause').textContent === {fault!r}.replace('NONE', 'none')"
    seen.until(f"rigctl.state.mode === {shown.state['mode']!r} && {cause}")


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_nothing_is_empty_cut_or_overlapping(
    chromium: Browser, picture: Picture, address: Callable[[], str], size: tuple[int, int]
) -> None:
    for theme in ("light", "dark"):
        seen, found = opened(chromium, address(), size, theme), []
        for shown, (view, places) in itertools.product(STATES, VIEWS.items()):
            shows(seen, picture, shown)
            seen.run(f"rigctl.see({view!r})")
            flaws = seen.page.evaluate(FLAWS, list(places))
            found += [f"{shown.name}, {view}, {theme}: {flaw}" for flaw in flaws]
        seen.page.close()
        assert found == []


def test_the_measure_sees_what_is_wrong(chromium: Browser, picture: Picture, address: Callable[[], str]) -> None:
    seen = opened(chromium, address(), (1440, 900))
    shows(seen, picture, CALM)
    for harm, flaw in (
        ("document.querySelector('#mimic').style.height = '0'", "empty: mimic"),
        ("document.querySelector('#does').textContent = 'words '.repeat(90)", "cut: under"),
        ("document.querySelector('#events').hidden = false", "events in another view"),
        ("document.querySelector('#next').style.marginLeft = '-90px'", "overlap: "),
    ):
        found = seen.page.evaluate(f"(places) => {{ {harm}; return ({FLAWS})(places); }}", list(VIEWS["rig"]))
        assert any(line.startswith(flaw) for line in found), (flaw, found)
    seen.page.close()


def test_mode_tension_entry_and_cause_are_legible_from_three_metres(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen = opened(chromium, address(), (1920, 1080))
    for shown in (CALM, SILENT, Shown("held", state(Mode.HOLD))):
        shows(seen, picture, shown)
        for node in ("#mode", "#vertical", "#entry", "#cause"):
            size = seen.run(f"parseFloat(getComputedStyle(document.querySelector('{node}')).fontSize)")
            assert CAP_SHARE * size >= 54.0, (shown.name, node, size)
    seen.page.close()


@pytest.mark.parametrize("size", SIZES[:3], ids=str)
def test_nothing_jumps_between_calm_and_fault(
    chromium: Browser, picture: Picture, address: Callable[[], str], size: tuple[int, int]
) -> None:
    seen = opened(chromium, address(), size)
    where = """[...document.querySelectorAll("#now > *, #banner, #next, main > section, footer, footer button")].filter(
      (node) => node.checkVisibility()).map((node) => {
        const box = node.getBoundingClientRect();
        return [node.id || node.dataset.verb, ...[box.left, box.top, box.height].map(Math.round)];
      })"""
    places: list[Any] = []
    for shown in (CALM, SILENT, LONG):
        shows(seen, picture, shown)
        places.append(seen.run(where))
    assert places[0] == places[1] == places[2]
    seen.page.close()


def test_five_alarms_are_in_sight_on_a_small_screen(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen = opened(chromium, address(), (1024, 768))
    shows(seen, picture, SILENT)
    inside = seen.run("""(() => {
      const scroll = document.querySelector("#alarms .scroll").getBoundingClientRect();
      return [...document.querySelectorAll("#alarm-table tbody tr")].filter((row) => {
        const box = row.getBoundingClientRect();
        return box.top >= scroll.top && box.bottom <= scroll.bottom + 1;
      }).length; })()""")
    assert inside >= 5
    assert seen.text("#alarm-count").startswith("9 active")
    assert "+8 that follow" in seen.text("#cause-text")
    seen.page.close()


def test_a_value_in_doubt_is_struck_through_wherever_it_is(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen = opened(chromium, address(), (1440, 900))
    shows(seen, picture, SILENT)
    struck = "(at) => getComputedStyle(document.querySelector(at)).textDecorationLine.includes('line-through')"
    for node in (
        "#vertical",
        "#value-stroke_mm",
        "#value-speed_mm_s",
        "#value-tangential_deg",
        "#m-tension",
        "#m-stroke-text",
        "#m-angle",
    ):
        assert seen.page.evaluate(struck, node), node
    assert seen.run("document.querySelector('.bar-needle') === null")  # the gauge points nowhere
    assert "slack" not in seen.text("#mimic")
    shows(seen, picture, CALM)
    assert not seen.page.evaluate(struck, "#vertical")
    assert seen.run("document.querySelector('.bar-needle') !== null")
    seen.page.close()


def test_the_words_in_sight_do_not_contradict(chromium: Browser, picture: Picture, address: Callable[[], str]) -> None:
    """The table of exclusions on what the browser draws, not on what the server says."""
    seen = opened(chromium, address(), (1440, 900))
    faults = (Fault.BUS_SILENT, Fault.CELL_STUCK, Fault.DRIVE_FAULT, Fault.E_STOP, Fault.BRAKE_SLIPS)
    for fault, by in itertools.product(faults, (HeldBy.BRAKE, HeldBy.MOTOR)):
        shown = Shown(fault.name, state(Mode.FAULT, fault=fault, held_by=by), tripped(fault))
        shows(seen, picture, shown)
        seen.until(f"document.querySelector('#alarm-table').textContent.includes({fault.name!r})")
        lines = seen.run("document.body.innerText").splitlines()
        lines = [re.sub(r"\s+", " ", line).strip() for line in lines if line.strip()]
        assert contradictions(lines) == [], fault.name
    seen.page.close()


def test_the_gauge_keeps_its_scale_and_draws_its_limits(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen = opened(chromium, address(), (1440, 900))
    ends = []
    for newtons in (300.0, 450.0):
        shows(seen, picture, Shown("there", state(Mode.HOLD, vertical_n=newtons, tension_n=newtons)))
        seen.until(f"rigctl.state.values.vertical_n === {newtons}")
        ends.append(seen.run("[...document.querySelectorAll('#bar text')].map((node) => node.textContent)"))
        needle = seen.run("document.querySelector('.bar-needle').getBBox().x")
        assert (needle > seen.run("document.querySelectorAll('.bar-limit')[1].getBBox().x")) is (newtons > 400)
    assert ends[0] == ends[1]
    assert {"0", "500 N", "limit 20", "limit 400"} <= set(ends[0])
    seen.page.close()


def test_every_chart_has_three_ticks_at_least(chromium: Browser, picture: Picture, address: Callable[[], str]) -> None:
    for size in SIZES:
        seen = opened(chromium, address(), size)
        shows(seen, picture, CALM)
        counts = seen.run(
            "rigctl.strips.charts.map((chart) => chart.u.axes[1]._splits.filter((at) => at !== null).length)"
        )
        assert min(counts) >= 3, size
        seen.page.close()
