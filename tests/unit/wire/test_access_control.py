"""The access list without a network: which rules there are for which link. Over real sessions: tests/live."""

from __future__ import annotations

from typing import Any

from rigctl.wire.access_control import access_control

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
    assert {key for _, key in stated} == {"rigctl/r/cmd/*", "rigctl/r/cmd/*/*", "rigctl/r/live/**"}


def test_every_verb_by_the_socket_and_hold_alone_by_tcp() -> None:
    section = access_control("r", "1abc")
    for subject, keys in (
        ("this computer", {"rigctl/r/cmd/*", "rigctl/r/cmd/hold"}),
        ("without a name", {"rigctl/r/cmd/hold"}),
    ):
        assert {one for one in allowed(section, subject, "ingress") if "/cmd/" in one[1]} == {
            ("query", key) for key in keys
        }


def test_where_routers_join_what_another_states_of_this_rig_is_denied() -> None:
    section = access_control("r", "1abc", joins=True)
    denied = allowed(section, "without a name", "ingress", "deny")
    assert denied == {(message, "rigctl/r/**") for message in STATING}
    assert allowed(section, "without a name", "egress", "deny") == {("query", "rigctl/r/**")}
    commands = {(message, key) for message, key in allowed(section, "without a name", "ingress") if "/cmd/" in key}
    assert {key for message, key in commands if message == "query"} == {"rigctl/*/cmd/hold"}
