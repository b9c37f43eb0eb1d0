"""The demo in simulated time: the same script, loop and frames, in one process."""

from __future__ import annotations

import math
import pathlib
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.lockstep import START_NS, Lockstep, lockstep
from hil.truth import TRUTH_DTYPE
from rigctl import __version__
from rigctl.config.settings import DemoSettings, RigSettings
from rigctl.demo.script import DemoError, Moment, Show, Stage, play
from rigctl.demo.summary import Summary, summarise
from rigctl.design.gains import DesignError
from rigctl.design.in_use import adopted, design_in_use
from rigctl.design.verdict import Design
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.recorder.continuous import Continuous


class LockstepStage(Stage):
    """`Stage` on a `Lockstep`; keeps every record and the plant's truth at every tick."""

    def __init__(self, rig: Lockstep, recording: Continuous | None = None) -> None:
        self._rig, self._recording = rig, recording
        self._wall_offset_ns = time.time_ns() - rig.clock.now()
        self.records: list[npt.NDArray[Any]] = []
        self._truth: list[Any] = []

    @property
    def truth(self) -> npt.NDArray[Any]:
        """Truth at every tick, ``TRUTH_DTYPE``."""
        return np.array(self._truth, TRUTH_DTYPE)

    def do(self, verb: Verb, *values: float) -> None:
        """See `Stage`."""
        refusal = self._rig.command(verb, *values)
        if refusal is not Refusal.NONE:
            raise DemoError(f"{verb.name.lower()} was refused: {refusal.name}")

    def start_move(self) -> None:
        """See `Stage`."""
        self._rig.rig.start_motion()

    def moving(self) -> bool:
        """See `Stage`."""
        return self._rig.rig.truth.moving

    def moment(self) -> Moment:
        """See `Stage`."""
        loop = self._rig.loop
        vertical_n = (
            loop.inbox.cell.tension_n
            * math.cos(loop.inbox.slope.tangential_rad)
            * math.cos(loop.inbox.slope.normal_rad)
        )
        return Moment(
            (self._rig.clock.now() - START_NS) * 1e-9,
            Mode(loop.machine.mode),
            vertical_n,
            loop.law.target_n,
            loop.inbox.drive.stroke_mm,
            math.degrees(loop.inbox.slope.tangential_rad),
            0.0,
        )

    def pass_time(self, seconds: float) -> None:
        """See `Stage`."""
        for _ in range(round(seconds * self._rig.settings.loop.rate_hz)):
            self._rig.loop.tick()
            self._truth.append(tuple(self._rig.rig.truth))
        self.records.append(self._rig.read_records())
        if self._recording is not None:
            now_ns = self._rig.clock.now()
            self._recording.poll(now_ns, now_ns + self._wall_offset_ns)

    def end_recording(self) -> pathlib.Path | None:
        """End the recording; returns its file, or None without one.

        Raises:
            DemoError: it could not be written.
        """
        if (recording := self._recording) is None:
            return None
        now_ns = self._rig.clock.now()
        file: str | None = recording.as_dict()["file"]
        recording.close(now_ns, now_ns + self._wall_offset_ns)
        if recording.why or file is None:
            raise DemoError(recording.why)
        return recording.folder / file


def play_lockstep(settings: RigSettings, demo: DemoSettings, show: Show) -> Summary:
    """Play the demo in simulated time.

    Raises:
        DemoError: it could not be played to its end.
    """
    try:
        design, believed = design_in_use(settings), adopted(settings)
    except DesignError as error:
        raise DemoError(f"no design: {error}") from None
    if not design.accepted:
        raise DemoError(design.verdict())
    with lockstep(believed, design.gains, built=settings, history_s=settings.telemetry.history_s) as rig:
        recorded = settings.recording.enabled
        stage = LockstepStage(rig, recording_of(rig, rig.settings, design, time.time_ns()) if recorded else None)
        stage.pass_time(0.2)
        play(stage, demo, show)
        return summarise(np.concatenate(stage.records), stage.truth, None, demo, stage.end_recording())


def recording_of(rig: Lockstep, settings: RigSettings, design: Design, wall_ns: int) -> Continuous:
    """A recording as the daemon's recorder makes it; ``settings``: with its folder, ``wall_ns``: of its begin."""
    active = {
        "settings": settings.model_dump(mode="json"),
        "version": __version__,
        "started_wall_ns": wall_ns,
        "design": design.as_dict(),
    }
    rig.runtime.write_json(ACTIVE, active)
    rig.runtime.write_json("control.json", {**rig.report.as_json(), "host_checks": 0})
    return Continuous(rig.runtime, settings, wall_ns, wall_ns)
