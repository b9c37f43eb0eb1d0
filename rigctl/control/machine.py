"""The rig's mode and its state: arming, the latched fault, the power wanted of the drive.

The machine takes events and commands and returns results as values; it sends and writes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from rigctl.control import modes
from rigctl.control.faults import Fault
from rigctl.control.modes import Event, Mode, Refusal, Situation, Verb
from rigctl.control.safety import Action, Trip
from rigctl.devices.drive import Power

ARM_LIMIT_NS = 2_000_000_000
_MAY_MOVE = frozenset({Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING})
CUT_AFTER_NS = 60_000_000  # the power of a drive that has not stopped by then is cut while it moves
DRIVE_RESET_NS = 500_000_000


@dataclass(frozen=True)
class Change:
    """A change of mode and the event behind it."""

    before: Mode
    after: Mode
    event: Event


@dataclass(frozen=True)
class Answer:
    """Answer to the command ``id``."""

    id: int
    verb: Verb
    refusal: Refusal


class Outcome(NamedTuple):
    """What the machine has done: changes of mode and answers, in order."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()

    def then(self, later: Outcome) -> Outcome:
        """This and what was done later."""
        return self if later is NOTHING else Outcome(self.changes + later.changes, self.answers + later.answers)


NOTHING = Outcome()


