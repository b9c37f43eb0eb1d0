"""What keeps the load: the latch of the stroke, the parked brake, or the motor where the brake does not hold."""

from __future__ import annotations

import math
from dataclasses import replace

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import Trial
from rigctl.control.law.tension import Estimate, TensionLaw
from rigctl.control.load.brake_flag import BrakeFlag, KeptBrake
from rigctl.control.load.carried_load import FOLLOWS_MM, WITNESS_TEXT, CarriedLoad
from rigctl.control.load.held_tension import HeldTension
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.load.stroke_hold import CREEP_MM_S, SHOWN_MM, StrokeHold
from rigctl.control.logbook import Logbook, number
from rigctl.control.observer import Observer
from rigctl.control.power.machine import SLIP_BITS, Machine
from rigctl.control.power.parking import UNDO_MM, UNDONE_TEXT, FirstSecond, Parking
from rigctl.control.power.power_seen import STILL_NS, stopping_ns
from rigctl.control.power.stage import KEPT, KEPT_NS, TickSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.escalation import Escalator
from rigctl.control.watch.safety import Trip, Watch
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode, PowerOff, Witness

_MOVES_BIT = Fault.STROKE_MOVES.bit
_ON_BRAKE = frozenset({HeldBy.BRAKE, HeldBy.UNKNOWN})


