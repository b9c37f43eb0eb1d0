"""What the answer to a command depends on, beside the mode: checks, causes, read-back, and what has sunk by arms."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rigctl.config.settings import RigSettings
from rigctl.control import modes
from rigctl.control.bus.readback import Readback
from rigctl.control.commands.settings_in_force import SettingsInForce
from rigctl.control.commands.situation import Situation
from rigctl.control.load.brake_flag import BrakeFlag
from rigctl.control.load.carried_load import CarriedLoad
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.observer import Observer
from rigctl.control.power import arming
from rigctl.control.power.machine import Machine
from rigctl.control.power.power_seen import STILL_NS
from rigctl.control.power.stage import NO_VALUES, Accepted
from rigctl.control.watch import safety
from rigctl.control.watch.safety import Watch
from rigctl.devices.objects import drive_state
from rigctl.model.checks import Check
from rigctl.model.emergency import LASTING
from rigctl.model.reactions import Action
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import Verb

RECHECK_NS = 600_000_000_000
"""A load that has been on the brake for longer, or since a fault, is taken back after a read-back of every object."""
_MOVES = frozenset({Verb.TENSION, Verb.RELEASE, Verb.LOWER})
"""The load moves on purpose: what it sank by the arms before is of no account."""


class CommandChecks:
    """``recheck``: a fault has been reset since the last read-back of every object."""

    def __init__(
        self, settings: RigSettings, machine: Machine, observer: Observer, watch: Watch, readback: Readback,
        brake: BrakeFlag, carried: CarriedLoad, rope: RopeMemory, in_force: SettingsInForce, *, supervised: bool,
    ) -> None:  # fmt: skip
        """``supervised``: start-up has verified that the drive stops by itself when we go silent."""
        self._settings, self._machine, self._observer, self._watch = settings, machine, observer, watch
        self._readback, self._brake, self._carried, self._rope = readback, brake, carried, rope
        self._in_force, self._supervised = in_force, supervised
        self.recheck = False
        self._armed_mm = math.nan  # stroke at the first ARM of a tight rope since the load was moved on purpose
        self._disarmed_mm = math.nan  # at the last DISARM: what moves from there to the next ARM is no arm's

    @property
    def sunk_mm(self) -> float:
        """How far the load has sunk by arms alone."""
        return self._armed_mm - self._observer.snapshot.stroke_mm

    def checked(self) -> None:
        """Every supervised object has been read back."""
        self.recheck = False

    def forget(self) -> None:
        """A latched fault has been reset: every object is read back before the motor takes a load."""
        self.recheck = True

    def failed(self, *, near_end: bool = False) -> Check:
        """Checks that bar arming now; ``near_end``: see `rigctl.control.watch.safety.preflight`."""
        known = Check(self._in_force.host_checks) | (Check.CALIBRATION if self._in_force.overdue else Check(0))
        if not self.verified_at_start or self._readback.lost:
            known |= Check.DRIVE_SUPERVISION
        snapshot = self._observer.snapshot
        beyond = self._watch.beyond(snapshot, Mode.HOLD)
        failing = safety.preflight(snapshot, self._settings, beyond, known, near_end=near_end)
        return failing | arming.awaited(snapshot)

    def barring(self, command: Accepted) -> Check:
        """Checks that fail now of those that a command must pass."""
        failing = self.failed(near_end=_near_end(command.verb, command.values))
        if command.verb is Verb.ARM:
            return failing
        if command.verb in modes.CARRIES and (self._brake.fails or self._carried.named):
            return failing & modes.bars_carry(self._carried.choose(self._watch.standing, self._observer.snapshot))
        return failing & ~modes.AT_ARM_ONLY

    @property
    def verified_at_start(self) -> bool:
        """Start-up has verified the drive's supervision, and no device has restarted since."""
        return self._supervised and not self._observer.inbox.network.restarted

    def reads_first(self, verb: Verb, t_ns: int) -> bool:
        """Every supervised object is read before this command, if it is accepted."""
        machine, at = self._machine, self._machine.sequence
        if at.pending or not (self._readback.size and self.verified_at_start):
            return False
        if verb is Verb.ARM:
            return True
        needs_motor = verb in modes.NEEDS_MOTOR and verb not in modes.CARRIES
        if not needs_motor or machine.mode is not Mode.HOLD or not (at.armed and at.off):
            return False
        return self.recheck or t_ns - at.since_ns >= RECHECK_NS

    def situation(
        self,
        t_ns: int,
        verb: Verb | None = None,
        values: Mapping[str, float] = NO_VALUES,
        *,
        failing: Check | None = None,
        read: bool = False,
        waiting: int = 0,
    ) -> Situation:
        """What the answer to a command depends on now.

        Args:
            t_ns: now.
            verb: of the command; None: of any.
            values: of the command.
            failing: the checks that bar arming, where they are known.
            read: the supervised objects have just been read for the command.
            waiting: verb of a command that waits for that.
        """
        machine, observer, settings, brake = self._machine, self._observer, self._settings, self._brake
        snapshot = observer.snapshot
        moves = machine.mode.moves_stroke  # no check and no cause is in the way of a command
        if failing is None:
            failing = Check(0) if moves else self.failed(near_end=_near_end(verb, values))
        stops = machine.sequence.action >= Action.QUICK_STOP or snapshot.drive_faulted
        situation = Situation(
            failed_checks=int(failing & ~arming.AWAITED_CHECKS),
            causes=0 if moves else self._watch.blocking(snapshot),
            stop_running=stops and not machine.sequence.carry_until_ns and arming.stop_running(snapshot),
            fault=machine.fault,
            moves=0 if settings.learning is None else settings.learning.moves,
            stroke_mm=snapshot.stroke_mm if snapshot.drive_heard else math.nan,
            armed=machine.sequence.armed,
            carried_s=max(0, machine.sequence.carry_until_ns - t_ns) * 1e-9 if machine.sequence.carry_until_ns else 0.0,
            e_stop=snapshot.e_stop != 0,
            brake_fails=brake.fails,
            sunk_mm=0.0 if observer.slack else self.sunk_mm,
            no_brake=settings.cylinder.brake_waiver is not None,
            needed_n=brake.wanted_n if brake.fails and snapshot.tension_n < brake.wanted_n else 0.0,
            at_rest=snapshot.still_ns >= STILL_NS,
            room_mm=safety.payable_mm(snapshot.stroke_mm, settings.cylinder.stroke_min_mm),
            strays=self._carried.strayed_mm != 0.0,
            apart_mm=snapshot.sinking.apart_mm or self._carried.strayed_mm,
            drive_faulted=snapshot.drive_faulted,
            drive_unfit=snapshot.drive_faulted and snapshot.drive_emergency >> 8 & 0xFF in LASTING,
            slack=observer.slack,
            slack_doubted=brake.fails and self._rope.slack_in_doubt(snapshot),
            unloaded=abs(observer.inbox.cell.reading_n) <= settings.tare_limit_n,
            target_min_n=settings.tension.target_min_n,
            target_max_n=settings.tension.target_max_n,
            witness=self._carried.suits(self._watch.standing, snapshot) if brake.fails else Witness.BOTH,
            pending=waiting,
            read_at_arm=not read and self.reads_first(Verb.ARM, t_ns),
            read_at_motor=not read and self.reads_first(Verb.TENSION, t_ns),
            speed_mm_s=observer.inbox.drive.speed_mm_s,
            drive_state=drive_state(observer.inbox.drive.statusword),
            reading_n=observer.inbox.cell.reading_n,
        )
        return machine.under_way(situation, t_ns).given(values)

    def note(self, verb: Verb) -> None:
        """A command is accepted: what the load sinks by arms alone begins anew, or goes on."""
        if verb in _MOVES or self._observer.slack:
            self._armed_mm = self._disarmed_mm = math.nan
            return
        stroke_mm = self._observer.snapshot.stroke_mm
        if verb is Verb.DISARM:
            self._disarmed_mm = stroke_mm
        elif verb is Verb.ARM:
            moved_mm = 0.0 if math.isnan(self._disarmed_mm) else stroke_mm - self._disarmed_mm
            self._armed_mm = stroke_mm if math.isnan(self._armed_mm) else self._armed_mm + moved_mm
            self._disarmed_mm = math.nan


def _near_end(verb: Verb | None, values: Mapping[str, float]) -> bool:
    """Whether a command is to drive away from an end of the stroke."""
    return verb is Verb.ARM and values.get("near_end") == 1.0
