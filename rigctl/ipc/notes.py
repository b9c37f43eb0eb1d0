"""Notes: the gateway's own events, on who commands and on alarms. Keys of the loop's events, own sequence."""

from __future__ import annotations

import contextlib
import math
from enum import IntEnum
from typing import Any

import numpy as np

from rigctl.ipc.ring import RingWriter


class Note(IntEnum):
    """Kind of a note."""

    LEASE_TAKEN = 1
    LEASE_TAKEN_OVER = 2  # other: the operator who had the lease
    LEASE_RETURNED = 3
    LEASE_LAPSED = 4
    HOLD_WITHOUT_LEASE = 5  # other: the holder of the lease
    LEASE_NOT_BELIEVED = 6  # lease.json is invalid
    ALARM_ACKNOWLEDGED = 7  # other: the cause
    ALARM_SHELVED = 8  # other: the cause; reason: for how many s, and why
    ALARM_UNSHELVED = 9  # other: the cause
    OPERATOR_NOTE = 10  # reason: the operator's words, for the record of the run
    TOO_MANY_COMMANDS = 65  # reason: number of the operator's refused commands, and the time span
    MESSAGE_REFUSED = 66  # operator: name in the certificate; other: certificate and address; reason: message and key
    CONNECTION_REFUSED = 67  # reason: what TLS found
    CONNECTION_CLOSED = 69  # operator: name in the certificate; other: who and from where; reason: why
    ENDPOINT_TAKEN = 70  # other: the endpoint, which another program has
    ENDPOINT_BACK = 71  # other: the endpoint
    PROCESS_LOST = 72  # other: the process, which has ended unwanted; reason: how, and when it restarts
    PROCESS_BACK = 73  # other: the process; reason: of the gateway's own, why it ends in order after this note
    AUDIT_LOG_CHANGED = 74  # reason: how, as the recorder has found it


_WORDS = {
    Note.LEASE_TAKEN: ("info", "{operator} takes the lease{why}"),
    Note.LEASE_TAKEN_OVER: ("warning", "{operator} takes the lease over from {other}{why}"),
    Note.LEASE_RETURNED: ("info", "{operator} gives the lease back; the rig goes on as it is"),
    Note.LEASE_LAPSED: ("warning", "the lease of {operator} has lapsed; the rig goes on as it is"),
    Note.LEASE_NOT_BELIEVED: ("warning", "lease.json holds no lease to be believed; nobody holds it"),
    Note.ALARM_ACKNOWLEDGED: ("info", "{operator} acknowledges the alarm {other}"),
    Note.ALARM_SHELVED: ("warning", "{operator} shelves the alarm {other} for {reason}"),
    Note.ALARM_UNSHELVED: ("info", "{operator} takes the alarm {other} from the shelf"),
    Note.OPERATOR_NOTE: ("info", "{operator} notes: {reason}"),
    Note.ENDPOINT_TAKEN: (
        "warning",
        "another program has {other}: who connects there gets nothing of this rig; it is tried until it is free. "
        "The sockets of this computer work",
    ),
    Note.AUDIT_LOG_CHANGED: (
        "warning",
        "the audit log {reason} while the daemon ran; it goes on in a file of its name, with an entry of what is gone",
    ),
    Note.ENDPOINT_BACK: ("info", "{other} is this daemon's again"),
    Note.PROCESS_LOST: ("warning", "{other} process {reason}"),
    Note.PROCESS_BACK: ("info", "{other} process is started again{why}"),
}
"""Severity and words of the notes that have one form."""


def worded(kind: Note, operator: str, other: str, reason: str) -> tuple[str, str]:
    """Severity and one line."""
    why = f": {reason}" if reason else ""
    match kind:
        case Note.HOLD_WITHOUT_LEASE if other:
            return "warning", f"HOLD given by {operator} without the lease, which {other} holds"
        case Note.HOLD_WITHOUT_LEASE:
            return "info", f"HOLD given by {operator} without a lease; nobody holds it"
        case Note.TOO_MANY_COMMANDS:
            return (
                "warning",
                f"{reason} from {operator or 'an unknown operator'} refused: too many; HOLD is taken all the same",
            )
        case Note.MESSAGE_REFUSED:
            return "warning", f"{reason} by {operator or 'an unknown client'} ({other}) refused: not allowed"
        case Note.CONNECTION_REFUSED | Note.CONNECTION_CLOSED:
            done = "closed" if kind is Note.CONNECTION_CLOSED else "refused"
            who = f"{operator} ({other})" if operator and other else operator or other or "an unknown client"
            return "warning", f"connection of {who} {done}{why}"
        case _:
            severity, words = _WORDS[kind]
            return severity, words.format(operator=operator, other=other, reason=reason, why=why)


def was_taken(notes: np.ndarray) -> bool:
    """Whether another program had the endpoint of the network at the last of these notes about it."""
    kinds = [int(note["kind"]) for note in notes if note["kind"] in (Note.ENDPOINT_TAKEN, Note.ENDPOINT_BACK)]
    return kinds[-1:] == [Note.ENDPOINT_TAKEN]


def changes_noted(notes: np.ndarray) -> int:
    """How often these notes say that the audit log was changed."""
    return int(np.count_nonzero(notes["kind"] == Note.AUDIT_LOG_CHANGED))


def note_message(note: np.void, wall_offset_ns: int) -> tuple[str, dict[str, Any]]:
    """Severity, and the note as a JSON object for subscribers."""
    operator, other, reason = (bytes(note[name]).decode(errors="replace") for name in ("operator", "other", "reason"))
    number, t_ns = int(note["kind"]), int(note["t_ns"])
    name, severity, text = str(number), "warning", f"note {number} {operator} {other} {reason}".rstrip()
    with contextlib.suppress(ValueError):
        kind = Note(number)
        name = kind.name
        severity, text = worded(kind, operator, other, reason)
    return severity, {
        "seq": int(note["seq"]), "t_ns": t_ns, "wall_ns": t_ns + wall_offset_ns, "severity": severity,
        "source": "gateway", "kind": name, "text": text, "operator": operator, "other": other, "reason": reason,
    }  # fmt: skip


class RequestLog:
    """Commands received and their answers, for the audit log. One thread writes it."""

    def __init__(self, writer: RingWriter) -> None:
        self._writer = writer

    def given(self, t_ns: int, id_: int, verb: str, operator: str, holder: str, value: float, giver: str = "") -> None:
        """A command passed on to the loop; ``giver``: user and process, as the kernel says."""
        self._write(t_ns, False, id_, verb, value, operator, holder, {}, "", giver)

    def answered(
        self, t_ns: int, id_: int, holder: str, message: dict[str, Any], entry: str = "", giver: str = ""
    ) -> None:
        """An answer as sent; ``id_``: 0 for a command the loop did not get. ``entry``: hash of the ledger's entry."""
        value = message.get("value")
        number = math.nan if value is None else float(value)
        verb, operator = str(message["verb"]), str(message["operator"])
        self._write(t_ns, True, id_, verb, number, operator, holder, message, entry, giver)

    def _write(
        self, t_ns: int, answered: bool, id_: int, verb: str, value: float, operator: str, holder: str,
        message: dict[str, Any], entry: str, giver: str,
    ) -> None:  # fmt: skip
        accepted, reason, text = (message.get(name, "") for name in ("accepted", "reason", "text"))
        self._writer.write(
            t_ns, answered, id_, verb.encode()[:32], value, operator.encode()[:256], holder.encode()[:256],
            bool(accepted), str(reason).encode()[:32], str(text).encode()[:480], entry.encode(),
            giver.encode()[:80],
        )  # fmt: skip
