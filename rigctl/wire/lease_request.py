"""Requests about the lease itself, on the wire. Pure functions of bytes and values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from rigctl.config.built_type import built
from rigctl.wire.command_request import RequestError, decoded, lease_of, operator_of
from rigctl.wire.lease import LeaseAct

_REASON_LENGTH = 120
_ALLOWED = {
    LeaseAct.TAKE: '{"operator": "NAME"} and "reason": TEXT',
    LeaseAct.RETURN: '{"operator": "NAME"}',
}


@built
class _LeasePayload(msgspec.Struct, forbid_unknown_fields=True):
    operator: str
    lease: Any = None
    reason: str = ""
    run_id: str = ""


@dataclass(frozen=True)
class LeaseRequest:
    """An operator's request to take or return the lease; ``reason`` may be empty. The others: see `Request`."""

    act: LeaseAct
    operator: str
    lease: str | None = None
    reason: str = ""
    run_id: str = ""

    @property
    def command(self) -> str:
        """The request's name, as its key ends."""
        return self.act.value


def parse_lease(act: LeaseAct, payload: bytes | None) -> LeaseRequest:
    """Read the payload.

    Raises:
        RequestError: bad JSON, an unknown key, a wrong type, no operator, an invalid id or an invalid reason.
    """
    found = decoded(payload, _LeasePayload, _ALLOWED[act])
    reason = found.reason.strip()
    if reason and act is LeaseAct.RETURN:
        raise RequestError(f"found reason, expected {_ALLOWED[act]}")
    if len(reason) > _REASON_LENGTH or not reason.isprintable():
        raise RequestError(f"found reason {reason[:80]!r}, expected up to {_REASON_LENGTH} printable letters")
    return LeaseRequest(act, operator_of(found.operator), lease_of(found.lease), reason, found.run_id)
