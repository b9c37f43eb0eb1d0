"""The lines that the daemon prints of the loop's events."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from rigctl.ipc.record import EVENT
from rigctl.model.events import EACH_SECOND, Kind
from rigctl.supervisor.event_lines import AGAIN_NS, KEPT, EventLines

S = 1_000_000_000


def slots(of: Iterable[tuple[int, Kind, str]]) -> np.ndarray:
    made = list(of)
    found = np.zeros(len(made), EVENT.dtype)
    for slot, (t_ns, kind, text) in zip(found, made, strict=True):
        slot["t_ns"], slot["kind"], slot["text"] = t_ns, kind, text.encode()
    return found


@pytest.mark.parametrize("name", EACH_SECOND)
def test_a_failure_that_lasts_is_printed_once_a_minute(name: str) -> None:
    lines, kind = EventLines(), Kind[name]
    printed = [len(list(lines.of(slots([(second * S, kind, "the bus has gone")])))) for second in range(1, 602)]
    assert printed[0] == 1
    assert sum(printed) == 601 * S // AGAIN_NS + 1


def test_another_reason_is_printed_at_once_and_so_are_all_other_events() -> None:
    lines = EventLines()
    found = list(lines.of(slots([
        (S, Kind.SEND_FAILED, "send buffer full"),
        (2 * S, Kind.SEND_FAILED, "no such device"),
        (3 * S, Kind.SEND_FAILED, "send buffer full"),
        (4 * S, Kind.STARTED, ""),
        (5 * S, Kind.STARTED, ""),
    ])))  # fmt: skip
    assert found[:2] == ["WARNING: frame not sent: send buffer full", "WARNING: frame not sent: no such device"]
    assert len(found) == 4
    assert found[2] == found[3]


def test_reasons_that_never_end_take_no_memory() -> None:
    lines = EventLines()
    made = slots((n + 1, Kind.SEND_FAILED, f"reason {n}") for n in range(10 * KEPT))
    assert len(list(lines.of(made))) == 10 * KEPT
    assert len(lines._next_ns) <= KEPT
