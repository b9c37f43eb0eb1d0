"""The rig's mode, the latched fault, and the sequence of drive, brake and load: what events and commands make of them.

The machine takes events and commands and returns results as values; it sends and writes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from rigctl.control import modes
from rigctl.control.commands.situation import Situation
from rigctl.control.power import arming, stage
from rigctl.control.power.arming import Preparation
from rigctl.control.power.stage import (
    CUT_AFTER_NS,
    KEPT_NS,
    NO_VALUES,
    NOT_LEFT,
    Accepted,
    Input,
    Sequence,
    StageRow,
    TickSeen,
)
from rigctl.control.watch.safety import Trip
from rigctl.devices.drive import Power
from rigctl.model.faults import Fault, Trait, bits_of, having
from rigctl.model.reactions import Action
from rigctl.model.states import Event, Mode
from rigctl.model.verbs import OFF_LIMIT_NS, TRIED_IN, Refusal, Verb

SLIP_BITS = bits_of(having(Trait.MOTOR_MAY_CARRY))
SUPERVISED_NS = 2_000_000_000
"""Time for a drive left to itself to miss heartbeat or command (1 s at most), to stop and to close its brake."""
_NO_COMMAND = Accepted(None, Verb.HOLD)
_TESTS_BRAKE = Verb.ARM, Verb.BRAKE_TEST


@dataclass(frozen=True)
class Change:
    """A change of mode and the event behind it."""

    before: Mode
    after: Mode
    event: Event


@dataclass(frozen=True)
class Answer:
    """Answer to the command ``id``; ``command``: what was known of it."""

    id: int
    verb: Verb
    refusal: Refusal
    command: Accepted = field(default=_NO_COMMAND, compare=False)


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

    ``sequence``: of drive, brake and load, with the command under way; see `rigctl.control.power.stage`.
    """

    def __init__(self, cut_after_ns: int = CUT_AFTER_NS, *, brake_test: bool = False) -> None:
        """``cut_after_ns``: time a drive has to stop before its power is cut. ``brake_test``: each ARM has one."""
        self.mode = Mode.DISARMED
        self.fault = Fault.NONE
        self.sequence = Sequence()
        self._cut_after_ns, self._brake_test = cut_after_ns, brake_test
        self._done = NOTHING

    def outcome(self) -> Outcome:
        """Changes of mode and answers since the last call."""
        done, self._done = self._done, NOTHING
        return done

    @property
    def watched_mode(self) -> Mode:
        """The mode whose rows of the safety table apply: an arming drive is watched as in HOLD."""
        return Mode.HOLD if self.mode is Mode.DISARMED and self.sequence.taking else self.mode

    def power(self, t_ns: int, *, drive_enabled: bool, drive_faulted: bool) -> Power:
        """Power to command now, see `rigctl.control.power.stage.power`."""
        self.sequence, power = stage.power(
            self.sequence, t_ns, drive_enabled=drive_enabled, drive_faulted=drive_faulted
        )
        return power

    def park(self, *, went_off: bool = False) -> None:
        """The brake takes the load: the drive stops, closes it and goes off; the mode stays.

        ``went_off``: the drive has done so by itself.
        """
        if self.sequence.trial in modes.NEEDS_MOTOR:  # a tare or a calibration only reads, and goes on
            self.end_trial(Refusal.ABORTED)
        armed = self.sequence.armed and not went_off
        self.sequence = stage.after(self.sequence, Input.PARKED, 0, armed=armed, carry_until_ns=0)

    def undo_parking(self, trip: Trip, t_ns: int) -> bool:
        """The brake slips at once: the motor takes the load back, as by CARRY, with a fault latched.

        Returns whether it does: not where the power was taken off or the rig disarmed, or a command is on its way.
        """
        at = self.sequence
        stopped = self.fault is not Fault.NONE and at.action > Action.HOLD
        parked = at.armed and not at.motor and self.mode.parks
        tests = at.preparing and at.pending is Verb.BRAKE_TEST
        if not parked or stopped or at.ends or (at.pending is not None and not tests):
            return False
        if at.command is not None:
            self.prepare(replace(at.command.test, moved_mm=trip.value))
        self.refuse_pending(Refusal.BRAKE_SLIPPED)
        self.trip(trip, t_ns)
        self.carry_back(t_ns)
        return True

    def on(self, event: Event) -> None:
        """Take an event of the rig itself; SLACK with a fault latched is the end of a ramp down, and goes to FAULT."""
        if event is Event.SLACK and self.fault is not Fault.NONE:
            self.sequence = replace(self.sequence, carry_until_ns=0)
            event = Event.RAMP_ENDS
        self._go(event)

    def trip(self, trip: Trip, t_ns: int, *, slack: bool = True) -> bool:
        """Latch the first fault and take the strongest action; returns whether this trip changes anything.

        A drive under power holds, except after a quick stop or power off. A ramp down needs a tight rope (not
        ``slack``) on the motor, in a mode that moves or may move; elsewhere it becomes a hold, and a hold ends it.
        """
        at = self.sequence
        if trip.fault.bit & SLIP_BITS and at.taking and self.mode is Mode.FAULT:
            return False  # the motor takes the load because the brake slips
        ramps = trip.action is Action.RAMP_DOWN and not slack and self.mode.may_move and at.motor
        action = trip.action if ramps else max(trip.action, Action.HOLD)
        if trip.at_once and at.action is Action.POWER_OFF and t_ns < at.cut_ns:
            self.sequence = at = replace(at, cut_ns=t_ns)
        if self.fault is not Fault.NONE and action <= at.action:
            return False
        if self.fault is Fault.NONE:
            self.fault = trip.fault
        kept_ns = at.carry_until_ns if action is Action.HOLD else 0  # from HOLD: the motor goes on
        changes: dict[str, object] = {"action": action, "carry_until_ns": kept_ns}
        if action >= Action.QUICK_STOP > at.action:  # a quick stop under way keeps its deadline
            changes |= {"armed": False, "cut_ns": t_ns + self._cut_after_ns}
        if trip.at_once:
            changes["cut_ns"] = t_ns
        self.end_trial(Refusal.ABORTED)
        self.refuse_pending(Refusal.PREFLIGHT if at.pending is Verb.ARM else Refusal.ABORTED)
        stops = Input.SILENCED if action is Action.SILENCE else Input.QUICK_STOPPED
        self.sequence = (
            stage.after(self.sequence, stops, t_ns, **changes)
            if action >= Action.QUICK_STOP
            else replace(self.sequence, **changes)  # type: ignore[arg-type]
        )
        self._go(Event.RAMP_DOWN if ramps else Event.TRIP)
        return True

    def under_way(self, situation: Situation, t_ns: int) -> Situation:
        """A situation with what is under way here."""
        at = self.sequence
        return replace(
            situation,
            ends=at.ends,
            silent=at.silent,
            left_alone=t_ns - at.since_ns >= SUPERVISED_NS,
            powered=at.motor,
            pending=situation.pending if at.pending is None else at.pending,
            disarming=at.disarming,
            tries=at.trial is not None,
        )

    def command(
        self, id_: int, verb: Verb, situation: Situation, t_ns: int, values: Mapping[str, float] = NO_VALUES,
        since_ns: int | None = None,
    ) -> Refusal | None:  # fmt: skip
        """Take an operator's command; returns its refusal, None if the answer comes later (ARM waits for the drive).

        ``since_ns``: when it came, if it has waited for the read-back. A command that is refused touches nothing that
        is under way.
        """
        command = Accepted(id_, verb, values=values, since_ns=since_ns or t_ns)
        decision = modes.answer(self.mode, verb, self.under_way(situation, t_ns))
        if decision.refusal is not Refusal.NONE:
            return self._answer(command, decision.refusal)
        if verb is Verb.RESET and self.sequence.silent:
            self.sequence = replace(self.sequence, anew=True)
            return self._answer(command, Refusal.NONE)
        self._end_others(verb)
        if decision.ends:
            return self._answer(command, Refusal.NONE)
        carry_ns = round(situation.carry_s * 1e9) if verb is Verb.CARRY else 0
        command = command._replace(event=decision.event, carry_ns=carry_ns)
        if verb is Verb.BRAKE_TEST:
            self.park()
        if verb is Verb.ARM or (verb in modes.NEEDS_MOTOR and not self.sequence.motor):
            self._begin(command, situation, t_ns)
            return None
        if verb is Verb.RESET and situation.drive_faulted:
            self.sequence = stage.after(self.sequence, Input.DRIVE_RESET, t_ns, command=command)
            return None
        if verb in TRIED_IN:
            self.sequence = replace(self.sequence, tried=command)
            return None
        self._accept(command, t_ns)
        if verb is Verb.DISARM:
            self.sequence = replace(self.sequence, command=command, until_ns=t_ns + OFF_LIMIT_NS)
            return None
        return self._answer(command, Refusal.NONE)

    def _begin(self, command: Accepted, situation: Situation, t_ns: int) -> None:
        """Begin what goes before the drive's power, for a command that needs it."""
        tests, longer = command.verb in _TESTS_BRAKE, situation.brake_fails or command.verb is Verb.BRAKE_TEST
        test = arming.begin(
            t_ns, tests=tests and (longer or self._brake_test), at_rest=self.mode is not Mode.FAULT, longer=longer
        )
        event = Event.ENABLED if command.verb is Verb.ARM else command.event
        command = command._replace(event=event, test=test)
        self.sequence = stage.after(self.sequence, Input.NEEDED, t_ns, command=command)

    def _end_others(self, verb: Verb) -> None:
        """End what is under way and gives way to an accepted command."""
        self.end_trial(Refusal.ABORTED)
        if verb not in modes.WHILE_DISARMING:
            self._end_disarming(Refusal.ABORTED)
        command = self.sequence.command
        takes_back = command is not None and command.id is None  # that the motor holds is what a HOLD wants
        if verb in modes.ENDS_PENDING and not (verb is Verb.HOLD and takes_back):
            self.refuse_pending(Refusal.ABORTED)

    def _answer(self, command: Accepted, refusal: Refusal) -> Refusal:
        """Answer a command; one that no operator has given, ``id`` None, has no answer."""
        if command.id is not None:
            answer = Answer(command.id, command.verb, refusal, command)
            self._done = self._done.then(Outcome(answers=(answer,)))
        return refusal

    def follow(self, seen: TickSeen) -> StageRow | None:
        """Do what the row of `rigctl.control.power.stage.ROWS` says that holds; returns it.

        After `NOT_LEFT` the latched fault is DRIVE_FAULT.
        """
        row, command = stage.decide(self.sequence, seen), self.sequence.command
        if row is None:
            return None
        if row.input is Input.KEPT:
            self.sequence = replace(self.sequence, carry_until_ns=seen.t_ns + KEPT_NS)
        elif row.input is Input.LOWERED:
            self.lower(seen.t_ns)
        elif row.input is Input.PARKED:
            self.park(went_off=seen.due and not seen.enabled)
        elif command is not None:
            self._end_wait(row, command, seen.t_ns)
        if row is NOT_LEFT:
            self.fault = Fault.DRIVE_FAULT
            self._go(Event.TRIP)
        return row

    def _end_wait(self, row: StageRow, command: Accepted, t_ns: int) -> None:
        changes: dict[str, object] = {}
        if row.input is Input.NOT_ENABLED:
            changes = {"action": Action.POWER_OFF, "cut_ns": t_ns + self._cut_after_ns, "armed": False}
        self.sequence = stage.after(self.sequence, row.input, t_ns, **changes)
        if row.input is Input.ENABLED and command.since_ns is not None and command.verb is not Verb.ARM:
            command = command._replace(taken_s=(t_ns - command.since_ns) * 1e-9)
        if row.answer is not Refusal.NONE and row.answer is not None:
            self._answer(command, row.answer)
        elif row.input is Input.ENABLED and command.verb in TRIED_IN and command.id is not None:
            self.sequence = replace(self.sequence, tried=command)
        elif row.input is not Input.PREPARED:
            self._accept(command, t_ns)
            self._answer(command, Refusal.NONE)

    def prepare(self, test: Preparation) -> None:
        """The state of what goes before the drive's power, for the command that waits."""
        if self.sequence.command is not None and test is not self.sequence.command.test:
            self.sequence = replace(self.sequence, command=self.sequence.command._replace(test=test))

    def follow_off(self, t_ns: int, *, off: bool) -> None:
        """The drive is seen ``off``, its brake closed, or not; that answers a DISARM, as does the end of its time."""
        self.sequence = stage.after(self.sequence, Input.SEEN_OFF if off else Input.SEEN_ON, t_ns)
        if self.sequence.disarming and (off or t_ns >= self.sequence.until_ns):
            self._end_disarming(Refusal.NONE if off else Refusal.OFF_UNSEEN)

    def _end_disarming(self, refusal: Refusal) -> None:
        if self.sequence.disarming:
            self._end_command(refusal)

    def refuse_pending(self, refusal: Refusal) -> None:
        """Refuse the command that waits for the drive."""
        if self.sequence.pending is not None:
            self._end_command(refusal)

    def end_trial(self, refusal: Refusal, found: Mapping[str, float] = NO_VALUES) -> None:
        """Answer the trial under way, if there is one, with the figures that it has found."""
        tried = self.sequence.tried
        if tried is not None:
            self.sequence = replace(self.sequence, tried=None)
            self._answer(tried._replace(found=found), refusal)

    def _end_command(self, refusal: Refusal) -> None:
        command = self.sequence.command
        self.sequence = stage.after(self.sequence, Input.WITHDRAWN, 0)
        if command is not None:
            self._answer(command, refusal)

    def lower(self, t_ns: int) -> None:
        """The motor's time is over: it lowers the load, since the brake would not hold it."""
        if self.mode is Mode.HOLD:
            self._go(Event.LOWER)
        else:
            self._accept(Accepted(None, Verb.LOWER, Event.LOWER), t_ns)

    def stop(self, until_ns: int = 0) -> None:
        """The process ends, by ``until_ns`` whatever comes: hold the stroke and take no more commands."""
        if not self.sequence.ends:
            self.end_trial(Refusal.ABORTED)
            self.refuse_pending(Refusal.STOPPING)
            self._end_disarming(Refusal.STOPPING)
            self.sequence = replace(self.sequence, ends=True, until_ns=until_ns, carry_until_ns=0)
            self._go(Event.STOP if self.fault is Fault.NONE else Event.RAMP_ENDS)

    def carry_back(self, t_ns: int) -> None:
        """The brake does not hold the load that it has been tested with: the motor takes it, as by CARRY."""
        command = Accepted(None, Verb.CARRY, carry_ns=KEPT_NS)
        self.sequence = stage.after(self.sequence, Input.TAKEN_BACK, t_ns, command=command)

    def _accept(self, command: Accepted, t_ns: int) -> None:
        at, event = self.sequence, command.event
        match command.verb:
            case Verb.RESET:
                self.fault = Fault.NONE
                at = stage.after(at, Input.RESET, t_ns, action=Action.HOLD, cut_ns=0)
            case Verb.DISARM:
                at = stage.after(at, Input.PARKED, t_ns, armed=False, carry_until_ns=0)
            case Verb.CARRY:
                at = replace(at, action=Action.HOLD, carry_until_ns=t_ns + command.carry_ns)
            case Verb.LOWER | Verb.RELEASE if self.fault is not Fault.NONE:  # the motor carries the load
                until_ns = max(at.carry_until_ns, t_ns + KEPT_NS)
                at = replace(at, action=Action.RAMP_DOWN, carry_until_ns=until_ns)
        self.sequence = at
        if event is not None:
            self._go(event)

    def _go(self, event: Event) -> None:
        before = self.mode
        after = modes.next_mode(before, event)
        if after is before:
            return
        self.mode = after
        self.end_trial(Refusal.ABORTED)
        if self.fault is Fault.NONE and self.sequence.carry_until_ns:
            self.sequence = replace(self.sequence, carry_until_ns=0)
        if event is Event.ENABLED:
            self.sequence = replace(self.sequence, armed=True)
        elif after is Mode.DISARMED:
            self.sequence = stage.after(self.sequence, Input.PARKED, 0, armed=False)
        self._done = self._done.then(Outcome(changes=(Change(before, after, event),)))
