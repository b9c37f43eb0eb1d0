"""``python -m rigctl.gateway.gateway_process [--service] RUNTIME_DIR``: rings in, Zenoh out; commands the other way.

It may be killed at any time: the loop does not notice, and the next gateway continues where this one stopped.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import msgspec
import zenoh
from pydantic import ValidationError

from rigctl.config.settings import RigSettings
from rigctl.control.realtime import die_with_parent
from rigctl.control.watch import limits, safety
from rigctl.diagnosis.live import LatchedCulprit
from rigctl.gateway import accepted_sockets
from rigctl.gateway.active import ActiveConfiguration, ReplacedFile
from rigctl.gateway.admission import Admission
from rigctl.gateway.answers import refuse
from rigctl.gateway.calibration_service import CalibrationService
from rigctl.gateway.command_queries import take_queries
from rigctl.gateway.command_server import CommandServer, Giver, Reply
from rigctl.gateway.command_socket import CommandSocket
from rigctl.gateway.ended_processes import EndedProcesses, ProcessNote
from rigctl.gateway.lease_service import LeaseService
from rigctl.gateway.margin_service import MarginService
from rigctl.gateway.preflight_service import PreflightService
from rigctl.gateway.published_position import Cursor
from rigctl.gateway.refused_access import RefusedAccess, ZenohLog
from rigctl.gateway.stalled_processes import StalledProcesses
from rigctl.gateway.streams import (
    EventStream,
    FastStream,
    declare_publisher,
    event_publishers,
    past_block,
    past_messages,
)
from rigctl.identity.key_folder import KeyFolderError
from rigctl.ipc import heap, ledger, public_slot, standard_output, wall_clock
from rigctl.ipc.folder_places import PUBLIC
from rigctl.ipc.joining import UsageError, joined
from rigctl.ipc.ledger import Standing
from rigctl.ipc.notes import Note, RequestLog, changes_noted, was_taken
from rigctl.ipc.progress import Progress
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import PUBLIC_MODE, RECORDED, FolderError, Runtime
from rigctl.ipc.termination import Termination
from rigctl.model.checks import HOST_CHECKS
from rigctl.model.faults import Fault
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations.preflight import PreflightVerdict
from rigctl.wire.command_request import newest_record
from rigctl.wire.keys import Keys
from rigctl.wire.offers import offers
from rigctl.wire.schema import schema
from rigctl.wire.session import SessionError, close, finish, open_client
from rigctl.wire.state_message import (
    Causes,
    CheckDetails,
    Recent,
    TripEvents,
    culprit_of,
    design_of,
    preflight_of,
    recorder_of,
    state_of,
    warnings_of,
)

_JSON = zenoh.Encoding.APPLICATION_JSON
_READ_NS = 500_000_000  # between two readings of the other processes' files
_LINK_S = 1.5  # limit for sessions at the routers to join; they are open at once unless the computer is busy
_JOIN_S = 0.5  # for their answers
_TAKEN_NS = 1_000_000_000  # without the endpoint of the network until another program has it: Zenoh opens it later


class StateView:
    """Makes the state message."""

    def __init__(
        self, runtime: Runtime, settings: RigSettings, active: ActiveConfiguration, dates: Mapping[str, datetime]
    ) -> None:
        """``dates``: of certificates, by what they are of."""
        self._dates, self._runtime = dates, runtime
        self._settings, self._active = settings, active
        self._recorder = ReplacedFile(runtime, RECORDED)
        self._records, self._events = runtime.records.reader(), runtime.events.reader(from_start=True)
        self._situations = runtime.situations.reader()
        self._records.cursor = max(0, self._records.head - settings.loop.rate_hz)
        self._recent, self._trip = Recent(), TripEvents()
        self._causes = Causes((*safety.table(settings), *limits.rows(settings)))
        self._culprit = LatchedCulprit(runtime.records.reader(), settings)
        self.standing: Mapping[Fault, str] = {}
        """Causes of a fault that stand now, in words, the strongest first."""
        self.check_details = CheckDetails(runtime.events.reader(from_start=True))
        self.log_changes = 0, ""
        """How often the audit log was changed in this run, and how the last time."""
        self._warnings: list[str] = []
        self._stalled = StalledProcesses(runtime)
        self._design: str | None = None
        self._kept: dict[str, Any] = {}
        self._read_ns = 0
        self._started_wall_ns = time.time_ns()
        self.newest = b"{}"

    def make(
        self,
        now_ns: int,
        samples_lost: int,
        standing: Standing,
        lease: dict[str, Any] | None,
        verdict: PreflightVerdict,
        cursor: Cursor,
    ) -> bytes:
        """Read what is new and encode it; ``cursor``: how far events and notes are published with this state."""
        record = self._records.latest()  # before the events: the loop writes a trip's event before its record
        self._recent.add(self._records.read())
        events = self._events.read()
        self._trip.note(events)
        self._causes.note(events)
        self._culprit.note(events)
        if now_ns >= self._read_ns:
            self._read_ns = now_ns + _READ_NS
            self._design, of_design = design_of(self._active.written)
            self._recorder.read()
            recorded = self._recorder.value
            if recorded.get("run") == self._active.written.get("started_wall_ns", 0):
                self.log_changes = recorded.get("changes", 0), recorded.get("changed", "")
            self._kept, of_recorder = recorder_of(self._recorder.value, now_ns)
            now = datetime.now(UTC)
            doubt = ledger.clock_doubt(self._settings, self._active.written.get("design"), now, standing)
            doubt = doubt or wall_clock.doubt(now, self._dates)
            self._warnings = [
                *([doubt] if doubt else []), *of_design, *warnings_of(self._active.control), *of_recorder,
                *self._stalled.look(),
            ]  # fmt: skip
        state = state_of(record, self._trip, self._recent, now_ns, time.time_ns())
        public = None if state["loop_alive"] else public_slot.read(self._runtime)
        wall_ns = time.time_ns() - now_ns
        causes = self._causes.of(record, wall_ns) if record is not None else []
        words: dict[Fault, str] = {}
        for cause in causes:
            words.setdefault(Fault[cause["fault"]], cause["text"])
        self.standing = words
        own = {
            "rig": self._settings.rig,
            "waits_for": public.waits_for or None if public is not None else None,
            "causes": causes,
            "culprit": culprit_of(self._culprit.of(record), causes, state),
            "samples_lost": samples_lost,
            "design": self._design,
            "calibration": standing,
            "lease": lease,
            "offers": offers(self._situations.latest(), now_ns, verdict.words, words),
            "preflight": preflight_of(record, verdict.words, verdict.waived),
            "read_back": self.check_details.read_back,
            **self._kept,
            "warnings": self._warnings,
            "gateway_wall_ns": self._started_wall_ns,
            "stream": cursor.stream,
            "event_seq": cursor.event_seq,
            "note_seq": cursor.note_seq,
        }
        return msgspec.json.encode({**own, **state})


def _answering(answer: Callable[[zenoh.Query], tuple[str, bytes]]) -> Callable[[zenoh.Query], None]:
    """A queryable's callback, from a function that returns key and payload; an exception becomes an error reply."""

    def take(query: zenoh.Query) -> None:
        try:
            key, payload = answer(query)
            query.reply(key, payload)
        except (ValueError, KeyError, OSError, msgspec.MsgspecError, zenoh.ZError) as error:
            with contextlib.suppress(zenoh.ZError):
                refuse(query, {"text": str(error)})
        finish(query)

    return take


