"""The command server: takes commands, hands them to the loop through the ring, and answers them.

It takes values and a function for the answer, whatever brought them: Zenoh (`rigctl.gateway.command_queries`) or the
socket of this computer (`rigctl.gateway.command_socket`). One thread serves many commands at once.
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import msgspec

from rigctl.config.one_line import on_one_line
from rigctl.control.excitation.trials import STEP_WAIT_S
from rigctl.control.modes import FILED, command_slot
from rigctl.gateway.calibration_service import CalibrationService
from rigctl.gateway.ended_processes import ProcessNote
from rigctl.gateway.lease_service import LeaseService
from rigctl.gateway.preflight_service import PreflightService
from rigctl.gateway.refused_access import AccessRefusal
from rigctl.ipc import ledger
from rigctl.ipc.notes import RequestLog
from rigctl.ipc.record import COMMAND_LIFETIME_NS
from rigctl.ipc.ring import RingReader, RingWriter
from rigctl.ipc.writers import OPERATORS
from rigctl.model.lease_acts import ACTS
from rigctl.model.requests import LeaseRequest, Request
from rigctl.model.verbs import Setting, SettingOrder, Verb, VerbTrait, having
from rigctl.operations.command_rate import Flow
from rigctl.operations.filing import Filed
from rigctl.wire.alarm_request import AlarmRequest, parse_alarm
from rigctl.wire.alarms import ALARM_ACTS
from rigctl.wire.command_request import NewestRecord, RequestError, answer, parse, refused, silent, verb_of
from rigctl.wire.lease_request import parse_lease
from rigctl.wire.note_request import NOTE, NoteRequest, parse_note
from rigctl.wire.user_name import with_user

POLL_S = 0.002
ANSWER_NS = COMMAND_LIFETIME_NS + 500_000_000  # the loop carries out no command older than its lifetime
TAKE_NS = 4_000_000_000  # taking the load back: standstill with the brake closed 2 s, the drive 2 s
WAIT_NS = {
    verb: ANSWER_NS + round(verb.row.takes_s * 1e9) + (TAKE_NS if VerbTrait.MOTOR in verb.row.traits else 0)
    for verb in Verb
}
WAITING = having(VerbTrait.FOLLOWS_DRIVE) | having(VerbTrait.MOTOR)
"""Commands that may wait for the drive, and for the read-back before it."""
READ_BACK_NS = 15_000_000_000  # added while the record shows ARMING: the loop reads the devices' settings back first
_PENDING_MAX = 64  # commands without an answer, HOLD not counted
_NAMES_ON_RECORD = 8  # operators put on record for one shared HOLD
_HOLD_SPACING_NS = 20_000_000  # between two HOLDs for the loop; those that arrive in between share the next one


Reply = Callable[[dict[str, Any]], None]
"""Sends an answer: called once for each command, from any thread; it must not wait."""


@dataclass(frozen=True)
class Giver:
    """Who gives a command, as the transport shows it.

    ``person``: name in a certificate. ``user``, ``process``: of this computer, as the kernel says. ``commands``: he may
    command, and not only give HOLD.
    """

    person: str = ""
    user: str = ""
    process: int = 0
    commands: bool = True

    def operator(self, given: str = "") -> str:
        """The operator's name, of which a request may say a part."""
        return self.person or (with_user(given, self.user) if self.user else given)

    @property
    def recorded(self) -> str:
        """User and process, for the record; empty over the network."""
        return f"process {self.process} of {self.user}" if self.user else ""


@dataclass(frozen=True)
class GivenCommand:
    """A command of an operator, and what answers it."""

    reply: Reply
    request: Request
    giver: Giver = Giver()


@dataclass(frozen=True)
class Recorded:
    """The calibration service's result for a trial; ``message`` is the loop's answer to that trial."""

    given: GivenCommand
    message: dict[str, Any]
    filed: Filed


@dataclass(frozen=True)
class Pending:
    """A command the loop has not answered yet."""

    given: GivenCommand
    until_ns: int
    recorded: Recorded | None = None  # a finding on record that the loop has yet to take
    sharing: tuple[GivenCommand, ...] = ()  # HOLDs that arrived with it and get the same answer


AnyRequest = Request | LeaseRequest | AlarmRequest | NoteRequest


def parsed(name: str, payload: bytes | None) -> AnyRequest:
    """The request on the key that ends in ``name``.

    Raises:
        RequestError: there is no such command, or the payload is not its.
    """
    if name in ACTS:
        return parse_lease(ACTS[name], payload)
    if name in ALARM_ACTS:
        return parse_alarm(ALARM_ACTS[name], payload)
    if name == NOTE:
        return parse_note(payload)
    return parse(verb_of(name), payload)


