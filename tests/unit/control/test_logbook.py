"""Events that a bus may send by the thousand: each is written once a second, and the others are not drowned."""

from __future__ import annotations

import pathlib

import pytest

from rigctl.control.logbook import NOTICES_KEPT, Logbook, Rings
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.events import Kind
from tests.builders.rig_bench import SETTINGS

MS = 1_000_000


class Book:
    """A logbook on rings of its own, and what it has written."""

    def __init__(self, folder: pathlib.Path) -> None:
        runtime = Runtime.of("paper_rig", folder)
        runtime.claim()
        runtime.make_rings(SETTINGS)
        self.logbook = Logbook(SETTINGS, Rings.of(runtime))
        self._events: RingReader = runtime.events.reader()

    def written(self) -> list[tuple[int, int]]:
        """Time and node of each new event."""
        return [(int(event["t_ns"]), int(event["a"])) for event in self._events.read()]


@pytest.fixture
def book(tmp_path: pathlib.Path) -> Book:
    return Book(tmp_path)


def test_a_notice_that_repeats_is_written_once_a_second(book: Book) -> None:
    for tick in range(3500):
        book.logbook.notice(tick * MS, Kind.NODE_STATE, 4, 127)
    assert [t_ns for t_ns, _ in book.written()] == [0, 1000 * MS, 2000 * MS, 3000 * MS]


def test_a_notice_that_repeats_delays_no_other(book: Book) -> None:
    for tick in range(900):
        book.logbook.notice(tick * MS, Kind.NODE_STATE, 4, 127)
    book.logbook.notice(900 * MS, Kind.NODE_STATE, 3, 127)
    book.logbook.notice(901 * MS, Kind.NODE_STATE, 3, 4)
    assert book.written() == [(0, 4), (900 * MS, 3), (901 * MS, 3)]


def test_a_bus_that_makes_up_ever_new_notices_takes_no_memory(book: Book) -> None:
    """The times of the last second are forgotten together: at worst, one of them is written twice in it."""
    for a in range(NOTICES_KEPT + 1):
        book.logbook.notice(a, Kind.EMERGENCY, a, 0)
    book.written()
    book.logbook.notice(2 * NOTICES_KEPT, Kind.EMERGENCY, 0, 0)
    assert book.written() == [(2 * NOTICES_KEPT, 0)]
