"""Rows of the catalogue in which one sign alone is left of drive, brake and load, and a second fault makes it false."""

from __future__ import annotations

import math
from dataclasses import replace

from hil.faults import in_device, on_bus
from hil.faults.expected import ACCURACY_N, Around, Expected, InjectedFault, Reaction
from hil.faults.in_device import CELL, SPEED, STROKE, both, brake_slips, reads, stuck
from hil.faults.rows.at_several import gives, in_turn
from hil.faults.rows.rows_parked import AT_ONCE
from hil.faults.stand import Injector
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import Verb

_LATER_S = 6.0
"""The first fault has been found, the drive is off, the load is at rest, and two seconds have shown it."""
_SEEN_S = 4.0
_LONG = ("hold.park_s", 30.0)
_MOVES, _HELD = {Mode.COMPENSATING: Reaction.MOVES}, {Mode.COMPENSATING: Reaction.HELD}


def _alone(id_: str, what: str, *parts: tuple[float, Injector], expected: Expected = _MOVES,
           band_n: float = math.inf, park: tuple[str, float] = AT_ONCE, why: str = "") -> InjectedFault:  # fmt: skip
    return InjectedFault(
        id_, what, in_turn(*parts), expected, seconds=_LATER_S + _SEEN_S, band_n=band_n, latency_ms=math.inf,
        around=Around(change=(park,)), why=why,
    )  # fmt: skip


ALONE = (
    _alone("cell_stuck_then_brake_slips_unseen",
           "the cell sticks; then the drive is not heard for 3 s, and its brake gives way by 0.5 mm/s",
           (0.0, stuck(CELL)), (_LATER_S, on_bus.silent(on_bus.drive, seconds=3.0)), (_LATER_S, brake_slips(0.5)),
           why="a cell in doubt shows no rest, also behind another fault"),
    _alone("encoder_drifts_then_brake_slips_unseen",
           "the position drifts by 2 mm/s, then sticks, as does the speed; then the cell's samples stop, and the brake "
           "gives way by 0.5 mm/s",
           (0.0, reads(STROKE, drift_s=2.0)),
           (_LATER_S / 2, both(stuck(STROKE), reads(SPEED, times=0.0))),
           (_LATER_S, both(on_bus.silent(on_bus.cell), brake_slips(0.5))),
           why="an encoder in doubt shows no rest, also once it shows no motion"),
    _alone("cell_silent_then_brake_slips_briefly",
           "the cell's samples stop; then the brake gives way by 10 mm/s for 0.1 s",
           (0.0, on_bus.silent(on_bus.cell)), (_LATER_S, brake_slips(10.0)), (_LATER_S + 0.1, brake_slips(0.0)),
           why="a stroke that has just moved shows no rest"),
    replace(
        _alone("brake_slips_then_lowered_by_encoder",
               "the brake gives way by 0.3 mm/s, then the cell's samples stop; LOWER by the encoder",
               (1.5, brake_slips(0.3)), (3.0, on_bus.silent(on_bus.cell)),
               (_LATER_S, gives(Verb.LOWER, float(Witness.ENCODER))), expected={Mode.HOLD: Reaction.RIDDEN},
               why="a stroke that the motor moves shows no rest"),
        ends_elsewhere=True,
    ),
    _alone("drive_silent_stays_on",
           "the drive is not heard, and its motor goes on holding, whatever it is commanded and whatever it misses",
           (0.0, both(on_bus.silent(on_bus.drive), in_device.hangs())), expected={Mode.HOLD: Reaction.HELD},
           band_n=ACCURACY_N, park=_LONG, why="a load at rest does not show that the motor that holds it is off"),
    _alone("runs_away_then_tool_enables",
           "the motor pays out 5 mm/s by itself until its power is off; then a service tool has it on, at rest",
           (0.0, in_device.runs_away(-5.0)), (1.0, in_device.runs_away(0.0)),
           (_LATER_S, in_device.tool_takes_over(0.0, deaf=True, shows_remote=True)), expected=_HELD, band_n=15.0,
           why="what confirmed that the power was off is withdrawn"),
    _alone("encoder_shifts_on_brake", "the position reads 0.01 mm more from one sample to the next, on the brake",
           (_LATER_S / 2, reads(STROKE, plus=0.01)), expected={Mode.HOLD: Reaction.RIDDEN}, band_n=ACCURACY_N,
           why="so little is no slip of the brake"),
)  # fmt: skip
