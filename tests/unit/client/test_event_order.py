"""Events of two sources put in order: each once, missed ones queried, a new daemon noticed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from rigctl.client.event_order import EventSource
from rigctl.client.mailbox import Mailbox
from rigctl.client.stream_source import Question
from rigctl.wire.keys import Keys

KEYS = Keys("paper_rig")


class Daemon:
    """A session that holds events and publishes given ones to a mailbox."""

    def __init__(self, loop: int, gateway: int, stream: int = 1) -> None:
        self.heads, self.stream = {"loop": loop, "gateway": gateway}, stream
        self.oldest = 1
        self.mailbox = Mailbox(cast("Any", self), "", 1000)

    def declare_subscriber(self, _key: str, put: Any) -> Daemon:
        self.put = put
        return self

    def undeclare(self) -> None:
        """It is the subscriber, too."""

    def message(self, source: str, seq: int) -> dict[str, Any]:
        return {
            "source": source, "seq": seq, "stream": self.stream, "kind": "X", "t_ns": seq, "wall_ns": seq,
            "severity": "info", "text": "x",
        }  # fmt: skip

    def publish(self, source: str, seq: int) -> None:
        self.heads[source] = max(self.heads[source], seq)
        self.put(SimpleNamespace(key_expr=KEYS.event("info"), payload=msgspec.json.encode(self.message(source, seq))))

    def answer(self, question: Question) -> bytes:
        if question.selector == KEYS.state:
            heads: dict[str, Any] = {
                "event_seq": self.heads["loop"],
                "note_seq": self.heads["gateway"],
                "mode": None,
                "wall_ns": 0,
            }
            heads |= {"loop_alive": False, "warnings": [], "age_ms": None}
            return msgspec.json.encode({"stream": self.stream, **heads})
        after = [int(part.split("=")[1]) for part in question.selector.split("?")[1].split(";")]
        pairs = zip(("loop", "gateway"), after, strict=True)
        found = [self.message(s, n) for s, a in pairs for n in range(max(a + 1, self.oldest), self.heads[s] + 1)]
        return msgspec.json.encode(found)

    def spoof(self, **wrong: Any) -> None:
        """Publish on the daemon's key as another peer."""
        self.put(
            SimpleNamespace(key_expr=KEYS.event("info"), payload=msgspec.json.encode(self.message("loop", 1) | wrong))
        )


def given_by(source: EventSource, daemon: Daemon, *, silent: bool = False) -> list[tuple[str, int]]:
    seen = []
    while (found := source.poll()) is not None:
        if isinstance(found, Question):
            source.answer(None if silent else daemon.answer(found))
        else:
            seen.append((found["source"], found["seq"]))
    return seen


def test_events_from_now_on_and_none_from_before() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    assert given_by(source, daemon) == []
    daemon.publish("loop", 11)
    daemon.publish("gateway", 5)
    assert given_by(source, daemon) == [("loop", 11), ("gateway", 5)]


def test_even_the_first_event_may_have_been_missed() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    given_by(source, daemon)
    daemon.heads["gateway"] = 5
    daemon.publish("loop", 13)
    assert sorted(given_by(source, daemon)) == [("gateway", 5), ("loop", 11), ("loop", 12), ("loop", 13)]
    daemon.publish("loop", 13)  # a gateway was killed after publishing it and before recording that
    assert given_by(source, daemon) == []


def test_what_came_before_the_sequences_were_known_counts() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    daemon.publish("loop", 11)  # the state, queried only now, already has 11
    assert given_by(source, daemon) == [("loop", 11)]


def test_the_past_comes_first_where_it_is_wanted() -> None:
    daemon = Daemon(3, 1)
    source = EventSource(daemon.mailbox, KEYS, past=True)
    assert given_by(source, daemon) == [("loop", 1), ("loop", 2), ("loop", 3), ("gateway", 1)]
    daemon.publish("loop", 4)
    assert given_by(source, daemon) == [("loop", 4)]


def test_a_new_daemon_is_followed_from_its_first_event() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    given_by(source, daemon)
    daemon.stream, daemon.heads = 2, {"loop": 0, "gateway": 0}
    daemon.publish("loop", 3)
    assert given_by(source, daemon) == [("loop", 1), ("loop", 2), ("loop", 3)]


def test_a_daemon_that_does_not_answer_leaves_what_was_published() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    daemon.publish("loop", 11)
    daemon.publish("loop", 15)
    daemon.put(SimpleNamespace(key_expr=KEYS.event("info"), payload=b"garbage"))
    assert given_by(source, daemon, silent=True) == [("loop", 11), ("loop", 15)]


def test_an_event_the_daemon_knows_nothing_of_is_refused() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    given_by(source, daemon)
    daemon.spoof(seq=2**60)
    daemon.spoof(stream=7)
    daemon.spoof(severity="\x1b[31m")
    daemon.publish("loop", 11)
    assert given_by(source, daemon) == [("loop", 11)]
    assert daemon.mailbox.refusals.count == 3


def test_beginning_anew_forgets_what_has_come() -> None:
    daemon = Daemon(10, 4)
    source = EventSource(daemon.mailbox, KEYS)
    given_by(source, daemon)
    daemon.publish("loop", 11)
    source.restart()
    daemon.publish("loop", 12)
    assert given_by(source, daemon) == [("loop", 12)]


@given(st.lists(st.tuples(st.sampled_from(["loop", "gateway"]), st.integers(1, 5)), max_size=30), st.integers(1, 20))
def test_whatever_is_missed_or_repeated_each_comes_once_and_in_order(steps: list[tuple[str, int]], oldest: int) -> None:
    daemon = Daemon(0, 0)
    source = EventSource(daemon.mailbox, KEYS)
    given_by(source, daemon)
    daemon.oldest = oldest
    seen = []
    for name, step in steps:
        daemon.publish(name, daemon.heads[name] + step)
        daemon.publish(name, daemon.heads[name])
        seen += given_by(source, daemon)
    for name, head in daemon.heads.items():
        numbers = [seq for source_, seq in seen if source_ == name]
        assert numbers == sorted(set(numbers))
        assert set(range(oldest, head + 1)) <= set(numbers)
