"""The page is self-contained, shows all it must, and prints."""

from __future__ import annotations

import base64
import pathlib
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from rigctl.model.states import Mode
from rigctl.recorder.audit_log import Item
from rigctl.recorder.recording import read
from rigctl.report.findings import find
from rigctl.report.page import render
from tests.builders.pages import browser, new_page
from tests.builders.synthetic import OFFSET_NS, Floats, mode_events, run, stay, write

CHARTS = 8
HOSTILE = "<script src=http://example.org/x.js></script>"
LEARNT = "move 1: 0.019 N rms, 0.033 N in the first; learnt from 2 moves"
_LINKS = {"src", "href", "xlink:href", "srcset", "data", "action", "poster", "background"}


def noisy(t_s: Floats) -> Floats:
    return np.random.default_rng(1).normal(0.0, 0.03, len(t_s)) + 0.05 * np.sin(2 * np.pi * 2.24 * t_s)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The report of a run with two phases, a trip and an operator with a hostile name."""
    folder = tmp_path_factory.mktemp("report")
    records = run(
        stay(Mode.HOLD, 1.0), stay(Mode.COMPENSATING, 20.0, noisy), stay(Mode.HOLD, 1.0),
        stay(Mode.COMPENSATING, 5.0, noisy, target_n=250.0), stay(Mode.FAULT, 1.0),
    )  # fmt: skip
    t_ns = int(records["t_ns"][27_000])
    said = [
        *mode_events(records),
        Item(t_ns, t_ns + OFFSET_NS, "trip", "trip E_STOP: pressed", "", {"severity": "error"}, "events", 9),
        Item(t_ns, t_ns + OFFSET_NS, "trip_dump", "", "", {"file": "synthetic-E_STOP.mcap"}, "audit", 1),
        Item(t_ns, t_ns + OFFSET_NS, "learnt", LEARNT, "", {"severity": "info"}, "events", 10),
        Item(t_ns + 1, t_ns + 1 + OFFSET_NS, "lease_taken", HOSTILE, HOSTILE, {}, "notes", 1),
    ]  # fmt: skip
    found = folder / "report.html"
    found.write_text(render(find(read(write(folder / "run.mcap", records, said), frames=False))))
    return found


class Links(HTMLParser):
    """Every resource and link in a page's markup."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.found += [value or "" for name, value in attrs if name in _LINKS]


def test_nothing_in_it_points_outside(page: pathlib.Path) -> None:
    text = page.read_text()
    links = Links()
    links.feed(text)
    assert len(links.found) == CHARTS
    assert all(link.startswith("data:image/svg+xml;base64,") for link in links.found)
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(links.tags)
    css = re.search(r"<style>(.*?)</style>", text, re.DOTALL)
    assert css is not None
    assert "url(" not in css[1]
    assert "@import" not in css[1]
    for link in links.found:
        svg = base64.b64decode(link.partition(",")[2]).decode()
        inside = Links()
        inside.feed(svg)
        assert all(target.startswith("#") for target in inside.found)
        assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", svg))
        assert "<script" not in svg
        assert set(re.findall(r'https?://[^"]*', svg)) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_what_a_recording_says_is_text_and_nothing_else(page: pathlib.Path) -> None:
    text = page.read_text()
    assert HOSTILE not in text
    assert "&lt;script src=http://example.org/x.js&gt;" in text


def test_it_names_its_data_and_their_basis(page: pathlib.Path) -> None:
    text = page.read_text()
    (file,) = read(page.with_name("run.mcap"), frames=False).files
    assert file.sha256 in text
    assert "It is not the true force" in text
    assert "±0.065 %" in text  # sensor budget: 0.195 N of 300 N
    assert "synthetic-E_STOP.mcap" in text
    assert text.count("target_n: 300.0") == 1  # the whole configuration


def test_it_lists_the_moves_that_were_learnt_from(page: pathlib.Path) -> None:
    text = page.read_text()
    assert text.count(LEARNT) == 2, "in the table of moves and among the events"


def test_a_browser_shows_every_chart_asks_for_nothing_and_prints_no_blank_page(page: pathlib.Path) -> None:
    asked: list[str] = []
    complaints: list[str] = []
    with browser() as chromium:
        tab = new_page(chromium, offline=True)
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("console", lambda message: complaints.append(message.text))
        tab.goto(page.as_uri())
        shown = tab.evaluate("Array.from(document.images, image => image.complete && image.naturalWidth > 300)")
        wide = tab.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        printed = tab.pdf(prefer_css_page_size=True)
    assert [url for url in asked if not url.startswith("data:")] == [page.as_uri()]
    assert complaints == []
    assert shown == [True] * CHARTS
    assert wide == 0
    contents = pdf_pages(printed)
    assert 5 <= len(contents) <= 15
    assert min(contents) > 3000  # a blank page with its footer has 1200


def pdf_pages(data: bytes) -> list[int]:
    """Bytes of drawing on each page of a PDF as Chromium writes it."""
    objects = {int(number): body for number, body in re.findall(rb"(?s)\n(\d+) 0 obj\s(.*?)\sendobj", data)}
    found = []
    for body in objects.values():
        if re.search(rb"/Type\s*/Page\b", body) and (contents := re.search(rb"/Contents (\d+) 0 R", body)):
            stream = objects[int(contents[1])].partition(b"stream")[2].lstrip(b"\r\n")
            found.append(len(zlib.decompressobj().decompress(stream)))
    return found
