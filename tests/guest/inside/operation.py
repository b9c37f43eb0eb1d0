"""Runs in the guest only (see ../test_guest.py): the real daemon on a real kernel's CAN interface."""

from __future__ import annotations

import pytest

from tests.builders.host_pause import PAUSE_MS, late_wake_ups
from tests.builders.waiting import until
from tests.guest.inside.guest_rig import TARGET_N, GuestRig

TRIES = 5


def test_arm_tension_hold_release(rig: GuestRig) -> None:
    for _ in range(TRIES):
        with late_wake_ups() as late:
            held, after = hold_and_release(rig)
        starved = rig.starved_by_host(after) or max(late) >= PAUSE_MS
        if "rope slack" in rig.said[after:] or not starved:  # else the rig's processes had no processor: once more
            break
    assert "RELEASING -> HOLD: rope slack" in rig.said[after:]
    assert rig.truth.vertical_n == 0.0
    assert rig.truth.stroke_mm < held - 10.0


def hold_and_release(rig: GuestRig) -> tuple[float, int]:
    """Tension, hold, and release until the rope is slack or the rig has tripped; held stroke, place in the log."""
    rig.compensate()
    assert rig.truth.vertical_n == pytest.approx(TARGET_N, abs=2.0), rig.said
    after = len(rig.said)
    rig.carried_out("hold")
    held = rig.truth.stroke_mm
    rig.carried_out("release")
    until(lambda: any(end in rig.said[after:] for end in ("rope slack", "-> FAULT")), log=rig.log)
    return held, after
