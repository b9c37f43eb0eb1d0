"""The demo in real time: simulated rig, daemon and an independent subscriber, each in its own processes."""

from __future__ import annotations

import contextlib
import functools
import math
import pathlib
import signal
import subprocess
import tempfile
import time
from typing import Any, NamedTuple

import can
import msgspec
import numpy as np
import numpy.typing as npt

from hil import truth as truth_log
from rigctl.client.connection import NoDaemonError
from rigctl.config.settings import DemoSettings, RigSettings
from rigctl.demo.live_rig import STOP_LIMIT_S, LiveRig, LiveRigError, process, start_live_rig
from rigctl.demo.script import DemoError, Moment, PausedError, Show, Stage, play
from rigctl.demo.simulator_node import SimulatorNode
from rigctl.demo.summary import Summary, Telemetry, summarise
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.model.signals import NEVER_AGE_NS
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.recorder import parts

OPERATOR = "demo"
STATE_LIMIT_S = 2.0
PAUSE_TICKS = 10  # missed by the loop, or without a sample: a computer with time for both processes has never as many


class LiveStage(Stage):
    """`Stage` on real processes: commands over Zenoh, the move by SDO to the simulator's own node."""

    def __init__(self, live_rig: LiveRig, records: RingReader, simulator: SimulatorNode) -> None:
        self._live_rig, self._client = live_rig, live_rig.client
        self._states = self._client.follow(self._client.keys.state)
        self._reader = records
        self._simulator = simulator
        self._start_ns = time.monotonic_ns()
        self._moment: Moment | None = None
        self._fresh_ns = 0
        self._renew_ns = 0  # 0: no command has been given yet
        self.records: list[npt.NDArray[Any]] = []

    def do(self, verb: Verb, *values: float) -> None:
        """See `Stage`."""
        self._accepted(self._live_rig.do(verb, *values))

    def _accepted(self, answer: dict[str, Any]) -> None:
        if not answer["accepted"]:
            raise DemoError(answer["text"])
        self._renew_ns = time.monotonic_ns() + round(answer["lease"]["left_s"] / 3 * 1e9)

    def start_move(self) -> None:
        """See `Stage`."""
        self._simulator.start_move()

    def moving(self) -> bool:
        """See `Stage`."""
        return self._simulator.moving()

    def moment(self) -> Moment:
        """See `Stage`."""
        state = self._states.newest()
        if state is None and self._moment is not None and time.monotonic_ns() - self._fresh_ns < STATE_LIMIT_S * 1e9:
            return self._moment
        if state is None:
            state = self._states.read(STATE_LIMIT_S)
        if state is None:
            raise DemoError(f"no state from the daemon for {STATE_LIMIT_S:.0f} s")
        self._fresh_ns = time.monotonic_ns()
        self._moment = Moment(
            self.since_start_s(int(state["t_ns"])),
            Mode[state["mode"]],
            float(state["vertical_n"]),
            float(state["target_n"]),
            float(state["stroke_mm"]),
            math.degrees(float(state["tangential_rad"])),
            float(state["lateness_us"]["p99"]),
        )
        return self._moment

    def since_start_s(self, t_ns: int) -> float:
        """Time of the demo at an instant of CLOCK_MONOTONIC."""
        return (t_ns - self._start_ns) * 1e-9

    def pass_time(self, seconds: float) -> None:
        """See `Stage`; also renews the lease, and reads the records before the ring overwrites them."""
        time.sleep(seconds)
        if self._renew_ns and time.monotonic_ns() >= self._renew_ns:
            try:
                self._accepted(self._client.take_lease(OPERATOR))
            except NoDaemonError as error:
                raise DemoError(str(error)) from None
        self.records.append(self._reader.read())


def _count(counter: subprocess.Popen[bytes]) -> Telemetry:
    counter.send_signal(signal.SIGTERM)
    out, _ = counter.communicate(timeout=STOP_LIMIT_S)
    lines = out.splitlines()
    if not lines:
        raise DemoError("the telemetry subscriber counted nothing")
    counted = msgspec.json.decode(lines[-1])
    return Telemetry(int(counted["produced"]), int(counted["received"]))


