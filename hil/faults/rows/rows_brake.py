"""Rows of the catalogue: a brake that slips, sticks or closes late, and RESET and ARM after it has been found."""

from __future__ import annotations

import math

from hil.faults import in_device
from hil.faults.expected import Around, Expected, InjectedFault, Reaction
from hil.faults.in_controller import brake_known_to_slip
from hil.faults.in_device import SPEED, STROKE, both, brake_slips, reads, stuck
from hil.faults.rows.at_several import gives, in_turn
from hil.faults.rows.rows_creep import HELD_MM
from hil.faults.rows.rows_parked import AT_ONCE
from hil.faults.stand import Injector
from rigctl.model.parts import Part
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import Verb

_LATER_S = 3.0
"""After the parking and its first second."""
_SEEN_MM = 0.6
_REPORTED_S = 7.0  # a slip too slow for its speed is one over 5 s
_MOVES: Expected = {Mode.HOLD: Reaction.MOVES, Mode.FAULT: Reaction.MOVES}
_TAKEN_BACK: Expected = {Mode.HOLD: Reaction.HELD, Mode.FAULT: Reaction.KEPT}
_WHY_BACK = "the motor that has just held the load takes it back, with a fault"
_WHY_KEPT = "the motor gives the load to no brake that is known not to hold"
_WHY_LATER = "nothing may switch a motor on by itself: the fault says so, and rigctl carry is the operator's"
_ENCODER_STUCK = both(stuck(STROKE), reads(SPEED, times=0.0))


def _parking(
    id_: str, what: str, inject: Injector, expected: Expected = _TAKEN_BACK, why: str = _WHY_BACK
) -> InjectedFault:
    return InjectedFault(
        id_, what, inject, expected, seconds=4.0, held_mm=HELD_MM, latency_ms=math.inf,
        around=Around(change=(AT_ONCE,)), why=why,
    )  # fmt: skip


def _later(id_: str, what: str, inject: Injector, lasts_s: float, *commands: tuple[float, Verb],
           expected: Expected = _MOVES, band_n: float = math.inf, why: str = _WHY_LATER) -> InjectedFault:  # fmt: skip
    given = ((_LATER_S + at_s, gives(verb)) for at_s, verb in commands)
    return InjectedFault(
        id_, what, in_turn((_LATER_S, inject), *given), expected, seconds=_LATER_S + lasts_s, band_n=band_n,
        latency_ms=math.inf, around=Around(change=(AT_ONCE,)), ends_elsewhere=bool(commands), why=why,
    )  # fmt: skip


_RESET, _RESET_ARM = ((5.0, Verb.RESET),), ((5.0, Verb.RESET), (6.0, Verb.ARM))
BRAKE: tuple[InjectedFault, ...] = (
    _parking("brake_slips_parking", "the brake gives way by 0.5 mm/s from the parking on", brake_slips(0.5)),
    _parking("brake_slips_parking_slowly", "the same by 0.1 mm/s", brake_slips(0.1)),
    _parking("brake_known_parking", "the brake is known not to hold, and gives way by 0.5 mm/s whenever it is closed",
             in_turn((0.0, brake_known_to_slip()), (0.0, brake_slips(0.5))),
             {Mode.HOLD: Reaction.RIDDEN, Mode.FAULT: Reaction.KEPT}, _WHY_KEPT),
    _parking("brake_closes_late", "the brake closes 0.3 s later than the drive waits for it",
             in_device.brake_closes_late(300), {Mode.HOLD: Reaction.EITHER, Mode.FAULT: Reaction.KEPT}),
    *(_later(f"brake_slips_later_{round(speed * 1e3)}", f"the brake that holds gives way by {speed:g} mm/s",
             brake_slips(speed), max(_SEEN_MM / speed, _REPORTED_S)) for speed in (0.03, 0.1)),
    *(_later(f"encoder_stuck_brake_slips_later_{round(speed * 1e3)}",
             f"the encoder has stuck, then the brake that holds gives way by {speed:g} mm/s",
             both(_ENCODER_STUCK, brake_slips(speed)), _SEEN_MM / speed + 3.0) for speed in (0.02, 0.05, 0.5)),
    _later("brake_slips_later_reset", "the brake that holds gives way by 0.3 mm/s; RESET", brake_slips(0.3), 7.0,
           *_RESET, band_n=20.0, why="refused while the load sinks"),
    _later("brake_slips_later_reset_arm", "the same; RESET and ARM", brake_slips(0.3), 9.0, *_RESET_ARM, band_n=20.0,
           why="both are refused while the load sinks"),
    _later("encoder_stuck_brake_slips_reset_arm",
           "the encoder has stuck, then the brake that holds gives way by 0.3 mm/s; RESET and ARM",
           both(_ENCODER_STUCK, brake_slips(0.3)), 9.0, *_RESET_ARM, band_n=20.0,
           why="both are refused while the tension falls"),
    InjectedFault(
        "encoder_dead_later_runs_away",
        "the encoder has stuck, the brake that holds gives way by 0.3 mm/s, the motor carries by the cell, and the "
        "encoder is dead in the drive's own speed loop too: the motor runs away by 3 mm/s",
        in_turn((_LATER_S, both(_ENCODER_STUCK, brake_slips(0.3))),
                (_LATER_S + 5.0, gives(Verb.CARRY, 60.0, float(Witness.CELL))),
                (_LATER_S + 8.0, in_device.runs_away(-3.0))),
        _MOVES, part=(Part.ENCODER,), seconds=_LATER_S + 9.5, band_n=30.0, latency_ms=math.inf,
        around=Around(change=(AT_ONCE,)), ends_elsewhere=True,
        why="the tension, which does not follow the commanded stroke, stops it by quick stop",
    ),
    _later("brake_sticks_take_back", "the brake does not open any more; TENSION", in_device.brake_stays_closed(), 3.0,
           (0.1, Verb.TENSION), expected={Mode.HOLD: Reaction.DRIVE_OFF}, band_n=9.0,
           why="the drive pulls at a load that does not move, and is taken off power"),
)  # fmt: skip
