"""The command server: takes command queries, hands them to the loop through the ring, and answers them.

One thread serves many commands at once.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import zenoh

from rigctl.commission.preflight import Preflight
from rigctl.config.one_line import on_one_line
from rigctl.control.modes import FILED, Setting, SettingOrder, Verb, command_slot
from rigctl.gateway.calibration_service import CalibrationService, Filed
from rigctl.gateway.command_rate import Flow
from rigctl.gateway.lease_service import LeaseService
from rigctl.ipc import ledger
from rigctl.ipc.notes import RequestLog
from rigctl.ipc.record import COMMAND_LIFETIME_NS
from rigctl.ipc.ring import RingReader, RingWriter
from rigctl.wire.command_request import NewestRecord, Request, RequestError, answer, parse, refused, silent, verb_of
from rigctl.wire.keys import Keys
from rigctl.wire.lease import ACTS
from rigctl.wire.lease_request import LeaseRequest, parse_lease
from rigctl.wire.session import MESSAGE_BYTES, finish

POLL_S = 0.002
ANSWER_NS = COMMAND_LIFETIME_NS + 500_000_000  # the loop carries out no command older than its lifetime
WAIT_NS = {
    Verb.ARM: 8_000_000_000,  # standstill 2 s, brake test 2 s, the drive 2 s
    Verb.TARE: ANSWER_NS + 2_000_000_000,
    Verb.CALIBRATE: ANSWER_NS + 2_000_000_000,
    Verb.IDENTIFY: ANSWER_NS + 10_000_000_000,
}
READ_BACK_NS = 15_000_000_000  # added while the record shows ARMING: the loop reads the devices' settings back first
_PENDING_MAX = 64  # commands without an answer, HOLD not counted
_NAMES_ON_RECORD = 8  # operators put on record for one shared HOLD
_HOLD_SPACING_NS = 20_000_000  # between two HOLDs for the loop; those that arrive in between share the next one


@dataclass(frozen=True)
class Pending:
    """A command the loop has not answered yet."""

    query: zenoh.Query
    request: Request
    until_ns: int
    recorded: Recorded | None = None  # a finding on record that the loop has yet to take
    sharing: tuple[ReceivedCommand, ...] = ()  # HOLDs that arrived with it and get the same answer


@dataclass(frozen=True)
class ReceivedCommand:
    """A command that has arrived."""

    query: zenoh.Query
    request: Request


@dataclass(frozen=True)
class ReceivedLease:
    """A request to take or return the lease."""

    query: zenoh.Query
    request: LeaseRequest


@dataclass(frozen=True)
class HoldWaits:
    """Wakes the server's thread: a HOLD waits in its own queue."""


@dataclass(frozen=True)
class RateReportDue:
    """Commands were refused because there were too many, and a report of it is due."""


@dataclass(frozen=True)
class LeaseExpired:
    """The lease has expired; the server's thread checks this again before it ends the lease."""


@dataclass(frozen=True)
class Recorded:
    """The calibration service's result for a trial; ``message`` is the loop's answer to that trial."""

    query: zenoh.Query
    request: Request
    message: dict[str, Any]
    filed: Filed


@dataclass(frozen=True)
class Refused:
    """A query that was refused and has been answered; it has yet to be put on record."""

    message: dict[str, Any]


_Work = ReceivedCommand | HoldWaits | RateReportDue | ReceivedLease | LeaseExpired | Recorded | Refused | SettingOrder


def send_answer(query: zenoh.Query, key: str, message: dict[str, Any]) -> None:
    """Answer and finish a query; a querier that has disconnected is no error."""
    payload = msgspec.json.encode(message)
    with contextlib.suppress(zenoh.ZError):
        if message["accepted"]:
            query.reply(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)
        else:
            query.reply_err(payload, encoding=zenoh.Encoding.APPLICATION_JSON)
    finish(query)


