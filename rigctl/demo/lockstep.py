"""The demo in simulated time: the same script, loop and frames, in one process."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.lockstep import START_NS, Lockstep, lockstep
from hil.truth import TRUTH_DTYPE
from rigctl.config import DemoSettings, RigSettings
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.demo.script import DemoError, Moment, Show, play
from rigctl.demo.summary import Summary, summarise
from rigctl.design.gain_file import design_in_use
from rigctl.design.gains import DesignError


class LockstepStage:
    """`Stage` on a `Lockstep`; keeps every record and the plant's truth at every tick."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig = rig
        self.records: list[npt.NDArray[Any]] = []
        self._truth: list[Any] = []

    @property
    def truth(self) -> npt.NDArray[Any]:
        """Truth at every tick, ``TRUTH_DTYPE``."""
        return np.array(self._truth, TRUTH_DTYPE)

    def command(self, verb: Verb) -> None:
        """See `Stage`."""
        refusal = self._rig.command(verb)
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
        vertical_n = loop.inbox.tension_n * math.cos(loop.inbox.tangential_rad) * math.cos(loop.inbox.normal_rad)
        return Moment(
            (self._rig.clock.now() - START_NS) * 1e-9,
            Mode(loop.machine.mode),
            vertical_n,
            loop.law.target_n,
            loop.inbox.stroke_mm,
            math.degrees(loop.inbox.tangential_rad),
            0.0,
        )

    def pass_time(self, seconds: float) -> None:
        """See `Stage`."""
        for _ in range(round(seconds * self._rig.settings.loop.rate_hz)):
            self._rig.loop.tick()
            self._truth.append(tuple(self._rig.rig.truth))
        self.records.append(self._rig.read_records())


def play_lockstep(settings: RigSettings, demo: DemoSettings, show: Show) -> Summary:
    """Play the demo in simulated time.

    Raises:
        DemoError: it could not be played to its end.
    """
    try:
        design = design_in_use(settings)
    except DesignError as error:
        raise DemoError(f"no design: {error}") from None
    if not design.accepted:
        raise DemoError(design.verdict())
    with lockstep(settings, design.gains) as rig:
        stage = LockstepStage(rig)
        stage.pass_time(0.2)
        play(stage, demo, show)
        return summarise(np.concatenate(stage.records), stage.truth, None, demo)
