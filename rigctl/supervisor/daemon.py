"""``rigctl run``: validates, designs, spawns recorder, control and gateway, and watches them.

The control process starts up while the gains are designed. A process that dies is replaced; a new control process
comes up DISARMED: drive off, brake closed, the load carried.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from types import FrameType
from typing import IO, Any

import msgspec
import numpy as np

from rigctl import __version__
from rigctl.config import layout
from rigctl.config.bounds import findings
from rigctl.config.settings import RigSettings
from rigctl.config.telemetry_section import open_listen
from rigctl.control.law.tension import Gains
from rigctl.control.load import last_stroke
from rigctl.control.power import ending
from rigctl.devices import busload
from rigctl.devices.objects import drive_state
from rigctl.ipc import ledger, public_slot
from rigctl.ipc.joining import presence
from rigctl.ipc.ledger import IN_FORCE, Standing
from rigctl.ipc.notes import was_taken
from rigctl.ipc.progress import HUNG_S, Progress, Stall, StallChange, main_thread, progress_of, stalled_words
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import ACTIVE, DESIGN, REFUSED, WAITS, AlreadyRunningError, FolderError, Runtime
from rigctl.ipc.service_manager import notify, unnotified
from rigctl.ipc.supervision import SUPERVISOR, Doing, Supervision
from rigctl.ipc.termination import ENDING, EXIT_STARTS_ANEW, on_signals
from rigctl.ipc.writers import WRITERS
from rigctl.model.device_states import DriveState
from rigctl.model.states import Flag, Mode
from rigctl.supervisor import memory
from rigctl.supervisor.event_lines import EventLines
from rigctl.supervisor.left_processes import StillRunsError, end_left
from rigctl.supervisor.service_process import ServiceProcess

POLL_S = 0.02  # delay until a signal or a lost folder ends the daemon; a ramp goes on meanwhile, 0.2 mm at 10 mm/s
START_LIMIT_S = 20.0
STARTING_S = 60.0  # until then a process without progress does not hang
STOP_LIMIT_S = 5.0
GAINS_BYTES = 1 << 20
BACKOFF_S = (0.2, 0.5, 1.0, 2.0, 5.0)
LOOPING = 3  # ends in a row above which the message to the operator gives their number
STABLE_S = 10.0
LOOK_S = 0.1  # between two looks at the progress of the others
WATCHDOG_PERIOD_NS = 500_000_000
WATCHDOG_STALE_NS = 1_000_000_000


_INTERRUPTED = (
    "the start was interrupted before the loop ran: this daemon has not enabled the drive, nor seen its brake"
)


class CannotRunError(RuntimeError):
    """The daemon cannot run; ``str()`` is one line."""


PROCESSES = {
    "recorder": "rigctl.recorder",
    "control": "rigctl.control",
    "gateway": "rigctl.gateway.gateway_process",
}
"""Module of each process that is kept alive, in the order in which they are started."""
PAGE = {"page": "rigctl.page"}  # if the rig file or an option has it
_NOT_NEEDED = frozenset({"recorder", "page"})  # the daemon starts without them


@dataclass
class Child:
    """A process that is kept alive."""

    name: str
    process: subprocess.Popen[bytes]
    started: float
    failures: int = 0
    retry_at: float | None = None
    stall: Stall = field(default_factory=Stall)
    hung: bool = False


class Supervisor:
    """One rig's daemon: its runtime folder and its processes."""

    def __init__(self, settings: RigSettings, say: Callable[[str], None], *, separate_users: bool = False) -> None:
        """``say`` takes the lines of the daemon's log.

        ``separate_users``: recorder and gateway are services of their own, as of an installed rig.
        """
        self.settings = settings
        self._say = say
        self._event_lines = EventLines()
        self._runtime = Runtime.of(settings.rig, layout.run_base(settings.directory))
        self._signals = 0
        self._ending = False
        self._feed_at_ns = 0
        self._supervision: Supervision | None = None
        self._folder_lost = self._not_kept = ""
        apart = WRITERS if separate_users else {}
        wanted = PROCESSES | (PAGE if settings.page is not None else {})
        self._modules = {name: module for name, module in wanted.items() if name not in apart}
        self._children: dict[str, Child] = {}
        self._apart = tuple(apart)
        self._services: dict[str, ServiceProcess] = {}
        self._active: dict[str, Any] = {}
        self._progress: Progress | None = None
        self._public: public_slot.SlotWriter | None = None
        self._show_at = 0.0
        self._look_at = 0.0
        self._stalls: dict[str, Stall] = {}  # of the services

    def run(self) -> int:
        """Run until SIGTERM, SIGINT or SIGHUP; returns the exit code.

        Raises:
            CannotRunError: the daemon cannot run; no process is left.
        """
        try:
            lock = self._runtime.claim()
        except (AlreadyRunningError, FolderError) as error:
            raise CannotRunError(f"{self.settings.rig}: {error}") from None
        try:
            left = end_left(self._runtime, PROCESSES | PAGE)
        except StillRunsError as error:  # which goes on with the folder
            os.close(lock)
            raise CannotRunError(f"{self.settings.rig}: {error}") from None
        on_signals(self._on_signal, *ENDING)
        memory.apply(memory.SUPERVISOR, os.getpid())
        try:
            for found in (*self._runtime.cleared, *left):
                self._say(f"WARNING: {found}")
            records, events = self._make_rings()
            self._start(records)
            while not self._stopping and not self._lost():
                self._watch(records)
                self._log_events(events)
                self._feed_watchdog(records)
                self._show(records)
                time.sleep(POLL_S)
            return self._stop(records, events)
        except CannotRunError as error:
            self._note(Doing.DAEMON_REFUSED, reason=str(error))
            raise
        finally:
            self._kill_all()
            if self._public is not None:
                self._public.close()
            self._runtime.remove()
            os.close(lock)

    # -- start ----------------------------------------------------------------------------------------------
    def _make_rings(self) -> tuple[RingReader, RingReader]:
        """Create the rings; returns readers of records and events."""
        try:
            self._public = public_slot.SlotWriter(self._runtime)
            self._show_awaited("rings in shared memory")
            self._runtime.make_rings(self.settings)
            self._supervision = Supervision(self._runtime.supervision.writer())
            self._progress = Progress(self._runtime, SUPERVISOR, feeds=False)
            return self._runtime.records.reader(), self._runtime.events.reader()
        except OSError as error:
            raise CannotRunError(self._no_room(error)) from None

    def _no_room(self, error: OSError) -> str:
        return f"{self.settings.rig}: {self._runtime.directory} cannot be written: {error.strerror}"

    def _start(self, records: RingReader) -> None:
        settings = self.settings
        self._active = {
            "settings": settings.model_dump(mode="json"),
            "version": __version__,
            "started_wall_ns": time.time_ns(),
            "pid": os.getpid(),
            "run_id": secrets.token_hex(8),
            "bus_load": busload.bus_load(settings),
        }
        run_id = self._active["run_id"]
        self._services = {name: ServiceProcess(self._runtime, name, run_id) for name in self._apart}
        self._put_active()
        self._note(Doing.DAEMON_STARTED, reason=f"rigctl {__version__}")
        self._say_calibration()
        for key, found, allowed in findings(settings):
            self._say(f"WARNING: {key}: found {found}, expected {allowed}; waived: {settings.safety.waiver}")
        if reached := open_listen(settings.telemetry):
            self._say(f"WARNING: {reached}; waived: {settings.telemetry.listen_waiver}")
        self._put_last_stroke(None)
        for name in self._modules:
            try:
                self._spawn(name)
            except OSError as error:
                raise CannotRunError(f"{settings.rig}: {name} cannot be started: {error.strerror}") from None
        self._show_awaited("design of the gains")
        self._design()
        if doubt := ledger.clock_doubt(settings, self._active["design"], datetime.now(UTC)):
            self._say(f"WARNING: {doubt}")
        self._send_gains()
        limit_s = START_LIMIT_S + settings.start_up_limit_s
        until = time.monotonic() + limit_s
        while records.head == 0 and not self._stopping:
            self._refuse_ended()
            if time.monotonic() > until:
                raise CannotRunError(f"{settings.rig}: the loop did not start within {limit_s:.0f} s")
            self._watch_services(time.monotonic())
            self._show(records)
            time.sleep(0.005)
        self._wait_until_it_answers(records)
        if self._stopping:
            return
        self._say_real_time()
        channel = f"{settings.can.interface}:{settings.can.channel}"
        listen, taken = settings.telemetry.listen, was_taken(self._runtime.notes.reader(from_start=True).read())
        answers = f"on the sockets of this computer; another program has {listen}" if taken else f"at {listen}"
        warning = "WARNING: " if taken else ""
        self._say(f"{warning}{settings.rig}: DISARMED, {settings.loop.rate_hz} Hz on {channel}, answering {answers}")
        self._show_at = 0.0
        self._show(records)
        notify("READY=1")

    def _refuse_ended(self) -> None:
        for child in self._children.values():
            if child.process.poll() is not None and child.name not in _NOT_NEEDED:
                why = self._why_refused(child) or f"it ended with code {child.process.returncode} (see above)"
                raise CannotRunError(f"{self.settings.rig}: {child.name} could not start: {why}")

    def _why_refused(self, child: Child) -> str:
        """The reason that the control process has left for its end; "": none, or another process."""
        if child.name != "control":
            return ""
        why = str(self._runtime.known(REFUSED).get("why", ""))
        with contextlib.suppress(OSError):
            self._runtime.place(REFUSED).unlink(missing_ok=True)
        return why

    def _wait_until_it_answers(self, records: RingReader) -> None:
        """Wait for the processes that an operator needs; the daemon goes on without a service after a time."""
        until = time.monotonic() + START_LIMIT_S
        while not self._stopping and (missing := self._unshown()):
            self._refuse_ended()
            self._watch_services(now := time.monotonic())
            self._show(records, " and ".join(missing))
            if now > until:
                units = ", ".join(f"rigctl-{name}@{self.settings.rig}" for name in missing if name in self._services)
                see = f"; see journalctl -u {units}" if units else ""
                self._say(f"WARNING: not up within {START_LIMIT_S:.0f} s: {', '.join(missing)}{see}")
                return
            time.sleep(POLL_S)

    def _unshown(self) -> list[str]:
        """Processes that an operator needs and that do not work yet."""
        run_id = str(self._active["run_id"])
        children = [name for name in self._children if name in WRITERS and name not in _NOT_NEEDED]
        return [name for name in children if presence(self._runtime, name, run_id) == 0] + [
            name for name, service in self._services.items() if name not in _NOT_NEEDED and not service.pid
        ]

    def _watch_services(self, now: float) -> None:
        for service in self._services.values():
            happened = service.look(now)
            if happened is Doing.PROCESS_STARTED:
                self._note(happened, service.name, str(service.pid))
            elif happened is Doing.PROCESS_ENDED:
                how = "ended; the service manager starts it again, the loop is unaffected"
                self._note(happened, service.name, how)
                self._say(f"WARNING: {service.name} process {how}")

    def _say_real_time(self) -> None:
        try:
            applied = self._runtime.read_json("control.json").get("realtime", [])
        except (OSError, msgspec.MsgspecError) as error:
            self._say(f"WARNING: control.json cannot be read ({error}); what real time is in force is not known")
            return
        for item in applied:
            mark = "" if item["ok"] else f" - WARNING: {item['warning']}"
            self._say(f"real time: {item['name']}: {item['in_force']}{mark}")

    def _put_active(self) -> None:
        self._active = msgspec.json.decode(msgspec.json.encode(self._active))  # as readers get it: lists, no tuples
        try:
            self._runtime.write_json(ACTIVE, self._active)
        except OSError as error:
            raise CannotRunError(self._no_room(error)) from None

    def _design(self) -> None:
        from rigctl.design.gains import DesignError
        from rigctl.design.in_use import design_in_use
        from rigctl.design.kept_results import KeptResults

        results = KeptResults(self.settings.kept_results)
        try:
            design = design_in_use(self.settings, results=results)
        except (DesignError, ArithmeticError, ValueError) as error:  # the others: numbers that no plant has
            raise CannotRunError(f"{self.settings.rig}: no design: {error}") from None
        results.keep()
        self._active["design"] = design.as_dict()
        if not design.accepted:
            raise CannotRunError(f"{self.settings.rig}: {design.verdict()}")
        self._say(f"design: {design.verdict()}")
        for warning in design.warnings():
            self._say(f"WARNING: design: {warning}")
        self._put_active()
        self._note(Doing.DAEMON_DESIGNED, reason=design.verdict())

    def _note(self, kind: Doing, process: str = "", reason: str = "") -> None:
        """Write an entry for the audit log, once there are rings."""
        if self._supervision is not None:
            self._supervision.note(time.monotonic_ns(), kind, process=process, reason=reason)

    def _say_calibration(self) -> None:
        """Put the calibration in force and report it to the operator."""
        standing = self._put_calibration()
        if self.settings.calibration is None or standing is None:
            return
        words = f"calibration: due {standing.due}" if standing.due else "calibration: none on record"
        if standing.overdue:
            waiver = standing.waiver
            words += f", waived: {waiver}" if waiver else " - WARNING: overdue, arming is refused"
        self._say(words)

    def _put_calibration(self) -> Standing | None:
        """Write zero, scale and due date from the ledger, for a control process about to start.

        If the ledger has become unreadable, the values before stay in force.
        """
        try:
            entries = ledger.read(self.settings)
        except ledger.LedgerError as error:
            self._say(f"WARNING: {error}; zero and scale stay as they were")
            return None
        standing = ledger.standing(self.settings, entries, time.time_ns())
        self._write_or_warn(IN_FORCE, standing, "; zero and scale stay as they were")
        return standing

    def _put_last_stroke(self, newest: np.void | None) -> None:
        """Write the last known stroke and the brake's flag for a control process about to start.

        They are those of the newest record, else of the file.
        """
        kept = last_stroke.shown_by(self.settings, newest)
        if kept.stroke.why:
            self._say(f"WARNING: the stroke last known: {kept.stroke.why}; it has to be confirmed")
        if self._write_or_warn(last_stroke.IN_FORCE, kept, "; the stroke has to be confirmed, and the brake tested"):
            return
        with contextlib.suppress(OSError):  # a loop that finds none has the stroke confirmed, and the brake tested
            self._runtime.place(last_stroke.IN_FORCE).unlink(missing_ok=True)

    def _keep_brake(self, newest: np.void | None) -> None:
        """Write a changed flag of the brake to the file, where no recorder does it."""
        settings = self.settings
        if newest is None:
            return
        kept = last_stroke.shown_by(settings, newest)
        if not last_stroke.differ(kept.brake, last_stroke.read(settings).brake):
            return
        try:
            last_stroke.write(settings, kept, time.time_ns())
        except OSError as error:
            holds = "does not hold" if kept.brake.fails else "holds again"
            why = f"{settings.last_stroke} cannot be written: {error.strerror}; not kept: the brake {holds}"
            if why != self._not_kept:
                self._not_kept = why
                self._say(f"WARNING: {why}; after the next start test it: rigctl arm on a tight rope")

    def _write_or_warn(self, name: str, value: object, otherwise: str) -> bool:
        """Whether it is written."""
        try:
            self._runtime.write_json(name, value)
        except OSError as error:
            self._say(f"WARNING: {self._no_room(error)}{otherwise}")
            return False
        return True

    def _spawn(self, name: str) -> None:
        if name == "control":
            with contextlib.suppress(OSError):  # what the loop before has waited for
                self._runtime.place(WAITS).unlink(missing_ok=True)
        command = [sys.executable, "-m", self._modules[name], str(self._runtime.directory)]
        stdin = subprocess.PIPE if name == "control" else subprocess.DEVNULL
        process = subprocess.Popen(command, stdin=stdin, start_new_session=True, env=unnotified())
        failures = self._children[name].failures if name in self._children else 0
        grace_s = STARTING_S + (self.settings.start_up_limit_s if name == "control" else 0.0)
        self._children[name] = Child(name, process, time.monotonic(), failures, stall=Stall(grace_s))
        memory.apply(memory.SHARES[name], process.pid)
        if name != "control":
            self._keep_off_the_loops_processor(process.pid)
        self._note(Doing.PROCESS_STARTED, name, str(process.pid))

    def _keep_off_the_loops_processor(self, pid: int) -> None:
        """Keep a process off the loop's processor: a non-preemptible kernel would make the loop wait; best effort."""
        with contextlib.suppress(OSError):
            if others := os.sched_getaffinity(pid) - {self.settings.loop.cpu}:
                os.sched_setaffinity(pid, others)

    def _send_gains(self) -> None:
        """Send the control process the gains in force, which may have changed since the start."""
        stdin: IO[bytes] | None = self._children["control"].process.stdin
        design = self._active["design"]
        gains = {**design["gains"], **(design.get("schedule") or {})}
        if stdin is not None:
            with contextlib.suppress(OSError):  # more than a pipe holds at first: a process that hangs does not read it
                fcntl.fcntl(stdin, fcntl.F_SETPIPE_SZ, GAINS_BYTES)
            with contextlib.suppress(BrokenPipeError):
                stdin.write(msgspec.json.encode(gains) + b"\n")
                stdin.flush()

    # -- public slot ----------------------------------------------------------------------------------------
    def _show(self, records: RingReader, waits_for: str = "") -> None:
        """Write the public slot ten times a second: the newest record, and what a start waits for."""
        if self._public is None or (now := time.monotonic()) < self._show_at:
            return
        self._show_at = now + LOOK_S
        newest = records.latest()
        waits_for = self._loop_waits_for(newest) or waits_for
        self._public.write(public_slot.slot_of(newest, time.monotonic_ns(), Flag.BRAKE_FAILS, waits_for))

    def _show_awaited(self, waits_for: str) -> None:
        """Write the public slot of a start without a record yet."""
        if self._public is not None:
            self._public.write(public_slot.PublicSlot(time.monotonic_ns(), waits_for=waits_for))

    def _loop_waits_for(self, newest: np.void | None) -> str:
        """What the loop waits for that starts, or has ended and is started anew; empty while it runs."""
        child = self._children["control"]
        if child.retry_at is not None:
            return "" if self._ending else "next start of the loop"
        if newest is not None and int(newest["t_ns"]) >= child.started * 1e9:
            return ""
        return str(self._runtime.known(WAITS).get("waits_for", "")) or "start of the loop"

    # -- watch ----------------------------------------------------------------------------------------------
    def _lost(self) -> bool:
        """Whether the runtime folder is lost: no process can be started without it, so the daemon ends in order."""
        if why := self._runtime.lost():
            self._folder_lost = f"the runtime folder {self._runtime.directory} is lost: {why}"
            self._note(Doing.FOLDER_LOST, reason=f"{why}; the daemon ends with the stroke held")
            self._say(f"WARNING: {self._folder_lost}; the daemon ends with the stroke held")
        return bool(why)

    def _look_at_active(self) -> None:
        """Check the active configuration before a process starts that reads it, and write it again if it is damaged.

        The design is taken from the file, because the gateway writes new gains that the loop has taken into it.
        """
        try:
            found = self._runtime.read_json(ACTIVE)
            msgspec.convert(found["design"]["gains"], Gains)
            if _but_design(found) == _but_design(self._active):
                self._active["design"] = found["design"]
                return
            why = "it is not what was written"
        except (OSError, msgspec.MsgspecError, KeyError, TypeError) as error:
            why = " ".join(str(error).split())
        self._say(f"WARNING: {ACTIVE} in the runtime folder was damaged ({why}); it is written anew")
        with contextlib.suppress(OSError):
            self._runtime.place(DESIGN).unlink(missing_ok=True)  # of it and the file one is damaged
        self._write_or_warn(ACTIVE, self._active, "")

    def _watch(self, records: RingReader) -> None:
        now = time.monotonic()
        self._watch_services(now)
        self._watch_progress(now, records)
        for child in list(self._children.values()):
            if self._ending and child.name == "control":
                continue
            code = child.process.poll()
            if code is None:
                if child.failures and now - child.started > STABLE_S:
                    child.failures = 0
            elif child.retry_at is None:
                wait = BACKOFF_S[min(child.failures, len(BACKOFF_S) - 1)]
                child.failures += 1
                child.retry_at = now + wait
                how = f"killed by signal {-code}" if code < 0 else f"ended with code {code}"
                how = "ended to start all devices up again" if code == EXIT_STARTS_ANEW else how
                then = "comes back DISARMED" if child.name == "control" else "comes back"
                if why := self._why_refused(child):
                    how, then = f"could not start: {why}", "is started anew, DISARMED,"
                if child.hung:
                    how = f"hung, without progress for {HUNG_S:g} s, and was killed"
                words = f"{how}; {then} in {wait:g} s{'' if child.name == 'control' else '; the loop is unaffected'}"
                if child.failures > LOOPING:
                    words += f" (it has ended {child.failures} times in a row: read its messages)"
                self._note(Doing.PROCESS_ENDED, child.name, words)
                self._say(f"WARNING: {child.name} process {words}")
            elif now >= child.retry_at:
                self._look_at_active()
                if child.name == "control":
                    self._put_calibration()
                    self._put_last_stroke(self._runtime.records.reader().latest())
                try:
                    self._spawn(child.name)
                except OSError as error:
                    child.retry_at = now + BACKOFF_S[-1]
                    again = f"it is tried again in {BACKOFF_S[-1]:g} s"
                    self._say(f"WARNING: {child.name} cannot be started: {error.strerror}; {again}")
                    continue
                if child.name == "control":
                    self._send_gains()

    def _watch_progress(self, now: float, records: RingReader) -> None:
        """Report a process without progress, and end a hung one, which is then replaced as one that has ended."""
        if self._progress is not None:
            self._progress.step()
        if now < self._look_at:
            return
        self._look_at = now + LOOK_S
        for child in self._children.values():
            if child.retry_at is None and child.process.poll() is None:
                count = records.head if child.name == "control" else progress_of(self._runtime, child.name)
                if self._judge(child.name, child.stall, now, count, child.process.pid):
                    child.hung = True
                    child.process.kill()
            elif child.name == "recorder":
                self._keep_brake(records.latest())
        for service in self._services.values():  # the service manager replaces it by its watchdog
            if service.pid:
                stall = self._stalls.setdefault(service.name, Stall())
                self._judge(service.name, stall, now, progress_of(self._runtime, service.name), service.pid)
            else:
                self._stalls.pop(service.name, None)

    def _judge(self, name: str, stall: Stall, now: float, count: int | None, pid: int) -> bool:
        """Whether the process hangs."""
        thread = main_thread(pid)
        found = stall.look(now, count, thread)
        if found is StallChange.STALLED:
            words = stalled_words(thread)
            self._note(Doing.PROCESS_STALLED, name, words)
            self._say(f"WARNING: {name} process: {words}")
        elif found is StallChange.RESUMED:
            words = f"after {stall.lasted_s:.1f} s"
            self._note(Doing.PROCESS_RESUMED, name, words)
            self._say(f"{name} process: progress again {words}")
        return found is StallChange.HUNG

    def _log_events(self, events: RingReader) -> None:
        for line in self._event_lines.of(events.read()):
            self._say(line)

    def _feed_watchdog(self, records: RingReader) -> None:
        """Feed the service watchdog twice a second, only while the loop writes records."""
        now_ns = time.monotonic_ns()
        slot = records.latest()
        alive = slot is not None and now_ns - int(slot["t_ns"]) < WATCHDOG_STALE_NS
        if alive and now_ns >= self._feed_at_ns:
            self._feed_at_ns = now_ns + WATCHDOG_PERIOD_NS
            notify("WATCHDOG=1")

    # -- stop -----------------------------------------------------------------------------------------------
    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._signals += 1

    @property
    def _stopping(self) -> bool:
        return self._signals > 0

    def _stop(self, records: RingReader, events: RingReader) -> int:
        """End control first: it holds the stroke and closes the brake; gateway and recorder end after reporting it."""
        notify("STOPPING=1")
        clean = self._end_control(records, events)
        self._log_events(events)
        last = records.latest()
        time.sleep(2.0 / self.settings.telemetry.rate_hz)
        self._end("gateway")
        now_ns, slack_n = time.monotonic_ns(), self.settings.tension.slack_n
        code, how = (1, _INTERRUPTED) if last is None else _ending(last, clean, now_ns, slack_n)
        if self._folder_lost:
            code, how = 1, f"{how}; ended because {self._folder_lost}"
        self._note(Doing.DAEMON_STOPPED, reason=how)
        self._end("recorder")
        self._keep_brake(last)
        self._say(how if code == 0 else f"WARNING: {how}")
        return code

    def _end_control(self, records: RingReader, events: RingReader) -> bool:
        """End the loop; returns whether it has ended in order.

        It may have the motor lower a load first (`rigctl.control.power.ending`). As long as its records show that,
        everything else goes on; a further signal goes to the loop, which then leaves the load.
        """
        process, signals, self._ending = self._children["control"].process, self._signals, True
        process.send_signal(signal.SIGTERM)
        until = time.monotonic() + STOP_LIMIT_S
        longest = until + ending.limit_s(self.settings)
        while process.poll() is None:
            if (newest := records.latest()) is not None and math.isfinite(newest["end_s"]):
                until = min(longest, time.monotonic() + STOP_LIMIT_S)
                self._feed_watchdog(records)
                if not self._folder_lost:
                    self._watch(records)
            if time.monotonic() > until:
                return False
            if self._signals > signals:
                signals = self._signals
                process.send_signal(signal.SIGTERM)
            self._log_events(events)
            self._show(records)
            time.sleep(POLL_S)
        return process.returncode == 0

    def _end(self, name: str) -> bool:
        if (service := self._services.get(name)) is not None:
            return service.end(STOP_LIMIT_S)
        process = self._children[name].process
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGTERM)
        try:
            return process.wait(STOP_LIMIT_S) == 0
        except subprocess.TimeoutExpired:
            return False

    def _kill_all(self) -> None:
        for child in self._children.values():
            if child.process.poll() is None:
                child.process.terminate()
        for service in self._services.values():
            service.end(STOP_LIMIT_S)
        for child in self._children.values():
            try:
                lowers = child.name == "control" and not self._ending
                child.process.wait(STOP_LIMIT_S + (ending.limit_s(self.settings) if lowers else 0.0))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()


