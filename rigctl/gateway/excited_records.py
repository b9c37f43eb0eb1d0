"""Keeps the loop's records of an excitation, which lasts longer than the ring of records holds."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.ipc.runtime_folder import Runtime

FIELDS = (
    "seq", "t_ns", "skipped", "mode", "flags", "excitation_mm_s", "command_mm_s", "tension_n", "stroke_mm",
    "speed_mm_s",
)  # fmt: skip
"""What an evaluation needs of a record."""
KEPT_S = 120.0
"""At most; no measurement takes as long."""


class ExcitedRecords:
    """The records since the excitation began, and those of the poll before; `poll` before the ring has come round."""

    def __init__(self, runtime: Runtime, rate_hz: int) -> None:
        self._reader, self._most = runtime.records.reader(), round(KEPT_S * rate_hz)
        self._parts: deque[npt.NDArray[Any]] = deque()
        self._began_ns = 0
        self._turn = threading.Lock()

    def poll(self) -> None:
        """Take what is new. Any thread."""
        with self._turn:
            new = self._reader.read()
            if not len(new):
                return
            part = np.empty(len(new), [(name, new.dtype[name]) for name in FIELDS])
            for name in FIELDS:
                part[name] = new[name]
            excited = bool(np.any(part["excitation_mm_s"]))
            if not excited:
                self._began_ns = 0
            elif not self._began_ns:
                self._began_ns = int(part["t_ns"][np.flatnonzero(part["excitation_mm_s"])[0]])
            before = bool(self._parts) and bool(np.any(self._parts[-1]["excitation_mm_s"]))
            if not excited and not before:
                self._parts.clear()
            self._parts.append(part)
            while sum(map(len, self._parts)) > self._most:
                self._parts.popleft()

    @property
    def span(self) -> tuple[int, int]:
        """When the excitation that goes on now began, 0 without one, and the time of the newest record kept, in ns."""
        with self._turn:
            return self._began_ns, int(self._parts[-1]["t_ns"][-1]) if self._parts else 0

    def between(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        """Records of ticks after ``after_ns`` up to ``until_ns``, as far as they are kept. Any thread."""
        self.poll()
        with self._turn:
            found = np.concatenate(self._parts) if self._parts else np.empty(0, [(name, "i8") for name in FIELDS])
        return found[(found["t_ns"] > after_ns) & (found["t_ns"] <= until_ns)]
