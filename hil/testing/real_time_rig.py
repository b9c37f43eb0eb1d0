"""The fixture ``hil_live_rig``: the real daemon and the served rig, in real time."""

from __future__ import annotations

import contextlib
import pathlib
import shutil
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from hil.faults import served
from hil.testing.fixture_rig import FixtureRig, RefusedInTestError, SimulatedTimeoutError, mode_of, name_of
from hil.testing.stretch import RunStretch
from hil.truth import TRUTH_DTYPE
from hil.truth import read as read_truth
from rigctl.config.settings import RigSettings
from rigctl.demo.live_rig import LiveRig, LiveRigError, own, start_live_rig
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.recorder import recording

OPERATOR = "test"
PAUSE_S = 0.02
TRUTH = "truth.bin"


class RealTimeRig(FixtureRig):
    """A daemon of its own, with a rig name, an endpoint and files of its own, on a served rig.

    Args:
        live: the processes.
        limit_s: time that the test may take.
        folder: of their files, below it the recording.
    """

    def __init__(self, live: LiveRig, limit_s: float, folder: pathlib.Path) -> None:
        self.live, self.settings = live, live.settings
        self._limit_s, self._folder = limit_s, folder
        self._start_ns = time.monotonic_ns()
        self._target_n = live.settings.tension.target_n

    @property
    def time_s(self) -> float:
        """Time of the test."""
        return (time.monotonic_ns() - self._start_ns) * 1e-9

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

    def do(self, verb: str | Verb, *values: float) -> None:
        """Give a command that has to be accepted.

        Raises:
            RefusedInTestError: it was refused, or the daemon does not answer.
            SimulatedTimeoutError: the test has no time left.
        """
        self._check(0.0)
        try:
            self.live.do(given := Verb[name_of(verb).upper()], *values)
        except LiveRigError as error:
            raise RefusedInTestError(str(error)) from None
        if given is Verb.TARGET and values:
            (self._target_n,) = values

    def disturb(self, **kinds: list[dict[str, Any]]) -> None:
        """Begin disturbances now: the lists below ``disturbances`` of a scenario file, see docs/scenario.md.

        Those that have begun before go on.

        Raises:
            ValueError: one of them is not valid.
        """
        answer = served.disturb(self.settings, kinds)
        if not answer.done:
            raise ValueError(answer.text)

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
        """Let time pass; returns the records of that stretch. There is no truth: it is in another process.

        Raises:
            SimulatedTimeoutError: the test has no time left.
        """
        self._check(seconds)
        start_ns = time.monotonic_ns()
        records = self.live.run(seconds)
        return RunStretch(self.settings, start_ns, self._target_n, records, np.empty(0, TRUTH_DTYPE))

    def run_until(self, mode: str | Mode, limit_s: float = 60.0) -> None:
        """Wait until the loop is in ``mode``.

        Raises:
            SimulatedTimeoutError: it does not get there.
        """
        left_s = min(limit_s, self._limit_s - self.time_s)
        until = time.monotonic() + left_s
        while (now := self.mode) != (wanted := mode_of(mode).name):
            if time.monotonic() > until:
                raise SimulatedTimeoutError(f"not in {wanted} within {max(left_s, 0.0):.4g} s, but in {now}")
            time.sleep(PAUSE_S)

    # -- what stays of it -------------------------------------------------------------------------------------

    def keep(self, folder: pathlib.Path, title: str) -> list[pathlib.Path]:
        """End the processes, so that the recording is whole; write it and a picture of it, return the files.

        Raises:
            OSError: one cannot be written.
            ValueError: there is no recording, or it cannot be read.
        """
        folder.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(LiveRigError):  # one that does not end is killed when the fixture ends
            self.live.end()
        parts = sorted((self._folder / self.settings.recording.folder).glob("*.mcap"))
        kept = [pathlib.Path(shutil.copy(part, folder / part.name)) for part in parts]
        if not kept:
            raise ValueError("the daemon has recorded nothing")
        records = recording.read(*kept, frames=False).records
        truth = read_truth(self._folder / TRUTH)
        first_ns, last_ns = int(records["t_ns"][0]), int(records["t_ns"][-1])
        truth = truth[(truth["t_ns"] >= first_ns) & (truth["t_ns"] <= last_ns)]  # the rig ends after the daemon
        stretch = RunStretch(self.settings, first_ns, self._target_n, records, truth)
        return [stretch.plot(folder / "run.png", title), *kept]

    def _check(self, seconds: float) -> None:
        if self.time_s + seconds > self._limit_s:
            used = f"{self.time_s:.4g} s are used and {seconds:g} s are asked for"
            raise SimulatedTimeoutError(f"the test may take {self._limit_s:g} s: {used}")


@contextlib.contextmanager
def real_time_rig(settings: RigSettings, limit_s: float) -> Iterator[RealTimeRig]:
    """A daemon and its rig for one test, in a folder with a short name: sockets allow 107 characters."""
    with tempfile.TemporaryDirectory(prefix="hil-", dir="/tmp") as name:
        folder = pathlib.Path(name)
        truth = ("--truth", str(folder / TRUTH))
        with start_live_rig(own(settings, "test"), folder, OPERATOR, *truth, quiet=True) as live:
            yield RealTimeRig(live, limit_s, folder)
