"""What the loop does for a command beside the machine's stages and modes, and the figure that its answer is about.

A verb with an action of its own is a class here; every other has `CommandAction`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from rigctl.control.commands.command_checks import CommandChecks
from rigctl.control.commands.situation import Situation
from rigctl.control.law.move_learning import MoveLearning
from rigctl.control.law.tension import TensionLaw
from rigctl.control.load.brake_flag import BrakeFlag
from rigctl.control.load.carried_load import CarriedLoad
from rigctl.control.load.homed import Homed
from rigctl.control.logbook import Logbook
from rigctl.control.observer import Observer
from rigctl.control.power.machine import Answer, Machine
from rigctl.control.watch.safety import Trip, Watch
from rigctl.devices.objects import drive_state
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import TRIED_IN, Refusal, Verb

Figures = dict[str, float]
"""By the names of their fields in the reply's slot."""
KNOWN_TEXT = " and is known not to hold, the motor has the load"


class ActedOn(NamedTuple):
    """The parts of the loop that a command acts on, or that its answer is about."""

    machine: Machine
    observer: Observer
    law: TensionLaw
    watch: Watch
    logbook: Logbook
    homed: Homed
    learning: MoveLearning | None
    brake: BrakeFlag
    carried: CarriedLoad
    checks: CommandChecks

    def trip_slip(self, t_ns: int) -> None:
        """Latch BRAKE_SLIPS for a load that the motor has because the brake is known not to hold."""
        trip = Trip(Fault.BRAKE_SLIPS, 0.0, 0.0, Action.HOLD, KNOWN_TEXT)
        if self.machine.trip(trip, t_ns):
            self.logbook.trip(t_ns, Kind.TRIP, trip)

    def begin_carrying(self, by: Witness, t_ns: int) -> None:
        """The motor is to carry or lower the load by a witness; outside FAULT BRAKE_SLIPS is latched first."""
        self.carried.begin(by, self.watch.standing, self.observer.snapshot)
        if self.machine.mode is not Mode.FAULT:
            self.trip_slip(t_ns)


class CommandAction:
    """Of a command that the machine alone carries out; its answer shows the tension."""

    def before(self, on: ActedOn, verb: Verb, situation: Situation, t_ns: int) -> None:
        """What goes before the machine's own, which may refuse it still."""

    def begin(self, on: ActedOn, values: Figures, t_ns: int) -> None:
        """What a command does that is carried out at once."""

    def figures(self, on: ActedOn, _given: Answer, _t_ns: int) -> Figures:
        """What the answer is about."""
        return {"tension_n": on.observer.tension_n}


class _TensionAction(CommandAction):
    def figures(self, on: ActedOn, _given: Answer, _t_ns: int) -> Figures:
        return {"target_n": on.law.target_n}


class _TargetAction(_TensionAction):
    def begin(self, on: ActedOn, values: Figures, _t_ns: int) -> None:
        on.law.aim(values["target_n"])


class _MoveAction(CommandAction):
    def begin(self, on: ActedOn, values: Figures, t_ns: int) -> None:
        if on.learning is not None:
            tangential_rad, _, normal_rad, _ = on.observer.inclination.state
            on.learning.begin(int(values["move"]), on.observer.snapshot.stroke_mm, tangential_rad, normal_rad)
            on.logbook.event(t_ns, Kind.MOVE, int(values["move"]), on.learning.taught)

    def figures(self, on: ActedOn, given: Answer, t_ns: int) -> Figures:
        return super().figures(on, given, t_ns) if on.learning is None else {"taught": float(on.learning.taught)}


class _ConfirmStrokeAction(CommandAction):
    def begin(self, on: ActedOn, _values: Figures, t_ns: int) -> None:
        on.logbook.stroke(t_ns, on.homed.confirm(on.observer.snapshot.stroke_mm))

    def figures(self, on: ActedOn, _given: Answer, _t_ns: int) -> Figures:
        return {"stroke_mm": on.observer.snapshot.stroke_mm}


class _CarryAction(CommandAction):
    def before(self, on: ActedOn, verb: Verb, situation: Situation, t_ns: int) -> None:
        by = Witness(int(situation.by))
        if by is not Witness.BOTH:
            on.logbook.event(t_ns, Kind.WITNESS, by, text=verb.name.encode())
        on.begin_carrying(by, t_ns)

    def figures(self, on: ActedOn, _given: Answer, t_ns: int) -> Figures:
        return {"carried_s": max(0, on.machine.sequence.carry_until_ns - t_ns) * 1e-9}


class _BrakeTestAction(CommandAction):
    def figures(self, on: ActedOn, given: Answer, t_ns: int) -> Figures:
        done = given.refusal is Refusal.NONE
        return {"tension_n": given.command.test.tension_n} if done else super().figures(on, given, t_ns)


class _TrialAction(CommandAction):
    def figures(self, on: ActedOn, given: Answer, t_ns: int) -> Figures:
        done = given.refusal is Refusal.NONE
        return dict(given.command.found) if done else super().figures(on, given, t_ns)


_PLAIN, _CARRY = CommandAction(), _CarryAction()
ACTIONS: dict[Verb, CommandAction] = {
    **dict.fromkeys(Verb, _PLAIN),
    **dict.fromkeys(TRIED_IN, _TrialAction()),
    Verb.TENSION: _TensionAction(),
    Verb.TARGET: _TargetAction(),
    Verb.MOVE: _MoveAction(),
    Verb.CONFIRM_STROKE: _ConfirmStrokeAction(),
    Verb.CARRY: _CARRY,
    Verb.LOWER: _CARRY,
    Verb.BRAKE_TEST: _BrakeTestAction(),
}


def _of_drive_state(on: ActedOn, _given: Answer, _t_ns: int) -> Figures:
    return {"drive_state": float(drive_state(on.observer.inbox.drive.statusword))}


OF_REFUSAL: dict[Refusal, Callable[[ActedOn, Answer, int], Figures]] = {
    Refusal.PREFLIGHT: _PLAIN.figures,
    Refusal.CAUSE_PRESENT: lambda on, _given, _t_ns: {"cause": float(on.watch.present(on.observer.snapshot))},
    Refusal.SUNK: lambda on, _given, _t_ns: {"moved_mm": on.checks.sunk_mm},
    Refusal.DISAGREE: lambda on, _given, _t_ns: {"apart_mm": on.observer.snapshot.sinking.apart_mm},
    Refusal.CARRIED: _CARRY.figures,
    Refusal.LOADED: lambda on, _given, _t_ns: {"reading_n": on.observer.inbox.cell.reading_n},
    Refusal.BRAKE_SLIPPED: lambda _on, given, _t_ns: {"moved_mm": given.command.test.moved_mm},
    Refusal.LITTLE_LOAD: lambda on, _given, _t_ns: {"needed_n": on.brake.wanted_n},
    Refusal.STOP_RUNNING: lambda on, _given, _t_ns: {"speed_mm_s": on.observer.inbox.drive.speed_mm_s},
    Refusal.DRIVE_STATE: _of_drive_state,
    Refusal.DRIVE_TIMEOUT: _of_drive_state,
    Refusal.OFF_UNSEEN: _of_drive_state,
}
"""What an answer is about, whatever the verb. All other refusals show the verb's own figure."""


def figures(on: ActedOn, given: Answer, t_ns: int) -> Figures:
    """What an answer is about."""
    about = OF_REFUSAL.get(given.refusal) or ACTIONS[given.verb].figures
    return about(on, given, t_ns)
