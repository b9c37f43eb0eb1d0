"""The offers of a state message that a test has made by hand: by the loop's own answer, of what the state shows."""

from __future__ import annotations

from typing import Any

import numpy as np

from rigctl.control.commands.situation import Situation, slot_values
from rigctl.ipc.record import SITUATION
from rigctl.model.checks import Check
from rigctl.model.faults import Fault, bits_of
from rigctl.model.states import Mode
from rigctl.wire.offers import offers


def offered(state: dict[str, Any], **more: Any) -> dict[str, Any] | None:
    """Offers that go with a state message; ``more``: fields of the situation that the state does not show."""
    if state.get("mode") not in Mode.__members__:
        return None
    mode, flags = Mode[state["mode"]], state.get("flag_names", [])
    causes = [cause for cause in state.get("causes", []) if cause.get("fault") in Fault.__members__]
    checks, on = int(state.get("checks") or 0), "drive_enabled" in flags
    situation = Situation(**{
        "failed_checks": checks, "fault": int(state.get("fault_code") or Fault[state.get("fault") or "NONE"]),
        "causes": bits_of(Fault[cause["fault"]] for cause in causes if cause.get("blocks_reset")),
        "stop_running": "stopping" in flags, "armed": on, "powered": on, "brake_fails": "brake_fails" in flags,
        "e_stop": any(cause["fault"] == Fault.E_STOP.name for cause in causes), "at_rest": True, "unloaded": True,
        "drive_faulted": bool(checks & Check.DRIVE_FAULT), "target_min_n": 50.0, "target_max_n": 350.0,
        "room_mm": 60.0, "stroke_mm": 52.3, **more,
    })  # fmt: skip
    slot = np.array([(1, *slot_values(0, mode, situation))], SITUATION.dtype)[0]
    preflight = (state.get("preflight") or {}).get("failing") or {}
    known = {Check[name]: words for name, words in preflight.items() if name in Check.__members__}
    return offers(slot, 40_000_000, known, {Fault[cause["fault"]]: cause.get("text", "") for cause in causes})
