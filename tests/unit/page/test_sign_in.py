"""Links and sessions of the page: once, for a time, and not without end."""

from __future__ import annotations

from starlette.datastructures import Headers

from rigctl.config.address import Address
from rigctl.page.guard import Guard
from rigctl.page.sign_in import LINK_S, LINKS, SESSION_S, SESSIONS, Session, SignIn


class Clock:
    """A monotonic clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def proof(session: Session, name: str = "rigctl") -> Headers:
    return Headers({"cookie": f"other=1; {name}={session.cookie}", "x-rigctl-key": session.key})


def signed_in(sessions: SignIn) -> Session:
    found = sessions.enter(sessions.link())
    assert found is not None
    return found


def test_a_link_is_used_once() -> None:
    sessions = SignIn(Clock())
    code = sessions.link()
    assert sessions.enter(code) is not None
    assert sessions.enter(code) is None
    assert sessions.enter("") is None


def test_a_link_and_a_session_last_their_time() -> None:
    clock = Clock()
    sessions = SignIn(clock)
    late, session = sessions.link(), signed_in(sessions)
    clock.now_s += LINK_S + 1
    assert sessions.enter(late) is None
    assert sessions.knows(proof(session))
    clock.now_s += SESSION_S
    assert not sessions.knows(proof(session))


def test_the_oldest_makes_room() -> None:
    sessions = SignIn(Clock())
    codes = [sessions.link() for _ in range(LINKS + 1)]
    assert sessions.enter(codes[0]) is None
    found = [signed_in(sessions) for _ in range(SESSIONS + 1)]
    assert not sessions.knows(proof(found[0]))
    assert sessions.knows(proof(found[-1]))


def test_no_secret_is_kept_in_clear() -> None:
    sessions = SignIn(Clock())
    code, session = sessions.link(), signed_in(sessions)
    kept = repr(vars(sessions))
    for secret in (code, session.cookie, session.key):
        assert secret not in kept


def test_what_a_page_asks_of_its_readers() -> None:
    nobody = Headers({})
    asked = {
        (host, operator, sign_in): Guard.of(Address(host, 1), operator=operator, sign_in=sign_in)
        for host in ("127.0.0.1", "0.0.0.0")
        for operator in (None, "kim")
        for sign_in in (False, True)
    }
    for (host, operator, sign_in), guard in asked.items():
        assert guard.may_read(nobody) is (host == "127.0.0.1" and not sign_in)
        assert not guard.may_command(nobody)
        assert guard.needs_links is (host != "127.0.0.1" or sign_in or operator is not None)
        session = proof(signed_in(guard.sessions), "rigctl-1")
        assert guard.may_read(session)
        assert guard.may_command(session) is (operator is not None)
