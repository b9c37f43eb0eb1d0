"""Daemons in miniature for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.builders.miniature import Daemon, running


@pytest.fixture(scope="module")
def shared() -> Iterator[Daemon]:
    """One daemon for the tests of a module that leave it as they found it."""
    yield from running()


@pytest.fixture
def own() -> Iterator[Daemon]:
    """A daemon for one test."""
    yield from running()
