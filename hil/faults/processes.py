"""Faults of the daemon's real processes: killed, stopped, starved; the simulated rig's truth judges the result."""

from __future__ import annotations

import math
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from hil.faults import wall_clock
from hil.faults.expected import ACCURACY_N, DRIVE_STOPS, RIDE, Expected, Reaction
from hil.faults.judging.judge import DRIVE_STOPS_MS, STANDS_MM, FaultResult
from hil.faults.rows.live_rows_rig import CONTROL, GATEWAY, RECORDER, SUPERVISOR, VICTIMS, Live, LiveError, give, live
from hil.scenario.play import Advance
from rigctl.config.settings import RigSettings
from rigctl.model.parts import Part
from rigctl.model.states import Mode

WATCHED_S = 1.5  # longer than the 1 s after which a process without progress is reported
BACK_S = 30.0
MOVED_MM = 1.0
"""A fault of a process may move the load by this much at most."""
TOLD_MS = 500.0
"""Time in which a loop whose supervisor has ended learns of it and stops in order."""
OTHER_SPRING_N_MM, OTHER_NODE = 60.0, 9
BEFORE_S = 0.05
NATURAL = {Mode.TENSIONING: {Mode.COMPENSATING}, Mode.RELEASING: {Mode.HOLD}}
"""Modes that end by themselves, with their next mode."""

Interference = Callable[[Live], AbstractContextManager[int]]
"""Disturbs the daemon while the context lasts; yields the time it began, CLOCK_MONOTONIC in ns."""


@dataclass(frozen=True)
class ProcessFault:
    """One fault of a process; the other fields are those of an `InjectedFault`, the same for all."""

    place, why, band_n, carried = "process", "", ACCURACY_N, True

    id: str
    what: str
    interference: Interference
    expected: Expected
    within_ms: float = DRIVE_STOPS_MS
    """Time until the stroke stands, where it has to."""
    restart: bool = False
    """Whether the daemon has to be started again by hand."""
    part: tuple[Part, ...] = (Part.PROCESS,)


@dataclass(frozen=True)
class Seen:
    """The truth's view of an interference: from just before it until the rig was judged."""

    mode_after: Mode
    fault: str
    stopped_ms: float  # from the interference until the stroke stood still
    moved_mm: float
    tension_off_n: float  # from its value before
    setpoint_off_n: float  # from the loop's set-point, while it ticked
    tension_min_n: float
    tension_max_n: float
    tripped: bool
    carried: bool


def kills(victim: str, number: signal.Signals) -> Interference:
    """Send a signal to one of the daemon's processes; a stopped process continues afterwards."""

    @contextmanager
    def interference(rig: Live) -> Any:
        pid = rig.pid(victim)
        at_ns = time.monotonic_ns()
        give(pid, number)
        yield at_ns
        if number is signal.SIGSTOP:
            give(pid, signal.SIGCONT)

    return interference


@contextmanager
def all_stopped(rig: Live) -> Any:
    """Stop supervisor, gateway and recorder together."""
    pids = list(map(rig.pid, (SUPERVISOR, GATEWAY, RECORDER)))
    at_ns = time.monotonic_ns()
    for pid in pids:
        give(pid, signal.SIGSTOP)
    try:
        yield at_ns
    finally:
        for pid in pids:
            give(pid, signal.SIGCONT)


@contextmanager
def disk_full(rig: Live) -> Any:
    """Make every write of the daemon's processes to a file fail (EFBIG, where a full disk gives ENOSPC)."""
    with ExitStack() as undo:
        at_ns = time.monotonic_ns()
        for pid in map(rig.pid, VICTIMS):
            limits = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, limits[1]))
            undo.callback(resource.prlimit, pid, resource.RLIMIT_FSIZE, limits)
        yield at_ns


@contextmanager
def folder_deleted(rig: Live) -> Any:
    """Delete the daemon's run-time folder, as a log-out may: the daemon ends in order."""
    at_ns = time.monotonic_ns()
    shutil.rmtree(rig.runtime.directory)
    yield at_ns
    _ended(rig)


@contextmanager
def terminal_gone(rig: Live) -> Any:
    """Close the terminal of ``rigctl run``."""
    at_ns = time.monotonic_ns()
    give(rig.pid(SUPERVISOR), signal.SIGHUP)
    yield at_ns
    _ended(rig)


def _ended(rig: Live) -> None:
    assert rig.daemon is not None
    try:
        rig.daemon.wait(BACK_S)
    except subprocess.TimeoutExpired:
        raise LiveError("the daemon does not end") from None


