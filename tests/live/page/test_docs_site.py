"""The documentation site, built and served by the page, in a browser that reaches nothing but this server."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from rigctl.page.server import SITE
from tests.builders import pages
from tests.builders.miniature import Daemon
from tests.builders.paths import ROOT


@pytest.fixture(scope="module")
def documented(daemon: Daemon) -> Iterator[pages.Server]:
    config = str(ROOT / "deploy/docs/mkdocs.yml")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-f", config],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    with pages.serving(daemon.endpoint) as server:
        yield server


@pytest.fixture
def reader(chromium: Browser, documented: pages.Server) -> Iterator[tuple[Page, list[str]]]:
    """A tab with the first page, and what the browser refused or asked of another host."""
    tab = pages.new_page(chromium)
    complaints: list[str] = []
    own = f"http://127.0.0.1:{documented.port}/"
    tab.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    tab.on(
        "request", lambda request: None if request.url.startswith((own, "data:")) else complaints.append(request.url)
    )
    tab.goto(f"{own}docs/")
    yield tab, complaints
    tab.close()


@pytest.mark.long
def test_a_reader_finds_a_word_by_the_search(reader: tuple[Page, list[str]]) -> None:
    tab, complaints = reader
    tab.get_by_placeholder("Search").first.fill("tare")
    found = tab.locator(".md-search-result__link", has_text="Commissioning").first
    found.wait_for()
    found.click()
    tab.wait_for_url(re.compile(r"/docs/commission\.html"))
    assert complaints == []


def test_the_reference_has_the_docstrings_of_the_code(reader: tuple[Page, list[str]]) -> None:
    tab, complaints = reader
    tab.goto(tab.url.partition("/docs/")[0] + "/docs/reference/rigctl.metrics.html")
    assert "rigctl.metrics.tension_error" in tab.locator("article").inner_text()
    assert complaints == []


def test_no_page_holds_code_that_the_server_forbids() -> None:
    for page in SITE.rglob("*.html"):
        text = page.read_text()
        assert "<script>" not in text, page
        assert "<style>" not in text, page
        assert ' style="' not in text, page


def test_the_fault_card_prints_on_two_pages(reader: tuple[Page, list[str]]) -> None:
    tab, _ = reader
    tab.goto(tab.url.partition("/docs/")[0] + "/docs/fault-card.html")
    printed = tab.pdf(prefer_css_page_size=True)
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) == 2
