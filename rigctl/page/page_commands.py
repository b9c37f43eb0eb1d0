"""Commands of a page that was started with operator rights: under the lease and confirmed, or HOLD at once.

A page without these rights has no `PageCommands`, and its server refuses every command.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rigctl.client import local_hold
from rigctl.client.connection import ChoiceError, Client, NoDaemonError
from rigctl.config.typed_number import TypedNumberError
from rigctl.model.lease_acts import Denial
from rigctl.model.verbs import Verb
from rigctl.page import typed_fields
from rigctl.page.picture import Picture
from rigctl.wire.alarms import AlarmAct
from rigctl.wire.offers import BUTTONS, refused_with
from rigctl.wire.state_words import measured, number, worded
from rigctl.wire.typed_values import SHELF_MINUTES, shelf_s

CONFIRM_S = 15.0
VERBS = ("hold", *(verb.name.lower() for verb in BUTTONS))
Answer = dict[str, Any]


class RefusedError(Exception):
    """A request that is not carried out; ``str()`` is one line for the operator."""


@dataclass(frozen=True)
class Proposal:
    """A command that waits for its confirmation; it is valid only in the mode the operator saw."""

    id: str
    verb: str
    value: float | None
    mode: str | None
    until: float


def meaning(verb: str, value: float | None, state: dict[str, Any]) -> str:
    """The effect of a command, in one line."""
    target, now = worded(state, "target_n"), measured(state, "tension_n", 1)
    stroke = measured(state, "stroke_mm", 1)
    if verb == "release" and value is not None:
        what = f"pay out {number(value, 1, 'mm')} of the slack rope; the stroke moves from {stroke}"
    else:
        fault, why = state.get("fault") or "the fault", state.get("fault_text") or "its cause is gone"
        what = Verb[verb.upper()].row.effect.format(
            target=target, now=now, stroke=stroke, value=value, fault=fault, why=why
        )
    return f"{verb.upper()}: {what}"


class PageCommands:
    """One operator's commands. Every method may block until the daemon answers."""

    def __init__(self, operator: str, rig: str | None, picture: Picture) -> None:
        self.operator, self._rig, self._picture = operator, rig, picture
        self._client: Client | None = None
        self._opening = threading.Lock()
        self._proposal: Proposal | None = None

    def holds_lease(self, state: dict[str, Any] | None) -> bool:
        """Whether this page holds the lease in force."""
        held = (state or {}).get("lease") or {}
        return held.get("holder") == self.operator and self._has_id

    @property
    def _has_id(self) -> bool:
        return self._client is not None and self.operator in self._client.leases

    def lease(self, act: str, reason: str) -> Answer:
        """Take the lease (from another with a reason), or give it back.

        Raises:
            RefusedError: no daemon answers, or ``act`` is not valid.
        """
        if act == "take":
            return self._ask(lambda client: client.take_lease(self.operator, reason))
        if act == "return":
            return self._ask(lambda client: client.return_lease(self.operator))
        raise RefusedError(f"found act {act!r}, expected take, return")

    def alarm(self, act: str, cause: str, reason: str, minutes: str | float) -> Answer:
        """Acknowledge, shelve or unshelve an alarm; it needs no lease. ``minutes``: as typed, of shelve alone.

        Raises:
            RefusedError: no daemon answers, or ``act`` or ``minutes`` is not valid.
        """
        try:
            decision = AlarmAct(f"alarm_{act}")
        except ValueError:
            raise RefusedError(f"found act {act[:40]!r}, expected acknowledge, shelve, unshelve") from None
        shelves = decision is AlarmAct.SHELVE or minutes != ""
        try:
            for_s = shelf_s(SHELF_MINUTES.read(minutes)) if shelves else 0
        except TypedNumberError as error:
            raise RefusedError(f"{act.upper()}: {error}") from None
        return self._ask(lambda client: client.decide_alarm(decision, self.operator, cause, reason, for_s))

    def note(self, text: str) -> Answer:
        """Put words on record with the run; it needs no lease.

        Raises:
            RefusedError: no daemon answers.
        """
        return self._ask(lambda client: client.note(self.operator, text))

    def propose(self, verb: str, given: str | float | None, reason: str = "") -> Answer:
        """Propose a command, to be confirmed by the number ``confirm``; HOLD is given at once.

        ``given``: its number, as text where an operator has typed it.

        Takes the lease first, where this page has none: from another holder only with a ``reason``. Without one the
        answer names the ``holder``.

        Raises:
            RefusedError: no such command, no daemon, text that is no number, or what the loop would refuse now.
        """
        if verb not in VERBS:
            raise RefusedError(f"found the command {verb[:40]!r}, expected {', '.join(VERBS)}")
        if (given is not None) != (verb in typed_fields.REQUIRED) and verb not in typed_fields.OPTIONAL:
            found = "no value" if given is None else "a value"
            raise RefusedError(f"found {found}, expected with {' and '.join(typed_fields.REQUIRED)} alone")
        try:
            value = typed_fields.value_of(verb, given)
        except TypedNumberError as error:
            raise RefusedError(f"{verb.upper()}: {error}") from None
        if verb == "hold":
            return self._hold()
        state = self._picture.state or {}
        if why := refused_with(state, verb, value):
            raise RefusedError(f"{verb.upper()} refused: {why}")
        if not self.holds_lease(state):
            taken = self._ask(lambda client: client.take_lease(self.operator, reason))
            if not taken.get("accepted"):
                holder = str((state.get("lease") or {}).get("holder", "")) or "somebody else"
                asks = taken.get("reason") == Denial.HELD.value
                return taken | ({"holder": holder} if asks else {})
        self._proposal = Proposal(secrets.token_hex(8), verb, value, state.get("mode"), time.monotonic() + CONFIRM_S)
        text = meaning(verb, value, state)
        return {"accepted": True, "confirm": self._proposal.id, "text": text, "for_s": CONFIRM_S}

    @property
    def asked(self) -> str:
        """What the command that waits for its confirmation would do now; "" without one."""
        proposal = self._proposal
        if proposal is None or time.monotonic() > proposal.until:
            return ""
        return meaning(proposal.verb, proposal.value, self._picture.state or {})

    def _hold(self) -> Answer:
        """Give HOLD; to a daemon of this computer without the network, so a flood or a hung gateway cannot delay it."""
        shown = (self._picture.state or {}).get("rig") or self._rig
        answer = local_hold.hold(self._picture.endpoint, shown, self.operator)
        return answer or self._ask(lambda client: client.command("hold", self.operator))

    def confirm(self, id_: str) -> Answer:
        """Give the command that was proposed last.

        Raises:
            RefusedError: ``id_`` is another, the time is over, or the rig's mode has changed.
        """
        proposal, self._proposal = self._proposal, None
        if proposal is None or not secrets.compare_digest(proposal.id.encode(), id_.encode(errors="replace")):
            raise RefusedError("nothing, or something else, waits for a confirmation: ask again")
        if time.monotonic() > proposal.until:
            raise RefusedError(f"{proposal.verb.upper()} was not confirmed within {CONFIRM_S:.0f} s: ask again")
        mode = (self._picture.state or {}).get("mode")
        if mode != proposal.mode:
            raise RefusedError(f"{proposal.verb.upper()} not given: it was {proposal.mode}, now it is {mode}")
        answer = self._ask(lambda client: client.command(proposal.verb, self.operator, proposal.value))
        if answer.get("reason") in (Denial.LAPSED.value, Denial.HELD.value) and self._client is not None:
            self._client.leases.pop(self.operator, None)
        return answer

    def _ask(self, question: Callable[[Client], Answer]) -> Answer:
        try:
            return question(self._opened())
        except (NoDaemonError, ChoiceError) as error:
            raise RefusedError(str(error)) from None

    def _opened(self) -> Client:
        """A client of the rig that the page shows; another rig may have taken its endpoint."""
        shown = (self._picture.state or {}).get("rig") or self._rig
        with self._opening:
            if self._client is not None and shown is not None and self._client.rig != shown:
                self._client.close()
                self._client = None
            if self._client is None:
                self._client = Client(self._picture.endpoint, shown)
                self.operator = self._client.operator(self.operator)
            return self._client

    def close(self) -> None:
        """End the session; the lease lapses by itself, and the rig continues unchanged."""
        if self._client is not None:
            self._client.close()
