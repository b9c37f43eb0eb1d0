"""Connection to the daemon of one rig: discovery, queries, commands. Every client here is built on it.

Zenoh runs in client mode: once connected it reconnects by itself after a restart of the gateway.
"""

from __future__ import annotations

import datetime
import os
import pathlib
import re
import threading
import time
from collections.abc import Callable
from typing import Any, Self, TypeVar

import msgspec
import zenoh

from rigctl.client import local_hold, shapes
from rigctl.client.block_order import DEPTH_BLOCKS, BlockSource
from rigctl.client.command_connection import CommandConnections
from rigctl.client.decoding import SampleLayout, SchemaError, layout_of, usable_schema
from rigctl.client.endpoint import chosen_endpoint
from rigctl.client.event_order import Events, EventSource
from rigctl.client.mailbox import Mailbox
from rigctl.client.messages import MessageSource, shape_of
from rigctl.client.route import Route
from rigctl.client.samples import Blocks, Samples
from rigctl.client.shapes import (
    LONGEST_BLOCK,
    LONGEST_DOCUMENT,
    LONGEST_PAST,
    Check,
    Message,
    MessageRefusedError,
    Refusals,
)
from rigctl.client.stream import Stream
from rigctl.client.stream_source import Question
from rigctl.identity import credentials
from rigctl.identity.credentials import Credentials, CredentialsError
from rigctl.ipc import wall_clock
from rigctl.model.lease_acts import ACTS, LeaseAct
from rigctl.model.verbs import COMMAND_S, Verb
from rigctl.wire import keys
from rigctl.wire.alarms import AlarmAct
from rigctl.wire.keys import Keys
from rigctl.wire.note_request import NOTE
from rigctl.wire.session import SessionError, close, open_client
from rigctl.wire.socket_message import COMMAND, STATE
from rigctl.wire.user_name import user_name, with_user

_AGAIN_S = 0.05
ABSENT = "absent, or not allowed"  # an access list refuses without an answer
FORMER = "the daemon is of an earlier version: restart the daemon to command it"
OPEN_S = 2.0
ASK_S = 2.0
WEIGHT_S = 120.0  # until a weight is hung on the cell, whose creep is then recorded
_RIG = re.compile(r"[a-z][a-z0-9_]{0,31}")
_EVENTS_DEPTH = 4096
_HOLD = "hold"
_Some = TypeVar("_Some")


class NoDaemonError(RuntimeError):
    """No daemon answers; ``str()`` is one line."""

    def __init__(self, text: str, *, connected: bool = False) -> None:
        """``connected``: a router has taken the session, and shows no rig to this client."""
        super().__init__(text)
        self.connected = connected


class OtherRigError(NoDaemonError):
    """Daemons answer, and none of them is the one meant; ``str()`` is one line."""


class ChoiceError(ValueError):
    """The endpoint or the rig's name is not valid, or several rigs answer; ``str()`` is one line."""


class NoKeyError(ChoiceError):
    """An endpoint ``tls/`` and no key file; ``str()`` is one line."""


def _open(route: Route, owned: Credentials | None) -> zenoh.Session:
    """Open a session, giving up after ``OPEN_S`` whatever the network does."""
    opened: list[zenoh.Session] = []

    def attempt() -> None:
        try:
            opened.append(open_client(route.endpoint, owned))
        except SessionError:
            return

    thread = threading.Thread(target=attempt, name="connect", daemon=True)
    thread.start()
    thread.join(OPEN_S)
    if not opened:
        raise NoDaemonError(f"no daemon answers at {route.given} ({ABSENT}{_clock(owned)})")
    return opened[0]


def _clock(owned: Credentials | None) -> str:
    """The further cause why nobody answers by TLS: this computer's clock, by which no certificate is valid."""
    why = wall_clock.unset(datetime.datetime.now(datetime.UTC)) if owned is not None else ""
    return f"; {why}: set the clock" if why else ""


def _has_token(session: zenoh.Session, rig: str) -> bool:
    found = session.liveliness().get(Keys(rig).daemon, timeout=ASK_S)
    return any(reply.ok is not None and str(reply.ok.key_expr) == Keys(rig).daemon for reply in found)


def _rigs(session: zenoh.Session) -> list[str]:
    tokens = session.liveliness().get(keys.ANY_DAEMON, timeout=ASK_S)
    found = {keys.rig_of(str(reply.ok.key_expr)) for reply in tokens if reply.ok is not None}
    return sorted(name for name in found if _RIG.fullmatch(name))


