"""Every view, size and theme in a real browser: nothing empty, cut or overlapping; legible from 3 m; nothing jumps."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser

from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode
from rigctl.page.picture import Picture
from tests.builders.exclusions import contradictions
from tests.builders.page_states import Shown, charted, event, page_of, picture_of, show, state, tripped
from tests.builders.pages import PageView, look

NOTEBOOK = (1366, 768)
SIZES = [NOTEBOOK, (1920, 1080), (1024, 768), (390, 844)]
PHONE_PX = 900
"""Up to here the page scrolls as a whole below its bar of commands."""
NARROW_PX = 1200
"""Up to here the drawing has a view of its own."""
VIEWS = {"timing": ("#lateness", "#polar", "#timing", "#records"), "history": ("#events",)}


def views(width: int) -> dict[str, tuple[str, ...]]:
    """The sections of every view."""
    if width > NARROW_PX:
        return {"rig": ("#mimic", "#alarms", "#charts", "#figures"), **VIEWS}
    return {"rig": ("#alarms", "#charts"), "drawing": ("#mimic", "#figures"), **VIEWS}


_A_DAY_S = 86_340.0  # the longest of words for how long ago
CALM = Shown("calm", state(Mode.COMPENSATING))
SILENT = Shown("bus silent", state(Mode.FAULT, fault=Fault.BUS_SILENT), tripped(Fault.BUS_SILENT))
LONG = Shown(
    "supervision", state(Mode.FAULT, fault=Fault.SUPERVISION_LOST), tripped(Fault.SUPERVISION_LOST, ago_s=_A_DAY_S)
)
MISSED = Shown("not following", state(Mode.FAULT, fault=Fault.DRIVE_NOT_FOLLOWING), tripped(Fault.DRIVE_NOT_FOLLOWING))
FALLS = Shown("falls", state(Mode.FAULT, fault=Fault.BRAKE_SLIPS, held_by=HeldBy.BRAKE), tripped(Fault.BRAKE_SLIPS))
CHATTERS = Shown(
    "chatters",
    state(Mode.FAULT, fault=Fault.E_STOP),
    [
        *(event(kind, -60.0 + n, Fault.LIMIT, Action.LOG, 4142.0, 2000.0, f"{signal} above")
          for n in range(42) for kind in (Kind.LIMIT, Kind.LIMIT_OVER)
          for signal in ("lateness_us", "skipped_ticks", "cell_age_ms")),
        *tripped(Fault.E_STOP), *tripped(Fault.DRIVE_EMERGENCY)[1:2], *tripped(Fault.DRIVE_FAULT)[1:2],
    ],
)  # fmt: skip
FAULTS = (Fault.DRIVE_FAULT, Fault.E_STOP, Fault.CELL_STALE, Fault.TENSION_HIGH, Fault.LOAD_UNSEEN, Fault.STROKE_JUMPED)
BARRED = {"failing": {check.name: check.words for check in Check}, "waived": {}}
STATES = (
    CALM, SILENT, LONG, MISSED, FALLS, CHATTERS,
    *(Shown(mode.name, state(mode)) for mode in Mode if mode not in (Mode.FAULT, Mode.COMPENSATING)),
    *(Shown(fault.name, state(Mode.FAULT, fault=fault), tripped(fault)) for fault in FAULTS),
    Shown("barred", state(Mode.DISARMED, checks=1, preflight=BARRED)),
)  # fmt: skip
CAP_SHARE = 0.729  # height of a capital of DejaVu Sans, of its size

_FLAWS = """(places) => {
  const flaws = [], name = (node) => node.id || node.className || node.tagName;
  const seen = (node) => node.checkVisibility({ visibilityProperty: true });
  const always = ["header", "#mode-box", "#entry-box", ".tension", "#next", "footer"];
  const areas = [...always, ...places].map((at) => document.querySelector(at));
  areas.push(...[...document.querySelectorAll("#alarm, #stale")].filter(seen));
  for (const area of areas) {
    const box = area.getBoundingClientRect();
    if (!seen(area) || box.width < 60 || box.height < 20) flaws.push(`empty: ${name(area)} ${box.height} high`);
  }
  for (const at of ["#mode", "#entry", "#vertical", "#hold"]) {
    if (!seen(document.querySelector(at))) flaws.push(`hidden: ${at}`);
  }
  for (const area of document.querySelectorAll("main > section")) {
    if (seen(area) !== places.some((at) => area.matches(at))) flaws.push(`${name(area)} in another view`);
  }
  const boxes = areas.map((area) => [name(area), area.getBoundingClientRect()]);
  boxes.forEach(([a, p], i) => boxes.slice(0, i).forEach(([b, q]) => {
    const inMain = (n) => places.includes(`#${n}`);
    if (inMain(a) !== inMain(b)) return; // what scrolls is under what does not
    if (innerWidth <= PHONE_PX && [a, b].includes("commands")) return; // and all of a phone's page is
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
    if (seen(plot) && plot.clientHeight < 44) flaws.push(`chart of ${plot.clientHeight} px`);
  }
  const letter = (node) => parseFloat(getComputedStyle(node).fontSize) * node.getScreenCTM().a;
  for (const node of document.querySelectorAll("#mimic text")) {
    const px = letter(node);
    if (seen(node) && node.textContent && px < 9) flaws.push(`letters of ${px.toFixed(1)} px: ${name(node)}`);
  }
  for (const node of document.querySelectorAll(".tools button, #cursor, #alarms button, #alarms td, #figures dd")) {
    const box = node.getBoundingClientRect(), inside = node.closest("main > section").getBoundingClientRect();
    const beyond = box.right > inside.right + 1 || box.left < inside.left - 1;
    if (seen(node) && beyond) flaws.push(`beyond its section: ${name(node)}`);
  }
  const scroll = document.querySelector("#alarms .scroll"), more = document.querySelector("#more-alarms");
  const hides = scroll.scrollHeight > scroll.clientHeight + 24;
  if (seen(scroll) && hides && more.hidden) flaws.push("no sign of more alarms");
  for (const button of document.querySelectorAll("footer button, header button")) {
    const box = button.getBoundingClientRect();
    const outside = box.right > innerWidth + 1 || box.bottom > innerHeight + 1;
    if (seen(button) && outside) flaws.push(`outside: ${name(button)}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) flaws.push("wider than the screen");
  const main = document.querySelector("main");
  if (main.clientHeight < 170) flaws.push(`main is ${main.clientHeight} px high`);
  return flaws;
}"""

FLAWS = _FLAWS.replace("PHONE_PX", str(PHONE_PX))


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
    cause = f"document.querySelector('#cause').textContent === {fault!r}.replace('NONE', '')"
    seen.until(f"rigctl.state.mode === {shown.state['mode']!r} && {cause}")


def flaws_of(seen: PageView, picture: Picture, states: tuple[Shown, ...], width: int) -> list[str]:
    """What is empty, cut, covered or out of reach in these states, in every view."""
    found = []
    for shown, (view, places) in itertools.product(states, views(width).items()):
        shows(seen, picture, shown)
        seen.run(f"rigctl.see({view!r})")
        found += [f"{shown.name}, {view}: {flaw}" for flaw in seen.page.evaluate(FLAWS, list(places))]
    return found


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_nothing_is_empty_cut_or_overlapping(
    chromium: Browser, picture: Picture, address: Callable[[], str], size: tuple[int, int]
) -> None:
    seen = opened(chromium, address(), size)
    assert flaws_of(seen, picture, STATES, size[0]) == []
    seen.page.emulate_media(color_scheme="dark")
    assert flaws_of(seen, picture, (CALM, SILENT), size[0]) == []
    seen.page.close()


@pytest.mark.smoke
def test_a_notebook_shows_all_of_a_run_and_of_a_fault(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen = opened(chromium, address(), NOTEBOOK)
    assert flaws_of(seen, picture, (CALM, SILENT, FALLS), NOTEBOOK[0]) == []
    asks(seen)
    seen.page.close()


CONFIRMED = """() => {
  const flaws = [], box = (node) => node.getBoundingClientRect();
  for (const at of ["#confirm", "#confirm-text", "#reason", "#confirm-yes", "#confirm-no"]) {
    const node = document.querySelector(at), { left, right, top, bottom, width, height } = box(node);
    if (!node.checkVisibility()) continue;
    if (left < 0 || right > innerWidth + 1 || top < 0 || bottom > innerHeight + 1) flaws.push(`outside: ${at}`);
    if (node.scrollWidth > node.clientWidth + 2 || node.scrollHeight > node.clientHeight + 2) flaws.push(`cut: ${at}`);
    const hit = document.elementFromPoint(left + width / 2, top + height / 2);
    if (!node.contains(hit)) flaws.push(`covered: ${at} by ${hit?.id || hit?.className}`);
  }
  return flaws;
}"""
QUESTION = (
    "CARRY: the motor holds the load for 3600 s, then lowers it; the brake is known not to hold, and the rope is slack "
    "in 160 s"
)


def asks(seen: PageView) -> None:
    """The longest question, and the longest with a reason, are all in sight."""
    for more in ({"confirm": "1"}, {"holder": "anna on the other side of the hall", "verb": "brake_test"}):
        seen.page.evaluate("(proposal) => rigctl.commands.ask(proposal)", {"text": QUESTION, "for_s": 60, **more})
        assert seen.page.evaluate(CONFIRMED) == []
        seen.run("rigctl.commands.ask(null)")


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_a_confirmation_has_the_width_it_needs(
    chromium: Browser, picture: Picture, address: Callable[[], str], size: tuple[int, int]
) -> None:
    seen = opened(chromium, address(), size)
    for shown in (CALM, SILENT, FALLS):
        shows(seen, picture, shown)
        asks(seen)
    seen.page.close()


def test_a_load_that_may_move_looks_unlike_a_run(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen, colours = opened(chromium, address(), NOTEBOOK), []
    for shown in (CALM, FALLS):
        shows(seen, picture, shown)
        assert seen.text("#entry") == "KEEP OUT"
        colours.append(seen.run("getComputedStyle(document.querySelector('#entry-box')).backgroundColor"))
    assert colours[0] != colours[1]
    seen.page.close()


def test_a_slack_rope_has_its_payload_on_the_floor_and_no_flickering_tension(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen, floor = (
        opened(chromium, address(), (1920, 1080)),
        "document.querySelector('#mimic .floor').getBoundingClientRect().top",
    )
    for newtons in (-0.03, 0.05):
        shows(seen, picture, Shown("slack", state(Mode.DISARMED, vertical_n=newtons, tension_n=newtons)))
        seen.until(f"rigctl.state.values.vertical_n === {newtons}")
        assert seen.text("#vertical") == "0"
        gap = seen.run(f"{floor} - document.querySelector('#m-load').getBoundingClientRect().bottom")
        assert abs(gap) < 4.0
    shows(seen, picture, CALM)
    assert seen.run(f"{floor} - document.querySelector('#m-load').getBoundingClientRect().bottom") > 20.0
    seen.page.close()


def test_an_old_sample_is_that_of_its_device(chromium: Browser, picture: Picture, address: Callable[[], str]) -> None:
    seen = opened(chromium, address(), NOTEBOOK)
    shows(seen, picture, Shown("old", state(Mode.COMPENSATING, lost=frozenset({"inclination"}))))
    seen.until("document.querySelector('#age').textContent.includes('inclinometer')")
    assert re.fullmatch(r"0\.\d s old, inclinometer 8\.\d s", seen.text("#age"))
    seen.page.close()


def test_the_measure_sees_what_is_wrong(chromium: Browser, picture: Picture, address: Callable[[], str]) -> None:
    seen = opened(chromium, address(), (1920, 1080))
    shows(seen, picture, CALM)
    for harm, flaw in (
        ("document.querySelector('#mimic svg').style.height = '60px'", "letters of"),
        ("document.querySelector('#mimic').style.height = '0'", "empty: mimic"),
        ("document.querySelector('#does').textContent = 'words '.repeat(90)", "cut: under"),
        ("document.querySelector('#events').hidden = false", "events in another view"),
        ("document.querySelector('#entry-box').style.marginLeft = '-90px'", "overlap: "),
    ):
        found = seen.page.evaluate(f"(places) => {{ {harm}; return ({FLAWS})(places); }}", list(views(1920)["rig"]))
        assert any(line.startswith(flaw) for line in found), (flaw, found)
    seen.page.close()


def test_mode_tension_entry_and_cause_are_legible_from_three_metres(
    chromium: Browser, picture: Picture, address: Callable[[], str]
) -> None:
    seen = opened(chromium, address(), (1920, 1080))
    for shown in (CALM, SILENT, Shown("held", state(Mode.HOLD))):
        shows(seen, picture, shown)
        for node in ("#mode", "#vertical", "#entry", *(("#cause",) if shown is SILENT else ())):
            size = seen.run(f"parseFloat(getComputedStyle(document.querySelector('{node}')).fontSize)")
            assert CAP_SHARE * size >= 54.0, (shown.name, node, size)
    seen.page.close()


@pytest.mark.parametrize("size", SIZES[:3], ids=str)
def test_the_bar_of_commands_and_what_is_above_the_banner_stay_in_place(
    chromium: Browser, picture: Picture, address: Callable[[], str], size: tuple[int, int]
) -> None:
    """The banner has one line while nothing is wrong; a button that is about to be pressed does not move with it."""
    seen = opened(chromium, address(), size)
    where = """[...document.querySelectorAll("#now > *, footer, footer button")].filter(
      (node) => node.checkVisibility()).map((node) => {
        const box = node.getBoundingClientRect();
        return [node.id || node.dataset.verb, ...[box.left, box.top, box.height].map(Math.round)];
      })"""
    places: list[Any] = []
    heights = []
    for shown in (CALM, SILENT, LONG):
        shows(seen, picture, shown)
        places.append(seen.run(where))
        heights.append(seen.run("document.querySelector('#banner').clientHeight"))
    assert places[0] == places[1] == places[2]
    assert heights[0] < 40 < heights[1]
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