def play_live(settings: RigSettings, demo: DemoSettings, show: Show) -> Summary:
    """Play the demo in real time.

    Raises:
        PausedError: the rig tripped because this computer stopped the loop or the simulated rig.
        DemoError: a process did not start or answer, or the script could not be played to its end.
    """
    if settings.can.interface != "rigsim":
        raise DemoError(
            f"the demo plays on the simulated bus only (can.interface rigsim, not {settings.can.interface})"
        )
    with tempfile.TemporaryDirectory(prefix="rigctl-demo-") as folder, contextlib.ExitStack() as stack:
        truth_file = pathlib.Path(folder) / "truth"
        try:
            options = OPERATOR, "--truth", str(truth_file)
            live_rig = stack.enter_context(start_live_rig(settings, pathlib.Path(folder), *options))
            where = ("--connect", settings.telemetry.listen, "--rig", settings.rig)
            counter = stack.enter_context(process("rigctl.client.counter", *where, stdout=subprocess.PIPE))
            records = Runtime.of(settings.rig).records.reader(from_start=True)
            bus = live_rig.settings.can
            open_bus = functools.partial(can.Bus, interface=bus.interface, channel=bus.channel)
            stage = LiveStage(live_rig, records, SimulatorNode(open_bus, time.monotonic_ns))
            try:
                play(stage, demo, show)
            except (DemoError, LiveRigError) as error:
                raise _by_pause(stage, settings) or error from None
            telemetry = _count(counter)
            stage.pass_time(0.0)
            recording = _recording(settings)
            live_rig.end()
        except LiveRigError as error:
            raise DemoError(str(error)) from None
        except can.CanError as error:
            raise DemoError(f"the simulated rig has gone: {error}") from None
        return summarise(np.concatenate(stage.records), truth_log.read(truth_file), telemetry, demo, recording)


def _by_pause(stage: LiveStage, settings: RigSettings) -> PausedError | None:
    """The error for a trip caused by a pause of this computer; None without one."""
    stage.pass_time(0.0)
    pause = pause_before_trip(np.concatenate(stage.records), settings)
    if pause is None:
        return None
    at_s = stage.since_start_s(pause.trip_ns)
    return PausedError(f"this computer stopped {pause.stopped} for {pause.duration_ms:.0f} ms at {at_s:.1f} s")


class Pause(NamedTuple):
    """What this computer stopped before a trip, for how long, and when the loop tripped (CLOCK_MONOTONIC)."""

    stopped: str
    duration_ms: float
    trip_ns: int


def pause_before_trip(records: npt.NDArray[Any], settings: RigSettings) -> Pause | None:
    """The longest pause within the window of the overrun's limit before the first trip; None without one.

    The loop's own records show it: periods of the grid that were missed, or samples that did not come, since no device
    of the demo's rig falls silent. A tick that wakes late skips periods only after its own decision, so the trip may be
    in the record before them.

    Args:
        records: ``record.RECORD`` slots.
        settings: the rig's.
    """
    tripped = np.flatnonzero(records["mode"] == Mode.FAULT)
    if not len(tripped):
        return None
    end = int(tripped[0])
    end_ns = int(records["t_ns"][end])
    begin = int(np.searchsorted(records["t_ns"], end_ns - settings.safety.overrun_window_ms * 1_000_000))
    after = min(end + 1, len(records) - 1)
    missed = int(records["skipped"][after]) - int(records["skipped"][max(0, begin - 1)])  # since the tick before it
    ages = np.concatenate([records[age][begin : end + 1] for age in ("tension_age_ns", "drive_age_ns")])
    silent_ns = int(ages[ages < NEVER_AGE_NS].max(initial=0))  # before its first sample no device has fallen silent
    ticks, stopped = max((missed, "the loop"), (silent_ns // settings.loop.period_ns, "the simulated rig"))
    return Pause(stopped, ticks * settings.loop.period_ns / 1e6, end_ns) if ticks >= PAUSE_TICKS else None


def _recording(settings: RigSettings) -> pathlib.Path | None:
    """First part of the daemon's recording."""
    written = Runtime.of(settings.rig).known(RECORDED).get("recording")
    if not written or not written.get("file"):
        return None
    return parts.of_same_run(pathlib.Path(written["folder"]) / written["file"])[0]
