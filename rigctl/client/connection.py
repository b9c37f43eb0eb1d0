"""Connection to the daemon of one rig: find it, ask it, command it. What every client here is made of.

Zenoh in client mode: once connected it comes back by itself when the gateway was restarted.
"""

from __future__ import annotations

import os
import re
import threading
from types import TracebackType
from typing import Any, Self

import msgspec
import zenoh

from rigctl.client.messages import Feed
from rigctl.telemetry import keys
from rigctl.telemetry.keys import Keys
from rigctl.telemetry.lease import Act
from rigctl.telemetry.session import SessionError, close, open_client

OPEN_S = 2.0
ASK_S = 2.0
COMMAND_S = 6.0  # the gateway answers within 4 s ...
TRIAL_S = 24.0  # ... or when a trial is over, up to 10 s; arming reads the devices' settings back: up to 15 s more
_TRIALS = ("arm", "tare", "calibrate", "identify", "gains")


class NoDaemonError(RuntimeError):
    """Nobody answers; ``str()`` is one line."""


class ChoiceError(ValueError):
    """Endpoint or rig is not one, or several rigs answer; ``str()`` is one line."""


def _open(endpoint: str) -> zenoh.Session:
    """Open a session, giving up after ``OPEN_S`` whatever the network does."""
    opened: list[zenoh.Session] = []

    def attempt() -> None:
        try:
            opened.append(open_client(endpoint))
        except SessionError:
            return

    thread = threading.Thread(target=attempt, name="connect", daemon=True)
    thread.start()
    thread.join(OPEN_S)
    if not opened:
        raise NoDaemonError(f"no daemon answers at {endpoint} (absent, or not allowed)")
    return opened[0]


def _rigs(session: zenoh.Session) -> list[str]:
    tokens = session.liveliness().get(keys.ANY_DAEMON, timeout=ASK_S)
    return sorted({keys.rig_of(str(reply.ok.key_expr)) for reply in tokens if reply.ok is not None})


def endpoint_of(connect: str | None) -> str:
    """The endpoint asked for, else ``RIGCTL_CONNECT``, else the default.

    Raises:
        ChoiceError: it is none.
    """
    endpoint = connect or os.environ.get("RIGCTL_CONNECT") or keys.DEFAULT_ENDPOINT
    if not re.fullmatch(r"[a-z-]+/\S+", endpoint):
        raise ChoiceError(f"found endpoint {endpoint!r}, allowed e.g. {keys.DEFAULT_ENDPOINT}")
    return endpoint


def rigs(connect: str | None = None) -> list[str]:
    """Names of the rigs whose daemons answer at an endpoint, sorted; several may share one router.

    Raises:
        NoDaemonError: nobody there, or not allowed.
        ChoiceError: not an endpoint.
    """
    session = _open(endpoint_of(connect))
    try:
        return _rigs(session)
    finally:
        close(session)