def config_replaced(*, control_killed: bool) -> Interference:
    """Overwrite the rig file with another rig's figures; with ``control_killed`` the loop has to restart too."""

    @contextmanager
    def interference(rig: Live) -> Any:
        good = rig.file.read_text()
        other = yaml.safe_load(good)
        other["plant"]["spring_n_mm"], other["tension_cell"]["node"] = OTHER_SPRING_N_MM, OTHER_NODE
        text, pid = yaml.safe_dump(other), rig.pid(CONTROL)
        at_ns = time.monotonic_ns()
        rig.file.write_text(text)
        try:
            if control_killed:
                give(pid, signal.SIGKILL)
            yield at_ns
        finally:
            rig.file.write_text(good)

    return interference


def clock_stepped(seconds: float) -> Interference:
    """Step the wall clock of all processes, as when it is set, and step it back."""

    @contextmanager
    def interference(rig: Live) -> Any:
        at_ns = time.monotonic_ns()
        wall_clock.step(rig.folder, round(seconds * 1e9))
        yield at_ns
        wall_clock.step(rig.folder, 0)

    return interference


CATALOGUE = (
    ProcessFault("control_killed", "the loop's process is killed", kills(CONTROL, signal.SIGKILL), DRIVE_STOPS),
    ProcessFault("control_stopped", "the loop's process hangs (SIGSTOP)", kills(CONTROL, signal.SIGSTOP), DRIVE_STOPS),
    ProcessFault(
        "supervisor_killed",
        "the supervisor is killed",
        kills(SUPERVISOR, signal.SIGKILL),
        DRIVE_STOPS,
        TOLD_MS,
        restart=True,
    ),
    ProcessFault("folder_deleted", "the runtime folder is deleted", folder_deleted, DRIVE_STOPS, TOLD_MS, restart=True),
    ProcessFault("terminal_gone", "the daemon's terminal is closed", terminal_gone, DRIVE_STOPS, TOLD_MS, restart=True),
    ProcessFault("supervisor_stopped", "the supervisor hangs", kills(SUPERVISOR, signal.SIGSTOP), RIDE),
    ProcessFault("gateway_killed", "the gateway is killed", kills(GATEWAY, signal.SIGKILL), RIDE),
    ProcessFault("gateway_stopped", "the gateway hangs", kills(GATEWAY, signal.SIGSTOP), RIDE),
    ProcessFault("recorder_stopped", "the recorder hangs", kills(RECORDER, signal.SIGSTOP), RIDE),
    ProcessFault("all_but_control_stopped", "every process but the loop's hangs", all_stopped, RIDE),
    ProcessFault("disk_full", "no process can write to a file", disk_full, RIDE, part=(Part.COMPUTER,)),
    ProcessFault(
        "clock_forward", "the wall clock jumps forward by a day", clock_stepped(86_400.0), RIDE, part=(Part.COMPUTER,)
    ),
    ProcessFault(
        "clock_back", "the wall clock jumps back by an hour", clock_stepped(-3_600.0), RIDE, part=(Part.COMPUTER,)
    ),
    ProcessFault(
        "config_replaced", "another rig's figures in the rig file", config_replaced(control_killed=False), RIDE
    ),
    ProcessFault(
        "config_replaced_killed", "... and the loop is killed", config_replaced(control_killed=True), DRIVE_STOPS
    ),
)
"""The faults with the expected reaction in every mode; the loop's restart ends DISARMED."""


def play(settings: RigSettings, rows: Sequence[tuple[ProcessFault, Mode]], advance: Advance) -> list[FaultResult]:
    """Play rows one after the other, in their order. A row that fails to play ends its rig, and the next has a new one.

    Raises:
        ScenarioError: rig and daemon do not come up (1).
    """
    found: list[FaultResult] = []
    while len(found) < len(rows):
        with live(settings) as rig:
            _play_on(rig, rows, found, advance)
    return found


def _play_on(rig: Live, rows: Sequence[tuple[ProcessFault, Mode]], found: list[FaultResult], advance: Advance) -> None:
    """Play the rows that are not in ``found`` yet, until one fails to play."""
    for fault, mode in rows[len(found) :]:
        advance(0.0, f"{fault.id} in {mode.name}")
        try:
            found.append(row_of(rig, fault, mode))
        except LiveError as error:
            found.append(FaultResult.unreached(fault.id, mode, fault.expected[mode], str(error)))
            return
        finally:
            advance(1.0, "")


def row_of(rig: Live, fault: ProcessFault, mode: Mode) -> FaultResult:
    """Play and judge one row."""
    rig.enter(mode)
    time.sleep(0.2)
    expected = fault.expected[mode]
    came = strike(rig, fault.interference, comes_back=not fault.restart)
    if fault.restart:
        rig.start_daemon()
    reaction, findings = judged(expected, came, mode, fault.within_ms)
    return FaultResult(
        fault.id,
        mode.name,
        str(expected),
        str(reaction),
        0.0 if expected is Reaction.DRIVE_STOPS else None,
        came.stopped_ms if expected is Reaction.DRIVE_STOPS else None,
        came.tension_min_n,
        came.tension_max_n,
        came.setpoint_off_n if expected is Reaction.RIDDEN and mode in NATURAL else came.tension_off_n,
        came.moved_mm,
        came.carried,
        came.fault,
        tuple(findings),
    )


