"""Requests about the lease itself, on the wire. Pure functions of bytes and values."""

from __future__ import annotations

from typing import Any

import msgspec

from rigctl.config.built_type import built
from rigctl.model.lease_acts import LeaseAct
from rigctl.model.requests import LeaseRequest
from rigctl.wire.command_request import RequestError, decoded, lease_of, operator_of

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
