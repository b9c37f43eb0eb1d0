"""Decisions about alarms on the wire: what is read, and what is refused in one line."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rigctl.wire.alarm_request import AlarmRequest, parse_alarm
from rigctl.wire.alarms import ALARM_ACTS, LONGEST_SHELF_S, AlarmAct
from rigctl.wire.command_request import RequestError
from rigctl.wire.schema import schema

SHELVED = {"operator": " kim ", "cause": "LIMIT tension_n above", "reason": "tea", "for_s": 60}


def test_each_decision_is_read() -> None:
    expected = AlarmRequest(AlarmAct.SHELVE, "kim", "LIMIT tension_n above", "tea", 60)
    assert parse_alarm(AlarmAct.SHELVE, msgspec.json.encode(SHELVED)) == expected
    for act in (AlarmAct.ACKNOWLEDGE, AlarmAct.UNSHELVE):
        found = parse_alarm(act, b'{"operator": "kim", "cause": "E_STOP"}')
        assert (found.cause, found.command) == ("E_STOP", act.value)


def test_the_schema_describes_every_decision() -> None:
    found = schema("rig")["alarms"]
    assert set(found["verbs"]) == set(ALARM_ACTS)
    assert all(one["description"] for one in found["verbs"].values())
    assert {row["name"] for row in found["payload"]} == {"operator", "cause", "reason", "for_s", "lease", "run_id"}


@pytest.mark.parametrize(("act", "more"), [
    (AlarmAct.SHELVE, {"reason": ""}), (AlarmAct.SHELVE, {"for_s": 0}), (AlarmAct.SHELVE, {"for_s": -1}),
    (AlarmAct.SHELVE, {"for_s": LONGEST_SHELF_S + 1}), (AlarmAct.SHELVE, {"for_s": 1.5}),
    (AlarmAct.SHELVE, {"cause": ""}), (AlarmAct.SHELVE, {"cause": "x" * 121}), (AlarmAct.SHELVE, {"reason": "a\nb"}),
    (AlarmAct.SHELVE, {"operator": ""}), (AlarmAct.SHELVE, {"lease": "0" * 31}), (AlarmAct.SHELVE, {"value": 1}),
    (AlarmAct.ACKNOWLEDGE, {}), (AlarmAct.UNSHELVE, {}),
])  # fmt: skip
def test_a_malformed_decision_is_one_line(act: AlarmAct, more: dict[str, Any]) -> None:
    with pytest.raises(RequestError, match="expected") as refused:
        parse_alarm(act, msgspec.json.encode(SHELVED | more))
    assert "\n" not in str(refused.value)
