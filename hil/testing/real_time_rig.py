"""The fixture ``hil_live_rig``: the real daemon and the served rig, in real time."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from hil.faults import served
from hil.testing.lockstep_rig import CommandRefusedError, SimulatedTimeoutError
from hil.testing.stretch import RunStretch
from hil.truth import TRUTH_DTYPE
from rigctl.config.settings import RigSettings
from rigctl.control.modes import Verb
from rigctl.demo.live_rig import LiveRig, LiveRigError, own, start_live_rig
from rigctl.ipc.runtime_folder import Runtime

OPERATOR = "test"
PAUSE_S = 0.02


class RealTimeRig:
    """A daemon of its own, with a rig name, an endpoint and files of its own, on a served rig."""

    def __init__(self, live: LiveRig) -> None:
        self.live, self.settings = live, live.settings
        self._reader = Runtime.of(live.settings.rig).records.reader()
        self._target_n = live.settings.tension.target_n

    @property
    def mode(self) -> str:
        """The loop's mode."""
        return str(self.live.state()["mode"])

    @property
    def fault(self) -> str:
        """The fault that is latched; NONE without one."""
        return str(self.live.state().get("fault") or "NONE")

    def state(self) -> dict[str, Any]:
        """The daemon's state, as ``rigctl status --json``."""
        return self.live.state()

    def do(self, verb: str, value: float | None = None) -> None:
        """Give a command that has to be accepted.

        Raises:
            CommandRefusedError: it was refused, or the daemon does not answer.
        """
        try:
            self.live.command(Verb[verb.upper()], OPERATOR, value)
        except LiveRigError as error:
            raise CommandRefusedError(str(error)) from None
        if verb == "target" and value is not None:
            self._target_n = value

    def inject(self, fault: str, for_s: float | None = None) -> None:
        """Put a fault of the catalogue into the served rig, for a while or until `end_fault`.

        Raises:
            ValueError: it cannot be put in.
        """
        answer = served.ask(self.settings, fault, for_s)
        if not answer.done:
            raise ValueError(answer.text)

    def end_fault(self) -> None:
        """End the fault that stands."""
        served.ask(self.settings, None, None)

    def run(self, seconds: float) -> RunStretch:
        """Let time pass; returns the records of that stretch. There is no truth: it is in another process."""
        self._reader.read()
        start_ns, parts = time.monotonic_ns(), []
        while (left_s := seconds - (time.monotonic_ns() - start_ns) * 1e-9) > 0.0:
            time.sleep(min(left_s, 1.0))
            parts.append(self._reader.read())
        return RunStretch(self.settings, start_ns, self._target_n, np.concatenate(parts), np.empty(0, TRUTH_DTYPE))

    def run_until(self, mode: str, limit_s: float = 60.0) -> None:
        """Wait until the loop is in ``mode``.

        Raises:
            SimulatedTimeoutError: it does not get there.
        """
        until = time.monotonic() + limit_s
        while (now := self.mode) != mode:
            if time.monotonic() > until:
                raise SimulatedTimeoutError(f"not in {mode} within {limit_s:g} s, but in {now}")
            time.sleep(PAUSE_S)


@contextlib.contextmanager
def real_time_rig(settings: RigSettings) -> Iterator[RealTimeRig]:
    """A daemon and its rig for one test, in a folder with a short name: sockets allow 107 characters."""
    with (
        tempfile.TemporaryDirectory(prefix="hil-", dir="/tmp") as folder,
        start_live_rig(own(settings, "test"), pathlib.Path(folder), quiet=True) as live,
    ):
        yield RealTimeRig(live)