class HeldLoad:
    """Keeps the load where the mode keeps the stroke. ``brake``: whether it is known not to hold."""

    def __init__(
        self, settings: RigSettings, machine: Machine, observer: Observer, law: TensionLaw, watch: Watch,
        logbook: Logbook, rope: RopeMemory, stroke: StrokeHold, tension: HeldTension, kept_brake: KeptBrake,
    ) -> None:  # fmt: skip
        """``stroke`` and ``tension``: their latches. ``kept_brake``: see `rigctl.control.loop.Loop`."""
        self._machine, self._observer, self._law, self._watch = machine, observer, law, watch
        self._logbook, self._rope, self.stroke, self._tension = logbook, rope, stroke, tension
        self.brake, self.carried = BrakeFlag(settings, rope, kept_brake), CarriedLoad(settings, rope)
        self._parking, self.first_second = Parking(settings, stopping_ns(settings)), FirstSecond(settings)
        self._escalator = Escalator(settings, stopping_ns(settings))
        self._moved_on_brake = False  # a load at rest on the brake has moved since

    def latch_anew(self) -> None:
        """Latch stroke and tension anew: the motor has taken the load, or a motion is acknowledged."""
        self.stroke.latch_anew()
        self._tension.latch_anew()

    def look(self, t_ns: int, powered_until_ns: int) -> None:
        """Take note of what carries the load; where the mode keeps the stroke, a change is an event.

        ``powered_until_ns``: the motor may hold until then for a trial.
        """
        snapshot, machine = self._observer.snapshot, self._machine
        before, shown, rest = snapshot.held_by, snapshot.power_off, snapshot.load_at_rest
        self._observer.look_at_load(self._watch.standing)
        if snapshot.power_off != shown and snapshot.power_off > PowerOff.AWAITED:
            since_s = self._observer.power_off.since_s(snapshot.t_ns)
            self._logbook.notice(t_ns, Kind.POWER_OFF, snapshot.power_off, int(self.brake.fails), value=since_s)
        if snapshot.held_by is not before and not machine.mode.moves_stroke:
            at = machine.sequence
            text = (at.trial or at.pending or machine.mode).name.encode()
            until_ns = powered_until_ns if at.trial is not None else at.carry_until_ns
            left_s = max(0, until_ns - t_ns) * 1e-9
            self._logbook.held(t_ns, before, snapshot.held_by, left_s, text)
        braked = self._observer.snapshot.power.braked and before in _ON_BRAKE and snapshot.held_by in _ON_BRAKE
        braked = braked and not machine.mode.moves_stroke
        if braked and (rest.rests if not snapshot.load_at_rest.rests else self._moved_on_brake):
            self._moved_on_brake = rest.rests
            text = machine.mode.name.encode()
            self._logbook.notice(t_ns, Kind.LOAD_AT_REST, rest, snapshot.load_at_rest, text)

    def park(self, t_ns: int, trial: Trial | None, powered_until_ns: int, *, delayed: bool) -> None:
        """Let the brake take a load that the motor has held for long enough, or lower it where the brake slips.

        ``trial``: under way; the motor may hold for it until ``powered_until_ns``. ``delayed``: the load delays an end.
        """
        machine, at, snapshot = self._machine, self._machine.sequence, self._observer.snapshot
        faulted, enabled = machine.mode is Mode.FAULT, snapshot.drive_enabled
        if at.carry_until_ns and (faulted or (machine.mode is Mode.HOLD and enabled)):
            # For a brake that is known not to hold the motor goes on whatever else is wrong, see `_trip_of_carried`.
            other = faulted and self._watch.standing & ~SLIP_BITS and not self.on_motor
            machine.follow(TickSeen(t_ns, gone=bool(other) or not enabled))
            return
        until_ns = powered_until_ns if trial is not None else at.carry_until_ns
        measures = trial is not None and not trial.power_s
        powered = at.motor and not (at.ends or delayed)
        if self._parking.due(t_ns, machine.mode, snapshot, powered=powered, until_ns=until_ns, measures=measures):
            # A motor that does not hold, or that an active cause would stop, does not keep the load.
            holds = snapshot.still_ns >= STILL_NS and not self.carried.stopped_by(self._watch.standing)
            row = machine.follow(TickSeen(t_ns, enabled, due=True, fails=holds and self.kept_by_motor))
            if row is KEPT:
                self.carried.begin(Witness.BOTH, self._watch.standing, snapshot)
                self._logbook.held(t_ns, HeldBy.MOTOR, HeldBy.MOTOR, KEPT_NS * 1e-9, machine.mode.name.encode())
            else:
                self.first_second.begin(snapshot)

    def undo_parking(self, t_ns: int) -> Trip | None:
        """Have the motor take the load back from a brake that slips in its first second, if nothing else is wrong.

        Returns the trip that goes with it.
        """
        first = self.first_second
        if not first.parks:
            return None
        first.look(self._observer.snapshot, moves=bool(self._watch.standing & _MOVES_BIT))
        if not first.sank_mm or self._watch.standing & ~SLIP_BITS:
            return None
        trip = Trip(Fault.BRAKE_SLIPS, first.sank_mm, UNDO_MM, text=UNDONE_TEXT)
        undone = self._machine.undo_parking(trip, t_ns)
        if undone:
            self._logbook.trip(t_ns, Kind.TRIP, trip)
            self.brake.set(f"it has slipped by {first.sank_mm:.2f} mm right after a parking")
            self.carried.begin(Witness.BOTH, self._watch.standing, self._observer.snapshot)
        first.end()
        return trip if undone else None

    def escalate(self, t_ns: int) -> None:
        """Follow a reaction that has not helped against the latched fault by the next stronger one."""
        machine, slack = self._machine, self._observer.slack
        if machine.fault is not Fault.NONE and self.on_motor:  # what ends that is decided by `_trip_of_carried`
            return
        over = machine.sequence.action is Action.RAMP_DOWN and machine.mode is Mode.FAULT
        action = Action.HOLD if over else machine.sequence.action
        found = self._escalator.look(machine.fault, action, self._observer.snapshot, t_ns)
        if found is not None:
            text = b"brake fails" if self.brake.fails else b""
            self._logbook.event(t_ns, Kind.ESCALATION, found.fault, found.symptom, found.value, found.limit, text)
            if found.trip is not None:
                machine.trip(found.trip, t_ns, slack=slack)

    def look_at_brake(self, t_ns: int, trip: Trip | None) -> Trip | None:
        """Whether the brake, which has the load or may get it, is known not to hold; returns what trips then.

        ``trip``: what trips elsewhere.
        """
        snapshot, brake = self._observer.snapshot, self.brake
        brake.look(self._watch.standing, snapshot, braked=snapshot.drive_off and self._observer.snapshot.power.braked)
        if brake.changed:
            self.note_brake(t_ns)
        if not self.on_motor:
            return trip
        ends = self._trip_of_carried(snapshot)
        if ends is None and trip is not None and self._machine.fault is Fault.NONE:  # in HOLD: the motor goes on
            return replace(trip, action=min(trip.action, Action.HOLD))
        return ends

    def note_brake(self, t_ns: int) -> None:
        """The brake is known not to hold from now on, or to hold again."""
        brake = self.brake
        brake.noted()
        tension_n, wanted_n = number(self._rope.tension_n), brake.wanted_n if brake.fails else 0.0
        text = brake.why.encode()[:80]
        self._logbook.event(t_ns, Kind.BRAKE_FLAG, int(brake.fails), int(brake.assumed), tension_n, wanted_n, text)

    def _trip_of_carried(self, snapshot: Snapshot) -> Trip | None:
        """What ends a carrying by the motor that alone can hold the load; all other causes are reported."""
        carried, standing = self.carried, self._watch.standing
        carried.look(standing, snapshot, self._law.command_mm_s, 1 + self._observer.just_skipped)
        if carried.strayed_mm:
            return Trip(
                Fault.DRIVE_NOT_FOLLOWING, carried.strayed_mm, FOLLOWS_MM, Action.QUICK_STOP, WITNESS_TEXT
            )  # fmt: skip
        off = self._machine.sequence.motor and not snapshot.drive_enabled  # nothing carries any more
        stops = standing if off else carried.stopped_by(standing)
        found = self._watch.strongest(snapshot, stops) if stops else None
        return found and replace(found, action=max(found.action, Action.QUICK_STOP))

    def releasing(self, estimate: Estimate, cosine: float, added_mm_s: float) -> float:
        """Lower the load by the tension, or by the encoder alone where the cell is in doubt."""
        lowering_mm_s = None
        if self.on_motor:
            lowering_mm_s = self.carried.lowering_mm_s(estimate.stroke_mm)
        if lowering_mm_s is None:
            return self._law.releasing(estimate, cosine, added_mm_s)
        return self._law.limited(lowering_mm_s, estimate.stroke_mm)

    def lowered(self, estimate: Estimate) -> bool:
        """The rope is slack."""
        if self.on_motor and self.carried.by is not Witness.BOTH:
            return self.carried.lowered(estimate.stroke_mm, self._observer.snapshot.t_ns)
        return self._law.slack(estimate)

    @property
    def kept_by_motor(self) -> bool:
        """The brake is known not to hold, and the rope is tight: the motor gives the load to nothing by itself."""
        tight = not self._observer.slack or self._rope.slack_in_doubt(self._observer.snapshot)
        return self.brake.fails and tight

    @property
    def on_motor(self) -> bool:
        """The motor alone can hold the load: it carries for a brake that does not, or by a witness that is named."""
        return self._machine.sequence.carries and (self.brake.fails or self.carried.named is not Witness.BOTH)

    def found_stiffness(self, slope_n_mm: float) -> None:
        """The rope's stiffness, as the sign check has measured it."""
        self._tension.found_stiffness(slope_n_mm)

    def watch_stroke(self, now_ns: int, trial: Trial | None, *, doubted: bool) -> None:
        """Latch the stroke where the mode keeps it, and write an event when it leaves the latch.

        ``doubted``: the position is not confirmed, so that it cannot be held.
        """
        hold, machine, snapshot = self.stroke, self._machine, self._observer.snapshot
        moves = machine.mode.moves_stroke or (trial is not None and trial.moves)
        if moves or doubted:
            hold.follow()
        else:
            hold.watch(now_ns, snapshot, self._law.command_mm_s)
            if hold.left:
                self._logbook.event(
                    now_ns, Kind.STROKE_LEFT, machine.mode, value=hold.seen.excursion_mm, limit=SHOWN_MM
                )
        if moves or (trial is not None and machine.mode is Mode.DISARMED):  # a weight of a tare or a calibration
            self._tension.follow()
        else:
            latched = math.isfinite(hold.reference_mm)
            self._tension.watch(snapshot, 1 + self._observer.just_skipped, latched=latched)
            lifted = machine.mode is Mode.DISARMED and not machine.sequence.taking
            if lifted:  # off the brake by hand, which is no loss
                self._tension.forget_loss()

    def correction(self, *, powered: bool) -> float:
        """Speed in mm/s that brings a held stroke back to its latch."""
        hold, observer = self.stroke, self._observer
        speed_mm_s = hold.correct(observer.snapshot, 1 + observer.just_skipped, powered=powered)
        if hold.creeps:
            self._logbook.event(observer.snapshot.t_ns, Kind.DRIVE_CREEPS, value=hold.creep_mm_s, limit=CREEP_MM_S)
        return speed_mm_s

    @property
    def carries(self) -> bool:
        """The motor has a load that would sink without it, by CARRY or LOWER or on a brake known not to hold."""
        at, mode = self._machine.sequence, self._machine.mode
        if at.carries:
            return True
        if not (self.brake.fails and at.motor):
            return False
        if mode is Mode.FAULT:  # the motor is about to keep it; after a ramp it has lowered it
            ramped = at.action is Action.RAMP_DOWN
            return self.kept_by_motor and self._observer.snapshot.drive_enabled and not ramped
        return mode is Mode.RELEASING or not self._observer.slack
