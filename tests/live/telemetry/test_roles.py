"""Every cell of the table of docs/security.md: messages x keys x roles, over real TLS sessions with a router.

The router has the gateway's own configuration and access list. A get, which the router ends even where it is refused,
follows every other message on the same link, so the router has judged the message when the get returns.
"""

from __future__ import annotations

import datetime
import pathlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
import zenoh

from rigctl.identity import credentials
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.roles import PEOPLE, Role
from rigctl.model.lease_acts import ACTS
from rigctl.model.verbs import Verb
from rigctl.wire.access_control import access_control
from rigctl.wire.alarms import ALARM_ACTS
from rigctl.wire.keys import Keys
from rigctl.wire.session import SessionError, close, finish, open_client, open_router
from tests.builders.miniature import free_port
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

RIG, OWN_ZID = "paper_rig", "1a2b3c4d5e6f"
NAMES = {"revoked": "rex", "viewer": "vera", "operator": "kim", "maintainer": "max"}
HEADER = "| message | key | revoked | viewer | operator | maintainer |\n|---|---|---|---|---|---|\n"
NOW = datetime.datetime.now(datetime.UTC)


def rows() -> list[tuple[str, str, dict[str, bool]]]:
    """Message, key and who may, from the page."""
    table = (ROOT / "docs/security.md").read_text().partition(HEADER)[2].partition("\n\n")[0]
    found = []
    for line in table.splitlines():
        message, keys, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        assert set(cells) <= {"yes", "no"} and len(cells) == len(NAMES), line
        may = {role: cell == "yes" for role, cell in zip(NAMES, cells, strict=True)}
        found += [(message, key, may) for key in re.findall("`([^`]+)`", keys)]
    return found


CELLS = [(message, key, role, may) for message, key, who in rows() for role, may in who.items()]


@dataclass
class Network:
    """A router as the gateway opens it, its own session for commands, and a session of each role."""

    router: zenoh.Session
    own: zenoh.Session
    people: dict[str, zenoh.Session]
    endpoint: str
    keys: KeyIssuer
    came: list[str] = field(default_factory=list)  # keys of what was put, deleted or asked at the router

    def key(self, tail: str, role: str) -> str:
        other = NAMES["maintainer" if role != "maintainer" else "operator"]
        parts = [{"NAME": NAMES[role], "OTHER": other}.get(part, part) for part in tail.split("/")]
        return f"rigctl/{RIG}/{'/'.join(parts)}"

    def judged(self, role: str) -> None:
        """Return when the router has judged every message that this role has sent so far."""
        assert list(self.people[role].get("judged", timeout=patience_s())) == []


def answer(query: zenoh.Query) -> None:
    query.reply(query.key_expr, b"the gateway's")
    finish(query)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Network]:
    folder = tmp_path_factory.mktemp("roles")
    keys = KeyIssuer(folder / "keys", NOW)
    keys.init([])
    for name, role in zip(NAMES.values(), (Role.MAINTAINER, *PEOPLE), strict=True):
        keys.add(name, role)
    keys.revoke(NAMES["revoked"])
    port, socket = free_port(), f"unixsock-stream/{folder}/own.sock"
    endpoint = f"tls/127.0.0.1:{port}"
    access = access_control(RIG, OWN_ZID, keys.folder.certificates(), NOW)
    router = open_router([f"tls/0.0.0.0:{port}", socket], [], keys.folder.gateway_credentials(), access)
    own = open_client(socket, zid=OWN_ZID)
    people = {role: open_client(endpoint, credentials.read(keys.folder.issued(name))) for role, name in NAMES.items()}
    made = Network(router, own, people, endpoint, keys)
    own.declare_queryable(Keys(RIG, "*").command("*"), answer)
    for key in (Keys(RIG).state, Keys(RIG).fast, Keys(RIG).events_past, Keys(RIG).schema, Keys(RIG).active):
        router.declare_queryable(key, answer)
    router.declare_subscriber("**", lambda sample: made.came.append(f"{sample.kind} {sample.key_expr}"))
    until(
        lambda: list(router.get(Keys(RIG, "kim").command("hold"), timeout=patience_s())), "the own session's queryable"
    )
    yield made
    for session in (*people.values(), own, router):
        close(session)


def reads(network: Network, session: zenoh.Session, key: str, role: str) -> bool:
    got: list[str] = []
    subscriber = session.declare_subscriber(key, lambda sample: got.append(str(sample.key_expr)))
    network.judged(role)
    published = key.replace("event/*", "event/info").replace("**", "tele/state")
    network.router.put(published, b"new")
    if wanted := session is not network.people["revoked"] and "cmd" not in key and not key.endswith("/**"):
        until(lambda: got, f"a message on {published}")
    network.judged(role)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return bool(got) or wanted


