"""Blocks of the fast stream, and the reader that puts them in order."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.client import stream
from rigctl.client.block_order import BlockSource
from rigctl.client.mailbox import Mailbox
from rigctl.client.samples import Blocks
from rigctl.client.shapes import Refusals
from rigctl.client.stream_source import Question
from rigctl.ipc.record import RECORD
from rigctl.wire import block
from rigctl.wire.keys import Keys
from rigctl.wire.schema import schema


def made(first: int, last: int, stream: int = 1, head: int | None = None) -> bytes:
    """Records from first to last; ``head``: the newest record of the ring, else the last."""
    data = b"".join(struct.pack("<QQ", seq, seq * 7) for seq in range(first, last + 1))
    return block.encode(data, 16, first_seq=first, lost=0, stream=stream, head_seq=last if head is None else head)


def test_block_comes_back() -> None:
    found = block.decode(made(5, 8))
    assert (found.first_seq, found.last_seq, found.count, found.record_size) == (5, 8, 4, 16)
    part = found.part(6, 7)
    assert struct.unpack("<QQQQ", part.data) == (6, 42, 7, 49)
    assert found.part(9, 20).count == 0
    assert len(found.part(9, 20).data) == 0


@given(st.binary(max_size=200) | st.binary(max_size=100).map(lambda tail: made(1, 3)[:-1] + tail))
def test_other_bytes_are_refused(payload: bytes) -> None:
    try:
        found = block.decode(payload)
    except block.FastBlockError:
        return
    assert len(found.data) == found.count * found.record_size


def test_schema_describes_the_record() -> None:
    found = schema("paper_rig")["fast"]
    assert struct.calcsize(found["record"]["struct"]) == found["record"]["size"] == RECORD.dtype.itemsize
    names = [field["name"] for field in found["record"]["fields"]]
    assert names == list(RECORD.dtype.names or ())
    values = np.zeros(1, RECORD.dtype)
    for number, name in enumerate(names):
        values[name] = number + 1
    assert struct.unpack(found["record"]["struct"], values.tobytes()) == tuple(range(1, len(names) + 1))
    assert found["header"]["size"] == struct.calcsize(found["header"]["struct"]) == block.HEADER.size
    assert all(field["description"] for field in found["record"]["fields"] + found["header"]["fields"])


class Gateway:
    """Holds records ``held``, answers queries for missed ones, and publishes given ones."""

    def __init__(self, held: range, stream: int = 1) -> None:
        self.held, self.stream, self.queries, self.silent = held, stream, 0, False
        self.put: Callable[[Any], None] = print
        self.keys = Keys("paper_rig")
        self.refusals = Refusals()

    def declare_subscriber(self, _key: str, put: Callable[[Any], None]) -> Gateway:
        self.put = put
        return self

    def undeclare(self) -> None:
        """It is the subscriber, too."""

    def query(self, question: Question) -> tuple[bool, bytes] | None:
        self.queries += 1
        if self.silent:
            return None
        after = int(question.selector.split("after=")[1])
        first = max(after + 1, self.held.start)
        answer = made(first, min(first + 9, self.held.stop - 1), self.stream, self.held.stop - 1)
        question.check(answer)
        return True, answer

    def publish(self, *spans: tuple[int, int]) -> None:
        for first, last in spans:
            self.put(SimpleNamespace(key_expr=self.keys.fast, payload=made(first, last, self.stream)))


def reading(gateway: Gateway, *, recover: bool = True, past: bool = False) -> Blocks:
    key = gateway.keys.fast
    mailbox = Mailbox(cast("Any", gateway), key, 1000, gateway.refusals)
    return Blocks(gateway.query, BlockSource(mailbox, key, recover=recover, past=past))


def numbers(blocks: Iterator[block.Block]) -> list[int]:
    return [seq for found in blocks for seq in range(found.first_seq, found.last_seq + 1)]


def test_missed_records_are_queried() -> None:
    gateway = Gateway(range(1, 100))
    reader = reading(gateway)
    gateway.publish((11, 20), (46, 50), (51, 60))
    assert numbers(reader.arrived()) == list(range(11, 61))
    assert (reader.count.recovered, reader.count.lost, reader.count.produced) == (25, 0, 50)


def test_repeated_records_come_once() -> None:
    gateway = Gateway(range(1, 100))
    reader = reading(gateway)
    gateway.publish((1, 10), (1, 10), (8, 12))
    assert numbers(reader.arrived()) == list(range(1, 13))
    assert (reader.count.repeated, reader.count.received, reader.count.produced) == (13, 12, 12)


def test_what_the_ring_no_longer_holds_is_lost() -> None:
    gateway = Gateway(range(31, 100))
    reader = reading(gateway)
    gateway.publish((1, 10), (46, 50))
    assert numbers(reader.arrived()) == [*range(1, 11), *range(31, 51)]
    assert (reader.count.lost, reader.count.produced, reader.count.received) == (20, 50, 30)


@pytest.mark.parametrize("silent", [True, False])
def test_a_gap_that_no_answer_fills_is_lost(silent: bool) -> None:
    gateway = Gateway(range(1, 100))
    gateway.silent = silent
    reader = reading(gateway, recover=silent)
    gateway.publish((1, 10), (21, 30))
    assert numbers(reader.arrived()) == [*range(1, 11), *([] if silent else range(21, 31))]
    assert numbers(reader.rest()) == (list(range(21, 31)) if silent else [])
    assert (reader.count.lost, reader.count.produced) == (10, 30)


def test_a_gateway_that_was_away_is_queried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr(stream, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    gateway = Gateway(range(1, 100))
    gateway.silent = True
    reader = reading(gateway)
    gateway.publish((1, 10), (21, 30), (31, 40))
    assert numbers(reader.arrived()) == list(range(1, 11))
    assert numbers(reader.arrived()) == []  # too soon for another query
    assert gateway.queries == 1
    gateway.silent = False
    now_s[0] += stream.AGAIN_S
    assert numbers(reader.arrived()) == list(range(11, 41))
    assert (reader.count.lost, reader.count.recovered) == (0, 10)


def test_a_new_daemon_counts_from_one_again() -> None:
    gateway = Gateway(range(1, 2000))
    reader = reading(gateway)
    gateway.publish((1001, 1010))
    gateway.put(SimpleNamespace(key_expr=gateway.keys.fast, payload=b"garbage"))
    gateway.stream = 2
    gateway.publish((3, 5))
    assert numbers(reader.arrived()) == [*range(1001, 1011), *range(1, 6)]
    assert (reader.count.streams, reader.count.lost, reader.count.malformed, reader.count.produced) == (2, 0, 1, 15)
    assert reader.count.recovered == 2  # written before this subscriber was back


def test_records_the_daemon_knows_nothing_of_are_refused() -> None:
    gateway = Gateway(range(1, 100))
    reader = reading(gateway)
    gateway.publish((1, 10))
    gateway.put(SimpleNamespace(key_expr=gateway.keys.fast, payload=made(2**60, 2**60 + 1)))  # from the far future
    gateway.put(
        SimpleNamespace(key_expr=gateway.keys.fast, payload=made(1, 5, stream=9))
    )  # as after a restart of the daemon
    gateway.publish((11, 20))
    assert numbers(reader.arrived()) == list(range(1, 21))
    assert (reader.count.malformed, reader.count.lost, reader.count.streams) == (2, 0, 1)
    assert gateway.refusals.words == (
        "2 messages refused, the last on rigctl/paper_rig/tele/fast: records the daemon knows nothing of"
    )


def test_the_past_comes_first_where_it_is_wanted() -> None:
    gateway = Gateway(range(31, 100))
    reader = reading(gateway, past=True)
    assert numbers(reader.arrived()) == list(range(31, 100))
    gateway.publish((95, 99))
    gateway.held = range(31, 121)
    gateway.publish((106, 120))
    assert numbers(reader.arrived()) == list(range(100, 121))
    assert (reader.count.first_seq, reader.count.lost, reader.count.streams) == (31, 0, 1)


def test_an_empty_ring_has_no_past() -> None:
    gateway = Gateway(range(1, 1))
    reader = reading(gateway, past=True)
    assert numbers(reader.arrived()) == []
    gateway.publish((1, 5))
    assert numbers(reader.arrived()) == list(range(1, 6))


@given(st.lists(st.tuples(st.integers(1, 60), st.integers(0, 20)), max_size=12), st.integers(1, 30))
def test_whatever_comes_the_count_adds_up(spans: list[tuple[int, int]], oldest: int) -> None:
    gateway = Gateway(range(oldest, 100))
    reader = reading(gateway)
    gateway.publish(*((first, first + length) for first, length in spans))
    seen = numbers(reader.arrived())
    count = reader.count
    assert seen == sorted(set(seen))
    assert count.received == len(seen)
    assert count.received + count.lost == count.produced
    if seen:
        assert count.produced == count.last_seq - count.first_seq + 1
