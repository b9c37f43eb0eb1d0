"""The state that the public slot shows, in the words of the state message; see `rigctl.ipc.public_slot`."""

from __future__ import annotations

import math
from typing import Any

from rigctl.ipc.progress import REPORTED_S
from rigctl.ipc.public_slot import PublicSlot
from rigctl.model.faults import Fault, faults_of
from rigctl.model.states import HeldBy, Mode
from rigctl.wire.record_names import ALIVE_NS, named, quality_words
from rigctl.wire.state_words import BRAKE_FAILS


def public_state(slot: PublicSlot, now_ns: int) -> dict[str, Any]:
    """What is known at ``now_ns``; the functions of `rigctl.wire.state_words` take it.

    ``written``: the supervisor has written the slot within the last second. ``loop_alive``: the loop then writes
    records. ``waits_for``: what a start waits for, None for nothing.
    """
    written = now_ns - slot.looked_ns < REPORTED_S * 1e9
    state: dict[str, Any] = {"written": written, "looked_ms": _age_ms(slot.looked_ns, now_ns)}
    state["waits_for"] = slot.waits_for or None
    if not slot.t_ns:
        return state | {"loop_alive": False, "age_ms": None, "mode": None}
    return state | {
        "loop_alive": written and slot.looked_ns - slot.t_ns < ALIVE_NS,
        "age_ms": _age_ms(slot.t_ns, now_ns),
        "mode": named(Mode, slot.mode),
        "held_by": named(HeldBy, slot.held_by),
        "fault": named(Fault, slot.fault) if slot.fault else None,
        "causes": [{"fault": fault.name} for fault in faults_of(slot.cause_bits)],
        "tension_n": None if math.isnan(slot.tension_n) else slot.tension_n,
        "quality": {"tension": quality_words(slot.tension_quality), "drive": quality_words(slot.drive_quality)},
        "flag_names": [BRAKE_FAILS] if slot.brake_fails else [],
    }


def _age_ms(t_ns: int, now_ns: int) -> float:
    return max(0.0, round((now_ns - t_ns) / 1e6, 3))
