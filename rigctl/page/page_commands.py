"""Commands given on the page, where it was started with operator rights: under the lease, confirmed, or HOLD at once.

Without rights there is no commands, and every command is refused by the server itself.
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
from rigctl.page.picture import Picture
from rigctl.wire.lease import Denial
from rigctl.wire.state_words import number

CONFIRM_S = 15.0
VERBS = ("arm", "tension", "hold", "release", "disarm", "reset", "target")
Answer = dict[str, Any]


class RefusedError(Exception):
    """A request that is not carried out; ``str()`` is one line for the operator."""


@dataclass(frozen=True)
class Proposal:
    """A command that waits for its confirmation; it holds for the mode the operator saw."""

    id: str
    verb: str
    value: float | None
    mode: str | None
    until: float


def meaning(verb: str, value: float | None, state: dict[str, Any]) -> str:
    """What a command is about to do, in one line."""
    target = number(state.get("target_n"), 1, "N")
    match verb:
        case "arm":
            what = "drive on, brake open, stroke held"
        case "tension":
            what = f"ramp to {target} and hold it"
        case "release":
            what = "ramp to a slack rope"
        case "disarm":
            what = "drive off, brake closed"
        case "reset":
            what = f"acknowledge {state.get('fault') or 'the fault'}: {state.get('fault_text') or 'its cause is gone'}"
        case _:
            what = f"hold {number(value, 1, 'N')} instead of {target}"
    return f"{verb.upper()}: {what}"


class PageCommands:
    """One operator's commands. Every method may block for as long as the daemon takes to answer."""

    def __init__(self, operator: str, rig: str | None, picture: Picture) -> None:
        self.operator, self._rig, self._picture = operator, rig, picture
        self._client: Client | None = None
        self._opening = threading.Lock()
        self._proposal: Proposal | None = None

    def holds_lease(self, state: dict[str, Any] | None) -> bool:
        """Whether the lease in force is the one this page was given."""
        held = (state or {}).get("lease") or {}
        return held.get("holder") == self.operator and self._has_id

    @property
    def _has_id(self) -> bool:
        return self._client is not None and self.operator in self._client.leases

    def lease(self, act: str, reason: str) -> Answer:
        """Take the lease (from another with a reason), or give it back.

        Raises:
            RefusedError: no daemon, or not an act.
        """
        if act == "take":
            return self._ask(lambda client: client.take_lease(self.operator, reason))
        if act == "return":
            return self._ask(lambda client: client.return_lease(self.operator))
        raise RefusedError(f"found act {act!r}, expected take, return")

    def propose(self, verb: str, value: float | None) -> Answer:
        """A command to be confirmed: ``confirm`` is its number; HOLD is given at once.

        Raises:
            RefusedError: no such command, no lease, no daemon.
        """
        if verb not in VERBS:
            raise RefusedError(f"found the command {verb[:40]!r}, expected {', '.join(VERBS)}")
        if (value is not None) != (verb == "target"):
            raise RefusedError("found " + ("no value" if value is None else "a value") + ", expected with target alone")
        if verb == "hold":
            return self._hold()
        if not self._has_id:
            raise RefusedError(f"{verb.upper()} refused: take the lease first")
        state = self._picture.state or {}
        self._proposal = Proposal(secrets.token_hex(8), verb, value, state.get("mode"), time.monotonic() + CONFIRM_S)
        text = meaning(verb, value, state)
        return {"accepted": True, "confirm": self._proposal.id, "text": text, "for_s": CONFIRM_S}

    def _hold(self) -> Answer:
        """HOLD, past the network where the daemon is on this computer: neither a flood nor a hung gateway delays it."""
        shown = (self._picture.state or {}).get("rig") or self._rig
        answer = local_hold.hold(self._picture.endpoint, shown, self.operator)
        return answer or self._ask(lambda client: client.command("hold", self.operator))

    def confirm(self, id_: str) -> Answer:
        """Give the command that was proposed last.

        Raises:
            RefusedError: another one, too late, or the rig is not as it was.
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
        """A client of the very rig the page shows: another may have come in its place at the same endpoint."""
        shown = (self._picture.state or {}).get("rig") or self._rig
        with self._opening:
            if self._client is not None and shown is not None and self._client.rig != shown:
                self._client.close()
                self._client = None
            if self._client is None:
                self._client = Client(self._picture.endpoint, shown)
            return self._client

    def close(self) -> None:
        """End the session; the lease lapses by itself, and the rig goes on as it is."""
        if self._client is not None:
            self._client.close()
