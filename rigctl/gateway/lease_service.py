"""The lease service of the gateway: the register, its file in the runtime folder, its notes and its messages.

Only the command server's thread changes it; ``shown``, ``has_lapsed`` and ``is_holder`` may be called from any.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

import msgspec

from rigctl.gateway.ended_processes import ProcessNote
from rigctl.gateway.refused_access import AccessRefusal
from rigctl.ipc.notes import Note, worded
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.lease_acts import Denial, LeaseAct, is_id
from rigctl.model.quantity import count
from rigctl.model.requests import LeaseRequest, Request
from rigctl.operations.command_rate import RefusedCommands
from rigctl.operations.lease import Lease, LeaseChange, LeaseRegister, why_not
from rigctl.wire.alarm_request import AlarmRequest
from rigctl.wire.alarms import AlarmAct
from rigctl.wire.command_request import RequestError, operator_of, refused
from rigctl.wire.note_request import NoteRequest

IN_FORCE = "lease.json"  # in the runtime folder
NAMES_REPORTED = 4
_ALARM_NOTES = {
    AlarmAct.ACKNOWLEDGE: Note.ALARM_ACKNOWLEDGED,
    AlarmAct.SHELVE: Note.ALARM_SHELVED,
    AlarmAct.UNSHELVE: Note.ALARM_UNSHELVED,
}


def valid_lease(written: Any, duration_ns: int, now_ns: int) -> Lease | None:
    """The lease read from the file; None for anything that a gateway would not have written."""
    try:
        lease = msgspec.convert(written, Lease)
        if operator_of(lease.holder) != lease.holder or not is_id(lease.id):
            return None
    except (msgspec.MsgspecError, RequestError):
        return None
    sound = 0 <= lease.since_ns <= now_ns and lease.since_ns < lease.until_ns <= now_ns + duration_ns
    return lease if sound else None


class LeaseService:
    """The lease of one rig."""

    def __init__(self, runtime: Runtime, duration_s: int, now_ns: int) -> None:
        """Continues the lease that the gateway before this one wrote down, if it is valid."""
        self._runtime, self._notes = runtime, runtime.notes.writer()
        duration_ns = duration_s * 1_000_000_000
        self._register = LeaseRegister(duration_ns, self._note_change, self._read(duration_ns, now_ns))

    def _read(self, duration_ns: int, now_ns: int) -> Lease | None:
        try:
            written: Any = self._runtime.read_json(IN_FORCE)
        except (OSError, msgspec.MsgspecError):
            written = None
        lease = valid_lease(written, duration_ns, now_ns) if written else None
        if lease is None and written != {}:
            self._note(now_ns, Note.LEASE_NOT_BELIEVED)
        return lease

    def admit(self, request: Request, now_ns: int) -> Request | dict[str, Any]:
        """The command with the lease it is given under, which its answer settles (`with_lease`), or the refusal."""
        self.expire(now_ns)
        found = self._register.admit(request.operator, request.lease, now_ns)
        if isinstance(found, Lease):
            return replace(request, lease=found.id)
        why = why_not(found, request.operator, self._register.lease(now_ns), now_ns)
        return refused(request.command, request.operator, found.value, why)

    def note_hold(self, request: Request, now_ns: int) -> None:
        """Note a HOLD given without the lease, which anyone may do; it neither takes nor renews the lease."""
        if not self._register.is_holder(request.operator, request.lease, now_ns):
            lease = self._register.lease(now_ns)
            self._note(now_ns, Note.HOLD_WITHOUT_LEASE, request.operator, lease.holder if lease else "")

    def is_holder(self, operator: str, id_: str | None, now_ns: int) -> bool:
        """Whether both name and id are those of the lease in force; may be called from any thread."""
        return self._register.is_holder(operator, id_, now_ns)

    def note_refused(self, refused_commands: list[RefusedCommands], now_ns: int) -> None:
        """Note commands refused because there were too many: the operators with most by name, the rest as one note."""
        worst, rest = refused_commands[:NAMES_REPORTED], refused_commands[NAMES_REPORTED:]
        if rest:
            worst.append(RefusedCommands(count(len(rest), "other"), sum(one.count for one in rest), rest[0].since_ns))
        for one in worst:
            text = f"{count(one.count, 'command')} in {(now_ns - one.since_ns) / 1e9:.0f} s"
            self._note(now_ns, Note.TOO_MANY_COMMANDS, one.operator, reason=text)

    def note_refused_access(self, refusals: list[AccessRefusal], now_ns: int) -> None:
        """Note what the access list and TLS refused."""
        for one in refusals:
            self._note(now_ns, one.note, one.who, one.other, one.words)

    def note_endpoint(self, endpoint: str, now_ns: int, *, is_taken: bool) -> None:
        """Note that another program has the endpoint of the network, or that it is this daemon's again."""
        self._note(now_ns, Note.ENDPOINT_TAKEN if is_taken else Note.ENDPOINT_BACK, other=endpoint)

    def note_process(self, note: ProcessNote) -> None:
        """Note that recorder or gateway has ended unwanted, or is back."""
        self._note(note.t_ns, note.kind, other=note.process, reason=note.reason)

    def note_log_changed(self, how: str, now_ns: int) -> None:
        """Note that the audit log was changed while the daemon ran."""
        self._note(now_ns, Note.AUDIT_LOG_CHANGED, reason=how)

    def note_request(self, request: AlarmRequest | NoteRequest, now_ns: int) -> dict[str, Any]:
        """Note what an operator decides about an alarm, or writes; neither takes a lease. Returns the answer."""
        if isinstance(request, NoteRequest):
            kind, other, reason = Note.OPERATOR_NOTE, "", request.text
        else:
            kind, other = _ALARM_NOTES[request.act], request.cause
            reason = f"{request.for_s} s: {request.reason}" if request.act is AlarmAct.SHELVE else ""
        self._note(now_ns, kind, request.operator, other, reason)
        _, text = worded(kind, request.operator, other, reason)
        return {"accepted": True, "verb": request.command, "operator": request.operator, "text": text}

    def decide(self, request: LeaseRequest, now_ns: int) -> dict[str, Any]:
        """Take the lease or give it back; returns the answer."""
        self.expire(now_ns)
        operator, id_ = request.operator, request.lease
        found: Lease | Denial | None
        if request.act is LeaseAct.TAKE:
            found = self._register.take(operator, id_, request.reason, now_ns)
        else:
            found = self._register.give_back(operator, id_, now_ns)
        self._save(now_ns)
        if isinstance(found, Denial):
            why = why_not(found, operator, self._register.lease(now_ns), now_ns)
            return self.with_lease(request, refused(request.command, operator, found.value, why), now_ns)
        text = "given back; the rig goes on as it is"
        if found is not None:
            left_s = (found.until_ns - now_ns) / 1e9
            request = replace(request, lease=found.id)
            text = f"{operator} holds the lease, until {left_s:.0f} s after the last command"
        message = {"accepted": True, "verb": request.command, "operator": operator, "text": f"LEASE: {text}"}
        return self.with_lease(request, message, now_ns)

    def with_lease(self, request: Request | LeaseRequest, message: dict[str, Any], now_ns: int) -> dict[str, Any]:
        """An answer with the lease in force; its id is for its holder alone. A refused command leaves it as it was."""
        operator, id_ = request.operator, request.lease
        if self._register.settle(operator, id_, now_ns, accepted=message["accepted"]):
            self._save(now_ns)
        lease = self.shown(now_ns)
        if lease is not None and self._register.is_holder(operator, id_, now_ns):
            lease["id"] = id_
        return message | {"lease": lease}

    def shown(self, now_ns: int) -> dict[str, Any] | None:
        """The lease in force as everyone may see it: without its id."""
        lease = self._register.lease(now_ns)
        return None if lease is None else lease.shown(now_ns)

    def has_lapsed(self, now_ns: int) -> bool:
        """Whether `expire` has something to do."""
        return self._register.has_lapsed(now_ns)

    def expire(self, now_ns: int) -> None:
        """End a lease that has lapsed. The rig gets no command from this."""
        if self._register.has_lapsed(now_ns):
            self._register.expire(now_ns)
            self._save(now_ns)

    def _note_change(self, change: LeaseChange) -> None:
        self._note(change.t_ns, change.kind, change.operator, change.other, change.reason)

    def _note(self, t_ns: int, kind: Note, operator: str = "", other: str = "", reason: str = "") -> None:
        self._notes.write(t_ns, int(kind), operator.encode(), other.encode(), reason.encode())

    def _save(self, now_ns: int) -> None:
        # Without the file a lease only ends with this gateway, so a failed write refuses no command.
        with contextlib.suppress(OSError):
            self._runtime.write_json(IN_FORCE, self._register.lease(now_ns) or {}, 0o600)
