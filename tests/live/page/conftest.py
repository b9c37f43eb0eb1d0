"""One browser for the tests of a module, daemons in miniature, and page servers beside them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.builders import pages
from tests.builders.miniature import Daemon, running


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with pages.browser() as found:
        yield found


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    """A daemon in miniature, for the tests of a module that leave it as they found it."""
    for found in running():
        found.client().close()
        yield found


@pytest.fixture(scope="module")
def readonly(daemon: Daemon) -> Iterator[pages.Server]:
    with pages.serving(daemon.endpoint) as server:
        yield server


@pytest.fixture(scope="module")
def commanding(daemon: Daemon) -> Iterator[pages.Server]:
    with pages.serving(daemon.endpoint, "--operator", "kim") as server:
        yield server


@pytest.fixture
def own() -> Iterator[Daemon]:
    """A daemon in miniature for one test."""
    yield from running()


@pytest.fixture
def own_page(own: Daemon) -> Iterator[pages.Server]:
    own.client().close()
    with pages.serving(own.endpoint, "--operator", "kim") as server:
        yield server
