"""How long a test waits for what has to come: the one place that knows.

No test judges a time of this computer's clock: a limit here ends a wait for what never comes. So it is far above what
an idle computer needs, and grows with the work that others give this one.
"""

from __future__ import annotations

import linecache
import os
import pathlib
import time
from collections.abc import Callable
from types import CodeType
from typing import Any

IDLE_S = 60.0
"""The limit on an idle computer."""
FACTOR = "RIGCTL_TEST_PATIENCE"
"""Variable of the environment: how many times longer all takes here, as in a guest kernel."""


def patience_s(idle_s: float = IDLE_S) -> float:
    """The limit now, where an idle computer would have ``idle_s``."""
    waiting = os.getloadavg()[0] / (os.cpu_count() or 1)
    return idle_s * float(os.environ.get(FACTOR, "1")) * max(1.0, waiting)


def until(true: Callable[[], Any], what: str = "", *, log: pathlib.Path | None = None, every_s: float = 0.02) -> Any:
    """Poll until ``true()`` is true; returns it.

    Raises:
        AssertionError: the limit is over; names what was waited for, else the line that waited, and shows the log.
    """
    begun = time.monotonic()
    while not (value := true()):
        if time.monotonic() - begun > patience_s():
            text = log.read_text(errors="replace") if log is not None and log.exists() else ""
            raise AssertionError(f"waited {patience_s():.0f} s for {what or line_of(true)}\n{text}")
        time.sleep(every_s)
    return value


def line_of(true: Callable[[], Any]) -> str:
    """The source line of what was polled."""
    code: CodeType | None = getattr(true, "__code__", None)
    if code is None:
        return repr(true)
    found = linecache.getline(code.co_filename, code.co_firstlineno).strip()
    return f"{found} ({pathlib.Path(code.co_filename).name}:{code.co_firstlineno})"
