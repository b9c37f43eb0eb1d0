"""The time of publishing an event: not before its tick is recorded, except for events of a loop that died."""

from __future__ import annotations

import pathlib
from typing import Any, cast

import msgspec
import pytest

from rigctl.config import rig_file as config
from rigctl.gateway.published_position import Cursor
from rigctl.gateway.streams import UNRECORDED_NS, EventStream
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.events import Kind
from rigctl.wire.keys import SEVERITIES
from tests.builders.paths import ROOT

MS = 1_000_000


class Publisher:
    """Stores the published messages."""

    matching_status = True

    def __init__(self) -> None:
        self.seqs: list[int] = []

    def put(self, payload: bytes) -> None:
        self.seqs.append(msgspec.json.decode(payload)["seq"])


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    found = Runtime(tmp_path)
    found.make_rings(config.load(ROOT / "config/paper_rig.yaml"))
    return found


def test_an_event_waits_for_the_record_of_its_tick_but_not_for_ever(runtime: Runtime) -> None:
    cursor = Cursor(runtime.gateway_cursor, runtime.records.path, 0)
    publisher, writer = Publisher(), runtime.events.writer()
    publishers = cast("Any", dict.fromkeys(SEVERITIES, publisher))
    stream = EventStream(publishers, runtime.events.reader(), runtime.notes.reader(), cursor, 0)

    def published(now_ns: int, recorded_ns: int) -> list[int]:
        stream.read(0, now_ns, recorded_ns)
        stream.publish()
        return publisher.seqs

    for tick in (10, 11, 12):
        writer.write(tick * MS, int(Kind.STARTED), 0, 0, 0.0, 0.0, b"")
    assert published(12 * MS, 11 * MS) == [1, 2]
    assert published(13 * MS, 11 * MS) == [1, 2]
    assert published(14 * MS, 12 * MS) == [1, 2, 3]
    writer.write(20 * MS, int(Kind.STARTED), 0, 0, 0.0, 0.0, b"")
    assert published(20 * MS + UNRECORDED_NS - 1, 12 * MS) == [1, 2, 3]
    assert published(20 * MS + UNRECORDED_NS, 12 * MS) == [1, 2, 3, 4]
    cursor.close()
