"""The rig's mode and its state: arming, the latched fault, the power wanted of the drive.

The machine takes events and commands and returns results as values; it sends and writes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from rigctl.control import modes
from rigctl.control.faults import Fault, Trait, bits_of, having
from rigctl.control.modes import Event, Mode, Refusal, Verb
from rigctl.control.safety import Action, Trip
from rigctl.control.situation import Situation
from rigctl.devices.drive import Power

ARM_LIMIT_NS = 2_000_000_000
"""Time a drive has to become enabled: by ARM, and when the motor takes the load back from the brake."""
LOWERED_NS = 600_000_000_000  # a HOLD during LOWER is carried by the motor for so long, as is a parking undone
SLIP_BITS = bits_of(having(Trait.MOTOR_MAY_CARRY))
CUT_AFTER_NS = 60_000_000  # the power of a drive that has not stopped by then is cut while it moves
OFF_LIMIT_NS = 3_000_000_000
"""Time a drive has to stop, to close its brake and to go off after a DISARM."""
DRIVE_RESET_NS = 1_000_000_000
"""Time a drive has to leave its fault state after a RESET."""
RESET_WORD_NS = 25_000_000
"""How long each of the two words of a fault reset is sent: drives read their controlword each 1 to 16 ms."""
SUPERVISED_NS = 2_000_000_000
"""Time for a drive left to itself to miss heartbeat or command (1 s at most), to stop and to close its brake."""


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


class PendingCommand(NamedTuple):
    """An accepted command that waits for the drive, and its event once the drive is enabled.

    ``id`` is None where no operator has given it: it has no answer.
    """

    id: int | None
    verb: Verb
    event: Event | None
    carry_ns: int = 0


class Outcome(NamedTuple):
    """What the machine has done: changes of mode and answers, in order."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()

    def then(self, later: Outcome) -> Outcome:
        """This and what was done later."""
        return Outcome(self.changes + later.changes, self.answers + later.answers)


NOTHING = Outcome()