class Client:
    """Connection to the daemon of one rig."""

    def __init__(self, connect: str | None = None, rig: str | None = None) -> None:
        """``connect``: endpoint, else ``RIGCTL_CONNECT``; ``rig``: name, else ``RIGCTL_RIG``, else the one there is.

        Raises:
            NoDaemonError: nobody there, or not allowed.
            ChoiceError: not an endpoint, not a name, or several rigs and none chosen.
        """
        self.endpoint = endpoint_of(connect)
        wanted = rig or os.environ.get("RIGCTL_RIG") or None
        if wanted is not None and not re.fullmatch(r"[a-z][a-z0-9_]{0,31}", wanted):
            raise ChoiceError(f"found rig {wanted!r}, allowed a rig's name, e.g. paper_rig")
        self.leases: dict[str, str] = {}  # id shown with the commands of each operator; kept from the answers
        self.session = _open(self.endpoint)
        try:
            self.keys = Keys(self._choose(wanted))
        except (NoDaemonError, ChoiceError):
            close(self.session)
            raise

    def _choose(self, wanted: str | None) -> str:
        rigs = _rigs(self.session)
        if wanted is not None and rigs and wanted not in rigs:
            raise NoDaemonError(f"no daemon of {wanted} answers at {self.endpoint}, only of {', '.join(rigs)}")
        if not rigs:
            raise self._nobody()
        if wanted is None and len(rigs) > 1:
            raise ChoiceError(f"several rigs answer at {self.endpoint}: {', '.join(rigs)}; choose one with --rig")
        return wanted or rigs[0]

    def _nobody(self) -> NoDaemonError:
        return NoDaemonError(f"no daemon answers at {self.endpoint} (absent, or not allowed)")

    @property
    def rig(self) -> str:
        """Name of the rig."""
        return self.keys.rig

    def ask(self, selector: str, payload: bytes | None = None, timeout_s: float = ASK_S) -> tuple[bool, bytes]:
        """One query; whether it was answered (else refused), and the answer's bytes.

        Raises:
            NoDaemonError: no answer.
        """
        # The answer travels as the query did: never waited for, and beside the published data.
        replies = self.session.get(
            selector,
            payload=payload,
            timeout=timeout_s,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW if payload is None else zenoh.Priority.DATA_HIGH,
        )
        for reply in replies:
            if reply.ok is not None:
                return True, bytes(reply.ok.payload)
            if reply.err is not None and (refusal := bytes(reply.err.payload)).startswith(b"{"):
                return False, refusal
        raise self._nobody()  # nothing, or Zenoh's own word for a time-out

    def _json(self, selector: str) -> Any:
        answered, payload = self.ask(selector)
        if not answered:
            raise NoDaemonError(f"{selector}: {payload.decode(errors='replace')}")
        return msgspec.json.decode(payload)

    def state(self) -> dict[str, Any]:
        """The newest state."""
        return dict(self._json(self.keys.state))

    def active(self) -> dict[str, Any]:
        """What runs: settings, design, versions, and what the control process read back."""
        return dict(self._json(self.keys.active))

    def schema(self) -> dict[str, Any]:
        """What the fast stream means."""
        return dict(self._json(self.keys.schema))

    def past_events(self, after: int = 0, after_note: int = 0) -> list[dict[str, Any]]:
        """Events of the loop and notes of the gateway that are still held, oldest first; each has its own sequence."""
        return list(self._json(f"{self.keys.events_past}?after={after};after_note={after_note}"))

    def command(self, verb: str, operator: str, value: float | None = None, **options: bool | str) -> dict[str, Any]:
        """Give a command; the answer, whose ``accepted`` and ``text`` say what happened.

        It is given under the lease in ``leases``; without one the lease is taken if nobody holds it. One that has
        lapsed is not taken anew behind the program's back, which may no longer know how the rig is: see `take_lease`.
        ``options``: see `rigctl.telemetry.request.Request`.

        Raises:
            NoDaemonError: no answer; whether the command was carried out is not known.
        """
        body: dict[str, Any] = {} if value is None else {"value": value}
        body |= {name: option for name, option in options.items() if option}
        return self._commanded(verb, operator, body, TRIAL_S if verb in _TRIALS else COMMAND_S)

    def take_lease(self, operator: str, reason: str = "") -> dict[str, Any]:
        """Take the lease, or renew it; from another only with a ``reason``. See `command`."""
        return self._commanded(Act.TAKE.value, operator, {"reason": reason} if reason else {})

    def return_lease(self, operator: str) -> dict[str, Any]:
        """Give the lease back. See `command`."""
        answer = self._commanded(Act.RETURN.value, operator, {})
        if answer["accepted"]:
            self.leases.pop(operator, None)
        return answer

    def _commanded(self, name: str, operator: str, body: dict[str, Any], limit_s: float = COMMAND_S) -> dict[str, Any]:
        shown = self.leases.get(operator)
        body = {"operator": operator} | ({"lease": shown} if shown else {}) | body
        _, payload = self.ask(self.keys.command(name), msgspec.json.encode(body), limit_s)
        answer = dict(msgspec.json.decode(payload))
        if isinstance(held := answer.get("lease"), dict) and "id" in held:
            self.leases[operator] = str(held["id"])
        return answer

    def follow(self, key: str, depth: int = 64) -> Feed:
        """JSON messages published on ``key`` from now on; the oldest go when more than ``depth`` wait."""
        return Feed(self.session, key, depth)

    def close(self) -> None:
        """End the session."""
        close(self.session)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()