def _payload_of(query: zenoh.Query) -> bytes | None:
    """A query's payload, not copied where it is too long to be a command."""
    if query.payload is None:
        return None
    if len(query.payload) > MESSAGE_BYTES:
        raise RequestError(f"found {len(query.payload)} bytes, expected at most {MESSAGE_BYTES}")
    return bytes(query.payload)


def _by_operator(holds: list[ReceivedCommand]) -> list[Request]:
    """One request of each operator, for the record: of at most ``_NAMES_ON_RECORD``, though all are answered."""
    return list({one.request.operator: one.request for one in holds}.values())[:_NAMES_ON_RECORD]


class CommandServer:
    """Queries in, ``COMMAND`` slots out, ``REPLY`` slots in, answers out."""

    def __init__(
        self,
        keys: Keys,
        commands: RingWriter,
        replies: RingReader,
        newest: Callable[[], NewestRecord],
        limits_n: tuple[float, float],
        calibration: CalibrationService,
        leases: LeaseService,
        log: RequestLog,
        preflight: Preflight,
        run_id: str = "",
    ) -> None:
        """``newest``: reads the newest record; ``limits_n``: lowest and highest target; ``log``: for the audit log.

        ``run_id``: of this daemon; a command that names another run is refused.
        """
        self._run_id = run_id
        self._log, self._preflight = log, preflight
        self._calibration, self._leases = calibration, leases
        self._keys, self._commands, self._replies = keys, commands, replies
        self._newest_record, self._limits_n = newest, limits_n
        self._work: queue.SimpleQueue[_Work | None] = queue.SimpleQueue()
        self._holds: deque[ReceivedCommand] = deque()  # served before all others
        self._hold_ns = 0  # earliest time of the next HOLD for the loop
        self._flow = Flow(time.monotonic_ns())
        self._pending: dict[int, Pending] = {}
        self._last_id = 0
        self._thread = threading.Thread(target=self._serve, name="commands", daemon=True)

    def open(self, session: zenoh.Session) -> None:
        """Take queries from ``session``."""
        self._thread.start()
        session.declare_queryable(self._keys.command("*"), self._take)

    def send(self, order: SettingOrder) -> None:
        """Send the loop a setting that no operator gives."""
        self._work.put(order)

    def look_at_lease(self, now_ns: int) -> None:
        """Have an expired lease ended and refused commands reported, also while no command arrives."""
        if self._leases.has_lapsed(now_ns):
            self._work.put(LeaseExpired())
        if self._flow.due(now_ns):
            self._work.put(RateReportDue())

    def close(self) -> None:
        """End the thread; nothing is answered after it."""
        self._work.put(None)
        self._thread.join(timeout=1.0)

    def _take(self, query: zenoh.Query) -> None:
        """Check, limit and queue, in Zenoh's thread: nothing here may wait. Commands over the limit go on no record."""
        key = str(query.key_expr)
        name = key.rsplit("/", 1)[-1]
        received: ReceivedCommand | ReceivedLease | Refused
        try:
            if key != self._keys.command(name):
                raise RequestError(f"found the key {on_one_line(key)}, expected one rig and one command")
            payload = _payload_of(query)
            if (act := ACTS.get(name)) is not None:
                received = ReceivedLease(query, parse_lease(act, payload))
            else:
                received = ReceivedCommand(query, parse(verb_of(name), payload))
                wanted = received.request
                if wanted.verb is Verb.HOLD and (
                    elsewhere := self._meant_for_another(wanted.run_id, "hold", wanted.operator)
                ):
                    received = Refused(elsewhere)
        except RequestError as error:
            received = Refused(refused(on_one_line(name), "", "bad_request", str(error)))
        if isinstance(received, ReceivedCommand) and received.request.verb is Verb.HOLD:
            self._holds.append(received)
            self._work.put(HoldWaits())
            return
        request = None if isinstance(received, Refused) else received.request
        operator, now = request.operator if request is not None else "", time.monotonic_ns()
        holder = request is not None and self._leases.is_holder(operator, request.lease, now)
        if why := self._flow.admit(operator, now, holder=holder):
            send_answer(query, key, refused(on_one_line(name), operator, "too_many", why))
            return
        if isinstance(received, Refused):
            send_answer(query, key, received.message)
        self._work.put(received)

    def _serve(self) -> None:
        while True:
            with contextlib.suppress(queue.Empty):
                work = self._work.get(timeout=POLL_S if self._pending or self._holds else None)
                if work is None:
                    return
                self._give_holds(time.monotonic_ns())
                self._do(work)
            self._give_holds(time.monotonic_ns())
            self._collect(time.monotonic_ns())

    def _do(self, work: _Work) -> None:
        match work:
            case RateReportDue():
                self._leases.note_crowd(self._flow.told(), time.monotonic_ns())
            case ReceivedCommand(query, request):
                if message := self._meant_for_another(request.run_id, request.verb.name.lower(), request.operator):
                    self._answer(query, request, message)
                    return
                self._give(query, request)
            case ReceivedLease(query, wanted):
                message = self._meant_for_another(wanted.run_id, wanted.act.value, wanted.operator)
                message = message or self._leases.decide(wanted, time.monotonic_ns())
                send_answer(query, self._keys.command(wanted.act.value), message)
                self._log.answered(time.monotonic_ns(), 0, self._holder(), message)
            case Refused(message):
                self._log.answered(time.monotonic_ns(), 0, self._holder(), message)
            case LeaseExpired():
                self._leases.expire(time.monotonic_ns())
            case Recorded():
                self._put_in_force(work)
            case SettingOrder(setting, values):
                self._write(setting, *values)

    def _meant_for_another(self, run_id: str, name: str, operator: str) -> dict[str, Any] | None:
        """The refusal of a command that names another daemon's run; None if it is meant for this one or for any."""
        if not run_id or run_id == self._run_id:
            return None
        text = f"found the run id of another daemon, expected {self._run_id}; nothing was done here"
        return refused(name, operator, "other_run", text)

    def _write(self, code: Verb | Setting, *values: float) -> int:
        """Write a command for the loop; returns its id, which no earlier command of any gateway has."""
        now = time.monotonic_ns()
        self._last_id = max(self._last_id + 1, now)
        self._commands.write(*command_slot(now, self._last_id, code, *values))
        return self._last_id

    def _give(self, query: zenoh.Query, request: Request) -> None:
        if len(self._pending) >= _PENDING_MAX:
            self._answer(query, request, silent(request.verb.name.lower(), request.operator))
            return
        if (why := self._calibration.impossible(request)) is not None:
            self._answer(query, request, refused(request.verb.name.lower(), request.operator, "not_possible", why))
            return
        now = time.monotonic_ns()
        admitted = self._leases.admit(request, now)
        if not isinstance(admitted, Request):
            self._answer(query, request, admitted)
            return
        request = admitted
        until_ns = now + WAIT_NS.get(request.verb, ANSWER_NS)
        if request.verb is Verb.ARM:  # the preflight must not use host checks of an earlier time
            self._write(Setting.HOST_CHECKS, float(self._preflight.verdict(now).host_checks))
        number = self._write(request.verb, request.number)
        self._pending[number] = Pending(query, request, until_ns)
        name = request.verb.name.lower()
        self._log.given(now, number, name, request.operator, self._holder(), request.number)

    def _give_holds(self, now_ns: int) -> None:
        """Send HOLD before all else and from anyone, since it is safe; waiting HOLDs become one, so no flood forms."""
        if not self._holds or now_ns < self._hold_ns:
            return
        self._hold_ns = now_ns + _HOLD_SPACING_NS
        holds = [self._holds.popleft() for _ in range(len(self._holds))]
        number = self._write(Verb.HOLD)
        first = holds[0]
        self._pending[number] = Pending(first.query, first.request, now_ns + ANSWER_NS, sharing=tuple(holds[1:]))
        for request in _by_operator(holds):
            self._log.given(now_ns, number, "hold", request.operator, self._holder(), request.number)
            self._leases.note_hold(request, now_ns)

    def _put_in_force(self, recorded: Recorded) -> None:
        """Send the loop what is on record now; the operator is answered when the loop has taken it."""
        request, finding = recorded.request, recorded.filed.finding
        if finding is None:
            name, filed = request.verb.name.lower(), recorded.filed
            self._answer(recorded.query, request, refused(name, request.operator, filed.reason, filed.text))
            return
        message = recorded.message
        message |= {"text": f"{request.verb.name}: {finding.text}", "entry": msgspec.to_builtins(finding.entry)}
        message |= {} if finding.good else {"accepted": False, "reason": "bad_result"}
        if finding.order is None:
            self._answer(recorded.query, request, message, recorded=recorded)
            return
        number = self._write(finding.order.setting, *finding.order.values)
        until_ns = time.monotonic_ns() + ANSWER_NS
        self._pending[number] = Pending(recorded.query, request, until_ns, recorded)

    def _collect(self, now_ns: int) -> None:
        for reply in self._replies.read():
            given = self._pending.pop(int(reply["id"]), None)
            if given is not None:
                self._answered(given, reply, int(reply["id"]))
        for number in [number for number, given in self._pending.items() if self._is_late(given, now_ns)]:
            given = self._pending.pop(number)
            if given.recorded is not None:
                self._calibration.unanswered(given.recorded.filed)
            name, operator = given.request.verb.name.lower(), given.request.operator
            self._answer(given.query, given.request, silent(name, operator), number)
            self._answer_sharing(given, lambda request: silent("hold", request.operator))

    def _is_late(self, given: Pending, now_ns: int) -> bool:
        more_ns = 0
        if given.request.verb is Verb.ARM and now_ns > given.until_ns and self._newest_record().arming:
            more_ns = READ_BACK_NS
        return now_ns > given.until_ns + more_ns

    def _answered(self, given: Pending, reply: Any, number: int) -> None:
        """Pass the loop's reply to the operator; that of a trial goes to the calibration service first."""
        query, request = given.query, given.request
        try:
            verdict = self._preflight.verdict(time.monotonic_ns())
            message = answer(request, reply, self._newest_record(), self._limits_n, verdict.words, verdict.waived)
        except (ValueError, KeyError) as error:
            text = f"the control loop's answer makes no sense: {error}"
            message = refused(request.verb.name.lower(), request.operator, "unknown", text)
        if given.recorded is not None:
            if message["accepted"]:
                self._calibration.put_in_force(given.recorded.filed)
                message = given.recorded.message
            else:
                self._calibration.withdraw(given.recorded.filed)
                message["text"] += "; withdrawn from the ledger"
        elif request.verb in FILED and message["accepted"]:

            def recorded(filed: Filed) -> None:
                self._work.put(Recorded(query, request, message, filed))

            self._calibration.file(request, reply, recorded)
            return
        self._answer(query, request, message, number, given.recorded)
        self._answer_sharing(given, lambda request: {**message, "operator": request.operator})

    def _answer_sharing(self, given: Pending, answer_to: Callable[[Request], dict[str, Any]]) -> None:
        """Answer every operator who shares this HOLD; the answer is put on record once."""
        now = time.monotonic_ns()
        for query, request in ((hold.query, hold.request) for hold in given.sharing):
            message = self._leases.with_lease(request.operator, request.lease, answer_to(request), now)
            send_answer(query, self._keys.command("hold"), message)

    def _answer(
        self, query: zenoh.Query, request: Request, message: dict[str, Any], number: int = 0,
        recorded: Recorded | None = None,
    ) -> None:  # fmt: skip
        now = time.monotonic_ns()
        message = self._leases.with_lease(request.operator, request.lease, message, now)
        send_answer(query, self._keys.command(request.verb.name.lower()), message)
        finding = recorded.filed.finding if recorded is not None else None
        entry = ledger.entry_digest(finding.entry) if finding is not None else ""
        self._log.answered(now, number, self._holder(), message, entry)

    def _holder(self) -> str:
        """The lease holder's name, empty without a lease."""
        lease = self._leases.shown(time.monotonic_ns())
        return str(lease["holder"]) if lease is not None else ""