def _by_operator(holds: list[GivenCommand]) -> list[GivenCommand]:
    """One of each operator, for the record: of at most ``_NAMES_ON_RECORD``, though all are answered."""
    return list({one.request.operator: one for one in holds}.values())[:_NAMES_ON_RECORD]


class CommandServer:
    """Commands in, ``COMMAND`` slots out, ``REPLY`` slots in, answers out."""

    def __init__(
        self,
        commands: RingWriter,
        replies: RingReader,
        newest: Callable[[], NewestRecord],
        limits_n: tuple[float, float],
        calibration: CalibrationService,
        leases: LeaseService,
        log: RequestLog,
        preflight: PreflightService,
        run_id: str = "",
    ) -> None:
        """``newest``: reads the newest record; ``limits_n``: lowest and highest target; ``log``: for the audit log.

        ``run_id``: of this daemon; a command that names another run is refused.
        """
        self._run_id = run_id
        self._log, self._preflight = log, preflight
        self._calibration, self._leases = calibration, leases
        self._commands, self._replies = commands, replies
        self._newest_record, self._limits_n = newest, limits_n
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()  # None ends the thread
        self._holds: deque[GivenCommand] = deque()  # served before all others
        self._hold_ns = 0  # earliest time of the next HOLD for the loop
        self._rate = Flow(time.monotonic_ns())
        self._pending: dict[int, Pending] = {}
        self._last_id = 0
        self._thread = threading.Thread(target=self._serve, name="commands", daemon=True)

    def open(self) -> None:
        """Start the thread; from now on `take` may be called."""
        self._thread.start()

    def give_setting(self, order: SettingOrder) -> None:
        """Send the loop a setting that no operator gives."""
        self._work.put(lambda: self._write(order.setting, *order.values))

    def check_lease_and_rate(self, now_ns: int) -> None:
        """Have a lapsed lease ended and refused commands reported, also while no command arrives."""
        if self._leases.has_lapsed(now_ns):
            self._work.put(lambda: self._leases.expire(time.monotonic_ns()))
        if self._rate.due(now_ns):
            self._work.put(self._note_refused)

    def note_refused_access(self, refusals: list[AccessRefusal]) -> None:
        """Have what the access list and TLS refused noted."""
        if refusals:
            self._work.put(lambda: self._leases.note_refused_access(refusals, time.monotonic_ns()))

    def note_endpoint(self, endpoint: str, *, is_taken: bool) -> None:
        """Have noted that another program has the endpoint of the network, or that it is this daemon's again."""
        self._work.put(lambda: self._leases.note_endpoint(endpoint, time.monotonic_ns(), is_taken=is_taken))

    def note_process(self, note: ProcessNote) -> None:
        """Have noted that recorder or gateway has ended unwanted, or is back."""
        self._work.put(lambda: self._leases.note_process(note))

    def note_log_changed(self, how: str) -> None:
        """Have noted that the audit log was changed while the daemon ran."""
        self._work.put(lambda: self._leases.note_log_changed(how, time.monotonic_ns()))

    def _note_refused(self) -> None:
        self._leases.note_refused(self._rate.report(), time.monotonic_ns())

    def close(self) -> None:
        """End the thread; nothing is answered after it."""
        self._work.put(None)
        self._thread.join(timeout=1.0)

    def take(self, name: str, payload: bytes | None, giver: Giver, reply: Reply) -> None:
        """Check, limit and queue, in the caller's thread: nothing here may wait.

        Commands over the limit go on no record. ``name``: of the command, as its key ends.
        """
        try:
            request = parsed(name, payload)
        except RequestError as error:
            self.refuse(name, str(error), giver, reply)
            return
        request = replace(request, operator=giver.operator(request.operator))
        if not giver.commands and request.command != "hold":  # which every user of this computer gives
            why = f"{giver.user} reads the rig; its commands are for the group {OPERATORS}"
            self._refuse(refused(request.command, request.operator, "not_allowed", why), giver, reply)
            return
        if isinstance(request, Request) and request.verb is Verb.HOLD:
            elsewhere = self._meant_for_another(request)
            if elsewhere is not None:
                self._refuse(elsewhere, giver, reply)
                return
            self._holds.append(GivenCommand(reply, request, giver))
            self._work.put(lambda: None)  # wakes the thread, which serves HOLDs first
            return
        now = time.monotonic_ns()
        holder = self._leases.is_holder(request.operator, request.lease, now)
        if why := self._rate.admit(request.operator, now, holder=holder):
            reply(refused(on_one_line(name), request.operator, "too_many", why))
        elif isinstance(request, LeaseRequest):
            self._work.put(partial(self._decide_lease, request, giver, reply))
        elif isinstance(request, AlarmRequest | NoteRequest):
            self._work.put(partial(self._put_on_record, request, giver, reply))
        else:
            self._work.put(partial(self._give, GivenCommand(reply, request, giver)))

    def refuse(self, name: str, why: str, giver: Giver, reply: Reply) -> None:
        """Refuse what is no command, in the caller's thread."""
        self._refuse(refused(on_one_line(name), giver.operator(), "bad_request", why), giver, reply)

    def _refuse(self, refusal: dict[str, Any], giver: Giver, reply: Reply) -> None:
        if why := self._rate.admit(giver.operator(), time.monotonic_ns()):
            reply(refused(refusal["verb"], giver.operator(), "too_many", why))
            return
        reply(refusal)
        self._work.put(partial(self._record_refusal, refusal, giver))

    def _serve(self) -> None:
        while True:
            with contextlib.suppress(queue.Empty):
                work = self._work.get(timeout=POLL_S if self._pending or self._holds else None)
                if work is None:
                    return
                self._give_holds(time.monotonic_ns())
                work()
            self._give_holds(time.monotonic_ns())
            self._collect(time.monotonic_ns())

    def _record_refusal(self, message: dict[str, Any], giver: Giver) -> None:
        self._log.answered(time.monotonic_ns(), 0, self._holder(), message, giver=giver.recorded)

    def _decide_lease(self, request: LeaseRequest, giver: Giver, reply: Reply) -> None:
        message = self._meant_for_another(request) or self._leases.decide(request, time.monotonic_ns())
        reply(message)
        self._record_refusal(message, giver)

    def _put_on_record(self, request: AlarmRequest | NoteRequest, giver: Giver, reply: Reply) -> None:
        """Put a decision about an alarm, or an operator's words, on record; every display has it from the events."""
        now = time.monotonic_ns()
        message = self._meant_for_another(request) or self._leases.note_request(request, now)
        reply(message | {"lease": self._leases.shown(now)})
        self._record_refusal(message, giver)

    def _meant_for_another(self, request: AnyRequest) -> dict[str, Any] | None:
        """The refusal of a command that names another daemon's run; None if it is meant for this one or for any."""
        if request.run_id in ("", self._run_id):
            return None
        text = f"found the run id of another daemon, expected {self._run_id}; nothing was done here"
        return refused(request.command, request.operator, "other_run", text)

    def _write(self, code: Verb | Setting, *values: float) -> int:
        """Write a command for the loop; returns its id, which no earlier command of any gateway has."""
        now = time.monotonic_ns()
        self._last_id = max(self._last_id + 1, now)
        self._commands.write(*command_slot(now, self._last_id, code, *values))
        return self._last_id

    def _give(self, given: GivenCommand) -> None:
        request, now = given.request, time.monotonic_ns()
        if (elsewhere := self._meant_for_another(request)) is not None:
            self._answer(given, elsewhere)
            return
        if len(self._pending) >= _PENDING_MAX:
            self._answer(given, silent(request.command, request.operator))
            return
        if (why := self._calibration.impossible(request)) is not None:
            self._answer(given, refused(request.command, request.operator, "not_possible", why))
            return
        admitted = self._leases.admit(request, now)
        if not isinstance(admitted, Request):
            self._answer(given, admitted)
            return
        if request.verb is Verb.ARM:  # the preflight must not use host checks of an earlier time
            self._write(Setting.HOST_CHECKS, float(self._preflight.verdict(now).host_checks))
        number = self._write(request.verb, *request.numbers)
        wait_ns = WAIT_NS[request.verb]
        if math.isfinite(request.creep_s):
            wait_ns += round((request.creep_s + STEP_WAIT_S) * 1e9)
        self._pending[number] = Pending(replace(given, request=admitted), now + wait_ns)
        self._record_given(now, number, given)

    def _record_given(self, now_ns: int, number: int, given: GivenCommand) -> None:
        request, giver = given.request, given.giver.recorded
        self._log.given(now_ns, number, request.command, request.operator, self._holder(), request.number, giver)

    def _give_holds(self, now_ns: int) -> None:
        """Send HOLD before all else and from anyone, since it is safe; waiting HOLDs become one, so no flood forms."""
        if not self._holds or now_ns < self._hold_ns:
            return
        self._hold_ns = now_ns + _HOLD_SPACING_NS
        first, *others = holds = [self._holds.popleft() for _ in range(len(self._holds))]
        number = self._write(Verb.HOLD)
        self._pending[number] = Pending(first, now_ns + ANSWER_NS, sharing=tuple(others))
        for given in _by_operator(holds):
            self._record_given(now_ns, number, given)
            self._leases.note_hold(given.request, now_ns)

    def _put_in_force(self, recorded: Recorded) -> None:
        """Send the loop what is on record now; the operator is answered when the loop has taken it."""
        given, filed = recorded.given, recorded.filed
        request, finding = given.request, filed.finding
        if finding is None:
            self._answer(given, refused(request.command, request.operator, filed.reason, filed.text))
            return
        message = recorded.message
        message |= {"text": f"{request.verb.name}: {finding.text}", "entry": msgspec.to_builtins(finding.entry)}
        message |= {} if finding.good else {"accepted": False, "reason": "bad_result"}
        if finding.order is not None:
            number = self._write(finding.order.setting, *finding.order.values)
            self._pending[number] = Pending(given, time.monotonic_ns() + ANSWER_NS, recorded)
        else:
            self._answer(given, message, recorded=recorded)

    def _collect(self, now_ns: int) -> None:
        for reply in self._replies.read():
            pending = self._pending.pop(int(reply["id"]), None)
            if pending is not None:
                self._pass_on(pending, reply, int(reply["id"]))
        for number in [number for number, pending in self._pending.items() if self._is_late(pending, now_ns)]:
            pending = self._pending.pop(number)
            if pending.recorded is not None:
                self._calibration.unanswered(pending.recorded.filed)
            request = pending.given.request
            self._answer(pending.given, silent(request.command, request.operator), number)
            self._answer_sharing(pending, lambda request: silent("hold", request.operator))

    def _is_late(self, pending: Pending, now_ns: int) -> bool:
        more_ns = 0
        if pending.given.request.verb in WAITING and now_ns > pending.until_ns and self._newest_record().arming:
            more_ns = READ_BACK_NS
        return now_ns > pending.until_ns + more_ns

    def _pass_on(self, pending: Pending, reply: Any, number: int) -> None:
        """Pass the loop's reply to the operator; that of a trial goes to the calibration service first."""
        given, request, recorded = pending.given, pending.given.request, pending.recorded
        try:
            verdict = self._preflight.verdict(time.monotonic_ns())
            message = answer(request, reply, self._newest_record(), self._limits_n, verdict.words, verdict.waived)
        except (ValueError, KeyError) as error:
            text = f"the control loop's answer makes no sense: {error}"
            message = refused(request.command, request.operator, "unknown", text)
        if recorded is not None:
            if message["accepted"]:
                self._calibration.put_in_force(recorded.filed)
                message = recorded.message
            else:
                self._calibration.withdraw(recorded.filed)
                message["text"] += "; withdrawn from the ledger"
        elif request.verb in FILED and message["accepted"]:

            def done(filed: Filed) -> None:
                self._work.put(lambda: self._put_in_force(Recorded(given, message, filed)))

            self._calibration.file(request, reply, done)
            return
        self._answer(given, message, number, recorded)
        self._answer_sharing(pending, lambda request: {**message, "operator": request.operator})

    def _answer_sharing(self, pending: Pending, answer_to: Callable[[Request], dict[str, Any]]) -> None:
        """Answer every operator who shares this HOLD; the answer is put on record once."""
        for given in pending.sharing:
            self._send(given, answer_to(given.request), time.monotonic_ns())

    def _answer(
        self, given: GivenCommand, message: dict[str, Any], number: int = 0, recorded: Recorded | None = None
    ) -> None:
        now = time.monotonic_ns()
        message = self._send(given, message, now)
        finding = recorded.filed.finding if recorded is not None else None
        entry = ledger.entry_digest(finding.entry) if finding is not None else ""
        self._log.answered(now, number, self._holder(), message, entry, given.giver.recorded)

    def _send(self, given: GivenCommand, message: dict[str, Any], now_ns: int) -> dict[str, Any]:
        """Answer a command with the lease in force; returns the answer."""
        request = given.request
        message = self._leases.with_lease(request, message, now_ns)
        given.reply(message)
        return message

    def _holder(self) -> str:
        """The lease holder's name, empty without a lease."""
        lease = self._leases.shown(time.monotonic_ns())
        return str(lease["holder"]) if lease is not None else ""
