"""The preflight service: judges the host checks in a thread, because a disk may be slow, and keeps the newest verdict.

It looks twice a second, and more often while a check fails.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import msgspec

from rigctl.config.settings import RigSettings
from rigctl.gateway.active import CONTROL
from rigctl.ipc.ledger import Standing
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.ipc.written_folders import folders
from rigctl.model.checks import Check
from rigctl.operations.preflight import PreflightVerdict, judge

LOOK_S, LOOK_AGAIN_S = 0.5, 0.1  # interval of the checks, normally and while one fails
FIRST_LOOK_S = 1.0  # a starting gateway waits at most this long for the first result
STALE_NS = 2_000_000_000  # an older result is not valid: with a hanging disk no rig is armed


class PreflightService:
    """Judges the host checks in a thread and keeps the newest verdict."""

    def __init__(
        self,
        runtime: Runtime,
        settings: RigSettings,
        standing: Callable[[], Standing],
        details: Callable[[], Mapping[Check, str]] = dict,
    ) -> None:
        """``standing``: the ledger's standing now. ``details``: details of the loop's own checks."""
        self._details = details
        self._runtime, self._settings, self._standing = runtime, settings, standing
        self._newest: tuple[int, PreflightVerdict] | None = None
        self._first, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._serve, name="preflight", daemon=True)
        self._thread.start()
        self._first.wait(FIRST_LOOK_S)

    def close(self) -> None:
        """End the thread."""
        self._stop.set()

    def verdict(self, now_ns: int) -> PreflightVerdict:
        """The newest verdict; only `Check.HOST` fails in it if it is stale at ``now_ns`` (CLOCK_MONOTONIC)."""
        if self._newest is None or now_ns - self._newest[0] > STALE_NS:
            return PreflightVerdict(
                {Check.HOST: "tare, margins, real time and disk cannot be looked at: does a disk hang?"}
            )
        return replace(self._newest[1], known=self._details())

    def _serve(self) -> None:
        while not self._stop.is_set():
            began_ns = time.monotonic_ns()
            found = look(self._runtime, self._settings, self._standing(), datetime.now(UTC))
            self._newest = began_ns, found
            self._first.set()
            self._stop.wait(LOOK_AGAIN_S if found.failing else LOOK_S)


def look(runtime: Runtime, settings: RigSettings, standing: Standing, now: datetime) -> PreflightVerdict:
    """Read files and disks and judge them."""
    read: dict[str, dict[str, Any]] = {ACTIVE: {}, CONTROL: {}}
    for name in read:
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            read[name] = runtime.read_json(name)
    return judge(settings, standing, read[ACTIVE], read[CONTROL], folders(settings), now)