def _ending(last: np.void, clean: bool, now_ns: int, slack_n: float) -> tuple[int, str]:
    """Exit code and one line on the state the rig was left in; ``last``: its newest record."""
    mode = Mode(int(last["mode"])).name
    where = f"stroke {last['stroke_mm']:z.2f} mm, tension {last['tension_n']:z.1f} N"
    if not clean:
        since_s = (now_ns - int(last["t_ns"])) * 1e-9
        return 1, (
            f"no loop has stopped in order: the last one was in {mode} {since_s:.0f} s ago, last seen {where}; "
            "the brake was not seen to close, and the drive is left to its own supervision"
        )
    if last["drive_quality"] or drive_state(int(last["statusword"])) is DriveState.OPERATION_ENABLED:
        return 1, f"stopped in {mode}: last seen {where}; the brake was not seen to close"
    if int(last["flags"]) & Flag.BRAKE_FAILS and last["tension_n"] > slack_n:
        return 1, f"stopped in {mode}: {where}; the closed brake does not hold it: support the payload from below"
    return 0, f"stopped in {mode}: {where}, brake closed"


def _but_design(active: dict[str, Any]) -> bytes:
    """The active configuration without its design, as JSON: for Python 1, 1.0 and True are equal."""
    rest = {name: value for name, value in active.items() if name != "design"}
    return msgspec.json.encode(rest, order="deterministic")
