"""The audit log under a flood: repeats are counted, the rate is limited, and every command carried out is there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rigctl.ipc.record import HOLD_ID
from rigctl.model.verbs import Verb
from rigctl.recorder import thinning
from rigctl.recorder.audit_log import Item
from rigctl.recorder.thinning import (
    BURST,
    DAY_S,
    ENTRY_BYTES,
    RATE_BYTES,
    RATE_HZ,
    WRITTEN_FIRST,
    Thinning,
    size_of,
)

S = 1_000_000_000


def item(t_ns: int, what: str, text: str = "", who: str = "kim", source: str = "desk", **details: Any) -> Item:
    return Item(t_ns, t_ns, what, text, who, details, source, max(1, t_ns // 1_000_000))


def refusal(t_ns: int, who: str = "kim") -> Item:
    return item(
        t_ns, "command_refused", f"TENSION refused: anna, since {t_ns // S} s", who, verb="tension", reason="held"
    )


def flood(thin: Thinning, items: list[Item], poll_ns: int = S // 20) -> list[Item]:
    """``items`` in the polls in which a recorder reads them."""
    written, at = [], 0
    for now in range(items[0].t_ns, items[-1].t_ns + 2 * poll_ns, poll_ns):
        new = []
        while at < len(items) and items[at].t_ns <= now:
            new.append(items[at])
            at += 1
        written += thin.thin(new, now, now)
    return written


def test_the_same_refusal_becomes_one_entry_with_its_count() -> None:
    written = flood(Thinning(), [refusal(S + number * 10_000_000) for number in range(1200)])
    assert [one.what for one in written[:WRITTEN_FIRST]] == ["command_refused"] * WRITTEN_FIRST
    counted = [one for one in written if one.what == "repeated"]
    (first,) = counted
    assert first.who == "kim"
    assert first.text.startswith(f"the same refusal {first.details['count']} times more in 10 s: TENSION refused: anna")
    assert 990 <= first.details["count"] <= 1000
    assert len(written) == WRITTEN_FIRST + 1


def test_counts_are_written_before_the_recorder_ends() -> None:
    thin = Thinning()
    flood(thin, [refusal(S + number) for number in range(100)])
    (last,) = thin.thin([], 2 * S, 2 * S, final=True)
    assert last.details["count"] == 100 - WRITTEN_FIRST


def test_another_operators_refusal_is_not_the_same() -> None:
    written = flood(Thinning(), [refusal(S + number, f"user{number}") for number in range(20)])
    assert len(written) == 20


@pytest.mark.parametrize("who", ["kim", "user{}"], ids=["one operator", "a new name each time"])
def test_the_log_grows_no_faster_than_stated_and_loses_no_accepted_command_and_no_trip(who: str) -> None:
    per_s, seconds = 500, 120
    items: list[Item] = []
    for number in range(per_s * seconds):
        t_ns = S + number * (S // per_s)
        items.append(refusal(t_ns, who.format(number)))
        items.append(item(t_ns, "order", "TENSION", "", "commands", id=number))
        if not number % per_s:
            items.append(item(t_ns, "command_accepted", "TARGET: 280 N", "anna", verb="target"))
            items.append(item(t_ns, "trip", "trip TENSION_HIGH", "", "events"))
    thin = Thinning()
    written = flood(thin, items)
    written += thin.thin([], items[-1].t_ns + S, 0, final=True)
    kinds = [one.what for one in written]
    assert kinds.count("command_accepted") == kinds.count("trip") == seconds
    thinned = [one for one in written if one.what not in ("command_accepted", "trip")]
    assert len(thinned) <= BURST + (RATE_HZ + 1) * seconds
    assert sum(size_of(one) for one in thinned) <= thinning.BURST_BYTES + 1.2 * RATE_BYTES * seconds
    counted = sum(sum(one.details.values()) for one in written if one.what == "left_out")
    repeated = sum(one.details["count"] for one in written if one.what == "repeated")
    plain = sum(one.what not in ("left_out", "repeated") for one in written)
    assert counted + repeated + plain == len(items)


FLOODS: dict[str, Callable[[int, int, int], Item]] = {
    "refusals": lambda t_ns, poll, n: refusal(t_ns, f"user{poll}-{n}"),
    "holds": lambda t_ns, poll, n: item(t_ns, "command_accepted", "HOLD: held", f"{poll}-{n}", verb="hold"),
    "messages": lambda t_ns, poll, n: item(t_ns, "message_refused", f"PUT {poll} {n}", "", "notes", other="a"),
    "repeats": lambda t_ns, _poll, n: refusal(t_ns, f"user{n % 60}"),
}


@pytest.mark.parametrize("what", FLOODS)
def test_a_flood_of_two_days_has_a_bound_for_each(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of names and texts that are never the same, and of many that are the same again and again."""
    monkeypatch.setattr(thinning, "DAY_BYTES", 1 << 20)
    thin, poll_s = Thinning(), 600
    written = [0, 0]
    for poll in range(1, 2 * DAY_S // poll_s):
        now_ns = poll * poll_s * S
        made = thin.thin([FLOODS[what](now_ns, poll, n) for n in range(300)], now_ns, now_ns)
        written[poll * poll_s // DAY_S] += sum(size_of(one) for one in made)
    counts = DAY_S // poll_s * (ENTRY_BYTES + 400)
    assert (1 << 19) < written[0] < (1 << 20) + counts
    assert written[1] < (1 << 19) + counts


def test_a_flood_of_refusals_keeps_no_hold_off_the_log() -> None:
    thin = Thinning()
    flood(thin, [refusal(S + number * 100_000, f"user{number}") for number in range(60_000)])
    held = item(8 * S, "command_accepted", "HOLD: held", "anna", verb="hold")
    assert held in thin.thin([held], 8 * S, 8 * S)


def local_hold(t_ns: int, uid: int, name: str) -> list[Item]:
    """The entries of one HOLD on a local socket, as `rigctl.recorder.sources` words them."""
    id_ = HOLD_ID | t_ns
    reply = {"id": id_, "accepted": True, "reason": "NONE", "mode": "HOLD", "checks": []}
    return [
        item(t_ns, "local_hold_given", f"HOLD of {uid}", name, "holds", id=id_, uid=uid),
        item(t_ns, "local_hold", f"HOLD from {name}", "", "events", a=uid, b=t_ns),
        item(t_ns, "reply", "carried out, HOLD", "", "replies", **reply),
    ]


def command_hold(t_ns: int, who: str) -> list[Item]:
    """The entries of one HOLD that comes as a command."""
    return [
        item(t_ns, "command_given", "hold", who, verb="hold", id=t_ns),
        item(t_ns, "order", "HOLD", "", "commands", verb=int(Verb.HOLD), id=t_ns),
        item(t_ns, "reply", "carried out, HOLD", "", "replies", id=t_ns, accepted=True, reason="NONE", mode="HOLD"),
        item(t_ns, "command_accepted", "HOLD: held", who, verb="hold", id=t_ns),
    ]


def others(t_ns: int) -> list[Item]:
    """A command that is carried out, a takeover, and a refusal of somebody else."""
    return [
        item(t_ns, "command_given", "lease_take", "anna", verb="lease_take", id=0),
        item(t_ns, "command_accepted", "lease taken over", "anna", verb="lease_take", id=0),
        item(t_ns, "lease_taken_over", "anna has the lease", "anna", "notes", other="kim"),
        item(t_ns, "order", "TARGET 280", "", "commands", verb=int(Verb.TARGET), id=t_ns),
        item(t_ns, "reply", "carried out, COMPENSATING", "", "replies", id=t_ns, accepted=True),
    ]


OF_HOLD: dict[str, Callable[[int, int], list[Item]]] = {
    "one user": lambda t_ns, _n: local_hold(t_ns, 65534, "nobody"),
    "one user with a new name each time": lambda t_ns, n: local_hold(t_ns, 65534, f"{n} (nobody)"),
    "as a command, with a new name each time": lambda t_ns, n: command_hold(t_ns, f"kim{n}"),
}


@pytest.fixture(params=OF_HOLD)
def flooded(request: pytest.FixtureRequest) -> tuple[str, Thinning, list[Item]]:
    """Which flood, the state after half a minute of it, and its items of the poll that is next.

    The loop takes 50 HOLDs of a user in a second; here six users flood it together.
    """
    per_s, seconds = 300, 30
    items = [one for n in range(per_s * seconds) for one in OF_HOLD[request.param](S + n * S // per_s, n)]
    thin, last_ns = Thinning(), items[-1].t_ns - S // 20
    flood(thin, [one for one in items if one.t_ns <= last_ns], S // 40)
    return request.param, thin, [one for one in items if one.t_ns > last_ns]


def test_a_flood_of_hold_keeps_no_other_command_off_the_log(flooded: tuple[str, Thinning, list[Item]]) -> None:
    _, thin, items = flooded
    wanted = others(items[-1].t_ns)
    assert [one for one in thin.thin([*items, *wanted], wanted[0].t_ns, 0) if one in wanted] == wanted


def test_a_flood_of_hold_keeps_no_hold_by_another_way_off_the_log(flooded: tuple[str, Thinning, list[Item]]) -> None:
    kind, thin, items = flooded
    t_ns = items[-1].t_ns + 1
    locally = local_hold(t_ns, 1000, "anna")[:2]  # that it was carried out is in the counted reply
    wanted = [*locally, *([] if kind.startswith("as a command") else command_hold(t_ns, "anna"))]
    assert [one for one in thin.thin([*items, *wanted], t_ns, 0) if one in wanted] == wanted


def test_every_hold_of_a_flood_is_written_or_counted() -> None:
    thin = Thinning()
    items = [one for n in range(1500) for one in local_hold(S + n * S // 50, 65534 - n % 3, "nobody")]
    written = [*flood(thin, items, S), *thin.thin([], 200 * S, 200 * S, final=True)]
    counted = sum(one.details["count"] for one in written if one.what == "repeated")
    assert counted + sum(one in items for one in written if one.what != "repeated") == len(items)


def test_what_is_not_named_is_always_written() -> None:
    items = [item(S + number, "mode", "HOLD -> FAULT", "", "events") for number in range(5000)]
    assert flood(Thinning(), items) == items


def test_a_tension_that_hovers_about_a_limit_does_not_fill_the_log() -> None:
    items = []
    for number in range(5000):
        t_ns = S + number * 2_000_000
        items.append(item(t_ns, "limit", f"limit: tension above 300 ({300 + number})", "", "events", a=12))
        items.append(item(t_ns + 1_000_000, "limit_over", "limit cleared: tension above 300", "", "events", a=12))
    assert len(flood(Thinning(), items)) <= 2 * (WRITTEN_FIRST + 1) * 2


@pytest.mark.parametrize("kind", ["bus_error", "send_failed", "receive_failed"])
def test_a_bus_that_is_gone_is_counted_once_a_minute(kind: str) -> None:
    """The loop reports each failure every second while it lasts, be it for a weekend."""
    minutes = 60
    items = [item(S + n * S, kind, "the bus has gone", "", "events", a=1, b=2) for n in range(60 * minutes)]
    thin = Thinning()
    written = flood(thin, items)
    assert len(written) <= WRITTEN_FIRST + 1 + minutes
    counted = [*written[WRITTEN_FIRST:], *thin.thin([], 2 * 60 * minutes * S, 0)]
    assert sum(one.details["count"] for one in counted) == len(items) - WRITTEN_FIRST
    assert thin.thin([], 3 * 60 * minutes * S - S, 0) == []
    again = item(3 * 60 * minutes * S, kind, "the bus has gone", "", "events", a=1, b=2)
    assert thin.thin([again], again.t_ns, again.t_ns) == [again]


def test_after_its_burst_the_log_still_takes_its_rate() -> None:
    thin, per_s, seconds = Thinning(), 100, 120
    orders = [item(S + n * (S // per_s), "order", f"TENSION {n}", "", "commands", id=n) for n in range(per_s * seconds)]
    late = [one for one in flood(thin, orders) if one.what == "order" and one.t_ns > 61 * S]
    assert len(late) == pytest.approx(RATE_HZ * (seconds - 60), rel=0.1)
