"""The line that a daemon ends with: what was seen of the drive, and when."""

from __future__ import annotations

from typing import Any

import numpy as np

from rigctl.ipc.record import RECORD
from rigctl.model.states import Flag, Mode
from rigctl.supervisor.daemon import _ending

S, SLACK_N = 1_000_000_000, 5.0
OFF, ENABLED = 0x0250, 0x0237  # statuswords


def record(**values: Any) -> np.void:
    slot: np.void = np.zeros(1, RECORD.dtype)[0]
    for name, value in {"t_ns": 5 * S, "stroke_mm": 1.5, "tension_n": 300.0, **values}.items():
        slot[name] = value
    return slot


def test_a_loop_that_has_stopped_in_order_states_what_it_saw() -> None:
    code, words = _ending(record(mode=Mode.HOLD, statusword=OFF), True, 6 * S, SLACK_N)
    assert (code, words) == (0, "stopped in HOLD: stroke 1.50 mm, tension 300.0 N, brake closed")
    code, words = _ending(record(mode=Mode.HOLD, statusword=ENABLED), True, 6 * S, SLACK_N)
    assert code == 1
    assert words.endswith("the brake was not seen to close")


def test_a_load_that_is_left_to_a_brake_that_does_not_hold_is_no_good_end() -> None:
    code, words = _ending(record(mode=Mode.FAULT, statusword=OFF, flags=Flag.BRAKE_FAILS), True, 6 * S, SLACK_N)
    assert code == 1
    assert "300.0 N; the closed brake does not hold it: support the payload from below" in words
    slack = record(mode=Mode.FAULT, statusword=OFF, flags=Flag.BRAKE_FAILS, tension_n=0.2)
    assert _ending(slack, True, 6 * S, SLACK_N)[0] == 0


def test_without_a_loop_that_has_stopped_nothing_is_said_of_the_drive_but_what_was_seen_last_and_when() -> None:
    """So where the bus has gone and the control process cannot start again."""
    code, words = _ending(record(mode=Mode.FAULT, statusword=OFF), False, 53 * S, SLACK_N)
    assert code == 1
    assert words == (
        "no loop has stopped in order: the last one was in FAULT 48 s ago, last seen stroke 1.50 mm, tension 300.0 N; "
        "the brake was not seen to close, and the drive is left to its own supervision"
    )