class Machine:
    """Starts in DISARMED. `outcome` gives what it has done since the last call.

    ``action``: reaction to the latched fault; it may grow stronger while the fault is latched, never weaker.
    """

    def __init__(self, cut_after_ns: int = CUT_AFTER_NS) -> None:
        """``cut_after_ns``: time a drive has to stop before its power is cut."""
        self.mode = Mode.DISARMED
        self.fault = Fault.NONE
        self.action = Action.HOLD
        self._cut_after_ns, self._cut_at_ns = cut_after_ns, 0
        self.stopping = False
        self.awaiting = False
        """An accepted ARM waits for the sequence of `rigctl.control.arming`, before the drive's power."""
        self._changes: list[Change] = []
        self._answers: list[Answer] = []
        self._arm_id: int | None = None
        self._arm_until = 0
        self._reset_until = 0
        self._powered = False
        self._trial: tuple[int, Verb] | None = None

    def outcome(self) -> Outcome:
        """Changes of mode and answers since the last call."""
        if not (self._changes or self._answers):
            return NOTHING
        done = Outcome(tuple(self._changes), tuple(self._answers))
        self._changes.clear()
        self._answers.clear()
        return done

    @property
    def trial(self) -> Verb | None:
        """The trial under way; its runner calls ``end_trial``."""
        return None if self._trial is None else self._trial[1]

    @property
    def arming(self) -> bool:
        """An accepted ARM waits for the drive."""
        return self._arm_id is not None

    def power(self, t_ns: int, *, drive_enabled: bool, drive_faulted: bool) -> Power:
        """Power to command now. Only arming switches the drive on; a drive that has dropped out stays off."""
        if drive_faulted and t_ns < self._reset_until:
            return Power.RESET
        if self.mode is Mode.FAULT and self.action >= Action.QUICK_STOP:
            cut = self.action is Action.POWER_OFF and t_ns >= self._cut_at_ns
            return Power.CUT if cut else Power.QUICK_STOP
        on = (self.arming and not self.awaiting) or (self._powered and drive_enabled)
        return Power.ON if on else Power.OFF

    @property
    def drive_wanted(self) -> bool:
        """The mode needs the drive to be enabled."""
        return self._powered

    def on(self, event: Event) -> None:
        """Take an event of the rig itself; SLACK with a fault latched is the end of a ramp down, and goes to FAULT."""
        self._go(Event.TRIP if event is Event.SLACK and self.fault is not Fault.NONE else event)

    def trip(self, trip: Trip, t_ns: int, *, slack: bool = True) -> bool:
        """Latch the first fault and take the strongest action; returns whether this trip changes anything.

        A drive under power holds, except after a quick stop or power off. A ramp down needs a tight rope (not
        ``slack``) in a mode that moves or may move; elsewhere it becomes a hold, and a hold ends it.
        """
        ramps = trip.action is Action.RAMP_DOWN and not slack and self.mode in _MAY_MOVE
        action = trip.action if ramps else max(trip.action, Action.HOLD)
        if self.fault is not Fault.NONE and action <= self.action:
            return False
        if self.fault is Fault.NONE:
            self.fault = trip.fault
        if action >= Action.QUICK_STOP > self.action:  # a quick stop under way keeps its deadline
            self._powered = False
            self._cut_at_ns = t_ns + self._cut_after_ns
        self.action = action
        self._go(Event.RAMP_DOWN if ramps else Event.TRIP)
        self._finish_arming(Refusal.PREFLIGHT)
        self.end_trial(Refusal.ABORTED)
        return True

    def command(self, id_: int, verb: Verb, situation: Situation, t_ns: int) -> Refusal | None:
        """Take an operator's command; returns its refusal, None if the answer comes later (ARM waits for the drive)."""
        self.end_trial(Refusal.ABORTED)
        if self.stopping:
            return self._answer(id_, verb, Refusal.STOPPING)
        if verb in modes.TRIED_IN and self.arming:
            return self._answer(id_, verb, Refusal.WRONG_MODE)
        if verb in (Verb.DISARM, Verb.HOLD) and self.arming:  # the load stays on the brake
            self._finish_arming(Refusal.ABORTED)
            return self._answer(id_, verb, Refusal.NONE)
        if verb is Verb.ARM and self.arming:
            return self._answer(id_, verb, Refusal.ALREADY)
        decision = modes.decide(self.mode, verb, situation)
        if decision.refusal is Refusal.NONE and verb is Verb.ARM:
            self._arm_id, self._arm_until = id_, t_ns + ARM_LIMIT_NS
            return None
        if decision.refusal is Refusal.NONE and verb in modes.TRIED_IN:
            self._trial = (id_, verb)
            return None
        if decision.refusal is Refusal.NONE:
            self._accept(verb, decision.event, t_ns)
        return self._answer(id_, verb, decision.refusal)

    def _answer(self, id_: int, verb: Verb, refusal: Refusal) -> Refusal:
        self._answers.append(Answer(id_, verb, refusal))
        return refusal

    def follow_drive(self, drive_enabled: bool, t_ns: int) -> None:
        """Finish arming once the drive is enabled, or give up."""
        if self._arm_id is None or self.awaiting:
            return
        if drive_enabled:
            self._go(Event.ENABLED)
            self._finish_arming(Refusal.NONE)
        elif t_ns >= self._arm_until:
            self._finish_arming(Refusal.DRIVE_TIMEOUT)

    def switch_on(self, t_ns: int) -> None:
        """The sequence of the accepted ARM is complete: the drive may have its power."""
        self.awaiting, self._arm_until = False, t_ns + ARM_LIMIT_NS

    def refuse_arming(self, refusal: Refusal) -> None:
        """Refuse the ARM under way."""
        self._finish_arming(refusal)

    def end_trial(self, refusal: Refusal) -> None:
        """Answer the trial under way, if there is one."""
        if self._trial is not None:
            self._answers.append(Answer(*self._trial, refusal))
            self._trial = None

    def stop(self) -> None:
        """The process ends: hold the stroke and take no more commands."""
        if not self.stopping:
            self.stopping = True
            self.end_trial(Refusal.ABORTED)
            self._finish_arming(Refusal.STOPPING)
            self._go(Event.STOP if self.fault is Fault.NONE else Event.TRIP)

    def power_off(self) -> None:
        """Let the drive close its brake and go off, in any mode, as the last act of a stop."""
        self._powered = False

    def _accept(self, verb: Verb, event: Event | None, t_ns: int) -> None:
        if verb is Verb.RESET:
            self._reset_until = t_ns + DRIVE_RESET_NS
            self.fault, self.action, self._cut_at_ns = Fault.NONE, Action.HOLD, 0
        if verb is Verb.DISARM:
            self._powered = False
        if event is not None:
            self._go(event)

    def _go(self, event: Event) -> None:
        before = self.mode
        after = modes.next_mode(before, event)
        if after is before:
            return
        self.mode = after
        self.end_trial(Refusal.ABORTED)
        if after is Mode.DISARMED:
            self._powered = False
        elif after is not Mode.FAULT:
            self._powered = True
        self._changes.append(Change(before, after, event))

    def _finish_arming(self, refusal: Refusal) -> None:
        if self._arm_id is not None:
            self._answers.append(Answer(self._arm_id, Verb.ARM, refusal))
            self._arm_id, self.awaiting = None, False