def _after(query: zenoh.Query, name: str = "after") -> int:
    """The ``after=SEQ`` of a query."""
    text = query.parameters.get(name, "0") or "0"
    if not text.isascii() or not text.isdigit() or len(text) > 19:
        raise ValueError(f"found {name}={text[:40]!r}, expected a sequence number")
    return int(text)


def _declare_queryables(
    session: zenoh.Session,
    keys: Keys,
    runtime: Runtime,
    view: StateView,
    active: ActiveConfiguration,
    stream: int,
) -> None:
    known = msgspec.json.encode(schema(keys.rig, keys.person))
    records, events, notes = runtime.records.reader(), runtime.events.reader(), runtime.notes.reader()

    def past_events(query: zenoh.Query) -> tuple[str, bytes]:
        offset = time.time_ns() - time.monotonic_ns()
        found = past_messages(events, notes, _after(query), _after(query, "after_note"), offset, stream)
        return keys.events_past, msgspec.json.encode(found)

    for key, answer in (
        (keys.schema, lambda _query: (keys.schema, known)),
        (keys.active, lambda _query: (keys.active, active.read())),
        (keys.fast, lambda query: (keys.fast, past_block(records, _after(query), stream))),
        (keys.events_past, past_events),
        (keys.state, lambda _query: (keys.state, view.newest)),  # last: a client that gets one finds the others
    ):
        session.declare_queryable(key, _answering(answer))


