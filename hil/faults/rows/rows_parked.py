"""Rows of the catalogue played with the load parked: HOLD and FAULT, held by the brake instead of by the motor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from hil.faults.expected import Expected, InjectedFault, Reaction
from rigctl.model.states import Mode

PARKED = {"HOLD_PARKED": Mode.HOLD, "FAULT_PARKED": Mode.FAULT}
"""Names of ``--mode`` for a mode in which the brake holds the load."""
SUFFIX = "_parked"
AT_ONCE = ("hold.park_s", 0.5)
HELD_MM, HELD_N = 1.0, 9.0
"""What a load on the brake may move, whatever becomes of sensors, bus and a motor that is off."""
_OWN_COMMANDS = frozenset({"reset_during_quick_stop"})
_PULLED = frozenset({"payload_caught"})
"""The payload is moved by something else: the brake holds the stroke, nothing can hold the tension."""
_OFF_HIDES = frozenset({Reaction.DRIVE_OFF, Reaction.DRIVE_STOPS})
"""Reactions to a motor that does not obey: one without power may not show it, and the load must not move either way."""


def of(fault: InjectedFault) -> InjectedFault | None:
    """The row with the load on the brake; None where the fault is about something else.

    It is about something else where it is there from the start, comes while the drive is switched on, or brings its
    own commands.
    """
    around = fault.around
    own = fault.id in _OWN_COMMANDS
    if fault.from_start or around.phase or around.course is not None or fault.ends_elsewhere or own:
        return None
    expected = dict(_expected(fault))
    if not expected:
        return None
    slips = Reaction.MOVES in expected.values() or not fault.carried
    pulled = fault.id in _PULLED
    change = tuple(pair for pair in around.change if pair[0] != AT_ONCE[0])
    return replace(
        fault,
        id=f"{fault.id}{SUFFIX}",
        expected=expected,
        after_s=0.0,
        against_cut=False,
        band_n=fault.band_n if slips or pulled else min(fault.band_n, HELD_N) if not change else fault.band_n,
        held_mm=fault.held_mm if slips else min(fault.held_mm, HELD_MM),
        within_ms=fault.within_ms,
        around=replace(around, change=(*change, AT_ONCE), parked=True),
    )


def _expected(fault: InjectedFault) -> Iterator[tuple[Mode, Reaction]]:
    for mode in PARKED.values():
        wanted = fault.expected.get(mode)
        if wanted is None:
            continue
        if mode is Mode.HOLD and wanted in _OFF_HIDES:
            yield mode, Reaction.EITHER
        elif mode is Mode.FAULT and wanted in _OFF_HIDES:
            yield mode, Reaction.KEPT
        else:
            yield mode, _ON_BRAKE.get(fault.id, {}).get(mode, wanted)


_ON_BRAKE: dict[str, Expected] = {
    "brake_stuck_open": {Mode.HOLD: Reaction.MOVES, Mode.FAULT: Reaction.MOVES},
    "cell_drift_fast": {Mode.HOLD: Reaction.RIDDEN},  # it rises: a load on the brake cannot
    "drive_reports_off": {Mode.HOLD: Reaction.RIDDEN},  # so it is
    "unlimited_cell_jumps": {Mode.HOLD: Reaction.RIDDEN},  # the same, below safety.tension_high_n
}
"""What differs on the brake: the first second is over, or a rig at rest does not show the fault."""
