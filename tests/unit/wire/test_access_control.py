"""The access list without a network: which rules there are for which link. Over real sessions: tests/live."""

from __future__ import annotations

from typing import Any

import pytest

from rigctl.wire.access_control import READ_TAILS, access_control

STATING = {"put", "delete", "declare_queryable", "reply", "liveliness_token"}


def allowed(section: dict[str, Any], subject: str, flow: str, permission: str = "allow") -> set[tuple[str, str]]:
    """Message and key of every rule of a subject."""
    rules = {rule["id"]: rule for rule in section["rules"]}
    (policy,) = [one for one in section["policies"] if one["subjects"] == [subject]]
    found = [rules[name] for name in policy["rules"]]
    return {
        (message, key)
        for rule in found if rule["flows"] == [flow] and rule["permission"] == permission
        for message in rule["messages"] for key in rule["key_exprs"]
    }  # fmt: skip


def test_only_the_gateways_own_session_states_anything() -> None:
    section = access_control("r", "1abc")
    assert (section["enabled"], section["default_permission"]) == (True, "deny")
    own = [one for one in section["subjects"] if one.get("zids") == ["1abc"]]
    assert [one["id"] for one in own] == ["own commands"]
    assert own[0]["link_protocols"] == ["unixsock-stream"]
    for subject in ("this computer", "without a name", "anyone"):
        assert not {message for message, _ in allowed(section, subject, "ingress")} & STATING
    stated = {one for one in allowed(section, "own commands", "ingress") if one[0] in STATING}
    assert {key for _, key in stated} == {"rigctl/r/cmd/*/*", "rigctl/r/live/**"}


@pytest.mark.parametrize("joins", [False, True])
def test_without_a_certificate_nothing_but_reading_is_allowed(joins: bool) -> None:
    section = access_control("r", "1abc", joins=joins)
    for subject in ("this computer", "without a name"):
        for flow in ("ingress", "egress"):
            assert not [key for _, key in allowed(section, subject, flow) if "cmd" in key or key.endswith("/**/**")]
    read = {f"rigctl/r/{tail}" for tail in READ_TAILS}
    asked = {one for one in allowed(access_control("r", "1abc"), "without a name", "ingress") if "live" not in one[1]}
    assert asked == {(message, key) for message in ("declare_subscriber", "query") for key in read}


def test_where_routers_join_what_another_states_of_this_rig_is_denied() -> None:
    section = access_control("r", "1abc", joins=True)
    denied = allowed(section, "without a name", "ingress", "deny")
    assert denied == {(message, "rigctl/r/**") for message in STATING}
    assert allowed(section, "without a name", "egress", "deny") == {("query", "rigctl/r/**")}
