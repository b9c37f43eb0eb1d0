"""What the answer to a command depends on, beside the mode: as values, and as the slot that the loop publishes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

from rigctl.ipc.record import SITUATION
from rigctl.model.states import Witness


@dataclass(frozen=True)
class Situation:
    """Values that the answer to a command depends on, beside the mode."""

    failed_checks: int = 0  # preflight, bits of checks.Check; those that are only waited for are left out
    causes: int = 0  # of a fault that keep it from being reset, bits, see `Fault.bit`
    stop_running: bool = False  # the drive is still stopping, or its brake is closing
    fault: int = 0  # that is latched
    armed: bool = False  # by ARM, and neither disarmed nor taken off power since
    carried_s: float = 0.0  # the motor carries the load for so long because the brake does not; 0: it does not
    e_stop: bool = False  # pressed
    brake_fails: bool = False  # the brake is known not to hold, see rigctl.control.load.brake_flag
    strays: bool = False  # the motor that carried did not follow its command, by the tension
    apart_mm: float = 0.0  # encoder and tension differ so much in the motion of the load on the closed brake
    sunk_mm: float = 0.0  # by ARMs alone, since the load was last moved on purpose
    no_brake: bool = False  # the rig file has none, see cylinder.brake_waiver
    needed_n: float = 0.0  # on the rope for a test of a brake that is known not to hold; 0: there is so much
    at_rest: bool = False  # the stroke has stood still
    room_mm: float = math.nan  # how far the cylinder may pay out
    drive_faulted: bool = False
    drive_unfit: bool = False  # by a fault of feedback, brake or power stage
    slack: bool = False
    slack_doubted: bool = False  # by another witness of the load than the cell
    unloaded: bool = False  # the cell reads no more than a tare may take away
    moves: int = 0  # highest number of a move; 0: nothing is learnt
    stroke_mm: float = math.nan  # NaN: unknown now
    target_min_n: float = 0.0
    target_max_n: float = 0.0
    witness: int = Witness.BOTH  # of a CARRY or LOWER whose operator names none
    # What is under way
    ends: bool = False  # the process
    silent: bool = False  # nothing is sent to the drive
    left_alone: bool = False  # for as long as a drive takes that stops by itself
    powered: bool = False  # the motor has the load
    pending: int = 0  # verb of a command that waits for the drive or for its read-back; 0: none
    disarming: bool = False  # a DISARM waits for the drive to be off
    tries: bool = False  # a trial is under way
    read_at_arm: bool = False  # an ARM has every supervised object read before it
    read_at_motor: bool = False  # so has what takes the load from the brake
    # Figures of the words
    speed_mm_s: float = 0.0
    drive_state: int = 0  # see rigctl.devices.objects
    reading_n: float = 0.0  # of the cell
    # Values of the command
    length_mm: float = 0.0  # of a RELEASE: how far a slack rope is paid out; 0: a ramp to slack
    by: float = 0.0  # of a CARRY or LOWER: the witness that the operator names
    wanted_n: float = 0.0  # target of a TARGET
    measured_mm: float = 0.0  # stroke of a CONFIRM_STROKE
    needs_tight: bool = False  # of an IDENTIFY
    regulated: float = math.nan  # of a RESPONSE: 1 only while COMPENSATING, 0 only in HOLD, NaN in either
    carry_s: float = math.nan  # of a CARRY: how long
    move: float = 0.0  # number of a MOVE

    @property
    def slack_by_all(self) -> bool:
        """The rope is slack, and with a brake that does not hold nothing but the cell says otherwise."""
        return self.slack and not (self.brake_fails and self.slack_doubted)

    def given(self, values: Mapping[str, float]) -> Situation:
        """The same for a command with these values, by the names of `rigctl.model.verbs.VALUES`; NaN: not given."""
        known = {
            _OF_VALUE[name]: value for name, value in values.items() if name in _OF_VALUE and not math.isnan(value)
        }
        return replace(self, **known) if known else self  # type: ignore[arg-type]


_OF_VALUE = {
    "length_mm": "length_mm", "by": "by", "target_n": "wanted_n", "stroke_mm": "measured_mm", "tight": "needs_tight",
    "regulated": "regulated", "carry_s": "carry_s", "move": "move",
}  # fmt: skip
_SLOTTED = tuple(field.name for field in SITUATION.fields if field.name not in ("t_ns", "mode"))
_IN_ORDER = attrgetter(*_SLOTTED)


def slot_values(t_ns: int, mode: int, situation: Situation) -> tuple[Any, ...]:
    """The values of a ``SITUATION`` slot."""
    return t_ns, mode, *_IN_ORDER(situation)


def of_slot(slot: Any) -> Situation:
    """The situation in a ``SITUATION`` slot."""
    return Situation(**{name: slot[name].item() for name in _SLOTTED})
