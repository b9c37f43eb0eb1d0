"""Acts on the lease as they come over the wire."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rigctl.model.lease_acts import ACTS, ID_BYTES, LeaseAct
from rigctl.model.requests import LeaseRequest
from rigctl.wire.command_request import RequestError
from rigctl.wire.lease_request import parse_lease

ID = "0" * 31 + "1"


def test_an_act_on_the_lease_is_read() -> None:
    assert ACTS == {"lease_take": LeaseAct.TAKE, "lease_return": LeaseAct.RETURN}
    payload = {"operator": " kim ", "reason": " tea ", "lease": ID}
    expected = LeaseRequest(LeaseAct.TAKE, "kim", ID, "tea")
    assert parse_lease(LeaseAct.TAKE, msgspec.json.encode(payload)) == expected
    assert parse_lease(LeaseAct.RETURN, b'{"operator": "kim"}') == LeaseRequest(LeaseAct.RETURN, "kim")


@pytest.mark.parametrize("act", LeaseAct)
@pytest.mark.parametrize(
    "more",
    [
        {"lease": 7}, {"lease": ""}, {"lease": "0" * (2 * ID_BYTES + 1)}, {"lease": "G" * 2 * ID_BYTES},
        {"lease": [[]]}, {"lease": {"id": ID}}, {"reason": "x" * 121}, {"reason": "a\nb"}, {"reason": 7},
        {"operator": ""}, {"value": 1}, {"lease": ID + "\n"},
    ],
)  # fmt: skip
def test_a_malformed_act_is_one_line(act: LeaseAct, more: dict[str, Any]) -> None:
    with pytest.raises(RequestError, match="expected") as refused:
        parse_lease(act, msgspec.json.encode({"operator": "kim"} | more))
    assert "\n" not in str(refused.value)