def refuse_duplicate_name(keys: Keys, join: Sequence[str]) -> None:
    """Refuse to start where a rig behind a router to join has the same name: its clients could not tell them apart.

    The routers are asked as by any client, because this one takes no token of its own rig from another.

    Raises:
        SessionError: there is one.
    """
    found: list[str] = []

    def look(endpoint: str) -> None:
        with contextlib.suppress(SessionError, zenoh.ZError):
            session = open_client(endpoint)
            if any(reply.ok is not None for reply in session.liveliness().get(keys.daemon, timeout=_JOIN_S)):
                found.append(endpoint)
            close(session)

    looks = [threading.Thread(target=look, args=(endpoint,), daemon=True) for endpoint in join]
    for one in looks:
        one.start()
    for one in looks:
        one.join(_LINK_S + _JOIN_S)
    if found:
        raise SessionError(f"another daemon named {keys.rig} answers behind {', '.join(found)}: rename one")


class Gateway:
    """Sessions, streams and command server of one rig."""

    def __init__(self, runtime: Runtime, settings: RigSettings, log: ZenohLog | None = None) -> None:
        """Open everything. ``log``: Zenoh's, which shows what the access list refuses.

        Raises:
            SessionError: the endpoint is in use or not valid, or another daemon has this rig's name.
            KeyFolderError: the key folder cannot be used.
        """
        self._admission = Admission(settings)
        self._log, self._refused = log, RefusedAccess()
        keys, now = self._admission.keys, time.monotonic_ns()
        self._active, self._active_sent = ActiveConfiguration(runtime), b""
        run_id, telemetry = str(self._active.written.get("run_id", "")), settings.telemetry
        socket = f"unixsock-stream/{runtime.gateway_socket}"
        # Before the router: a client that finds that one without this socket knows a daemon of a version before.
        self._socket = CommandSocket(runtime, self._take, lambda: self._view.newest)
        refuse_duplicate_name(keys, telemetry.join)
        again = runtime.known(PUBLIC).get("run_id") == run_id
        self._session = self._admission.open_router(socket, again=again)
        runtime.let_members_connect(runtime.gateway_socket)
        public = {"rig": settings.rig, "listen": telemetry.listen, "run_id": run_id, "join": telemetry.join}
        runtime.write_json(PUBLIC, public, PUBLIC_MODE)
        self._places, self._listen = self._admission.places(self._session, socket), telemetry.listen
        self._is_taken, self._unheard_ns = was_taken(runtime.notes.reader(from_start=True).read()), 0
        # Commands have a session of their own, so that congestion of the data cannot delay them.
        self._command_session = open_client(socket, zid=self._admission.own_zid)
        self._period_ns = 1_000_000_000 // settings.telemetry.rate_hz
        self._per_call = max(1, settings.loop.rate_hz // settings.telemetry.rate_hz)

        records = runtime.records.reader(from_start=True)
        self._cursor = Cursor(runtime.gateway_cursor, runtime.records.path, records.head)
        self._view = view = StateView(runtime, settings, self._active, self._admission.dates)
        self._state = declare_publisher(self._session, keys.state, encoding=_JSON)
        self._configuration = declare_publisher(self._session, keys.active, encoding=_JSON)
        fast = declare_publisher(self._session, keys.fast)
        self._fast = FastStream(fast, records, self._cursor, now)
        publishers = event_publishers(self._session, keys)
        events, notes = runtime.events.reader(from_start=True), runtime.notes.reader(from_start=True)
        self._events = EventStream(publishers, events, notes, self._cursor, now)

        limits_n = (settings.tension.target_min_n, settings.tension.target_max_n)
        self._newest = newest = runtime.records.reader()
        self._calibration = calibration = CalibrationService(runtime, settings)
        self._margins = MarginService(runtime, settings, calibration.excited, calibration.record)
        self._preflight = PreflightService(
            runtime, settings, lambda: calibration.standing, self._view.check_details.read
        )
        self._read_ns, self._outdated = 0, False
        self._changes, self._ended = (
            changes_noted(runtime.notes.reader(from_start=True).read()),
            EndedProcesses(runtime),
        )
        self._host_checks_ns = now  # earliest time at which the host checks are sent to the loop again
        self._leases = LeaseService(runtime, settings.telemetry.lease_s, now)
        self._commands = CommandServer(
            runtime.commands.writer(),
            runtime.replies.reader(),
            lambda: newest_record(newest, view.standing),
            limits_n,
            self._calibration,
            self._leases,
            RequestLog(runtime.requests.writer()),
            self._preflight,
            run_id,
        )
        self._note_taken_at_start(now)
        verdict = self._preflight.verdict(now)
        lease = self._leases.shown(now)
        self._view.newest = self._view.make(now, 0, self._calibration.standing, lease, verdict, self._cursor)
        stream = self._cursor.stream
        self._commands.open()
        self._socket.open()
        if keys.person:  # who it is, certificates say
            take_queries(self._command_session, keys, self._commands)
        _declare_queryables(self._session, keys, runtime, self._view, self._active, stream)
        # On the session of the commands, after them: a client that sees the token finds every command.
        self._token = self._command_session.liveliness().declare_token(keys.daemon)

    def _take(self, name: str, payload: bytes | None, giver: Giver, reply: Reply) -> None:
        self._commands.take(name, payload, giver, reply)

    def publish(self) -> None:
        """Publish what one period brought.

        The state is made before the events are sent: a client that queries it on an event gets one that includes it.
        """
        now = time.monotonic_ns()
        self._fast.publish(self._per_call, now)
        record = self._newest.latest()
        self._events.read(time.time_ns() - now, now, int(record["t_ns"]) if record is not None else 0)
        for order in (*self._calibration.settings_due(now, time.time_ns()), *self._margins.settings_due()):
            self._commands.give_setting(order)
        verdict = self._preflight.verdict(now)
        self._send_host_checks(verdict, now)
        self._commands.check_lease_and_rate(now)
        self._note_refused_access(now)
        self._note_log_changes()
        if now >= self._read_ns:
            self._read_ns = now + _READ_NS
            self._publish_active()
            self._outdated = self._admission.has_changed()
            for note in self._ended.look():
                self._commands.note_process(note)
        lease = self._leases.shown(now)
        state = self._view.make(now, self._fast.lost, self._calibration.standing, lease, verdict, self._cursor)
        self._view.newest = state  # before the events, see above
        self._events.publish()
        self._state.put(state)
        self._socket.publish(state)

    def _note_refused_access(self, now_ns: int) -> None:
        if self._log is not None:
            for line in self._log.lines():
                self._refused.take(line, now_ns)
        self._places.keep(self._refused, now_ns)
        self._note_endpoint(now_ns)
        while self._socket.closed:
            who, why = self._socket.closed.popleft()
            self._refused.add(Note.CONNECTION_CLOSED, f"{why} of {who}", ("", who, why), now_ns)
        self._commands.note_refused_access(self._refused.due(now_ns))

    def _note_log_changes(self) -> None:
        """Note once what the recorder has found of the audit log."""
        count, how = self._view.log_changes
        if count > self._changes:
            self._changes = count
            self._commands.note_log_changed(how)

    def _note_taken_at_start(self, now_ns: int) -> None:
        if self._admission.is_taken and not self._is_taken:
            self._is_taken = True
            self._leases.note_endpoint(self._listen, now_ns, is_taken=True)

    def _note_endpoint(self, now_ns: int) -> None:
        """Note when another program has the endpoint of the network, and when it is the router's again."""
        if self._places.listens:
            self._unheard_ns = 0
        elif not self._unheard_ns:
            self._unheard_ns = now_ns
        is_taken = bool(self._unheard_ns) and (self._is_taken or now_ns - self._unheard_ns > _TAKEN_NS)
        if is_taken != self._is_taken:
            self._is_taken = is_taken
            self._commands.note_endpoint(self._listen, is_taken=is_taken)

    def _publish_active(self) -> None:
        if (found := self._active.read()) is not self._active_sent:
            self._active_sent = found
            self._configuration.put(found)

    def _send_host_checks(self, verdict: PreflightVerdict, now_ns: int) -> None:
        """Send the host checks whenever the loop's record shows others; a loop that has just started has none."""
        record = self._newest.latest()
        if (
            record is None
            or int(record["checks"]) & int(HOST_CHECKS) == verdict.host_checks
            or now_ns < self._host_checks_ns
        ):
            return
        self._host_checks_ns = now_ns + _READ_NS
        self._commands.give_setting(SettingOrder(Setting.HOST_CHECKS, (float(verdict.host_checks),)))

    def run(self, stop: Termination, progress: Progress) -> None:
        """Publish on an absolute grid until ``stop``, or until the access list changes; missed periods are skipped."""
        due = time.monotonic_ns()
        while not stop.requested and not self._outdated:
            self.publish()
            progress.step()
            now = time.monotonic_ns()
            due += self._period_ns * max(1, -((due - now) // self._period_ns))
            time.sleep(max(0.0, (due - time.monotonic_ns()) / 1e9))
        if self._outdated:
            why = "the access list has changed"
            now_ns = time.monotonic_ns()
            self._commands.note_process(ProcessNote(now_ns, Note.PROCESS_BACK, "gateway", why))
            sys.stderr.write("gateway: the access list has changed; it is started anew with the new one\n")

    def close(self) -> bool:
        """Publish the rest and end the sessions; False: the router is still open, for Zenoh would wait 10 s.

        It waits for the task that tries an endpoint of the network again that another program has.
        """
        self._calibration.close()
        self._preflight.close()
        self._commands.close()
        self.publish()
        self._socket.close()
        close(self._command_session)
        self._cursor.close()
        if self._places.listens:
            close(self._session)
        return self._places.listens


def main(arguments: list[str]) -> int:
    """Run the gateway of the runtime folder named; returns the exit code."""
    standard_output.never_wait()
    stop = Termination(signal.SIGTERM, signal.SIGHUP)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent(signal.SIGTERM)
    heap.limit()
    accepted_sockets.raise_limit()
    try:
        if (run := joined(arguments, "gateway", stop)) is None:
            return 0
        runtime = run.runtime
        settings = RigSettings.model_validate(runtime.read_json("active.json").get("settings"))
        gateway = Gateway(runtime, settings, ZenohLog())
        progress = run.show()
    except UsageError as error:
        sys.stderr.write(f"usage: python -m rigctl.gateway.gateway_process {error}\n")
        return 2
    except (OSError, RingError, FolderError, SessionError, KeyFolderError, msgspec.MsgspecError) as error:
        sys.stderr.write(f"gateway: {error}\n")
        return 1
    except ValidationError:
        sys.stderr.write("gateway: active.json holds no valid settings\n")
        return 1
    gateway.run(stop, progress)
    if not gateway.close():
        sys.stderr.flush()
        os._exit(0)  # the interpreter would close the router
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