def strike(rig: Live, interference: Interference, *, comes_back: bool) -> Seen:
    """Interfere with the daemon and log the truth until it ticks again (or for a moment)."""
    records = rig.runtime.records.reader()
    with interference(rig) as at_ns:
        time.sleep(WATCHED_S)
    until = time.monotonic() + BACK_S
    while comes_back and not rig.ticking():
        if time.monotonic() > until:
            raise LiveError("the loop does not come back")
        time.sleep(0.02)
    time.sleep(0.1)
    end_ns = time.monotonic_ns()
    after, fault = rig.mode, rig.fault
    ticks = records.read()
    truth = rig.truth(at_ns - round(BEFORE_S * 1e9), end_ns)
    return seen(truth, ticks, at_ns, after if after is not None else Mode.DISARMED, fault)


def seen(truth: npt.NDArray[Any], ticks: npt.NDArray[Any], at_ns: int, after: Mode, fault: str) -> Seen:
    """The effect of an interference at ``at_ns`` in the truth and the loop's records.

    Raises:
        LiveError: no truth since then.
    """
    since = truth[truth["t_ns"] >= at_ns]
    if not len(since):
        raise LiveError("the simulated rig writes no truth")
    first, last = since[0], since[-1]
    moving = since["t_ns"][np.abs(since["stroke_mm"] - last["stroke_mm"]) > STANDS_MM]
    ticks = ticks[np.isin(ticks["mode"], [Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT])]
    following = ticks[ticks["mode"] != Mode.FAULT]
    off = np.abs(np.interp(following["t_ns"], truth["t_ns"], truth["tension_n"]) - following["setpoint_n"])
    return Seen(
        after,
        fault,
        1e-6 * float(moving[-1] - at_ns) if len(moving) else 0.0,
        float(np.max(np.abs(since["stroke_mm"] - first["stroke_mm"]))),
        float(np.max(np.abs(since["tension_n"] - first["tension_n"]))),
        float(off.max()) if len(off) else 0.0,
        float(since["tension_n"].min()),
        float(since["tension_n"].max()),
        bool(np.any(ticks["mode"] == Mode.FAULT)),
        bool(last["tension_n"] > 0.5 * first["tension_n"]),
    )


def judged(expected: Reaction, seen: Seen, mode: Mode, within_ms: float = DRIVE_STOPS_MS) -> tuple[Reaction, list[str]]:
    """The reaction to an interference, and its deviations from the expectation."""
    findings = [] if seen.carried else ["load not carried"]
    if expected is Reaction.DRIVE_STOPS:
        reaction = Reaction.DRIVE_STOPS if seen.stopped_ms <= within_ms else Reaction.MOVES
        if reaction is Reaction.MOVES:
            findings.append(f"moves for {seen.stopped_ms:.0f} ms, expected at most {within_ms:g}")
        if seen.mode_after not in (Mode.DISARMED, Mode.FAULT):
            findings.append(f"then {seen.mode_after.name}, not DISARMED or FAULT")
        return reaction, findings + _moved(seen)
    if mode is Mode.FAULT:
        kept = seen.mode_after is Mode.FAULT
        return Reaction.KEPT if kept else Reaction.LEFT, findings + _moved(seen) + ([] if kept else ["FAULT was left"])
    if seen.tripped:
        return Reaction.HELD, [*findings, f"tripped: {seen.fault}"]
    if mode in NATURAL or mode is Mode.COMPENSATING:
        allowed = {mode} | NATURAL.get(mode, set())
        findings += [] if seen.mode_after in allowed else [f"then {seen.mode_after.name}"]
        if seen.setpoint_off_n > ACCURACY_N:
            findings.append(f"tension {seen.setpoint_off_n:.1f} N off its set-point, expected at most {ACCURACY_N:g}")
        return Reaction.RIDDEN, findings
    findings += [] if seen.mode_after is mode else [f"then {seen.mode_after.name}"]
    return Reaction.RIDDEN, findings + _moved(seen)


def _moved(seen: Seen) -> list[str]:
    findings = []
    if seen.moved_mm > MOVED_MM:
        findings.append(f"stroke moved {seen.moved_mm:.2f} mm, expected at most {MOVED_MM:g}")
    if not math.isfinite(seen.tension_off_n) or seen.tension_off_n > ACCURACY_N:
        findings.append(f"tension {seen.tension_off_n:.1f} N off, expected at most {ACCURACY_N:g}")
    return findings
