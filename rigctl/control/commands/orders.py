"""Commands from the ring: an operator's verbs, the trials they begin, and the gateway's settings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.control import modes
from rigctl.control.bus.hold_sockets import Hold, HoldSource
from rigctl.control.bus.readback import Readback
from rigctl.control.commands import command_actions
from rigctl.control.commands.command_actions import ACTIONS, ActedOn
from rigctl.control.commands.command_checks import CommandChecks
from rigctl.control.commands.settings_in_force import SettingsInForce
from rigctl.control.commands.situation import Situation
from rigctl.control.excitation import trials
from rigctl.control.law.move_learning import MoveLearning
from rigctl.control.law.tension import TensionLaw
from rigctl.control.load.brake_flag import BrakeFlag
from rigctl.control.load.carried_load import CarriedLoad
from rigctl.control.load.homed import Homed
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.logbook import Logbook, number
from rigctl.control.observer import Observer
from rigctl.control.power import arming
from rigctl.control.power.machine import Answer, Machine
from rigctl.control.power.stage import READY, SLIPPED, Accepted, TickSeen
from rigctl.control.watch.safety import Trip, Watch
from rigctl.ipc.hold_socket import HoldAnswer
from rigctl.ipc.record import COMMAND_LIFETIME_NS, HOLD_ID
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import VALUES, Refusal, Setting, Verb

_VERBS, _SETTINGS = frozenset(map(int, Verb)), frozenset(map(int, Setting))
_Values = dict[str, float]  # of a command, by the names in `VALUES`


class _Waiting(NamedTuple):
    """A command that waits for the read-back of every supervised object."""

    id: int
    verb: Verb
    values: _Values
    since_ns: int
    mode: Mode


_NO_FIGURES: Mapping[str, float] = MappingProxyType({})
LOOK_NS = 100_000_000  # period of what the displays offer


class Orders:
    """Carries out commands and answers them. ``checks``: what the answers depend on.

    ``trial``: the one under way. ``settings``: what the gateway has put in force.
    ``shown_checks``: bits of the checks that failed when they were last looked at, for the record.
    """

    def __init__(
        self,
        settings: RigSettings,
        machine: Machine,
        observer: Observer,
        law: TensionLaw,
        watch: Watch,
        logbook: Logbook,
        readback: Readback,
        homed: Homed,
        learning: MoveLearning | None,
        holds: HoldSource,
        brake: BrakeFlag,
        carried: CarriedLoad,
        rope: RopeMemory,
        *,
        supervised: bool,
    ) -> None:
        """``supervised``: start-up has verified that the drive stops by itself when we go silent.

        ``readback``: reads this, and all else that start-up has verified, again before the rig arms.
        """
        self.trial: trials.Trial | None = None
        self.shown_checks = 0
        self.settings = SettingsInForce(settings, observer, law, logbook)
        self.checks = CommandChecks(
            settings, machine, observer, watch, readback, brake, carried, rope, self.settings, supervised=supervised
        )
        self._settings, self._machine, self._observer = settings, machine, observer
        self._watch, self._logbook, self._readback, self._holds = watch, logbook, readback, holds
        self._brake, self._carried = brake, carried
        self._on = ActedOn(machine, observer, law, watch, logbook, homed, learning, brake, carried, self.checks)
        self._waiting: _Waiting | None = None
        self.powered_until_ns = 0
        """The motor may hold until then for the trial under way; 0: the trial needs no power."""
        self._look_ns = 0
        self.length_mm = 0.0  # of the last RELEASE
        self._held_ns = 0  # when the last HOLD of a user of this computer was taken

    def take(self, slot: object, t_ns: int) -> bool:
        """Take one slot of the command ring; returns whether an operator gave it."""
        given_ns, id_, code = (slot[name].item() for name in ("t_ns", "id", "verb"))  # type: ignore[index]
        values = {name: slot[name].item() for name in VALUES.get(code, ())}  # type: ignore[index]
        if code not in _VERBS and code not in _SETTINGS:
            self._reply(t_ns, id_, Refusal.UNKNOWN)
        elif abs(t_ns - given_ns) > COMMAND_LIFETIME_NS:
            self._reply(t_ns, id_, Refusal.EXPIRED)
        elif code in _VERBS and given_ns < self._held_ns:  # an older command that waited must not undo a HOLD
            self._reply(t_ns, id_, Refusal.ABORTED)
        elif code in _SETTINGS:
            self._set(id_, Setting(code), values, t_ns)
        else:
            self._obey(id_, Verb(code), values, t_ns)
        return code in _VERBS

    def take_hold(self, hold: Hold, t_ns: int) -> None:
        """Take a HOLD of a user of this computer, which anyone may give, however long it has waited."""
        id_ = HOLD_ID | t_ns
        self._logbook.hold(t_ns, id_, hold)
        self._held_ns = t_ns
        self._obey(id_, Verb.HOLD, {}, t_ns)

    def go_on(self, t_ns: int) -> None:
        """Go on with a waiting command, what the displays offer, and the trial, answered once it has ended."""
        machine = self._machine
        if self._waiting is not None:
            self._go_on_waiting(self._waiting, t_ns)
        if t_ns >= self._look_ns:
            self._look_ns = t_ns + LOOK_NS
            self._publish(t_ns)
        if self.trial is None and machine.sequence.tried is not None:  # the motor has taken the load for it
            self._begin_trial(machine.sequence.tried, t_ns)
        trial = self.trial
        if trial is None:
            return
        if machine.sequence.trial is not None:
            if self._waits_for_brake(trial):
                return
            verdict = trial.see(self._observer.inbox, self._observer.snapshot)
            if isinstance(trial, trials.LoadStep):
                for part in trial.take_bins():
                    self._logbook.load_bin(t_ns, part)
            if verdict is None:
                return
            machine.end_trial(verdict, trial.figures)
        self.trial = None

    @property
    def _waiting_verb(self) -> int:
        """Of a command that waits for the read-back; 0: none does."""
        return 0 if self._waiting is None else self._waiting.verb

    def look_again(self) -> None:
        """What the answers to commands depend on has changed."""
        self._look_ns = 0

    def _publish(self, t_ns: int) -> None:
        """Write the situation for the displays, and note the checks for the record."""
        machine = self._machine
        failing = Check(0) if machine.mode.moves_stroke else self.checks.failed()
        self._logbook.situation(
            t_ns, machine.mode, self.checks.situation(t_ns, failing=failing, waiting=self._waiting_verb)
        )
        if machine.mode in (Mode.DISARMED, Mode.FAULT) and not machine.sequence.pending:
            self.shown_checks = int(failing & ~arming.AWAITED_CHECKS or failing)

    def _waits_for_brake(self, trial: trials.Trial) -> bool:
        """Whether a trial that only measures waits for the brake: a motor that holds the load moves it."""
        on_motor = self._machine.mode is Mode.HOLD and not self._observer.snapshot.power.braked
        given = self._settings.cylinder.brake_waiver is None and not self._machine.sequence.carry_until_ns
        return on_motor and not trial.power_s and given

    def prepare(self, t_ns: int) -> None:
        """Go on with the sequence of an accepted command; the checks must pass to its end."""
        machine, snapshot, command = self._machine, self._observer.snapshot, self._machine.sequence.command
        if command is None or not machine.sequence.preparing:
            return
        test, step = arming.prepare(command.test, t_ns, snapshot, slack=self._observer.slack)
        machine.prepare(test)
        barred = step is not arming.ArmingStep.SLIPPED and bool(self.checks.barring(command) & ~arming.AWAITED_CHECKS)
        row = machine.follow(TickSeen(t_ns, prepared=step, barred=barred))
        if row is SLIPPED:
            trip = Trip(Fault.BRAKE_SLIPS, test.moved_mm, arming.BRAKE_TEST_MM, Action.HOLD, arming.TEST_TEXT)
            if machine.trip(trip, t_ns):
                self._logbook.trip(t_ns, Kind.TRIP, trip)
            # A load on a brake that fails the test for the second time is the motor's, as is one that it had before.
            back = self._brake.fails or command.verb is Verb.BRAKE_TEST
            self._brake.set("the brake test has failed")
            if back and not self.checks.barring(Accepted(None, Verb.CARRY)):
                self._carried.begin(Witness.BOTH, self._watch.standing, snapshot)
                machine.carry_back(t_ns)
        elif row is READY and test.tested is not None:
            held = int(test.tested)
            self._logbook.event(t_ns, Kind.BRAKE_TEST, held, 0, test.moved_mm, number(test.tension_n))
            if held:
                self._brake.tested(test.tension_n)

    def reply(self, t_ns: int, answers: Sequence[Answer]) -> None:
        """Reply to the commands that the machine has answered."""
        for given in answers:
            self.look_again()
            self._reply_to(t_ns, given if self._machine.fault is Fault.NONE else self._tripped(given))

    def _tripped(self, given: Answer) -> Answer:
        """A trip that no check names has ended the command: its cause is the answer."""
        tripped = given.refusal is Refusal.PREFLIGHT and not self.checks.barring(given.command)
        return replace(given, refusal=Refusal.CAUSE_PRESENT) if tripped else given

    def _reply_to(self, t_ns: int, given: Answer, barred: Check = Check(0)) -> None:  # noqa: B008 - a constant
        """``barred``: by these checks, where the situation of the answer knows them."""
        checks = 0
        if given.refusal is Refusal.PREFLIGHT:
            failing = barred or self.checks.barring(given.command)
            checks = int(failing & ~arming.AWAITED_CHECKS or failing)  # name AWAITED_CHECKS only if alone
        elif given.refusal is Refusal.CAUSE_PRESENT:
            checks = self._watch.blocking(self._observer.snapshot)
        about = command_actions.figures(self._on, given, t_ns)
        self._reply(t_ns, given.id, given.refusal, checks, {**about, **_taken(given)})

    def _obey(self, id_: int, verb: Verb, values: _Values, t_ns: int) -> None:
        machine, waiting = self._machine, self._waiting
        self.look_again()
        idle = waiting is None and not machine.sequence.pending
        if idle and verb is Verb.RESET and machine.mode is Mode.DISARMED:
            self._readback.forget()  # ARM reads all of it again
            self._readback.show()
        situation = self.checks.situation(t_ns, verb, values, waiting=self._waiting_verb)
        decision = modes.answer(machine.mode, verb, situation)
        if decision.refusal is not Refusal.NONE:
            named = decision.refusal is Refusal.PREFLIGHT and verb is not Verb.ARM
            barred = modes.barring(verb, situation) if named else 0
            refused = Answer(id_, verb, decision.refusal, Accepted(id_, verb, values=values))
            self._reply_to(t_ns, refused, Check(barred))
            return
        if waiting is not None and verb in modes.ENDS_PENDING:
            self._reply(t_ns, waiting.id, Refusal.ABORTED)
            self._waiting = None
            self._readback.give_up()
            if decision.ends:
                self._reply(t_ns, id_, Refusal.NONE)
                return
        elif waiting is None and self.checks.reads_first(verb, t_ns):
            machine.end_trial(Refusal.ABORTED)
            self.trial = None
            self._waiting = _Waiting(id_, verb, values, t_ns, machine.mode)
            self._readback.begin_all(t_ns)
            return
        self._carry_out(id_, verb, values, situation, t_ns)

    def _go_on_waiting(self, waiting: _Waiting, t_ns: int) -> None:
        """Carry the command out once everything is read back, or refuse; the other checks are evaluated again."""
        verdict = self._readback.verdict(t_ns)
        if verdict is None and self._machine.mode is waiting.mode and not self._machine.sequence.ends:
            return
        self._waiting = None
        self._readback.give_up()
        if verdict:
            self.checks.checked()
            self._logbook.event(t_ns, Kind.READ_BACK, self._readback.size, value=(t_ns - waiting.since_ns) * 1e-9)
        situation = self.checks.situation(t_ns, waiting.verb, waiting.values, read=True)
        self._carry_out(waiting.id, waiting.verb, waiting.values, situation, t_ns, since_ns=waiting.since_ns)

    def _carry_out(
        self, id_: int, verb: Verb, values: _Values, situation: Situation, t_ns: int, *, since_ns: int | None = None
    ) -> None:
        """``since_ns``: when the command came, if it has waited for the read-back."""
        machine = self._machine
        action = ACTIONS[verb]
        action.before(self._on, verb, situation, t_ns)
        fault = machine.fault
        refusal = machine.command(id_, verb, situation, t_ns, values, since_ns)
        if refusal not in (None, Refusal.NONE):
            return
        done = refusal is Refusal.NONE
        self.checks.note(verb)
        if verb is Verb.ARM:  # while armed, the checks shown are those of the moment of arming
            self.shown_checks = situation.failed_checks
        self.trial, self.powered_until_ns = None, 0
        if verb is Verb.RELEASE:
            self.length_mm = situation.length_mm
        if machine.sequence.tried is not None:
            self._begin_trial(machine.sequence.tried, t_ns)
        if fault is not machine.fault:
            self.acknowledged(fault, t_ns)
        if done:
            action.begin(self._on, values, t_ns)

    def lower_to_end(self, t_ns: int) -> None:
        """The motor lowers the load that it has, by the witness that is in force; outside FAULT as after a slip."""
        if self._machine.mode is not Mode.FAULT:
            self._on.begin_carrying(Witness.BOTH, t_ns)
        self._machine.lower(t_ns)

    def acknowledged(self, fault: Fault, t_ns: int) -> None:
        """A latched fault has been reset."""
        self.checks.forget()
        self._carried.forget()
        self._logbook.event(t_ns, Kind.RESET, fault)

    def _begin_trial(self, tried: Accepted, t_ns: int) -> None:
        """Begin a trial; one that moves the stroke has the motor hold for as long as it states."""
        machine, observer = self._machine, self._observer
        held, regulated = machine.mode is Mode.HOLD, machine.mode is Mode.COMPENSATING
        self.trial = trials.begin(
            tried.verb,
            self._settings,
            observer.inbox,
            creep_s=tried.values.get("creep_s", math.nan),
            tight_ns=observer.tight_ns if held else None,
            regulated=regulated,
        )
        self.powered_until_ns = t_ns + round(self.trial.power_s * 1e9) if self.trial.power_s else 0

    def _set(self, id_: int, setting: Setting, values: _Values, t_ns: int) -> None:
        """Put a setting in force, within its bounds, and reply."""
        refusal = self.settings.put(setting, values, t_ns, self._machine)
        if setting is Setting.HOST_CHECKS:
            self.shown_checks = self.shown_checks & ~int(HOST_CHECKS) | self.settings.host_checks
        figures = {"reading_n": self._observer.inbox.cell.reading_n} if refusal is Refusal.LOADED else {}
        self._reply(t_ns, id_, refusal, figures=figures)

    def _reply(
        self, t_ns: int, id_: int, refusal: Refusal, checks: int = 0, figures: Mapping[str, float] = _NO_FIGURES
    ) -> None:
        machine, observer = self._machine, self._observer
        self._logbook.reply(t_ns, id_, refusal, checks, machine.mode, figures)
        if id_ & HOLD_ID:
            stroke_mm, tension_n = observer.inbox.drive.stroke_mm, observer.inbox.cell.tension_n
            done = refusal is Refusal.NONE
            self._holds.answer(
                id_ ^ HOLD_ID,
                HoldAnswer(t_ns, done, refusal, checks, machine.fault, stroke_mm, tension_n, machine.mode.name),
            )


def _taken(given: Answer) -> dict[str, float]:
    """How long the motor took to take the load from the brake for this command, if it did."""
    taken_s = given.command.taken_s
    return {"taken_s": taken_s} if given.refusal is Refusal.NONE and not math.isnan(taken_s) else {}
