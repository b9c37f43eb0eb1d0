"""Tables for ``meta/schema``: fields of the JSON messages, kinds of events, commands.

A row of fields is name, type in JSON, unit ("" for none), meaning. ``number?`` may be null.
"""

from __future__ import annotations

from rigctl.ipc.notes import Note
from rigctl.model.events import Kind
from rigctl.model.lease_acts import LeaseAct
from rigctl.model.verbs import Option, Verb
from rigctl.wire.alarms import AlarmAct

Rows = tuple[tuple[str, str, str, str], ...]

_EVENT_COMMON: Rows = (
    ("seq", "integer", "", "its number, from 1, without gaps; each source counts for itself"),
    ("stream", "integer", "", "as in the header of tele/fast: changes when the daemon is started anew"),
    ("t_ns", "integer", "ns", "when, CLOCK_MONOTONIC of the rig's computer"),
    ("wall_ns", "integer", "ns", "the same on the wall clock, since 1970 UTC"),
    ("severity", "string", "", "info, warning or error, as the key ends"),
    ("source", "string", "", "loop or gateway"),
    ("kind", "string", "", "see kinds of its source"),
    ("text", "string", "", "one line for people"),
)
LOOP_EVENT: Rows = (
    *_EVENT_COMMON,
    ("a", "integer", "", "see the kind"),
    ("b", "integer", "", "see the kind"),
    ("value", "number?", "", "what was found, in the unit its kind or fault has"),
    ("limit", "number?", "", "what is allowed, in the same unit"),
    ("about", "string", "", "the loop's own words, see the kind: of a limit, the row of the rig file"),
    (
        "fields",
        "object",
        "",
        "the same by the names of kind_fields: a member of an enumeration by its name, null for a number that is none; "
        "empty for an unknown kind",
    ),
)
GATEWAY_EVENT: Rows = (
    *_EVENT_COMMON,
    ("operator", "string", "", "who"),
    ("other", "string", "", "whom it concerns beside the operator"),
    ("reason", "string", "", "why, in the operator's words"),
)

KINDS: dict[Kind, str] = {kind: kind.sentence for kind in Kind}
KIND_FIELDS: dict[Kind, Rows] = {
    kind: tuple((field.name, field.json, field.unit, field.meaning) for field in kind.fields) for kind in Kind
}
NOTES: dict[Note, str] = {
    Note.LEASE_TAKEN: "operator takes the lease",
    Note.LEASE_TAKEN_OVER: "operator takes the lease from other, for reason",
    Note.LEASE_RETURNED: "operator gives the lease back",
    Note.LEASE_LAPSED: "the lease of operator has lapsed",
    Note.HOLD_WITHOUT_LEASE: "operator gives HOLD without the lease, which other holds",
    Note.ALARM_ACKNOWLEDGED: "operator acknowledges the alarm other",
    Note.ALARM_SHELVED: "operator shelves the alarm other; reason: 'SECONDS s: why'",
    Note.ALARM_UNSHELVED: "operator takes the alarm other from the shelf",
    Note.OPERATOR_NOTE: "words of the operator for the record of the run: reason",
    Note.TOO_MANY_COMMANDS: "commands of an operator were refused because there were too many; reason: how many",
    Note.MESSAGE_REFUSED: "the access list refused a message of operator's certificate; other: certificate and "
    "address, reason: message and key",
    Note.CONNECTION_REFUSED: "TLS refused a connection; reason: why",
    Note.ENDPOINT_TAKEN: "another program has the endpoint of the network; other: it",
    Note.AUDIT_LOG_CHANGED: "the audit log was renamed, replaced or cut while the daemon ran; reason: how",
    Note.ENDPOINT_BACK: "the endpoint of the network is the daemon's again; other: it",
    Note.PROCESS_LOST: "a process (other: recorder or gateway) has ended unwanted; reason: how",
    Note.PROCESS_BACK: "such a process (other) is started again; reason: of one started anew in order, why",
    Note.CONNECTION_CLOSED: "the gateway closed a connection to keep the places of others; other: who, reason: why",
    Note.LEASE_NOT_BELIEVED: "lease.json holds no lease to be believed; nobody holds the lease",
}

_OPERATOR = ("operator", "string", "", "who gives it; required")
_LEASE = ("lease", "string", "", "id of the lease it is given under, from the answer to who took it")
_JSON = {bool: "boolean", float: "number", str: "string"}