class Machine:
    """Starts in DISARMED. `outcome` gives what it has done since the last call.

    ``action``: reaction to the latched fault; it may grow stronger while the fault is latched, and weaker only by CARRY
    and LOWER. ``armed``: by ARM, and neither disarmed nor taken off power since, so that a reset leads to HOLD; what
    took the power off asks for a whole arming, with its brake test.
    """

    def __init__(self, cut_after_ns: int = CUT_AFTER_NS) -> None:
        """``cut_after_ns``: time a drive has to stop before its power is cut."""
        self.mode = Mode.DISARMED
        self.fault = Fault.NONE
        self.action = Action.HOLD
        self._cut_after_ns, self._cut_at_ns = cut_after_ns, 0
        self.stopping = False
        self.armed = False
        self.awaiting = False
        """An accepted command waits for the sequence of `rigctl.control.arming`, before the drive's power."""
        self.carry_until_ns = 0
        """In FAULT the motor holds until then and then lowers the load, because the brake does not hold; 0: no."""
        self.starts_anew = False
        """A reset of the silence is accepted: the loop ends, and start-up brings all devices up again."""
        self._silent_at_ns = 0
        self._changes: list[Change] = []
        self._answers: list[Answer] = []
        self._pending: PendingCommand | None = None
        self._pending_until = 0
        self.drive_wanted = False
        """The motor carries the load, so the drive has to be enabled."""
        self._trial: tuple[int, Verb] | None = None
        self._disarming: tuple[int, int] | None = None

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
    def disarming(self) -> bool:
        """An accepted DISARM waits for the drive to be off, its brake closed."""
        return self._disarming is not None

    @property
    def arming(self) -> bool:
        """An accepted ARM waits for the drive."""
        return self._pending is not None and self._pending.verb is Verb.ARM

    @property
    def pending(self) -> Verb | None:
        """An accepted command that waits for the drive."""
        return None if self._pending is None else self._pending.verb

    @property
    def taking(self) -> bool:
        """The drive is commanded on, so that the motor takes the load from the brake."""
        return self._pending is not None and not (self.awaiting or self.resetting)

    @property
    def resetting(self) -> bool:
        """An accepted RESET waits for the drive to leave its fault state; the fault stays latched until then."""
        return self._pending is not None and self._pending.verb is Verb.RESET

    @property
    def carries(self) -> bool:
        """The motor carries or lowers a load that the brake does not hold, or is being switched on to."""
        return self.carry_until_ns > 0 or (self._pending is not None and self._pending.verb in modes.CARRIES)

    @property
    def watched_mode(self) -> Mode:
        """The mode whose rows of the safety table apply: an arming drive is watched as in HOLD."""
        return Mode.HOLD if self.mode is Mode.DISARMED and self.taking else self.mode

    @property
    def silent(self) -> bool:
        """Nothing is sent to the drive any more, until start-up has brought it up again."""
        return self.action is Action.SILENCE and self.fault is not Fault.NONE

    def power(self, t_ns: int, *, drive_enabled: bool, drive_faulted: bool) -> Power:
        """Power to command now. Only arming and taking the load back switch it on; one that dropped out stays off."""
        if drive_faulted and (self.resetting or (self.taking and self.carries)):
            edges = (self._pending_until - t_ns) // RESET_WORD_NS
            return Power.RESET if edges % 2 == 0 else Power.RESET_LOW
        if self.taking:
            return Power.ON
        if self.mode is Mode.FAULT and self.action >= Action.QUICK_STOP:
            cut = self.action is Action.POWER_OFF and t_ns >= self._cut_at_ns
            return Power.CUT if cut else Power.QUICK_STOP
        return Power.ON if self.drive_wanted and drive_enabled else Power.OFF

    def park(self, *, went_off: bool = False) -> None:
        """The brake takes the load: the drive stops, closes it and goes off; the mode stays.

        ``went_off``: the drive has done so by itself, unasked.
        """
        self.armed &= not went_off
        if self.trial in modes.NEEDS_MOTOR:  # a tare or a calibration only reads, and goes on
            self.end_trial(Refusal.ABORTED)
        self.drive_wanted, self.carry_until_ns = False, 0

    def undo_parking(self, trip: Trip, t_ns: int) -> bool:
        """The brake slips at once: the motor takes the load back, as by CARRY, with a fault latched.

        Returns whether it does: not where the power was taken off or the rig disarmed, or a command is on its way.
        """
        stopped = self.fault is not Fault.NONE and self.action > Action.HOLD
        parked = self.armed and not self.drive_wanted and self.mode.parks
        tests = self.awaiting and self.pending is Verb.BRAKE_TEST
        if not parked or stopped or self.stopping or (self._pending is not None and not tests):
            return False
        self._finish_pending(Refusal.BRAKE_SLIPPED)
        self.trip(trip, t_ns)
        self._pending = PendingCommand(None, Verb.CARRY, None, LOWERED_NS)
        self._pending_until = t_ns + ARM_LIMIT_NS
        return True

    def on(self, event: Event) -> None:
        """Take an event of the rig itself; SLACK with a fault latched is the end of a ramp down, and goes to FAULT."""
        if event is Event.SLACK and self.fault is not Fault.NONE:
            self.carry_until_ns = 0
            event = Event.RAMP_ENDS
        self._go(event)

    def trip(self, trip: Trip, t_ns: int, *, slack: bool = True) -> bool:
        """Latch the first fault and take the strongest action; returns whether this trip changes anything.

        A drive under power holds, except after a quick stop or power off. A ramp down needs a tight rope (not
        ``slack``) on the motor, in a mode that moves or may move; elsewhere it becomes a hold, and a hold ends it.
        """
        if trip.fault.bit & SLIP_BITS and self.taking and self.mode is Mode.FAULT:
            return False  # the motor takes the load because the brake slips
        ramps = trip.action is Action.RAMP_DOWN and not slack and self.mode.may_move and self.drive_wanted
        action = trip.action if ramps else max(trip.action, Action.HOLD)
        if trip.at_once and self.action is Action.POWER_OFF:
            self._cut_at_ns = min(self._cut_at_ns, t_ns)
        if self.fault is not Fault.NONE and action <= self.action:
            return False
        if self.fault is Fault.NONE:
            self.fault = trip.fault
        if action >= Action.QUICK_STOP > self.action:  # a quick stop under way keeps its deadline
            self.drive_wanted = self.armed = False
            self._cut_at_ns = t_ns + self._cut_after_ns
        if trip.at_once:
            self._cut_at_ns = t_ns
        if action is Action.SILENCE:
            self._silent_at_ns = t_ns
        self.action, self.carry_until_ns = action, 0
        self._go(Event.RAMP_DOWN if ramps else Event.TRIP)
        self._finish_pending(Refusal.PREFLIGHT if self.arming else Refusal.ABORTED)
        self.end_trial(Refusal.ABORTED)
        return True

    def under_way(self, situation: Situation, t_ns: int) -> Situation:
        """A situation with what is under way here."""
        return replace(
            situation,
            ends=self.stopping,
            silent=self.silent,
            left_alone=t_ns - self._silent_at_ns >= SUPERVISED_NS,
            powered=self.drive_wanted,
            pending=situation.pending if self._pending is None else self._pending.verb,
            disarming=self.disarming,
            tries=self._trial is not None,
        )

    def command(self, id_: int, verb: Verb, situation: Situation, t_ns: int) -> Refusal | None:
        """Take an operator's command; returns its refusal, None if the answer comes later (ARM waits for the drive).

        A command that is refused touches nothing that is under way.
        """
        decision = modes.answer(self.mode, verb, self.under_way(situation, t_ns))
        if decision.refusal is not Refusal.NONE:
            return self._answer(id_, verb, decision.refusal)
        if verb is Verb.RESET and self.silent:
            self.starts_anew = True
            return self._answer(id_, verb, Refusal.NONE)
        self._end_others(verb)
        if decision.ends:
            return self._answer(id_, verb, Refusal.NONE)
        carry_ns = round(situation.carry_s * 1e9) if verb is Verb.CARRY else 0
        if verb is Verb.BRAKE_TEST:
            self.park()
        if verb is Verb.ARM or (verb in modes.NEEDS_MOTOR and not self.drive_wanted):
            event = Event.ENABLED if verb is Verb.ARM else decision.event
            self._pending = PendingCommand(id_, verb, event, carry_ns)
            self._pending_until = t_ns + ARM_LIMIT_NS
            return None
        if verb is Verb.RESET and situation.drive_faulted:
            self._pending = PendingCommand(id_, verb, decision.event)
            self._pending_until = t_ns + DRIVE_RESET_NS
            return None
        if verb in modes.TRIED_IN:
            self._trial = (id_, verb)
            return None
        self._accept(verb, decision.event, t_ns, carry_ns)
        if verb is Verb.DISARM:
            self._disarming = id_, t_ns + OFF_LIMIT_NS
            return None
        return self._answer(id_, verb, Refusal.NONE)

    def _end_others(self, verb: Verb) -> None:
        """End what is under way and gives way to an accepted command."""
        self.end_trial(Refusal.ABORTED)
        if verb not in modes.WHILE_DISARMING:
            self._end_disarming(Refusal.ABORTED)
        if verb in modes.ENDS_PENDING:
            self._finish_pending(Refusal.ABORTED)

    def _answer(self, id_: int | None, verb: Verb, refusal: Refusal) -> Refusal:
        """Answer a command; one that no operator has given, ``id_`` None, has no answer."""
        if id_ is not None:
            self._answers.append(Answer(id_, verb, refusal))
        return refusal

    def follow_drive(
        self, drive_enabled: bool, t_ns: int, *, drive_faulted: bool = False, cause_present: bool = False
    ) -> bool:
        """Carry out the command that waits for the drive once its state is there, or give up after its time.

        ``cause_present``: a cause that keeps a fault from being reset, which may begin while a RESET waits. Returns
        True if a drive has not followed a RESET: then the latched fault is DRIVE_FAULT.
        """
        pending = self._pending
        if pending is None or self.awaiting:
            return False
        if self.resetting:
            if cause_present:
                self._finish_pending(Refusal.CAUSE_PRESENT)
            elif not drive_faulted:
                self._pending = None
                self._accept(Verb.RESET, pending.event, t_ns, 0)
                self._answer(pending.id, Verb.RESET, Refusal.NONE)
            elif t_ns >= self._pending_until:
                self._finish_pending(Refusal.DRIVE_STATE)
                self.fault = Fault.DRIVE_FAULT
                self._go(Event.TRIP)
                return True
            return False
        if not drive_enabled:
            if drive_faulted and t_ns >= self._pending_until - ARM_LIMIT_NS + DRIVE_RESET_NS and self.carries:
                self._finish_pending(Refusal.DRIVE_STATE)
            elif t_ns >= self._pending_until:
                self._finish_pending(Refusal.DRIVE_TIMEOUT)
                if self.mode is Mode.FAULT:  # whatever the drive does now, its brake has to close
                    self.action, self._cut_at_ns = Action.POWER_OFF, t_ns + self._cut_after_ns
            return False
        self.drive_wanted, self._pending = True, None
        if pending.verb in modes.TRIED_IN and pending.id is not None:
            self._trial = pending.id, pending.verb
            return False
        self._accept(pending.verb, pending.event, t_ns, pending.carry_ns)
        self._answer(pending.id, pending.verb, Refusal.NONE)
        return False

    def follow_off(self, t_ns: int, *, off: bool) -> None:
        """Answer the DISARM once the drive is ``off``, its brake closed, or after its time."""
        if self._disarming is not None and (off or t_ns >= self._disarming[1]):
            self._end_disarming(Refusal.NONE if off else Refusal.OFF_UNSEEN)

    def _end_disarming(self, refusal: Refusal) -> None:
        if self._disarming is not None:
            self._answers.append(Answer(self._disarming[0], Verb.DISARM, refusal))
            self._disarming = None

    def await_sequence(self) -> None:
        """The command that waits for the drive waits for the sequence before its power first."""
        self.awaiting = True

    def switch_on(self, t_ns: int) -> None:
        """The sequence before it is complete: the drive may have its power."""
        self.awaiting, self._pending_until = False, t_ns + ARM_LIMIT_NS
        if self.mode is Mode.FAULT:
            self.action = Action.HOLD

    def refuse_pending(self, refusal: Refusal) -> None:
        """Refuse the command that waits for the drive."""
        self._finish_pending(refusal)

    def end_trial(self, refusal: Refusal) -> None:
        """Answer the trial under way, if there is one."""
        if self._trial is not None:
            self._answers.append(Answer(*self._trial, refusal))
            self._trial = None

    def lower(self, t_ns: int) -> None:
        """The time of a CARRY is over: the motor lowers the load, since the brake would not hold it."""
        self._accept(Verb.LOWER, Event.LOWER, t_ns, 0)

    def stop(self) -> None:
        """The process ends: hold the stroke and take no more commands."""
        if not self.stopping:
            self.stopping, self.carry_until_ns = True, 0
            self.end_trial(Refusal.ABORTED)
            self._finish_pending(Refusal.STOPPING)
            self._end_disarming(Refusal.STOPPING)
            self._go(Event.STOP if self.fault is Fault.NONE else Event.RAMP_ENDS)

    def power_off(self) -> None:
        """Let the drive close its brake and go off, in any mode, as the last act of a stop."""
        self.drive_wanted = False

    def carry_back(self, t_ns: int) -> None:
        """The brake does not hold the load that it has been tested with: the motor takes it, as by CARRY."""
        self._pending = PendingCommand(None, Verb.CARRY, None, LOWERED_NS)
        self._pending_until, self.awaiting = t_ns + ARM_LIMIT_NS, False
        self.action = Action.HOLD

    def _accept(self, verb: Verb, event: Event | None, t_ns: int, carry_ns: int) -> None:
        match verb:
            case Verb.RESET:
                self.fault, self.action, self._cut_at_ns = Fault.NONE, Action.HOLD, 0
            case Verb.DISARM:
                self.drive_wanted = self.armed = False
                self.carry_until_ns = 0
            case Verb.CARRY:
                self.action, self.carry_until_ns = Action.HOLD, t_ns + carry_ns
            case Verb.LOWER | Verb.RELEASE if self.fault is not Fault.NONE:  # the motor carries the load
                self.action, self.carry_until_ns = Action.RAMP_DOWN, max(self.carry_until_ns, t_ns + LOWERED_NS)
        if event is not None:
            self._go(event)

    def _go(self, event: Event) -> None:
        before = self.mode
        after = modes.next_mode(before, event)
        if after is before:
            return
        self.mode = after
        self.end_trial(Refusal.ABORTED)
        if event is Event.ENABLED:
            self.drive_wanted = self.armed = True
        elif after is Mode.DISARMED:
            self.drive_wanted = self.armed = False
        self._changes.append(Change(before, after, event))

    def _finish_pending(self, refusal: Refusal) -> None:
        if self._pending is not None:
            self._answer(self._pending.id, self._pending.verb, refusal)
            self._pending, self.awaiting = None, False
