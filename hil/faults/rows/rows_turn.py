"""Rows of the catalogue: faults inside transitions, and what comes after a reaction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from hil.faults import in_controller, in_device, on_bus
from hil.faults.expected import Around, Expected, InjectedFault, Reaction
from hil.faults.in_device import CELL, SPEED, STROKE, both, reads
from hil.faults.rows.at_several import gives, in_turn
from hil.faults.stand import Injector
from rigctl.config.settings import LearningSettings
from rigctl.config.settings_base import Settings
from rigctl.model.states import Mode
from rigctl.model.verbs import Setting, Verb

_WATCHED_S = 1.5
_PARKS_AT_ONCE, _LONG = ("hold.park_s", 0.5), ("hold.park_s", 30.0)
_PARKED_S = 1.2
"""From the entry into HOLD until the brake carries."""


@dataclass(frozen=True)
class InTransition:
    """A command in a mode, and the moments after it at which a fault begins."""

    name: str
    what: str
    mode: Mode
    verb: Verb | Setting
    values: tuple[float, ...]
    at_s: tuple[float, ...]
    given_s: float = 0.0
    change: tuple[tuple[str, float | Settings], ...] = ()
    without: frozenset[str] = frozenset()
    """Faults that have rows of their own."""
    moves: bool = False
    """The command moves the load by more than the bound, so the run without the fault has it too."""


TRANSITIONS = (
    InTransition(
        "arming", "while it is armed", Mode.DISARMED, Verb.ARM, (), (0.1, 0.3),
        without=frozenset({"brake_slips"}),
    ),
    InTransition(
        "take_back", "while the motor takes the load back", Mode.HOLD, Verb.TENSION, (), (0.02, 0.2),
        _PARKED_S, (_PARKS_AT_ONCE,), frozenset({"brake_slips"}), moves=True,
    ),
    InTransition("response", "during a response", Mode.COMPENSATING, Verb.RESPONSE, (1.0,), (0.3,)),
    InTransition("identify", "during an identification", Mode.HOLD, Verb.IDENTIFY, (1.0,), (0.5,), 0.0, (_LONG,)),
    InTransition(
        "move", "inside a marked move, from which the rig learns", Mode.COMPENSATING, Verb.MOVE, (1.0,), (0.4,), 0.0,
        (("learning", LearningSettings(move_s=9.5, cutoff_hz=2.0)),),
    ),
    InTransition("gains", "while gains are exchanged", Mode.COMPENSATING, Verb.GAINS, (), (0.002,)),
)  # fmt: skip

_DURING: tuple[tuple[str, str, Injector], ...] = (
    ("cell_silent", "the cell's samples stop", on_bus.silent(on_bus.cell)),
    ("cell_jumps", "the cell reads 80 N more", reads(CELL, plus=80.0)),
    ("encoder_drifts", "position and speed show 2 mm/s too much",
     both(reads(STROKE, drift_s=2.0), reads(SPEED, plus=2.0))),
    ("creeps", "the motor pays out 2 mm/s faster than commanded", in_device.creeps(-2.0)),
    ("runs", "the motor pays out 5 mm/s by itself", in_device.runs_away(-5.0)),
    ("brake_closes", "the brake closes by itself", in_device.brake_stays_closed()),
    ("brake_slips", "the closed brake gives way by 0.5 mm/s", in_device.brake_slips(0.5)),
    ("hangs", "the loop is 0.3 s late", in_controller.hangs(300)),
)  # fmt: skip
_BAND_N = {"runs": 15.0}
"""Of a motor that goes on until its drive is off."""


def _inside() -> Iterator[InjectedFault]:
    for way in TRANSITIONS:
        command = (way.given_s, gives(way.verb, *way.values))
        around = Around(change=way.change, course=in_turn(command) if way.moves else None)
        for name, what, injector in _DURING:
            if name in way.without:
                continue
            for at_s in way.at_s:
                yield InjectedFault(
                    f"{way.name}_{round(at_s * 1e3)}_{name}",
                    f"{what} {at_s:g} s into it, {way.what}",
                    in_turn(command, (way.given_s + at_s, injector)),
                    {way.mode: Reaction.EITHER},
                    seconds=way.given_s + at_s + _WATCHED_S,
                    band_n=_BAND_N.get(name, 9.0),
                    around=around,
                    ends_elsewhere=True,
                )


_RESET_S, _AGAIN_S = 2.5, 3.5
_RESETS = (_RESET_S, gives(Verb.RESET))
_BACK = (_RESETS, (_AGAIN_S, gives(Verb.ARM)), (6.5, gives(Verb.TENSION)))
"""A drive that was taken off power is armed anew."""
_LATE = ((0.0, in_controller.hangs(300)), _RESETS, (_AGAIN_S, gives(Verb.ARM)), (5.5, gives(Verb.TENSION)))
"""The drive stops by its own supervision, so the reset leads to DISARMED."""
_SECOND_S = 8.5
"""A second fault after the rig has been reset and compensates again."""
_OFF: Expected = {Mode.HOLD: Reaction.DRIVE_OFF, Mode.COMPENSATING: Reaction.DRIVE_OFF}
_HELD: Expected = {Mode.HOLD: Reaction.HELD, Mode.COMPENSATING: Reaction.HELD}
_STALE = on_bus.silent(on_bus.cell)


def _afterwards(id_: str, what: str, *parts: tuple[float, Injector], expected: Expected = _HELD,
                band_n: float = 9.0, held_mm: float = 1.0, why: str = "") -> InjectedFault:  # fmt: skip
    return InjectedFault(
        id_, what, in_turn(*parts), expected, part=parts[-1][1].part, seconds=max(at_s for at_s, _ in parts) + 2.5,
        band_n=band_n, held_mm=held_mm, latency_ms=math.inf, around=Around(change=(_LONG,)), ends_elsewhere=True,
        why=why,
    )  # fmt: skip


AFTER = (
    _afterwards("creeps_reset_tension", "the motor creeps by 2 mm/s; RESET, ARM, TENSION",
                (0.0, in_device.creeps(-2.0)), *_BACK, expected=_OFF, held_mm=2.0,
                why="found again as soon as the motor holds: twice within 1 mm, since an operator has armed it again"),
    _afterwards("runs_reset_tension", "the motor pays out 5 mm/s by itself; RESET, ARM, TENSION",
                (0.0, in_device.runs_away(-5.0)), *_BACK, expected=_OFF, band_n=15.0),
    _afterwards("encoder_drifts_reset_tension", "position and speed drift by 1 mm/s; RESET, ARM, TENSION",
                (0.0, both(reads(STROKE, drift_s=1.0), reads(SPEED, plus=1.0))), *_BACK,
                expected={Mode.HOLD: Reaction.DRIVE_OFF}),
    _afterwards("cell_silent_reset", "the cell's samples stop; RESET", (0.0, _STALE), _RESETS,
                why="refused while it is silent"),
    _afterwards("late_reset_tension_creeps",
                "the loop is 0.3 s late; RESET, ARM, TENSION; then the motor creeps",
                *_LATE, (_SECOND_S, in_device.creeps(-2.0)), expected={Mode.COMPENSATING: Reaction.DRIVE_OFF}),
    _afterwards("late_reset_tension_cell_silent",
                "the loop is 0.3 s late; RESET, ARM, TENSION; then the cell's samples stop",
                *_LATE, (_SECOND_S, _STALE), expected={Mode.COMPENSATING: Reaction.HELD}),
)  # fmt: skip
INSIDE = tuple(_inside())
