"""The recorder: ``python -m rigctl.recorder RUNTIME_DIR``. Keeps audit log, trip dumps and recording of a daemon.

It reads the rings and writes files, and no process waits for it: it may be killed at any time, and the next one
continues where the log ends. A failed write is reported, counted, and tried again while the rings hold the data.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import msgspec
from pydantic import ValidationError

from rigctl.config.settings import RigSettings
from rigctl.control.load import last_stroke
from rigctl.control.realtime import die_with_parent
from rigctl.ipc import heap, ledger, supervision
from rigctl.ipc.joining import UsageError, joined
from rigctl.ipc.progress import Stall, StallChange, progress_of, stalled_words
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import ACTIVE, RECORDED, FolderError, Runtime
from rigctl.ipc.seal import SealError
from rigctl.ipc.supervision import OVER, SUPERVISOR, Doing
from rigctl.ipc.termination import Termination
from rigctl.model.states import Mode
from rigctl.recorder import audit_host, parts, sealed_head
from rigctl.recorder.audit_host import AuditHost
from rigctl.recorder.audit_log import AuditError, AuditLog, Item
from rigctl.recorder.chain import read_line
from rigctl.recorder.continuous import Continuous
from rigctl.recorder.sources import AuditedRings, sourced
from rigctl.recorder.thinning import Thinning
from rigctl.recorder.trips import Trips

POLL_S = 0.05
RETRY_NS = 1_000_000_000
PUBLISH_NS = 1_000_000_000
KEEP_STROKE_NS = 1_000_000_000
ORDER_NS = 1_000_000_000
LOG_NS = 1_000_000_000
WAITING_MAX = 20_000  # entries kept while the disk fails; beyond it the rings hold the data
HOST_LIMIT_S = 1.0  # for the last heads to leave
LAST_ENTRY_S = 6.0  # after SIGTERM, limit for the wait for the supervisor's last entry
_OVER = frozenset(doing.name.lower() for doing in OVER)


class Trouble:
    """Outputs that cannot be written now: their begin and end are reported, every failure is counted."""

    def __init__(self) -> None:
        self.count = 0
        self.now: dict[str, str] = {}  # output: reason
        self._since: dict[str, int] = {}
        self._retry_ns: dict[str, int] = {}

    def may_try(self, what: str, now_ns: int) -> bool:
        """Whether a write may be tried: after a failure only at intervals."""
        return now_ns >= self._retry_ns.get(what, 0)

    def begins(self, what: str, why: str, now_ns: int) -> None:
        """Note a failed write."""
        self.count += 1
        self._retry_ns[what] = now_ns + RETRY_NS
        self._since.setdefault(what, now_ns)
        if self.now.get(what) != why:
            self.now[what] = why
            _say(f"WARNING: {why}; the loop is unaffected")

    def ends(self, what: str, now_ns: int) -> dict[str, Any] | None:
        """Note a successful write; returns the details of a failure that this ends."""
        self._retry_ns.pop(what, None)
        why = self.now.pop(what, None)
        if why is None:
            return None
        _say(f"{what} is written again")
        return {"what": what, "why": why, "for_s": round((now_ns - self._since.pop(what)) / 1e9, 1)}


class Recorder:
    """Audit log and trip dumps of one daemon."""

    def __init__(self, runtime: Runtime, settings: RigSettings, now_ns: int, wall_ns: int) -> None:
        """Continues where the log ends, if its end is of this run of the daemon.

        Raises:
            AuditError: the file is another rig's log or not a log.
        """
        self._runtime, self._settings = runtime, settings
        self._run = int(runtime.known(ACTIVE).get("started_wall_ns", 0))
        before = runtime.known(RECORDED)
        mine = before.get("run") == self._run
        self.log = AuditLog(settings.audit_log, settings.rig, int(before.get("entries", 0)) if mine else 0)
        self._changes_before = int(before.get("changes", 0)) if mine else 0
        self._changes_shown = 0
        self.trouble = Trouble()
        self.trip_dump: str | None = before.get("trip_dump") if mine else None
        self.over = False
        self._thinning = Thinning()
        self._waiting: list[tuple[Item, dict[str, int]]] = []
        self._published: dict[str, Any] = {}
        self._sealed = ""  # head of the log that was sealed last
        self._publish_ns = 0
        try:
            self.log.open()
        except (OSError, AuditError) as error:  # the log was good at the daemon's start; the rest goes on
            why = f"{self.log.path} cannot be written: {error.strerror}" if isinstance(error, OSError) else str(error)
            self.trouble.begins("audit log", why, now_ns)
        read = self.log.read if self.log.read.get("run") == self._run else {"run": self._run}
        self._read = read  # positions of the rings once all that waits is written
        self._rings = AuditedRings(runtime, read)
        self._trips = Trips(runtime, settings, read.get("dumped", 0))
        self._trips.sweep()
        self._recording = Continuous(runtime, settings, self._run, wall_ns) if settings.recording.enabled else None
        self._host = AuditHost(settings.audit.syslog) if settings.audit.syslog is not None else None
        self._records = runtime.records.reader()
        self._kept_mm, self._keep_ns = math.nan, 0  # the stroke last written, and when it may be next
        self._kept_brake = last_stroke.read(settings).brake
        self._failures = 0  # of the recording, already reported
        self._misordered: dict[str, str] = {}  # words by the name's part that a run's files share
        self._order_ns = self._log_ns = 0
        self._supervisor = Stall()
        self._add(self._own(now_ns, wall_ns, "recorder_started", f"process {os.getpid()}", {"pid": os.getpid()}))

    def poll(self, now_ns: int, wall_ns: int, *, final: bool = False) -> None:
        """Write what is new and the dumps that are due. ``final``: the last call."""
        if len(self._waiting) < WAITING_MAX:
            items = self._rings.take(wall_ns - now_ns)
            thinned = self._thinning.thin(items, now_ns, wall_ns, final=final)
            self._add(*(self._enriched(item) for item in thinned))
            self.over = self.over or any(item.what in _OVER for item in items)
        self._watch_log(now_ns, wall_ns)
        self._write(now_ns, wall_ns, final=final)
        self._dump(now_ns, wall_ns, final=final)
        self._record(now_ns, wall_ns)
        self._keep_stroke(now_ns, wall_ns, final=final)
        self._watch_host(now_ns, wall_ns)
        self._watch_supervisor(now_ns, wall_ns)
        self._watch_order(now_ns, wall_ns)
        self._publish(now_ns)

    def close(self, now_ns: int, wall_ns: int) -> None:
        """Write the rest and close the files."""
        self.poll(now_ns, wall_ns, final=True)
        self._add(self._own(now_ns, wall_ns, "recorder_stopped", f"process {os.getpid()}", {}))
        self._write(now_ns, wall_ns, final=True)
        if self._recording is not None:
            self._recording.close(now_ns, wall_ns)
            if self._recording.why:
                self.trouble.begins("recording", self._recording.why, now_ns)
        if self._host is not None:
            self._host.close(HOST_LIMIT_S)
        self._publish(now_ns, at_once=True)
        self.log.close()

    def _record(self, now_ns: int, wall_ns: int) -> None:
        """Continue the recording; its failures and deleted parts go into the log."""
        if (recording := self._recording) is None:
            return
        recording.poll(now_ns, wall_ns)
        said = [
            self._own(now_ns, wall_ns, "recording_deleted", name, {"file": name}) for name in recording.deleted
        ]  # fmt: skip
        recording.deleted.clear()
        if recording.why and (
            recording.failures > self._failures or self.trouble.now.get("recording") != recording.why
        ):
            self.trouble.begins("recording", recording.why, now_ns)
        elif not recording.why and (gap := self.trouble.ends("recording", now_ns)) is not None:
            said.append(self._own(now_ns, wall_ns, "written_again", "it could not be recorded before", gap))
        self._failures = recording.failures
        if said:
            self._add(*said)

    def _keep_stroke(self, now_ns: int, wall_ns: int, *, final: bool) -> None:
        """Write the last known stroke, once a second while it changes, and at the end; the brake's flag at once.

        Of the strokes only one at rest is synced to the disk: a stalled disk must not hold up the recording.
        """
        if (record := self._records.latest()) is None:
            return
        stroke_mm, brake = last_stroke.of_record(record), last_stroke.brake_of(record)
        turned = last_stroke.differ(brake, self._kept_brake)
        moved = stroke_mm is not None and not abs(stroke_mm - self._kept_mm) < last_stroke.KEPT_MM
        at_once = brake.fails is not self._kept_brake.fails
        may = self.trouble.may_try("last stroke", now_ns) if at_once else now_ns >= self._keep_ns
        if not (turned or moved) or not (final or may):
            return
        self._keep_ns = now_ns + KEEP_STROKE_NS
        at_rest = final or int(record["mode"]) in (Mode.DISARMED, Mode.HOLD, Mode.FAULT)
        try:
            kept = last_stroke.shown_by(self._settings, record)
            last_stroke.write(self._settings, kept, wall_ns, sync=at_rest or turned)
        except OSError as error:
            why = f"{self._settings.last_stroke} cannot be written: {error.strerror}"
            self.trouble.begins("last stroke", why, now_ns)
            return
        self._kept_mm, self._kept_brake = math.nan if stroke_mm is None else stroke_mm, brake
        if (gap := self.trouble.ends("last stroke", now_ns)) is not None:
            self._add(
                self._own(now_ns, wall_ns, "written_again", "stroke and brake's flag could not be written before", gap)
            )

    def _watch_host(self, now_ns: int, wall_ns: int) -> None:
        """Report when the audit log's host cannot be reached, and when it can again."""
        if self._host is None:
            return
        if why := self._host.why:
            if self.trouble.now.get("audit host") != why:
                self.trouble.begins("audit host", why, now_ns)
        elif (gap := self.trouble.ends("audit host", now_ns)) is not None:
            self._add(self._own(now_ns, wall_ns, "written_again", "the log's host could not be reached before", gap))

    def _watch_supervisor(self, now_ns: int, wall_ns: int) -> None:
        """Note a supervisor without progress, which cannot do so itself."""
        if (count := progress_of(self._runtime, SUPERVISOR)) is None:
            return
        found = self._supervisor.look(now_ns * 1e-9, count, None)
        if found in (StallChange.STALLED, StallChange.RESUMED):
            is_over = found is StallChange.RESUMED
            reason = f"after {self._supervisor.lasted_s:.1f} s" if is_over else stalled_words(None)
            kind = Doing.PROCESS_RESUMED if is_over else Doing.PROCESS_STALLED
            what, text = supervision.worded(kind, SUPERVISOR, reason)
            self._add(self._own(now_ns, wall_ns, what, text, {"process": SUPERVISOR, "reason": reason}))

    def _watch_order(self, now_ns: int, wall_ns: int) -> None:
        """Report files whose name contradicts the wall clock, or the number of the running run."""
        if now_ns < self._order_ns:
            return
        self._order_ns = now_ns + ORDER_NS
        rig, recording = self._settings.rig, self._recording
        found = parts.misordered(parts.dumps(self._trips.folder, rig), wall_ns)
        if recording is not None:
            found |= parts.misordered(parts.parts(recording.folder, rig), wall_ns, recording.run_number)
        for name in found.keys() - self._misordered.keys():
            _say(f"WARNING: {found[name]}")
            self._add(self._own(now_ns, wall_ns, "misordered", found[name], {"run": name}))
        self._misordered = found

    def _own(self, now_ns: int, wall_ns: int, what: str, text: str, details: dict[str, Any]) -> Item:
        return Item(now_ns, wall_ns, what, text, details=details)

    def _add(self, *items: Item, **read: int) -> None:
        """Queue entries for the log; ``read``: further positions to store with the last of them."""
        states = sourced(list(items), self._read)
        if states:
            states[-1] = {**states[-1], **read}
            self._waiting += zip(items, states, strict=True)
            self._read = states[-1]

    def _enriched(self, item: Item) -> Item:
        """The item; that of the daemon's start or design with the figures behind it."""
        active = self._runtime.known(ACTIVE)
        if item.what == Doing.DAEMON_STARTED.name.lower():
            more = {"version": active.get("version"), "pid": active.get("pid"), "calibration_waiver": None,
                    "settings_sha256": ledger.digest(self._settings), "host": os.uname().nodename}  # fmt: skip
            if self._settings.calibration is not None:
                more["calibration_waiver"] = self._settings.calibration.waiver
        elif item.what == Doing.DAEMON_DESIGNED.name.lower():
            design = active.get("design", {})
            more = {name: design.get(name) for name in ("gains", "accepted", "ms_max", "limit", "waiver", "warnings")}
        else:
            return item
        return replace(item, details={**item.details, **more})

    def _watch_log(self, now_ns: int, wall_ns: int) -> None:
        """Notice at intervals that the log was renamed or cut, also while there is nothing to write."""
        if now_ns >= self._log_ns and not self._waiting and self.trouble.may_try("audit log", now_ns):
            self._log_ns = now_ns + LOG_NS
            if self.log.changed():
                self._append((), (), now_ns, wall_ns)

    def _write(self, now_ns: int, wall_ns: int, *, final: bool) -> None:
        if self._waiting and (final or self.trouble.may_try("audit log", now_ns)):
            items, states = zip(*self._waiting, strict=True)
            self._append(items, states, now_ns, wall_ns)

    def _append(self, items: Sequence[Item], states: Sequence[dict[str, int]], now_ns: int, wall_ns: int) -> None:
        try:
            lines = self.log.append(items, states, now_ns, wall_ns)
        except (OSError, AuditError) as error:
            why = f"{self.log.path} cannot be written: {error.strerror}" if isinstance(error, OSError) else str(error)
            self.trouble.begins("audit log", why, now_ns)
            return
        self._waiting.clear()
        for how in self.log.changes[self._changes_shown :]:
            _say(f"WARNING: the audit log {self.log.path} {how} while the daemon ran; it goes on in a file of its name")
        self._changes_shown = len(self.log.changes)
        if self._recording is not None:
            self._recording.audit(lines)
        if self._host is not None:
            for line in lines:
                self._host.send(audit_host.message(*read_line(line)))
        if (gap := self.trouble.ends("audit log", now_ns)) is not None:
            self._add(self._own(now_ns, wall_ns, "written_again", "the log could not be written before", gap))

    def _dump(self, now_ns: int, wall_ns: int, *, final: bool) -> None:
        if not (final or self.trouble.may_try("trip dump", now_ns)):
            return
        while (group := self._trips.due(now_ns, final=final)) is not None:
            audit = {"file": self.log.path.name, "entries": self.log.entries, "head": self.log.head}
            try:
                dump = self._trips.write(group, wall_ns - now_ns, audit)
            except OSError as error:
                why = f"trip dump cannot be written to {self._trips.folder}: {error.strerror}"
                self.trouble.begins("trip dump", why, now_ns)
                if not final and not self._trips.missed(group, now_ns):
                    return
                self._trips.done(group)
                self._add(
                    self._own(now_ns, wall_ns, "trip_dump_lost", why, {"trip": group.fault}), dumped=group.last_seq
                )
                continue
            self._trips.done(group)
            self.trip_dump = dump.path.name
            details = {"file": dump.path.name, "trip": group.fault, "records": dump.records, "frames": dump.frames}
            items = [self._own(now_ns, wall_ns, "trip_dump", f"{group.fault}: {dump.path.name}", details)]
            for name in dump.deleted:
                items.append(self._own(now_ns, wall_ns, "trip_dump_deleted", name, {"file": name}))
            if (gap := self.trouble.ends("trip dump", now_ns)) is not None:
                items.append(
                    self._own(now_ns, wall_ns, "written_again", "a trip dump could not be written before", gap)
                )
            self._add(*items, dumped=group.last_seq)
            _say(f"trip dump: {dump.path}")
        self._write(now_ns, wall_ns, final=final)

    def _publish(self, now_ns: int, *, at_once: bool = False) -> None:
        """Write the recorder's figures to the runtime folder, at least once a second."""
        figures = {
            "run": self._run,
            "rig": self._settings.rig,
            "pid": os.getpid(),
            "audit_log": str(self.log.path),
            "entries": self.log.entries,
            "head": self.log.head,
            "trip_dump": self.trip_dump,
            "trips": str(self._trips.folder),
            "recording": self._recording.as_dict() if self._recording is not None else None,
            "failures": self.trouble.count,
            "changes": self._changes_before + self._changes_shown,
            "changed": self.log.changes[-1] if self.log.changes else "",
            "warnings": [f"recorder: {why}" for why in (*self.trouble.now.values(), *self._misordered.values())],
        }
        if not at_once and figures == self._published and now_ns < self._publish_ns:
            return
        self._published, self._publish_ns = figures, now_ns + PUBLISH_NS
        if self.log.head != self._sealed:
            with contextlib.suppress(OSError, SealError):  # the log itself goes on
                sealed_head.write(self._settings, self.log.entries, self.log.head)
                self._sealed = self.log.head
        with contextlib.suppress(OSError):  # the runtime folder may be gone, or its memory full
            self._runtime.write_json(RECORDED, {**figures, "t_ns": now_ns})


