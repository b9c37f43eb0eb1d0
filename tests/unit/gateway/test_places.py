"""No identity's connections take the places of another's; who has many loses its own oldest."""

from __future__ import annotations

from rigctl.gateway.places import OPENING, OPENING_OF_SOURCE, OPENING_S, POOL, SHARE, Connection, Rules, Why, closed


def sessions(identity: str, number: int, first: int = 0) -> list[Connection]:
    return [Connection(first + i, 0.0, identity, identity) for i in range(number)]


def opening(source: str, number: int, first: int = 0) -> list[Connection]:
    return [Connection(first + i, 0.0, source) for i in range(number)]


def test_every_session_of_a_certificate_that_is_not_known_is_closed_and_no_other() -> None:
    rules = Rules({"kim.1"}, {"kim.1"})
    found = closed(sessions("max.1", 127) + sessions("kim.1", SHARE, 127), rules, 0.0)
    assert [one.identity for one, _ in found] == ["max.1"] * 127
    assert {why for _, why in found} == {Why.UNKNOWN}


def test_beyond_its_share_an_identity_loses_its_own_oldest_session() -> None:
    found = closed(sessions("kim.1", SHARE + 2) + sessions("lee.1", SHARE, 1000), Rules({"kim.1", "lee.1"}), 0.0)
    assert [(one.number, why) for one, why in found] == [(0, Why.SHARE), (1, Why.SHARE)]


def test_the_pool_is_shared_and_reserved_places_are_not_of_it() -> None:
    crowd = [one for i in range(POOL) for one in sessions(f"user {i}", 1, i)]
    held = sessions("kim", SHARE, 1000)
    assert closed([*crowd, *held], Rules({"kim"}), 0.0) == []
    (one, why), *more = closed([*crowd, *held, Connection(2000, 0.0, "user 7", "user 7")], Rules({"kim"}), 0.0)
    assert (one.number, why, more) == (7, Why.POOL, [])  # of the user with two


def test_of_half_open_connections_the_newest_has_its_turn() -> None:
    flood, genuine = opening("a", 1800), Connection(5000, 0.0, "b")
    found = closed([*flood, genuine], Rules(), 0.0)
    assert [one.number for one, _ in found] == list(range(1800 - OPENING_OF_SOURCE))
    many = [one for i in range(40) for one in opening(f"host {i}", OPENING_OF_SOURCE, 100 * i)]
    found = closed([*many, genuine], Rules(), 0.0)
    assert len(found) == len(many) + 1 - OPENING
    assert genuine not in [one for one, _ in found]
    assert [why for _, why in closed([genuine], Rules(), OPENING_S + 0.1)] == [Why.LATE]
