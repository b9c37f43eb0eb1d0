"""The fixture ``hil_rig``: loop and simulated rig in one process and in simulated time."""

from __future__ import annotations

import contextlib
import pathlib
import shutil
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults.judging.standing import StandingFault, found, hindrance
from hil.lockstep import Lockstep, lockstep
from hil.rig_with_ledger import RigWithLedger
from hil.scenario.case import load
from hil.scenario.play import Played, play
from hil.scenario.running_disturbances import RunningDisturbances
from hil.testing.fixture_rig import FixtureRig, RefusedInTestError, SimulatedTimeoutError, mode_of, name_of
from hil.testing.stretch import RunStretch
from hil.truth import TRUTH_DTYPE, Truth
from rigctl.config.settings import RigSettings
from rigctl.demo.lockstep import recording_of
from rigctl.design.verdict import Design
from rigctl.model.faults import Fault
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations.filing import Filed

WAKE_S = 0.2
"""Until every signal is fresh."""
POLL_TICKS = 250


class LockstepRig(FixtureRig):
    """A rig whose clock moves only when the test lets it. The same test gives the same run, bit for bit.

    Args:
        rig: the rig under it, for what is not here: devices, frames, events.
        design: its gains, which a replay of the recording needs.
        limit_s: simulated time that the test may take.
        folder: for the recording.
    """

    def __init__(self, rig: Lockstep, design: Design, limit_s: float, folder: pathlib.Path) -> None:
        self.lockstep, self.settings = rig, rig.settings
        self._limit_s = limit_s
        self._start_ns = rig.clock.now()
        self._wall_offset_ns = time.time_ns() - self._start_ns
        self._records: list[npt.NDArray[Any]] = []
        self._truth: list[Truth] = []
        self._faults: list[StandingFault] = []
        self._disturbances = RunningDisturbances(rig.rig.plant, rig.settings)
        self.ledger = RigWithLedger(rig, design.gains, design.as_dict(), self._wall_offset_ns)
        own = _recorded_in(folder, rig.settings)
        self._recording = recording_of(rig, own, design, self._start_ns + self._wall_offset_ns)
        rig.on_advance = self._each_period
        self.run(WAKE_S)

    # -- what it is -------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Simulated time of the test."""
        return (self.lockstep.clock.now() - self._start_ns) * 1e-9

    @property
    def mode(self) -> str:
        """The loop's mode."""
        return Mode(self.lockstep.loop.machine.mode).name

    @property
    def fault(self) -> str:
        """The fault that is latched; NONE without one."""
        return Fault(self.lockstep.loop.machine.fault).name

    @property
    def truth(self) -> Truth:
        """The plant's true state now."""
        return self.lockstep.rig.truth

    @property
    def whole(self) -> RunStretch:
        """The run from its beginning."""
        return self._since(self._start_ns)

    # -- what is done with it ---------------------------------------------------------------------------------

    def command(self, verb: str | Verb, *values: float) -> str:
        """Give a command as ``rigctl VERB`` does; returns why it was refused, NONE if it was not.

        Raises:
            ValueError: there is no such command.
            SimulatedTimeoutError: the test has no time left.
        """
        names, name = [one.name.lower() for one in Verb], name_of(verb)
        if name not in names:
            raise ValueError(f"found command {name!r}, expected {', '.join(names)}")
        self._check(0.0)
        if name == "hold":
            return self.lockstep.hold().name
        return Refusal(self.lockstep.command(Verb[name.upper()], *values)).name

    def do(self, verb: str | Verb, *values: float) -> None:
        """Give a command that has to be accepted.

        Raises:
            RefusedInTestError: it was refused.
        """
        if (refusal := self.command(verb, *values)) != Refusal.NONE.name:
            raise RefusedInTestError(f"{name_of(verb)} was refused in {self.mode}: {refusal}")

    def commission(self, verb: str | Verb, **fields: Any) -> Filed:
        """Carry out TARE, CALIBRATE, IDENTIFY, RESPONSE or GAINS as the daemon does, with a ledger in memory.

        ``fields``: of a `rigctl.model.requests.Request`: ``value``, ``adopt``, ``tight``, ``gain_file`` ...

        Returns:
            The finding, on record and in force, or the reason why there is none.
        """
        self._check(0.0)
        return self.ledger.carry_out(Request(Verb[name_of(verb).upper()], "test", **fields))

    def disturb(self, **kinds: list[dict[str, Any]]) -> None:
        """Begin disturbances now: the lists below ``disturbances`` of a scenario file, see docs/scenario.md.

        Those that have begun before go on.

        Raises:
            ValueError: one of them is not valid.
        """
        self._disturbances.begin(kinds)

    def inject(self, fault: str, for_s: float | None = None) -> StandingFault:
        """Begin a fault of the catalogue (``python -m hil faults --list``), for a while or until its `end`.

        Raises:
            FaultRefusedError: there is no such fault, or this rig cannot have it.
        """
        row = found(fault)
        if why := hindrance(row, served=False):
            raise ValueError(f"{fault}: {why}")
        standing = StandingFault(self.lockstep, row, self.lockstep.clock.now(), for_s)
        self._faults.append(standing)
        return standing

    def run(self, seconds: float) -> RunStretch:
        """Let simulated time pass; returns that stretch.

        Raises:
            SimulatedTimeoutError: the test has no time left.
        """
        self._check(seconds)
        start_ns = self.lockstep.clock.now()
        for _ in range(round(seconds * self.settings.loop.rate_hz)):
            self.lockstep.tick()
        return self._since(start_ns)

    def run_until(self, mode: str | Mode, limit_s: float = 60.0) -> RunStretch:
        """Let simulated time pass until the loop is in ``mode``; returns that stretch.

        Raises:
            SimulatedTimeoutError: it did not get there within ``limit_s``, or the test has no time left.
        """
        wanted, start_ns = mode_of(mode), self.lockstep.clock.now()
        left_s = min(limit_s, self._limit_s - self.time_s)
        for _ in range(round(left_s * self.settings.loop.rate_hz)):
            if self.lockstep.loop.machine.mode is wanted:
                return self._since(start_ns)
            self.lockstep.tick()
        raise SimulatedTimeoutError(f"not in {wanted.name} within {left_s:g} s of simulated time, but in {self.mode}")

    # -- what stays of it -------------------------------------------------------------------------------------

    def keep(self, folder: pathlib.Path, title: str) -> list[pathlib.Path]:
        """Write picture and recording of the whole run; returns the files.

        Raises:
            OSError: one cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        now_ns = self.lockstep.clock.now()
        self._recording.close(now_ns, now_ns + self._wall_offset_ns)
        kept = [self.whole.plot(folder / "run.png", title)]
        for part in sorted(self._recording.folder.glob("*.mcap")):
            kept.append(pathlib.Path(shutil.copy(part, folder / part.name)))
        return kept

    def _each_period(self) -> None:
        now_ns = self.lockstep.rig_ns
        self._faults = [fault for fault in self._faults if fault.step(now_ns)]
        self._truth.append(self.lockstep.rig.truth)
        if len(self._truth) % POLL_TICKS == 0:
            self._take()

    def _take(self) -> None:
        """Read the rings, which hold the last seconds only."""
        self._records.append(self.lockstep.read_records())
        now_ns = self.lockstep.clock.now()
        self._recording.poll(now_ns, now_ns + self._wall_offset_ns)

    def _check(self, seconds: float) -> None:
        if self.time_s + seconds > self._limit_s:
            used = f"{self.time_s:g} s are used and {seconds:g} s are asked for"
            raise SimulatedTimeoutError(f"the test may take {self._limit_s:g} s of simulated time: {used}")

    def _since(self, start_ns: int) -> RunStretch:
        self._take()
        records = np.concatenate(self._records)
        truth = np.array(self._truth, TRUTH_DTYPE)
        target_n = self.lockstep.loop.law.target_n
        return RunStretch(
            self.settings, start_ns, target_n, records[records["t_ns"] > start_ns], truth[truth["t_ns"] > start_ns]
        )


def play_scenario(file: str | pathlib.Path) -> RunStretch:
    """Play a scenario file; the stretch begins with its disturbances.

    Raises:
        ScenarioError: the file is not valid, or the rig does not get as far as COMPENSATING.
    """
    case = load(file)
    scenario = case.scenario
    played: Played = play(
        case.settings, case.tracks, seconds=scenario.duration_s, controller="loop", target_n=case.target_n,
        settle_s=scenario.settle_s,
    )  # fmt: skip
    assert played.records is not None  # controller "loop"
    return RunStretch(case.settings, int(played.truth["t_ns"][0]), case.target_n, played.records, played.truth)


@contextlib.contextmanager
def lockstep_rig(settings: RigSettings, design: Design, limit_s: float, folder: pathlib.Path) -> Iterator[LockstepRig]:
    """A rig for one test."""
    with lockstep(settings, design.gains) as rig:
        yield LockstepRig(rig, design, limit_s, folder)


def _recorded_in(folder: pathlib.Path, settings: RigSettings) -> RigSettings:
    """The rig with a recording in a folder of its own, of which a test without a failure keeps nothing."""
    recording = settings.recording.model_copy(update={"folder": str(folder), "enabled": True})
    audit = settings.audit.model_copy(update={"file": str(folder / "audit.jsonl"), "trips": str(folder / "trips")})
    return settings.model_copy(update={"recording": recording, "audit": audit})