def _options() -> Rows:
    """The fields of payloads, each once; of one that several commands have, the meaning for each."""
    found: dict[str, dict[str, Option]] = {}
    for verb in Verb:
        for option in verb.row.options:
            found.setdefault(option.name, {})[verb.name.lower()] = option
    return tuple(
        (name, _JSON[first.kind], "s" if name.endswith("_s") else "", first.meaning if len(same) == 1 else
         "; ".join(f"{meaning} ({', '.join(v for v in same if same[v].meaning == meaning)})"
                   for meaning in dict.fromkeys(option.meaning for option in same.values())))
        for name, same in found.items() for first in [next(iter(same.values()))]
    )  # fmt: skip


PAYLOAD: Rows = (
    _OPERATOR,
    *_options(),
    _LEASE,
    ("run_id", "string", "", "run of the daemon it is meant for, from the active configuration; any other refuses it"),
)
LEASE_PAYLOAD: Rows = (
    ("operator", "string", "", "who asks; required"),
    ("reason", "string", "", "why it is taken over from another"),
    ("lease", "string", "", "id of the lease it is given under, from the answer to who took it"),
    ("run_id", "string", "", "run of the daemon it is meant for; any other refuses it"),
)
NOTE_PAYLOAD: Rows = (
    ("operator", "string", "", "who writes it; required"),
    ("text", "string", "", "up to 400 bytes, on one line; required"),
    ("lease", "string?", "", "id of the operator's lease; a note takes none"),
    ("run_id", "string", "", "of the daemon it is meant for, empty for any"),
)
ALARM_PAYLOAD: Rows = (
    ("operator", "string", "", "who decides; required"),
    ("cause", "string", "", "which alarm, as rigctl alarms names it; required"),
    ("reason", "string", "", "why it is shelved"),
    ("for_s", "integer", "s", "how long it is shelved"),
    ("lease", "string", "", "id of the lease it is given under, from the answer to who took it"),
    ("run_id", "string", "", "run of the daemon it is meant for; any other refuses it"),
)
ANSWER: Rows = (
    ("accepted", "boolean", "", "whether it was carried out; a refusal comes as an error reply"),
    ("verb", "string", "", "the command"),
    ("operator", "string", "", "who gave it"),
    ("text", "string", "", "one line for people"),
    ("reason", "string", "", "of a refusal, one word: a name of refusals in lower case, bad_request, no_answer, ..."),
    ("checks", "array", "", "of a refused arm: what stands against it, in words"),
    ("waived", "object", "", "of an arm: what does not count, and why"),
    ("mode", "string", "", "mode after the command"),
    ("t_ns", "integer", "ns", "when the loop answered, CLOCK_MONOTONIC"),
    ("value", "number?", "", "what it is about: target, tension or reading in N; identify, response: s"),
    ("entry", "object", "", "what the calibration ledger was given"),
    ("lease", "object?", "", "who holds it: holder, since_ns, until_ns, held_s, left_s; to its holder alone, its id"),
)

VERBS: dict[Verb, tuple[str, tuple[str, ...]]] = {
    verb: (verb.row.does, tuple(option.name for option in verb.row.options)) for verb in Verb
}
ACTS: dict[LeaseAct, tuple[str, tuple[str, ...]]] = {
    LeaseAct.TAKE: ("take the lease or renew it; from another only with a reason", ("reason",)),
    LeaseAct.RETURN: ("give the lease back", ()),
}
ALARM_DECISIONS: dict[AlarmAct, tuple[str, tuple[str, ...]]] = {
    AlarmAct.ACKNOWLEDGE: ("somebody has seen the alarm", ()),
    AlarmAct.SHELVE: ("the alarm is put aside for a time", ("reason", "for_s")),
    AlarmAct.UNSHELVE: ("the alarm is put aside no longer", ()),
}

ACTIVE_CONFIGURATION: Rows = (
    ("settings", "object", "", "the rig file, defaults filled in"),
    ("version", "string", "", "of the daemon"),
    ("started_wall_ns", "integer", "ns", "when the daemon started, since 1970 UTC"),
    ("pid", "integer", "", "of the daemon"),
    ("run_id", "string", "", "of this start of the daemon: a command that carries another is refused"),
    ("bus_load", "number", "", "worst-case load of the bus, of 1"),
    ("design", "object", "", "law in use: gains, margins, where they come from"),
    ("control", "object", "", "read back by the control process: real time, devices, their own stop settings"),
    ("calibration", "object", "", "tension cell: zero_n, scale, due, overdue, tared, waiver"),
)