def endpoint_of(connect: str | None) -> str:
    """The endpoint given, else ``RIGCTL_CONNECT``, else the default.

    Raises:
        ChoiceError: it is not a valid endpoint.
    """
    endpoint = chosen_endpoint(connect)
    if not re.fullmatch(r"[a-z-]+/\S+", endpoint):
        raise ChoiceError(f"found endpoint {endpoint!r}, expected e.g. {keys.DEFAULT_ENDPOINT}")
    return endpoint


def credentials_of(endpoint: str, key: pathlib.Path | str | None) -> Credentials | None:
    """The key file given, else that of ``RIGCTL_KEY``, for an endpoint ``tls/``; None for any other.

    Raises:
        NoKeyError: there is no key file.
        ChoiceError: it cannot be used, or its certificate has expired.
    """
    if not endpoint.startswith("tls/"):
        return None
    given = key or os.environ.get("RIGCTL_KEY")
    if not given:
        raise NoKeyError(f"found no key for {endpoint}, expected a key file in --key or RIGCTL_KEY (rigctl keys add)")
    try:
        owned = credentials.read(pathlib.Path(given))
    except CredentialsError as error:
        raise ChoiceError(str(error)) from None
    now = datetime.datetime.now(datetime.UTC)
    if owned.not_after <= now:
        clock = f"; {why}: set the clock" if (why := wall_clock.unset(now)) else ""
        raise ChoiceError(f"{given}: expired on {owned.not_after:%Y-%m-%d}: rigctl keys renew {owned.name}{clock}")
    return owned


def rigs(connect: str | None = None, key: pathlib.Path | str | None = None) -> list[str]:
    """Names of the rigs whose daemons answer at an endpoint, sorted; several may share one router.

    Raises:
        NoDaemonError: no daemon answers, or access is not allowed.
        ChoiceError: endpoint or key is not valid.
    """
    route, owned = _route(endpoint_of(connect), None, key)
    try:
        session = _open(route, owned)
        try:
            return _rigs(session)
        finally:
            close(session)
    finally:
        route.leave()


def _route(endpoint: str, rig: str | None, key: pathlib.Path | str | None) -> tuple[Route, Credentials | None]:
    """The way to an endpoint, and the key for it. On the rig's own computer ``tls/`` needs no key: its socket is there.

    Raises:
        ChoiceError: the key cannot be used, or is missing.
    """
    try:
        owned = credentials_of(endpoint, key)
    except NoKeyError:
        if (route := Route(endpoint, rig)).is_local:
            return route, None
        raise
    return Route(endpoint, rig, certified=owned is not None), owned


