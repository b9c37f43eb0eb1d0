"""Rows of the catalogue: the second force path, on a rig that has one."""

from __future__ import annotations

from hil.faults import in_device, on_bus
from hil.faults.expected import HOLD, RIDE, Around, InjectedFault, Reaction
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.model.states import Mode

FITTED = Around(
    change=(("second_force", SecondForceSettings(kind="cell", zero_n=0.0, u_n=0.1, cell_u_n=0.2, disagree_n=1.0)),)
)
SECOND_FORCE = (
    InjectedFault(
        "second_force_wrong",
        "the second cell reads 5 N too much",
        in_device.second_force_off(5.0),
        HOLD,
        band_n=3,
        latency_ms=150.0,
        within_ms=500.0,
        around=FITTED,
        why="with two paths a difference shows that one is wrong, not which; what fusion takes is bounded meanwhile",
    ),
    InjectedFault(
        "second_force_silent",
        "the second cell's samples stop coming",
        on_bus.silent(on_bus.second),
        {**RIDE, Mode.DISARMED: Reaction.REFUSED},
        band_n=3,
        around=FITTED,
        why="the cell leads without it; an event says so, and the rig does not arm again",
    ),
    InjectedFault(
        "second_force_no_heartbeat",
        "the second cell sends no heartbeat any more, its samples go on",
        in_device.no_heartbeat(on_bus.second),
        RIDE,
        band_n=3,
        around=FITTED,
    ),
)