def _say(text: str) -> None:
    with contextlib.suppress(OSError):
        sys.stderr.write(f"recorder: {text}\n")
        sys.stderr.flush()


def _settings(runtime: Runtime) -> RigSettings:
    return RigSettings.model_validate(runtime.read_json(ACTIVE).get("settings"))


def _serve(recorder: Recorder, stop: Termination, is_gone: Callable[[], bool], turn: Callable[[], None]) -> None:
    """Poll until ``stop``, and then until the supervisor has written its last entry or is gone."""
    until = None
    while True:
        recorder.poll(time.monotonic_ns(), time.time_ns())
        turn()
        if until is None and stop.requested:
            until = time.monotonic() + LAST_ENTRY_S
        if until is not None and (recorder.over or is_gone() or time.monotonic() > until):
            return
        time.sleep(POLL_S)


def main(arguments: Sequence[str], stop: Termination) -> int:
    """Run the recorder of the runtime folder named until ``stop``; returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent(signal.SIGTERM)
    heap.limit()
    try:
        if (run := joined(arguments, "recorder", stop)) is None:
            return 0
        recorder = Recorder(run.runtime, _settings(run.runtime), time.monotonic_ns(), time.time_ns())
        progress = run.show()
    except UsageError as error:
        sys.stderr.write(f"usage: python -m rigctl.recorder {error}\n")
        return 2
    except (OSError, ValidationError, msgspec.MsgspecError, RingError, AuditError, FolderError) as error:
        _say("active.json holds no valid settings" if isinstance(error, ValidationError) else str(error))
        return 1
    _serve(recorder, stop, run.is_gone, progress.step)
    recorder.close(time.monotonic_ns(), time.time_ns())
    return 0
