"""A daemon in miniature, and a local user who attacks it from a process of his own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.builders.miniature import Daemon, running


@pytest.fixture
def own() -> Iterator[Daemon]:
    """A daemon for one test, in TENSIONING or COMPENSATING under the lease of anna once `tensioned` is called."""
    yield from running()