def asks(_network: Network, session: zenoh.Session, key: str, _role: str) -> bool:
    replies = list(session.get(key, timeout=patience_s(), target=zenoh.QueryTarget.ALL))
    assert all(reply.ok is not None for reply in replies)
    return bool(replies)


def puts(network: Network, session: zenoh.Session, key: str, role: str) -> bool:
    network.came.clear()
    session.put(key, b"forged")
    network.judged(role)
    return bool(network.came)


def deletes(network: Network, session: zenoh.Session, key: str, role: str) -> bool:
    network.came.clear()
    session.delete(key)
    network.judged(role)
    return bool(network.came)


def answers(network: Network, session: zenoh.Session, key: str, role: str) -> bool:
    """Whether a forged answer reaches the router or another person, who asks for the key the forger claims."""
    asked: list[str] = []

    def forge(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.reply(query.key_expr, b"forged")
        finish(query)

    queryable = session.declare_queryable(key, forge)
    network.judged(role)
    concrete = key.replace("cmd/*", f"cmd/{NAMES['operator']}").replace("**", "tele/state")
    found = []
    # Not the forger: a session answers its own questions itself.
    for asker in (network.router, network.people["maintainer" if role == "operator" else "operator"]):
        found += list(asker.get(concrete, timeout=patience_s(), target=zenoh.QueryTarget.ALL,
                                consolidation=zenoh.ConsolidationMode.NONE))  # fmt: skip
    queryable.undeclare()  # type: ignore[no-untyped-call]
    assert b"the gateway's" in [bytes(reply.ok.payload) for reply in found if reply.ok is not None]
    return bool(asked) or any(bytes(reply.ok.payload) == b"forged" for reply in found if reply.ok is not None)


def declares(network: Network, session: zenoh.Session, key: str, role: str) -> bool:
    token = session.liveliness().declare_token(key)
    network.judged(role)
    found = list(network.router.liveliness().get("rigctl/*/live/daemon", timeout=patience_s()))
    token.undeclare()  # type: ignore[no-untyped-call]
    network.judged(role)
    return bool(found)


def sees(network: Network, session: zenoh.Session, key: str, _role: str) -> bool:
    token = network.own.liveliness().declare_token(key)
    ask = network.router.liveliness().get
    until(lambda: list(ask(key, timeout=patience_s())), "the token at the router")
    found = list(session.liveliness().get("rigctl/*/live/daemon", timeout=patience_s()))
    token.undeclare()  # type: ignore[no-untyped-call]
    until(lambda: not list(ask(key, timeout=patience_s())), "the token's end")
    return bool(found)


TRIED: dict[str, Callable[[Network, zenoh.Session, str, str], bool]] = {
    "read": reads, "query": asks, "put": puts, "delete": deletes, "answer": answers, "token": declares,
    "see token": sees,
}  # fmt: skip


@pytest.mark.parametrize(("message", "key", "role", "may"), CELLS, ids=str)
def test_a_role_may_what_the_table_says(network: Network, message: str, key: str, role: str, may: bool) -> None:
    assert TRIED[message](network, network.people[role], network.key(key, role), role) is may


def test_the_table_has_every_verb_every_message_and_every_role() -> None:
    found = {(message, key) for message, key, _ in rows()}
    commands = [*(verb.name.lower() for verb in Verb), *ACTS, *ALARM_ACTS]
    assert {("query", f"cmd/NAME/{name}") for name in commands} <= found
    assert {message for message, _ in found} == TRIED.keys()
    assert {*NAMES} == {"revoked", *(role.value for role in PEOPLE)}


def test_no_session_without_a_valid_certificate_of_the_rigs_authority(network: Network, tmp_path: pathlib.Path) -> None:
    stranger = KeyIssuer(tmp_path / "keys", NOW)
    stranger.init([])
    stranger.add("kim", Role.MAINTAINER)
    late = KeyIssuer(network.keys.folder.path, NOW - datetime.timedelta(days=9))
    late.add("eva", Role.MAINTAINER, days=1)
    mixed = credentials.read(stranger.folder.issued("kim"))
    mine = credentials.read(network.keys.folder.issued("kim"))
    trusting = type(mixed)(mixed.name, mixed.role, mixed.not_after, mixed.key, mixed.certificate, mine.authority)
    expired = credentials.read(late.folder.issued("eva"))
    for owned in (None, mixed, trusting, expired):
        with pytest.raises(SessionError):
            close(open_client(network.endpoint, owned))
    close(open_client(network.endpoint, mine))
    with pytest.raises(SessionError):  # the certificate is not good for this host
        close(open_client(network.endpoint.replace("127.0.0.1", "127.0.0.2"), mine))


def test_a_person_cannot_stand_in_for_the_router(network: Network) -> None:
    """A person's certificate is not good for a server: no client connects."""
    owned = credentials.read(network.keys.folder.issued("max"))
    endpoint = f"tls/127.0.0.1:{free_port()}"
    false = open_router([endpoint], [], owned)
    with pytest.raises(SessionError):
        close(open_client(endpoint, credentials.read(network.keys.folder.issued("kim"))))
    close(false)


def test_another_process_on_the_local_socket_only_reads(network: Network) -> None:
    """The page is there; and the own session's id cannot be taken."""
    socket = network.keys.folder.path.parent / "own.sock"
    other = open_client(f"unixsock-stream/{socket}")
    key = Keys(RIG, "kim").command("hold")
    assert list(other.get(key, timeout=patience_s())) == []

    def forge(query: zenoh.Query) -> None:
        query.reply(key, b"forged")
        finish(query)

    other.declare_queryable(key, forge)
    assert list(other.get("judged", timeout=patience_s())) == []
    assert list(other.get(Keys(RIG).state, timeout=patience_s()))
    found = list(network.people["operator"].get(key, timeout=patience_s(), target=zenoh.QueryTarget.ALL))
    assert [bytes(reply.ok.payload) for reply in found if reply.ok is not None] == [b"the gateway's"]
    close(other)
    with pytest.raises(SessionError):
        close(open_client(f"unixsock-stream/{socket}", zid=OWN_ZID))


def test_subscriptions_renewed_many_times_are_never_dropped(network: Network) -> None:
    """Known of other access lists: a subscription declared again, or by a session that came back, gets nothing."""
    keys, owned = Keys(RIG), credentials.read(network.keys.folder.issued("vera"))
    for session in (network.people["viewer"], *(open_client(network.endpoint, owned) for _ in range(3))):
        for turn in range(20):
            got: list[bytes] = []
            subscribers = [
                session.declare_subscriber(key, lambda sample: got.append(bytes(sample.payload)))  # noqa: B023
                for key in (keys.state, keys.event("*"), keys.fast)
            ]
            assert list(session.get(keys.state, timeout=patience_s()))
            for key in (keys.state, keys.event("info"), keys.fast):
                network.router.put(key, f"{key} {turn}".encode())
            until(lambda: len(got) == 3, f"three messages in turn {turn}")  # noqa: B023
            for subscriber in subscribers:
                subscriber.undeclare()  # type: ignore[no-untyped-call]
        if session is not network.people["viewer"]:
            close(session)


def test_nothing_of_a_key_is_in_a_sessions_configuration_messages(network: Network) -> None:
    with pytest.raises(SessionError) as refused:
        open_client("tls/127.0.0.1:1", credentials.read(network.keys.folder.issued("kim")))
    assert not re.search("PRIVATE|BEGIN", str(refused.value))


def test_a_session_ends_with_its_certificate(tmp_path: pathlib.Path) -> None:
    """At the router's end: the session was open, its holder reads no more, and gets no other session."""
    keys = KeyIssuer(tmp_path / "keys", NOW)
    keys.init([])
    lasts = datetime.timedelta(seconds=10)  # opening takes milliseconds
    KeyIssuer(keys.folder.path, datetime.datetime.now(datetime.UTC) + lasts - datetime.timedelta(days=1)).add(
        "eva", Role.VIEWER, days=1
    )
    endpoint, owned = f"tls/127.0.0.1:{free_port()}", credentials.read(keys.folder.issued("eva"))
    access = access_control(RIG, OWN_ZID, keys.folder.certificates(), datetime.datetime.now(datetime.UTC))
    router = open_router([endpoint], [], keys.folder.gateway_credentials(), access)
    router.declare_queryable(Keys(RIG).state, answer)
    session = open_client(endpoint, owned)
    assert list(session.get(Keys(RIG).state, timeout=patience_s()))
    until(lambda: not list(session.get(Keys(RIG).state, timeout=patience_s())), "the end of the session")
    assert datetime.datetime.now(datetime.UTC) >= owned.not_after
    with pytest.raises(SessionError):
        close(open_client(endpoint, owned))
    close(session)
    close(router)
