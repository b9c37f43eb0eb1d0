"""Messages of the command socket: whatever the pieces they arrive in, and what is none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.wire.socket_message import (
    LONGEST_QUESTION,
    SocketAnswer,
    SocketMessageError,
    SocketQuestion,
    Splitter,
    packed,
    unpacked,
)


@given(st.lists(st.binary(max_size=300), max_size=5), st.lists(st.integers(1, 40), min_size=1, max_size=20))
def test_messages_come_whole_and_in_order_in_whatever_pieces(payloads: list[bytes], sizes: list[int]) -> None:
    sent = [(SocketQuestion(n, "cmd/arm"), payload) for n, payload in enumerate(payloads, 1)]
    data, found, at, splitter = b"".join(packed(*one) for one in sent), [], 0, Splitter(LONGEST_QUESTION)
    while at < len(data):
        size = sizes[at % len(sizes)]
        splitter.feed(data[at : at + size])
        at += size
        while (message := splitter.take()) is not None:
            found.append(unpacked(message, SocketQuestion))
    assert found == sent


def test_a_payload_is_taken_as_it_is_also_with_line_ends_and_no_json() -> None:
    splitter = Splitter(LONGEST_QUESTION)
    splitter.feed(packed(SocketAnswer(7, False), b"{\n\n\xff"))
    assert unpacked(splitter.take() or b"", SocketAnswer) == (SocketAnswer(7, False), b"{\n\n\xff")
    assert splitter.take() is None


def test_a_message_that_would_be_too_long_is_refused_by_its_length_alone() -> None:
    splitter = Splitter(LONGEST_QUESTION)
    splitter.feed((LONGEST_QUESTION + 1).to_bytes(4, "big"))
    with pytest.raises(SocketMessageError, match="expected at most"):
        splitter.take()


@pytest.mark.parametrize(
    "head",
    [b"", b"arm", b"[]", b'{"number":1}', b'{"number":"1","key":"x"}', b'{"number":1,"key":"x","uid":0}', b"\xff"],
)
def test_what_is_no_question_is_refused_in_one_line(head: bytes) -> None:
    with pytest.raises(SocketMessageError) as refused:
        unpacked(head + b"\nx", SocketQuestion)
    assert "\n" not in str(refused.value)
