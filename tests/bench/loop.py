"""The loop at a rate, in closed loop on `rigsim`, with the rig in its own process."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
import time
from typing import Any

import numpy as np

from rigctl.control.modes import Mode
from rigctl.report import metrics
from rigctl.telemetry.runtime import Runtime
from tests import daemons

# The simulated bus has no bit timing: 4 kHz would be 170 % of 1 Mbit/s. The design is judged at the rig's own rate.
CHANGES: dict[str, dict[str, Any]] = {
    "can": {"bitrate_bit_s": None},
    "design": {"waiver": "bench: the loop's timing is measured, not the law"},
    "inclinometer": {"rate_hz": 100},
}

TARGET_N = "60"  # the closed loop works as hard as at 300 N, and is reached five times sooner


class BenchRig:
    """Rig and daemon at one rate, tensioned, kept alive between the slices of a measurement."""

    def __init__(self, rate_hz: int, stack: contextlib.ExitStack) -> None:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        changes = {**CHANGES, "loop": {"rate_hz": rate_hz}}
        self.file = daemons.rig_file(folder, changes, rig=f"bench_{rate_hz}")
        self._log = folder / "daemon.log"
        stack.enter_context(daemons.simulated_rig(self.file, folder / "rig.log"))
        stack.enter_context(daemons.daemon(self.file, self._log))
        for words in (("target", TARGET_N), ("arm",), ("tension", "--wait")):
            answer = daemons.rigctl(*words, file=self.file)
            if answer.returncode:
                raise RuntimeError(answer.stderr + self._log.read_text())
        self._records = Runtime.of(f"bench_{rate_hz}").record_reader()

    def measure(self, seconds: float) -> Any:
        """Records of the next ``seconds``."""
        self._records.read()
        slices = []
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            time.sleep(min(1.0, until - time.monotonic()))
            slices.append(self._records.read())
        return np.concatenate(slices)


def figures(slices: list[Any]) -> dict[str, Any]:
    """Percentiles over the slices of one rate."""
    records = np.concatenate(slices)
    skipped = sum(int(part["skipped"][-1] - part["skipped"][0]) for part in slices)
    missing = sum(int(part["frames_lost"][-1]) - int(part["frames_lost"][0]) for part in slices)
    return {
        "ticks": len(records),
        "skipped_ticks": skipped,
        "frames_missing": missing,
        "compensating": bool(np.all(records["mode"] == Mode.COMPENSATING)),
        "lateness_us": metrics.percentiles_us(records["lateness_ns"]),
        "work_us": metrics.percentiles_us(records["work_ns"]),
    }
