"""The desk: takes command queries, hands them to the loop through the ring, answers them. One thread, many at once."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import zenoh

from rigctl.control.modes import Verb
from rigctl.control.safety import Fault
from rigctl.telemetry.keys import Keys
from rigctl.telemetry.record import COMMAND_LIFETIME_NS
from rigctl.telemetry.request import Request, RequestError, Sight, answer, parse, refused, silent, verb_of
from rigctl.telemetry.ring import RingReader, RingWriter
from rigctl.telemetry.session import finish

POLL_S = 0.002
ARM_NS = 4_000_000_000  # the loop gives the drive up to 3 s
ANSWER_NS = COMMAND_LIFETIME_NS + 500_000_000  # after its lifetime the loop would not carry it out any more
_PENDING_MAX = 64


@dataclass(frozen=True)
class Pending:
    """A command the loop has not answered yet."""

    query: zenoh.Query
    request: Request
    until_ns: int


def send_answer(query: zenoh.Query, key: str, message: dict[str, Any]) -> None:
    """Answer and finish a query; a querier that has gone is no error."""
    payload = msgspec.json.encode(message)
    with contextlib.suppress(zenoh.ZError):
        if message["accepted"]:
            query.reply(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)
        else:
            query.reply_err(payload, encoding=zenoh.Encoding.APPLICATION_JSON)
    finish(query)


class Desk:
    """Queries in, ``COMMAND`` slots out, ``REPLY`` slots in, answers out."""

    def __init__(
        self,
        keys: Keys,
        commands: RingWriter,
        replies: RingReader,
        sight: Callable[[], Sight],
        limits_n: tuple[float, float],
    ) -> None:
        """``sight``: what the newest record says; ``limits_n``: lowest and highest target."""
        self._keys, self._commands, self._replies = keys, commands, replies
        self._sight, self._limits_n = sight, limits_n
        self._asked: queue.SimpleQueue[tuple[zenoh.Query, Request] | None] = queue.SimpleQueue()
        self._pending: dict[int, Pending] = {}
        self._last_id = 0
        self._thread = threading.Thread(target=self._serve, name="desk", daemon=True)

    def open(self, session: zenoh.Session) -> None:
        """Take queries from ``session``."""
        self._thread.start()
        session.declare_queryable(self._keys.command("*"), self._take)

    def close(self) -> None:
        """Answer no more."""
        self._asked.put(None)
        self._thread.join(timeout=1.0)

    def _take(self, query: zenoh.Query) -> None:
        """Zenoh's thread: check and queue, nothing that waits."""
        key = str(query.key_expr)
        name = key.rsplit("/", 1)[-1]
        try:
            verb = verb_of(name)
            if key != self._keys.command(name):
                raise RequestError(f"found the key {key}, allowed one rig and one command")
            request = parse(verb, bytes(query.payload) if query.payload is not None else None)
        except RequestError as error:
            send_answer(query, key, refused(name, "", "bad_request", str(error)))
            return
        self._asked.put((query, request))

    def _serve(self) -> None:
        while True:
            with contextlib.suppress(queue.Empty):
                asked = self._asked.get(timeout=POLL_S if self._pending else None)
                if asked is None:
                    return
                self._give(*asked)
            self._collect(time.monotonic_ns())

    def _give(self, query: zenoh.Query, request: Request) -> None:
        if len(self._pending) >= _PENDING_MAX:
            self._answer(query, request, silent(request.verb.name.lower(), request.operator))
            return
        now = time.monotonic_ns()
        # Never the id of a command given before, by this gateway or by one before it.
        self._last_id = max(self._last_id + 1, now)
        wait = ARM_NS if request.verb is Verb.ARM else ANSWER_NS
        self._pending[self._last_id] = Pending(query, request, now + wait)
        self._commands.write(now, self._last_id, int(request.verb), request.value)

    def _collect(self, now_ns: int) -> None:
        for reply in self._replies.read():
            given = self._pending.pop(int(reply["id"]), None)
            if given is None:
                continue
            request = given.request
            try:
                message = answer(request, reply, self._sight(), self._limits_n)
            except (ValueError, KeyError) as error:
                text = f"the control loop's answer makes no sense: {error}"
                message = refused(request.verb.name.lower(), request.operator, "unknown", text)
            self._answer(given.query, request, message)
        for number in [number for number, given in self._pending.items() if now_ns > given.until_ns]:
            given = self._pending.pop(number)
            name, operator = given.request.verb.name.lower(), given.request.operator
            self._answer(given.query, given.request, silent(name, operator))

    def _answer(self, query: zenoh.Query, request: Request, message: dict[str, Any]) -> None:
        send_answer(query, self._keys.command(request.verb.name.lower()), message)


def sight_of(records: RingReader) -> Sight:
    """What the newest record says about the rig."""
    record = records.latest()
    if record is None:
        return Sight()
    try:
        fault = Fault(int(record["fault"]))
    except ValueError:
        fault = Fault.NONE
    return Sight(fault, float(record["stroke_mm"]), float(record["tension_n"]), float(record["target_n"]))