class Client:
    """Connection to the daemon of one rig."""

    def __init__(
        self,
        connect: str | None = None,
        rig: str | None = None,
        run_id: str | None = None,
        key: pathlib.Path | str | None = None,
    ) -> None:
        """``connect``: endpoint, else ``RIGCTL_CONNECT``; ``rig``: name, else ``RIGCTL_RIG``, else the only one.

        ``key``: key file, else ``RIGCTL_KEY``, for an endpoint ``tls/``; who commands is then the name in it.

        ``run_id``: of the one daemon process that may be commanded; every command but HOLD carries it, and a daemon of
        another run refuses it (``other_run``).

        Raises:
            NoDaemonError: no daemon answers, access is not allowed, or the run is not ``run_id``.
            ChoiceError: endpoint, name or key is not valid, or several rigs answer and none is chosen.
        """
        self.endpoint = endpoint_of(connect)
        wanted = rig or os.environ.get("RIGCTL_RIG") or None
        if wanted is not None and not _RIG.fullmatch(wanted):
            raise ChoiceError(f"found rig {wanted!r}, expected a rig's name, e.g. paper_rig")
        self.leases: dict[str, str] = {}  # operator: lease id from the answers, sent with the operator's commands
        self.refusals = Refusals()  # messages without the shape of the daemon's
        self._mailboxes: list[Mailbox] = []
        self.route, owned = _route(self.endpoint, wanted, key)
        self.person = owned.name if owned is not None else ""
        """Name in the certificate, by which the daemon knows this client; empty without one."""
        self._owned, self._opening = owned, threading.Lock()
        self._session: zenoh.Session | None = None
        self._leave = self.route.followed()
        self._local: CommandConnections | None = None  # of a version before there is no socket for commands
        try:
            self.keys = Keys(self._answering_here(wanted) or self._choose(wanted), self.person)
            if self._local is None and (place := self.route.command_socket(self.rig)) is not None:
                self._local = CommandConnections(place)
            self._run_id = run_id
            self._check_run()
        except (NoDaemonError, ChoiceError):
            self.close()
            raise

    def _check_run(self) -> None:
        if self._run_id is not None and (found := self.active().get("run_id")) != self._run_id:
            raise OtherRigError(
                f"another daemon answers at {self.endpoint}: found run {found}, expected run {self._run_id}; "
                f"it was not commanded"
            )

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session, opened at its first use: commands and the state of this computer's rig do without it.

        Raises:
            NoDaemonError: the daemon's router does not take it.
        """
        with self._opening:
            if self._session is None:
                self._session = _open(self.route, self._owned)
            return self._session

    def _answering_here(self, wanted: str | None) -> str:
        """Name of the rig whose command socket answers, if it is the one meant; empty: Zenoh has to find it.

        Raises:
            NoDaemonError: the gateway hangs.
        """
        rig = self.route.rig
        if wanted != rig and (wanted is not None or not self.route.is_alone):
            return ""
        if (place := self.route.command_socket(rig)) is None:
            return ""
        local, hangs = CommandConnections(place), False
        try:
            if local.ask(STATE, None, ASK_S)[0]:
                self._local = local
                return rig
        except (TimeoutError, BlockingIOError):
            hangs = True  # and its router with it, which is in the same process
        except OSError:
            pass
        local.close()
        if hangs:
            raise self._nobody()
        return ""

    def _choose(self, wanted: str | None) -> str:
        """The rig's name.

        Raises:
            NoDaemonError: no daemon answers.
            ChoiceError: several rigs answer and none is chosen.
        """
        if wanted is not None and _has_token(self.session, wanted):
            return wanted
        rigs = _rigs(self.session)
        if wanted is not None and rigs and wanted not in rigs:
            raise OtherRigError(f"no daemon of {wanted} answers at {self.endpoint}, only of {', '.join(rigs)}")
        if not rigs:
            raise self._nobody()
        if wanted is None and len(rigs) > 1:
            raise ChoiceError(f"several rigs answer at {self.endpoint}: {', '.join(rigs)}; choose one with --rig")
        return wanted or rigs[0]

    def _nobody(self) -> NoDaemonError:
        return NoDaemonError(f"no daemon answers at {self.endpoint} ({ABSENT})", connected=self._session is not None)

    @property
    def rig(self) -> str:
        """Name of the rig."""
        return self.keys.rig

    def operator(self, given: str = "") -> str:
        """The name by which the daemon knows who commands here: the certificate's, or that of this user."""
        return self.person or with_user(given, user_name(os.geteuid()))

    def ask(
        self,
        selector: str,
        payload: bytes | None = None,
        timeout_s: float = ASK_S,
        check: Check = bytes,
    ) -> tuple[bool, bytes]:
        """One query; returns whether it was answered (else refused), and the answer's bytes.

        ``check``: raises MessageRefusedError for an answer of the wrong shape. Such an answer is skipped, as is one on
        more than one key: where nothing is verified anyone may answer beside the daemon.

        Raises:
            NoDaemonError: no answer.
            SchemaError: ``check`` expects a schema, and no answer has one that this client knows.
        """
        if (here := self._ask_here(selector, payload, timeout_s, check)) is not None:
            return here
        unknown: SchemaError | None = None
        key = selector.partition("?")[0]
        # The answer gets the query's options: it never blocks the gateway, and has its own priority beside the data.
        replies = self.session.get(
            selector,
            payload=payload,
            timeout=timeout_s,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW if payload is None else zenoh.Priority.DATA_HIGH,
            # All answers are wanted: a peer that claims the key, or answers last, must not replace the daemon's answer.
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        for reply in replies:
            answer = reply.ok if reply.ok is not None else reply.err
            if answer is None:
                continue
            try:
                if len(answer.payload) > LONGEST_PAST:
                    raise MessageRefusedError(f"found {len(answer.payload)} bytes, expected at most {LONGEST_PAST}")
                found = bytes(answer.payload)
                if reply.ok is None and not found.startswith(b"{"):  # Zenoh's own text for a time-out
                    continue
                if reply.ok is not None and "*" in str(reply.ok.key_expr):
                    raise MessageRefusedError("an answer on more than one key")
                check(found) if reply.ok is not None else shapes.refusal(found)
            except MessageRefusedError as error:
                self.refusals.add(key, error)
                unknown = error if isinstance(error, SchemaError) else unknown
                continue
            return reply.ok is not None, found
        raise unknown or self._nobody()

    def _ask_here(self, key: str, payload: bytes | None, timeout_s: float, check: Check) -> tuple[bool, bytes] | None:
        """As `ask`, by the command socket of this computer; None: there is none, or it takes no such question.

        Raises:
            NoDaemonError: no answer.
        """
        tail = key.removeprefix(f"{keys.ROOT}/{self.rig}/")
        is_command = payload is not None and tail.startswith(COMMAND) and "/" not in tail.removeprefix(COMMAND)
        if self._local is None or not (tail == STATE or is_command):
            return None
        try:
            good, found = self._local.ask(tail, payload, timeout_s)
            check(found) if good else shapes.refusal(found)
        except MessageRefusedError as error:
            self.refusals.add(key, error)
            raise self._nobody() from None
        except OSError:
            raise self._nobody() from None
        return good, found

    def _asked(self, selector: str, decode: Callable[[bytes], _Some]) -> _Some:
        """What a reading query brings; repeated while it ends at once because a gateway starts anew."""
        until = time.monotonic() + ASK_S
        while True:
            try:
                answered, payload = self.ask(selector, check=decode)
                break
            except NoDaemonError:
                if time.monotonic() >= until:
                    raise
                time.sleep(_AGAIN_S)
        if not answered:
            raise NoDaemonError(f"{selector}: {shapes.refusal(payload)['text']}")
        return decode(payload)

    def state(self) -> dict[str, Any]:
        """The newest state."""
        return self._asked(self.keys.state, shapes.state)

    def active(self) -> dict[str, Any]:
        """The active configuration: settings, design, versions, and what the control process read back."""
        return self._asked(self.keys.active, shapes.active)

    def schema(self) -> dict[str, Any]:
        """The schema of the fast stream. Raises SchemaError if this client does not know its version."""
        return self._asked(self.keys.schema, usable_schema)

    def past_events(self, after: int = 0, after_note: int = 0) -> list[dict[str, Any]]:
        """The loop's events and the gateway's notes that the rings hold, oldest first; each has its own sequence."""
        return self._asked(f"{self.keys.events_past}?after={after};after_note={after_note}", shapes.past_events)

    def command(
        self, verb: str, operator: str, value: float | None = None, **options: bool | str | float
    ) -> dict[str, Any]:
        """Give a command; ``accepted`` and ``text`` of the answer say what happened.

        It is given under the lease in ``leases``; without one the lease is taken if nobody holds it. A lapsed lease is
        not taken again automatically, because the program may no longer know the rig's state: see `take_lease`.
        ``options``: see `rigctl.wire.command_request.Request`.

        Raises:
            NoDaemonError: no answer; whether the command was carried out is unknown.
        """
        body: dict[str, Any] = {} if value is None else {"value": value}
        body |= {name: option for name, option in options.items() if option}
        creep_s = float(options.get("creep_s", 0.0))
        limit_s = next((one.row.answered_s for one in Verb if one.name.lower() == verb), COMMAND_S)
        return self._commanded(verb, operator, body, limit_s + (WEIGHT_S + creep_s if creep_s else 0.0))

    def take_lease(self, operator: str, reason: str = "") -> dict[str, Any]:
        """Take or renew the lease; from another holder only with a ``reason``. See `command`."""
        return self._commanded(LeaseAct.TAKE.value, operator, {"reason": reason} if reason else {})

    def return_lease(self, operator: str) -> dict[str, Any]:
        """Give the lease back. See `command`."""
        answer = self._commanded(LeaseAct.RETURN.value, operator, {})
        if answer["accepted"]:
            self.leases.pop(self.operator(operator), None)
        return answer

    def decide_alarm(
        self, act: AlarmAct, operator: str, cause: str, reason: str = "", for_s: int = 0
    ) -> dict[str, Any]:
        """Acknowledge the alarm ``cause``, shelve it with a reason for some seconds, or unshelve it. See `command`."""
        body: dict[str, Any] = {"cause": cause}
        body |= {"reason": reason, "for_s": for_s} if act is AlarmAct.SHELVE else {}
        return self._commanded(act.value, operator, body)

    def note(self, operator: str, text: str) -> dict[str, Any]:
        """Put words on record with the run. See `command`."""
        return self._commanded(NOTE, operator, {"text": text})

    def _commanded(self, name: str, operator: str, body: dict[str, Any], limit_s: float = COMMAND_S) -> dict[str, Any]:
        operator, given = self.operator(operator), operator
        if name == _HOLD and not self.person:
            held = local_hold.hold(self.endpoint, self.rig, given)
            if held is not None:
                return held
        body = {"operator": operator} | body | ({"run_id": self._run_id} if self._run_id is not None else {})
        if (lease := self.leases.get(operator)) is not None:
            body["lease"] = lease
        if self._local is None and not self.person:
            what, why = "LEASE" if name in ACTS else name.upper(), self.route.words(self.rig) or FORMER
            return {
                "accepted": False, "verb": name, "operator": operator, "reason": "not_allowed",
                "text": f"{what} refused: {why}",
            }  # fmt: skip
        try:
            answered, found = self.ask(self.keys.command(name), msgspec.json.encode(body), limit_s, shapes.answer)
        except NoDaemonError:
            if not self.person:
                raise
            raise NoDaemonError(f"{name} of {self.person} is not answered at {self.endpoint} ({ABSENT})") from None
        answer = shapes.answer(found) if answered else shapes.refusal(found)
        if id_ := (answer.get("lease") or {}).get("id"):
            self.leases[operator] = id_
        return answer

    # -- streams --------------------------------------------------------------------------------------------
    def follow(self, key: str, depth: int = 64) -> Stream[Message]:
        """JSON messages published on ``key`` from now on; when more than ``depth`` wait, the oldest are dropped."""
        if self._local is not None and key == self.keys.state:
            mailbox = self._kept(Mailbox(None, key, depth, self.refusals, LONGEST_DOCUMENT))
            self._local.follow_state(mailbox)
        else:
            mailbox = self._mailbox(key, depth, LONGEST_DOCUMENT)
        return Stream(self._query, MessageSource(mailbox, shape_of(self.keys, key)))

    def events(self, *, past: bool = False) -> Events:
        """Events from now on, or from the oldest held (``past``); each once, also across a restart."""
        mailbox = self._mailbox(self.keys.event("*"), _EVENTS_DEPTH, LONGEST_BLOCK)
        return Events(self._query, EventSource(mailbox, self.keys, past=past))

    def blocks(self, *, recover: bool = True) -> Blocks:
        """The fast stream, undecoded; ``recover``: query missed records, False: a gap counts as lost at once."""
        return Blocks(self._query, self._block_source(DEPTH_BLOCKS, recover=recover))

    def samples(self, layout: SampleLayout | None = None, *, depth: int = DEPTH_BLOCKS, past: bool = False) -> Samples:
        """Every tick from now on, or from the oldest held (``past``); ``layout``: of the schema, None: query it.

        ``depth``: blocks (50 a second) that may wait before the oldest are dropped, and queried again.

        Raises:
            SchemaError: the daemon serves a schema this client does not know.
            NoDaemonError: no answer.
        """
        source = self._block_source(depth, past=past)
        return Samples(self._query, source, layout or layout_of(self.schema()), self.keys.schema)

    def _block_source(self, depth: int, *, recover: bool = True, past: bool = False) -> BlockSource:
        return BlockSource(
            self._mailbox(self.keys.fast, depth, LONGEST_BLOCK), self.keys.fast, recover=recover, past=past
        )

    def _mailbox(self, key: str, depth: int, longest: int) -> Mailbox:
        return self._kept(Mailbox(self.session, key, depth, self.refusals, longest))

    def _kept(self, mailbox: Mailbox) -> Mailbox:
        self._mailboxes = [*(one for one in self._mailboxes if not one.closed), mailbox]
        return mailbox

    def _query(self, question: Question) -> tuple[bool, bytes] | None:
        try:
            return self.ask(question.selector, check=question.check)
        except (NoDaemonError, zenoh.ZError):
            return None

    def close(self) -> None:
        """End every stream and the session."""
        for mailbox in self._mailboxes:
            mailbox.close()
        if self._local is not None:
            self._local.close()
        if self._session is not None:
            close(self._session)
        self._leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
