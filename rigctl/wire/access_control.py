"""Zenoh's access control of a gateway, from the certificates issued. Default deny. Pure functions of values.

The gateway's router looks at every message from a link (ingress) and to it (egress). Zenoh knows a certificate by its
common name, and gives a queryable no name of who asks; so the commands of a person have keys with the person's name,
and the rules let only that person's certificates use them.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Sequence
from typing import Any

from rigctl.control.modes import Verb
from rigctl.identity.access_file import Certified
from rigctl.identity.roles import PEOPLE, Role
from rigctl.wire.alarms import ALARM_ACTS
from rigctl.wire.keys import ROOT, Keys
from rigctl.wire.lease import ACTS

READ_TAILS = ("tele/**", "event/**", "events/**", "meta/**", "cfg/**")
"""Ends of the keys on which a daemon publishes and answers; everyone with a certificate may read them."""
LIVE_TAIL = "live/**"
ROLE_OF_VERB = {
    Verb.CALIBRATE: Role.MAINTAINER,
    Verb.IDENTIFY: Role.MAINTAINER,
    Verb.GAINS: Role.MAINTAINER,
    Verb.RESPONSE: Role.MAINTAINER,
}
"""Role that a verb needs; operators may give every other verb, and HOLD among them."""

_ANY_RIG = "*"
# Without undeclarations and ends of queries: Zenoh lets those pass, or judges them as what they end.
_LIVENESS = ("liveliness_query", "declare_liveliness_subscriber")


def commands_of(role: Role) -> list[str]:
    """Ends of the keys of the commands that a role may give, acts on the lease and on alarms among them."""
    needed = {verb.name.lower(): ROLE_OF_VERB.get(verb, Role.OPERATOR) for verb in Verb}
    needed |= dict.fromkeys((*ACTS, *ALARM_ACTS), Role.OPERATOR)
    return [name for name, least in needed.items() if role.includes(least)]


def _on(rig: str, tails: Iterable[str]) -> list[str]:
    return [f"{ROOT}/{rig}/{tail}" for tail in tails]


class _Rules:
    """Rules and policies in Zenoh's form, each rule for one kind of subject."""

    def __init__(self) -> None:
        self.rules: list[dict[str, Any]] = []
        self._of: dict[str, list[str]] = {}

    def add(self, subject: str, flow: str, messages: Sequence[str], keys: list[str], permission: str = "allow") -> None:
        name = f"{subject}: {flow} {len(self.rules)}"
        self.rules.append(
            {"id": name, "permission": permission, "flows": [flow], "messages": list(messages), "key_exprs": keys}
        )
        self._of.setdefault(subject, []).append(name)

    @property
    def policies(self) -> list[dict[str, Any]]:
        return [{"rules": rules, "subjects": [subject]} for subject, rules in self._of.items()]


def _reader(rules: _Rules, subject: str, rig: str) -> None:
    # A client finds the rig's name by asking for the token of any rig.
    read, live = _on(rig, READ_TAILS), _on(_ANY_RIG, [LIVE_TAIL])
    rules.add(subject, "ingress", ["declare_subscriber", "query"], read)
    rules.add(subject, "ingress", _LIVENESS, live)
    rules.add(subject, "egress", ["put", "reply"], read)
    rules.add(subject, "egress", ["liveliness_token"], live)


def _person(rules: _Rules, subject: str, keys: Keys, role: Role) -> None:
    """Reading, and commands under the person's own name."""
    _reader(rules, subject, keys.rig)
    if commands := [keys.command(name) for name in commands_of(role)]:
        rules.add(subject, "ingress", ["query"], commands)
        rules.add(subject, "egress", ["reply"], commands)


def _own_commands(rules: _Rules, subject: str, keys: Keys) -> None:
    """The gateway's session for commands, on its socket in the run-time folder."""
    commands, live = [keys.command("*")], _on(keys.rig, [LIVE_TAIL])
    rules.add(subject, "ingress", ["declare_queryable", "reply"], commands)
    rules.add(subject, "ingress", ["liveliness_token", *_LIVENESS], live)
    rules.add(subject, "egress", ["query", "declare_queryable"], commands)
    rules.add(subject, "egress", ["liveliness_token"], live)


def _anyone(rules: _Rules, subject: str) -> None:
    """Everyone with a certificate, known or not: gets nothing.

    Zenoh names the certificate in its log of a refusal only if it belongs to some subject.
    """
    rules.add(subject, "ingress", ["put"], [f"{ROOT}/nothing"], "deny")


def access_control(rig: str, certificates: Sequence[Certified], now: datetime.datetime, own_zid: str) -> dict[str, Any]:
    """The section ``access_control`` of the configuration of this rig's router.

    The socket in the run-time folder is for the rig's own processes: the page reads there, and the gateway's session
    for commands is the one with the id ``own_zid``. Nobody else has that id before that session is open, and Zenoh
    takes no second session of an id.

    ``certificates``: every one issued; those revoked or expired get no rule, so that all their messages are refused.
    """
    rules = _Rules()
    _own_commands(rules, "own commands", Keys(rig, "*"))
    _reader(rules, "own processes", rig)
    socket = {"link_protocols": ["unixsock-stream"]}
    _anyone(rules, "anyone")
    subjects: list[dict[str, Any]] = [
        {"id": "own commands", "zids": [own_zid]} | socket,
        {"id": "own processes"} | socket,
        {"id": "anyone", "link_protocols": ["tls"]},
    ]
    for one in certificates:
        if not one.is_valid(now) or one.role not in PEOPLE:
            continue
        subject = one.common_name
        subjects.append({"id": subject, "cert_common_names": [subject], "link_protocols": ["tls"]})
        _person(rules, subject, Keys(rig, one.name), one.role)
    return {
        "enabled": True, "default_permission": "deny",
        "rules": rules.rules, "subjects": subjects, "policies": rules.policies,
    }  # fmt: skip
