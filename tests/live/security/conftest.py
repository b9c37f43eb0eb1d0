"""A daemon in miniature, and a local user who attacks it from a process of his own."""

from __future__ import annotations

import pathlib
import tempfile
from collections.abc import Iterator

import pytest

from tests.builders.miniature import Daemon, running
from tests.builders.namespace import cabled


@pytest.fixture
def tmp_path() -> Iterator[pathlib.Path]:
    """A folder that every user may enter. Those of pytest are closed to others whenever one more run of it begins."""
    with tempfile.TemporaryDirectory(prefix="rigctl-test-") as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        yield folder


@pytest.fixture
def own() -> Iterator[Daemon]:
    """A daemon for one test, in TENSIONING or COMPENSATING under the lease of anna once `tensioned` is called."""
    yield from running()


@pytest.fixture
def elsewhere() -> Iterator[tuple[str, ...]]:
    """Words before a command that has it run in another network namespace, where this computer is ``HERE``."""
    with cabled() as within:
        yield within
