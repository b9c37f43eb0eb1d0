"""Zenoh's access control of a gateway: what each kind of link may do. Default deny. Pure functions of values.

The gateway's router looks at every message from a link (ingress) and to it (egress). It knows a link's protocol and a
certificate's common name, and gives a queryable no name of who asks.

- The Unix socket in the run-time folder, and ``tcp``: reads. Commands of this computer have a socket of their own, and
  so has HOLD (`rigctl.gateway.command_socket`, `rigctl.control.bus.hold_sockets`).
- ``tls``: the commands of a person have keys with the person's name, and the rules let only that person's certificates
  use them.

Zenoh applies a rule to a message whose key expression the rule's includes: one with wildcards slips past a rule that
denies the keys of one rig. Only where routers join is anything of other rigs allowed at all.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Sequence
from typing import Any

from rigctl.identity.access_file import Certified
from rigctl.identity.roles import PEOPLE, Role
from rigctl.model.lease_acts import ACTS
from rigctl.model.verbs import Verb, VerbTrait, having
from rigctl.wire.alarms import ALARM_ACTS
from rigctl.wire.keys import ROOT, Keys
from rigctl.wire.note_request import NOTE

READ_TAILS = ("tele/**", "event/**", "events/**", "meta/**", "cfg/**")
"""Ends of the keys on which a daemon publishes and answers; everyone who is let in may read them."""
LIVE_TAIL = "live/**"
ROLE_OF_VERB = dict.fromkeys(having(VerbTrait.MAINTAINER), Role.MAINTAINER)
"""Role that a verb needs; operators may give every other verb, and HOLD among them."""

_ANY_RIG = "*"
# Without undeclarations and ends of queries: Zenoh lets those pass, or judges them as what they end.
_LIVENESS = ("liveliness_query", "declare_liveliness_subscriber")
_STATING = ("put", "delete", "declare_queryable", "reply", "liveliness_token")


def commands_of(role: Role) -> list[str]:
    """Ends of the keys of the commands that a role may give, with acts on the lease and on alarms, and notes."""
    needed = {verb.name.lower(): ROLE_OF_VERB.get(verb, Role.OPERATOR) for verb in Verb}
    needed |= dict.fromkeys((*ACTS, *ALARM_ACTS, NOTE), Role.OPERATOR)
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


def _joined(rules: _Rules, subject: str, rig: str) -> None:
    """Another router at the end of a link: it relays other rigs, and states nothing of this one.

    No query of this rig's keys goes there, whatever is declared with wildcards.
    """
    relayed = _on(_ANY_RIG, [*READ_TAILS, LIVE_TAIL])
    own = _on(rig, ["**"])
    for flow in ("ingress", "egress"):
        rules.add(subject, flow, [*_STATING, "declare_subscriber", *_LIVENESS], relayed)
        rules.add(subject, flow, ["query"], _on(_ANY_RIG, READ_TAILS))
    rules.add(subject, "ingress", _STATING, own, "deny")
    rules.add(subject, "egress", ["query"], own, "deny")


def _own_commands(rules: _Rules, subject: str, keys: Keys) -> None:
    """The gateway's session for commands over TLS, on its socket in the run-time folder."""
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


def access_control(
    rig: str,
    own_zid: str,
    certificates: Sequence[Certified] = (),
    now: datetime.datetime | None = None,
    *,
    joins: bool = False,
) -> dict[str, Any]:
    """The section ``access_control`` of the configuration of this rig's router.

    ``own_zid``: id of the gateway's own session for commands, which is on the Unix socket too. Nobody else has that id
    before that session is open, and Zenoh takes no second session of an id.

    ``certificates``: every one issued, judged at ``now``; those revoked or expired get no rule, so that all their
    messages are refused. ``joins``: this router joins others.
    """
    rules = _Rules()
    _own_commands(rules, "own commands", Keys(rig, "*"))
    for subject in ("this computer", "without a name"):
        _reader(rules, subject, _ANY_RIG if joins else rig)
    if joins:
        _joined(rules, "without a name", rig)
    _anyone(rules, "anyone")
    socket = {"link_protocols": ["unixsock-stream"]}
    subjects: list[dict[str, Any]] = [
        {"id": "own commands", "zids": [own_zid]} | socket,
        {"id": "this computer"} | socket,
        {"id": "without a name", "link_protocols": ["tcp"]},
        {"id": "anyone", "link_protocols": ["tls"]},
    ]
    for one in certificates:
        if now is None or not one.is_valid(now) or one.role not in PEOPLE:
            continue
        subject = one.common_name
        subjects.append({"id": subject, "cert_common_names": [subject], "link_protocols": ["tls"]})
        _person(rules, subject, Keys(rig, one.name), one.role)
    return {
        "enabled": True, "default_permission": "deny",
        "rules": rules.rules, "subjects": subjects, "policies": rules.policies,
    }  # fmt: skip
