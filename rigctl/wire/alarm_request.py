"""What an operator decides about an alarm, on the wire. Pure functions of bytes and values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from rigctl.config.built_type import built
from rigctl.wire.alarms import LONGEST_SHELF_S, AlarmAct
from rigctl.wire.command_request import RequestError, decoded, lease_of, operator_of

_LONGEST = 120
"""Letters of a cause or a reason."""


_ALLOWED = {
    AlarmAct.ACKNOWLEDGE: '{"operator": "NAME", "cause": "CAUSE"}',
    AlarmAct.SHELVE: '{"operator": "NAME", "cause": "CAUSE", "reason": TEXT, "for_s": SECONDS}',
    AlarmAct.UNSHELVE: '{"operator": "NAME", "cause": "CAUSE"}',
}


@built
class _AlarmPayload(msgspec.Struct, forbid_unknown_fields=True):
    operator: str
    cause: str = ""
    reason: str = ""
    for_s: int = 0
    lease: Any = None
    run_id: str = ""


@dataclass(frozen=True)
class AlarmRequest:
    """A decision about the alarm ``cause``; SHELVE has a reason and a time in s. The others: see `Request`."""

    act: AlarmAct
    operator: str
    cause: str
    reason: str = ""
    for_s: int = 0
    lease: str | None = None
    run_id: str = ""

    @property
    def command(self) -> str:
        """The request's name, as its key ends."""
        return self.act.value


def parse_alarm(act: AlarmAct, payload: bytes | None) -> AlarmRequest:
    """Read the payload.

    Raises:
        RequestError: bad JSON, an unknown key, a wrong type, no operator, no cause, or an invalid reason or time.
    """
    found = decoded(payload, _AlarmPayload, _ALLOWED[act])
    cause, reason = found.cause.strip(), found.reason.strip()
    for name, text in (("cause", cause), ("reason", reason)):
        if len(text) > _LONGEST or not text.isprintable():
            raise RequestError(f"found {name} {text[:80]!r}, expected up to {_LONGEST} printable letters")
    if not cause:
        raise RequestError(f"found no cause, expected {_ALLOWED[act]}")
    if act is AlarmAct.SHELVE:
        if not reason:
            raise RequestError(f"found no reason, expected {_ALLOWED[act]}")
        if not 1 <= found.for_s <= LONGEST_SHELF_S:
            raise RequestError(f"found for_s {found.for_s}, expected 1 to {LONGEST_SHELF_S}")
    elif reason or found.for_s:
        raise RequestError(f"found a reason or a time, expected {_ALLOWED[act]}")
    lease = lease_of(found.lease)
    return AlarmRequest(act, operator_of(found.operator), cause, reason, found.for_s, lease, found.run_id)
