"""Prometheus' own checker, from Debian's package (``tests/guest/setup`` fetches it)."""

from __future__ import annotations

import os
import pathlib
import shutil


def promtool() -> str:
    """The program's path."""
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
    found = shutil.which("promtool") or shutil.which("promtool", path=cache / "rigctl/promtool")
    assert found, "no promtool: tests/guest/setup fetches it"
    return found
