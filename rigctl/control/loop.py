"""One tick: receive, estimate, decide, send, record."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import can

from rigctl.config.settings import RigSettings
from rigctl.control import frequency_trial
from rigctl.control.brake_flag import BrakeFlag, KeptBrake
from rigctl.control.carried_load import FOLLOWS_MM, WITNESS_TEXT, CarriedLoad
from rigctl.control.cell_correction import CellHistory
from rigctl.control.clock import Clock
from rigctl.control.ending import Ending
from rigctl.control.escalation import Escalator
from rigctl.control.events import Kind
from rigctl.control.faults import Fault
from rigctl.control.gain_table import GainTable
from rigctl.control.held_tension import HeldTension
from rigctl.control.hold_sockets import GivenHolds, HoldSource
from rigctl.control.homed import Homed, LastStroke
from rigctl.control.inbox import Inbox
from rigctl.control.limits import rows as limit_rows
from rigctl.control.logbook import Logbook, Rings, number
from rigctl.control.loop_probe import LoopProbe, NoProbe
from rigctl.control.machine import NOTHING, SLIP_BITS, Change, Machine, Outcome
from rigctl.control.modes import Event, HeldBy, Mode, PowerOff, Verb
from rigctl.control.move_learning import MoveLearning
from rigctl.control.observer import Observer
from rigctl.control.orders import Orders
from rigctl.control.outbox import CONTROLWORD_WRITTEN, Outbox
from rigctl.control.parking import UNDO_MM, UNDONE_TEXT, FirstSecond, Parking
from rigctl.control.power_seen import stopping_ns
from rigctl.control.preload import Preload
from rigctl.control.probe_plan import plan
from rigctl.control.readback import Readback
from rigctl.control.rope_memory import RopeMemory
from rigctl.control.safety import Action, Trip, Watch
from rigctl.control.signs import SignCheck
from rigctl.control.situation import Witness
from rigctl.control.snapshot import Snapshot
from rigctl.control.stroke_hold import CREEP_MM_S, SAID_MM, StrokeHold
from rigctl.control.tension import Estimate, Gains, TensionLaw
from rigctl.devices.drive import LeftInDrive, Power, next_controlword
from rigctl.devices.objects import NmtState, drive_state
from rigctl.devices.process_data import ProcessData
from rigctl.devices.sdo import Watched
from rigctl.ipc.correction import Correction

STOPPED_MM_S = 0.05
STOP_LIMIT_NS = 2_000_000_000
START_AGAIN_NS = 300_000_000  # a node has heard heartbeats of ours by then
NEVER_NS = 1 << 62
SAFE_FRAMES = 10  # commands of no speed in a row before the drive is switched on, and before it is switched off
COMMANDS_PER_TICK = 4
FAILING_TICKS = 100  # consecutive ticks that end in an exception, after which the drive stops and goes off
SILENT_TICKS = 1000  # and after which it is left to its own supervision, whether it has gone off or not
SKIP_NOTICE = 5  # ticks skipped at once from which an event is written
_MOVES_BIT = Fault.STROKE_MOVES.bit
_ENDS_BY_ITSELF = frozenset({Mode.TENSIONING, Mode.RELEASING})
_ON_BRAKE = frozenset({HeldBy.BRAKE, HeldBy.UNKNOWN})
LawFactory = Callable[[RigSettings, Gains, Inbox], TensionLaw]


class Loop:
    """The fixed-rate loop. Bus and clock are passed in, so that the same code runs real and simulated rigs."""

    def __init__(
        self,
        settings: RigSettings,
        gains: Gains,
        bus: can.BusABC,
        clock: Clock,
        rings: Rings,
        *,
        supervised: bool,
        host_checks: int = 0,
        law: LawFactory | None = None,
        correction: Correction | None = None,
        process_data: ProcessData | None = None,
        watched: Sequence[Watched] = (),
        found: Sequence[LeftInDrive] = (),
        last_stroke: LastStroke = LastStroke(),  # noqa: B008 - frozen: nothing on record
        kept_brake: KeptBrake = KeptBrake(),  # noqa: B008 - frozen: nothing on record
        cell_history: CellHistory | None = None,
        holds: HoldSource | None = None,
    ) -> None:
        """``supervised``: start-up has verified that the drive stops by itself when we go silent.

        ``host_checks``: failing bits of `rigctl.control.checks.HOST_CHECKS`, until the gateway sends newer ones.
        ``law``: makes another law for comparison with ours; the law may read the inbox.
        ``correction``: of the tension cell, from the ledger. ``watched``: objects start-up has verified in the devices.
        ``found``: what a former controller had left in the drive, for the record.
        ``process_data``: as start-up found it; None: as the rig file has it. ``last_stroke``: the last known stroke.
        ``kept_brake``: whether the brake was known not to hold in the loop before.
        ``cell_history``: of the cell's creep in the loop before; None: not known. ``holds``: HOLD from this computer's
        users; None: there are none.
        """
        self.settings = settings
        self.machine = Machine(stopping_ns(settings))
        self._commanded_ns = started_ns = clock.now()
        self.readback = Readback(watched, settings, started_ns)
        self.homed = Homed(settings.cylinder, last_stroke)
        self.inbox = Inbox(bus, settings, rings.frames, process_data, self.readback)
        self.outbox = Outbox(bus, settings, rings.frames, process_data)
        self.law = TensionLaw(settings, gains) if law is None else law(settings, gains, self.inbox)
        self._table = GainTable.of(settings, gains) if law is None else None
        self.learning = MoveLearning(settings, self.law) if settings.learning is not None else None
        self._signs = SignCheck(settings)
        self._stroke_hold, self._held_tension = StrokeHold(settings), HeldTension(settings)
        frequency_trial.prepare(settings)
        self._preload = Preload(settings)
        self._probe = (
            LoopProbe(settings, plan(settings, gains), self.inbox.quantum_mm) if law is None else NoProbe(settings)
        )
        self._rope = RopeMemory(settings)
        self.observer = Observer(
            settings, self.inbox, self.outbox, self.machine, self.law, self.homed, self.readback, self._stroke_hold,
            self._held_tension, self._signs, self._probe, self._rope,
        )  # fmt: skip
        self.exceptions_untold = 0
        self.finished = False
        self.stop_requested = False
        self.repeated_stops = 0
        """Requests to end after the first: the next one leaves a load that delays the end."""
        self._clock, self._commands = clock, rings.commands
        self._holds: HoldSource = GivenHolds() if holds is None else holds
        self.brake, self._carried = BrakeFlag(settings, self._rope, kept_brake), CarriedLoad(settings, self._rope)
        self._watch = Watch(settings, limit_rows(settings))
        self._ending = Ending(settings)
        self._escalator = Escalator(settings, stopping_ns(settings))
        self._parking, self._first_second = Parking(settings, stopping_ns(settings)), FirstSecond(settings)
        self._travel_from = 0.0, 0.0  # stroke in mm and set-point in N at the begin of COMPENSATING
        self._moved_on_brake = False  # a load at rest on the brake has moved since
        self._tripped: Trip | None = None  # not in a record yet, as is what the machine has done
        self._done = NOTHING
        self._logbook = logbook = Logbook(settings, rings)
        self._orders = Orders(
            settings, self.machine, self.observer, self.law, self._watch, logbook, self.readback, self.homed,
            self.learning, self._holds, self.brake, self._carried, self._rope,
            supervised=supervised,
        )  # fmt: skip
        self._work_ns = self._stop_until = self._off_until = self._start_again_ns = 0
        self._failing = self._tick = 0  # ticks in a row that ended in an exception; the tick's number
        self._added_mm_s = self._learned_mm_s = 0.0  # to the law's command: by trial or probe; by a move learned
        logbook.event(started_ns, Kind.STARTED, rings.commands.cursor, rings.holds.head)
        for index, value, left in found:
            logbook.event(started_ns, Kind.FOUND_AT_START, settings.cylinder.node, index << 8, value, left)
        if self.brake.changed:
            self._take_note_of_brake(started_ns)
        self._orders.settings.start(host_checks, correction, cell_history, started_ns)

    @property
    def drive_off(self) -> bool:
        """The drive is seen to be off, its brake closed, and no power off has stayed without a confirmation."""
        return self.observer.snapshot.power.braked and self.observer.snapshot.power_off != PowerOff.UNCONFIRMED

    # -- the tick -----------------------------------------------------------------------------------------------
    def tick(self) -> None:
        """One period. If anything in it fails, the drive still gets a command: stop."""
        t_ns, skipped = self._clock.next_tick()
        woke_ns = self._clock.now()
        try:
            self._receive(t_ns, woke_ns, skipped)
            estimate = self.observer.estimate(skipped, regulated=self.machine.mode is Mode.COMPENSATING)
            self._decide(t_ns, estimate)
            self._look_at_load(t_ns)
            speed_mm_s = self._speed(estimate)
            self._send(t_ns, speed_mm_s)
            self._failing = 0
        except Exception as error:  # noqa: BLE001 - the edge of the tick: recorded, latched, and the stroke held
            self._stop_safely(t_ns, error)
        try:
            self._record(t_ns, woke_ns)
        except Exception as error:  # noqa: BLE001 - the same edge, for the record
            self._stop_safely(t_ns, error)
        self._work_ns = self._clock.now() - woke_ns

    def run(self) -> None:
        """Tick until a requested stop has ended."""
        while not self.finished:
            self.tick()

    def _receive(self, t_ns: int, now_ns: int, skipped: int) -> None:
        inbox, observer, machine = self.inbox, self.observer, self.machine
        inbox.drain(now_ns, self.outbox.syncs)
        self._tick += 1 + skipped
        observer.look(now_ns, skipped)
        if inbox.drive_fresh:
            found = self.homed.look(inbox.stroke_mm, inbox.speed_mm_s, now_ns)
            if found is not None:
                self._logbook.stroke(now_ns, found)
        self._watch_stroke(now_ns)
        if not self._signs.passed and machine.mode is Mode.TENSIONING:
            self._check_signs(now_ns)
        observer.look_at_control(t_ns, self._commanded_ns, self._travel_from)

    def _decide(self, t_ns: int, estimate: Estimate) -> None:
        machine, snapshot, orders = self.machine, self.observer.snapshot, self._orders
        trip = self._watch.look(snapshot, machine.watched_mode, t_ns)
        self._rope.look(self._watch.standing, snapshot)
        load = machine.fault is not Fault.NONE or not snapshot.drive_enabled  # the brake has it, or may get it
        trip = self._look_at_brake(t_ns, trip) if load else trip
        self._undo_parking(t_ns)
        if trip is not None and machine.trip(trip, t_ns, slack=self.observer.slack):
            self._tripped = trip
            self._logbook.trip(t_ns, Kind.TRIP, trip)
        self._escalate(t_ns)
        self._take_orders(t_ns)
        if self.stop_requested and not machine.stopping:
            self._end(t_ns)
        orders.prepare(t_ns)
        if machine.pending is not None:
            self._follow_drive(t_ns, snapshot)
        if machine.disarming:
            machine.follow_off(t_ns, off=snapshot.power.braked)
        orders.attend(t_ns)
        self._park(t_ns)
        if machine.mode in _ENDS_BY_ITSELF:
            self._end_mode(estimate)
        self._take_outcome(estimate)

    def _follow_drive(self, t_ns: int, snapshot: Snapshot) -> None:
        """Go on with a command that waits for the drive: to be enabled, or to leave its fault state."""
        machine = self.machine
        if not (machine.taking or machine.resetting):
            return
        fault, cause = machine.fault, machine.resetting and self._watch.present(snapshot) is not Fault.NONE
        if machine.follow_drive(
            snapshot.drive_enabled, t_ns, drive_faulted=snapshot.drive_faulted, cause_present=cause
        ):
            self._tripped = trip = Trip(machine.fault, 1.0, 0.0, machine.action)
            self._logbook.trip(t_ns, Kind.TRIP, trip)
        elif machine.fault is Fault.NONE is not fault:
            self._orders.acknowledged(fault, t_ns)
        if machine.drive_wanted:
            self._stroke_hold.latch_anew()  # the motor took the load from the brake
            self._held_tension.latch_anew()

    def _end_mode(self, estimate: Estimate) -> None:
        """Take the event that ends TENSIONING or RELEASING."""
        machine, signs = self.machine, self._signs
        if machine.mode is Mode.RELEASING:
            if self._lowered(estimate):
                machine.on(Event.SLACK)
        elif self.law.tensioned(estimate):
            if signs.passed:
                machine.on(Event.UNTESTED if self.brake.wants_test else Event.TENSIONED)
            elif not signs.probe_mm_s:
                signs.feel(estimate.stroke_mm, self.observer.tension_n)

    def _take_outcome(self, estimate: Estimate) -> None:
        """Keep what the machine has done for the record, and begin the modes that it has entered."""
        done = self.machine.outcome()
        if done is not NOTHING:
            self._done = self._done.then(done)
            self._begin_modes(done.changes, estimate)

    def _begin_modes(self, changes: Sequence[Change], estimate: Estimate) -> None:
        """Start what a change of mode needs: ramp, sign check, travel, a new latch of the stroke."""
        law = self.law
        for change in changes:
            self._orders.look_again()
            if change.before is Mode.FAULT:
                self._stroke_hold.latch_anew()  # motion acknowledged
                self._held_tension.latch_anew()
                self.observer.forget_sinking()
            if change.after is Mode.COMPENSATING:
                self._travel_from = estimate.stroke_mm, law.setpoint_n
            if change.after in (Mode.TENSIONING, Mode.RELEASING):
                self.brake.follow()
                law.begin(estimate.tension_n * self.observer.cosine, estimate.speed_mm_s)
                self._signs.begin(estimate.stroke_mm, self.observer.tension_n, estimate.speed_mm_s)
            if change.event is Event.PAY_OUT:
                law.pay_out(estimate.stroke_mm, self._orders.length_mm)

    def _take_orders(self, t_ns: int) -> None:
        """HOLD comes first, so that no queue of commands delays it."""
        if (hold := self._holds.take(t_ns)) is not None:
            self._orders.take_hold(hold, t_ns)
            self._commanded_ns = t_ns
        if self._commands.waits:
            for slot in self._commands.read(COMMANDS_PER_TICK):
                if self._orders.take(slot, t_ns):
                    self._commanded_ns = t_ns
            if self.machine.pending is Verb.BRAKE_TEST and self.observer.snapshot.drive_enabled:
                self._first_second.begin(self.observer.snapshot)

    def _speed(self, estimate: Estimate) -> float:
        law, mode, trial, snapshot = self.law, self.machine.mode, self._orders.trial, self.observer.snapshot
        regulates, ticks = mode is Mode.COMPENSATING, 1 + self.observer.just_skipped
        free = regulates and trial is None and law.setpoint_n == law.target_n
        added_mm_s = self._probe.speed_mm_s(snapshot, law.command_mm_s, ticks, free=free)
        if trial is not None and trial.moves:
            added_mm_s = trial.wanted_mm_s
        self._added_mm_s = added_mm_s
        unfiltered_mm_s = 0.0  # added where the filter is to see its effect only, as that of a disturbance
        if self.learning is not None:
            self._learned_mm_s = self._learned(self.learning, mode)
        whole_mm_s = added_mm_s + self._learned_mm_s
        if not snapshot.drive_enabled:
            law.follow_speed(0.0)
            law.hold(estimate, self._correction(powered=False))
            speed_mm_s = 0.0
        elif regulates:
            speed_mm_s, unfiltered_mm_s = law.compensating(estimate, self.observer.cosine, whole_mm_s), added_mm_s
        else:
            speed_mm_s = self._unregulated(estimate, whole_mm_s, added_mm_s)
        self.observer.filter.command(speed_mm_s - unfiltered_mm_s)
        if self._table is not None and mode.moves_stroke:
            self._follow_table(self._table, estimate.stroke_mm)
        return speed_mm_s

    def _unregulated(self, estimate: Estimate, whole_mm_s: float, added_mm_s: float) -> float:
        """Speed of an enabled drive in the other modes.

        ``added_mm_s``: by a trial or the probe. ``whole_mm_s``: with that by a move that was learnt.
        """
        law, mode, cosine, trial = self.law, self.machine.mode, self.observer.cosine, self._orders.trial
        if mode is Mode.TENSIONING:
            return law.tensioning(estimate, cosine, self._signs.probe_mm_s, whole_mm_s)
        if mode is Mode.RELEASING:
            return self._releasing(estimate, cosine, whole_mm_s)
        if mode is Mode.HOLD and trial is not None and trial.moves:
            return law.limited(added_mm_s, estimate.stroke_mm)
        powered = self.machine.drive_wanted and (self._carried.corrects or not self._on_motor)
        return law.hold(estimate, self._correction(powered=powered))

    def _follow_table(self, table: GainTable, stroke_mm: float) -> None:
        """Put the entry of the table for this operating point in force."""
        if self._orders.settings.gains_ordered:  # they replace the table
            self._table = None
            return
        observer, law = self.observer, self.law
        entry = table.look(law.rope_setpoint_n, stroke_mm, observer.filter)
        if entry is not None:
            observer.change_filter(entry.filter)
            law.change_gains(entry.gains, entry.stiffness_n_mm)
            self._logbook.event(observer.snapshot.t_ns, Kind.GAINS, text=entry.gains.text)

    def _learned(self, learning: MoveLearning, mode: Mode) -> float:
        observer, (tangential, _, normal, _) = self.observer, self.observer.inclination.state
        ticks, stroke_mm = 1 + observer.just_skipped, observer.snapshot.stroke_mm
        return learning.step(mode, ticks, observer.tension_n, stroke_mm, tangential, normal)

    def _send(self, t_ns: int, speed_mm_s: float) -> None:
        machine, snapshot, outbox = self.machine, self.observer.snapshot, self.outbox
        if machine.stopping:
            self._finish_stop(t_ns)
        if machine.silent:
            self._be_silent(t_ns)
            return
        power = machine.power(t_ns, drive_enabled=snapshot.drive_enabled, drive_faulted=snapshot.drive_faulted)
        unsafe = outbox.safe_frames < SAFE_FRAMES
        if power is Power.OFF and snapshot.drive_enabled and self._off_waits(t_ns, unsafe=unsafe):
            power = Power.ON  # stop first, then power off: a brake must not stop a moving load
        elif power is Power.ON and not snapshot.drive_enabled and unsafe:
            power = Power.OFF
        elif power is not Power.OFF:
            self._off_until = t_ns + STOP_LIMIT_NS
        if power is Power.OFF and snapshot.power.overdue:
            power = Power.CUT  # a drive that says it is off and has not closed its brake loses its power
        word, preload_n = next_controlword(snapshot.power.state, power), self._preload.look(snapshot)
        outbox.command(word, speed_mm_s, self._clock.now(), preload_n, enable=self._enable(power))
        request = self.readback.request(t_ns, armed=machine.mode is not Mode.DISARMED)
        if request is not None and not outbox.request(*request):
            self.readback.unsent()
        if t_ns >= self._start_again_ns:
            self._start_again(t_ns)

    def _be_silent(self, t_ns: int) -> None:
        """Leave the drive to its own supervision, until a start anew is accepted."""
        self.readback.wrote(self.settings.cylinder.node, CONTROLWORD_WRITTEN)
        self.outbox.silence(self._clock.now())
        if self.machine.starts_anew:
            self.finished = True
            self._logbook.event(t_ns, Kind.START_ANEW, self.machine.fault)

    def _start_again(self, t_ns: int) -> None:
        """Repeat NMT start once to the nodes that are not operational, now that they have our heartbeats.

        Not to one that has booted since its configuration: it has lost it.
        """
        first, self._start_again_ns = self._start_again_ns == 0, NEVER_NS
        if first:
            self._start_again_ns = t_ns + START_AGAIN_NS
            return
        for node, state in self.inbox.states.items():
            if state == NmtState.PRE_OPERATIONAL and not self.inbox.restarted:
                self.outbox.start(node)

    def _record(self, t_ns: int, woke_ns: int) -> None:
        logbook, machine = self._logbook, self.machine
        arming = machine.pending is not None or machine.disarming or self.readback.reading_all
        carries = (self.brake.fails or arming or machine.carry_until_ns > 0) and self._carries
        logbook.record(
            self._tick, t_ns, woke_ns - t_ns, self._work_ns, machine, self.observer, self.law, self.outbox,
            self._commands.cursor, self._watch.standing, self._orders.shown_checks,
            added_mm_s=self._added_mm_s, learned_mm_s=self._learned_mm_s, brake_fails=self.brake.shown,
            arming=arming, stroke_known=self.homed.known, carries=carries, end_s=self._ending.left_s,
            slipped_n=self.brake.slipped_n, move=0 if self.learning is None else self.learning.number,
        )  # fmt: skip
        if self.learning is not None:
            logbook.moves(t_ns, self.learning.news)
        done, late = self._done, machine.outcome()
        if late is not NOTHING:
            done = done.then(late)
        if done is not NOTHING:
            self._done = NOTHING
            logbook.mode_changes(t_ns, done.changes, self.outbox.safe_frames)
        self._report(t_ns, done)

    def _report(self, t_ns: int, done: Outcome) -> None:
        """Write what began and ended in this tick, the answers and what came from the bus."""
        logbook, skipped = self._logbook, self.observer.just_skipped
        limits, causes = self._watch.reports()
        for limit, begins in limits:
            logbook.trip(t_ns, Kind.LIMIT if begins else Kind.LIMIT_OVER, limit)
        for cause, begins in causes:
            if not begins or cause != self._tripped:  # the trip's own event has reported this cause
                logbook.trip(t_ns, Kind.CAUSE if begins else Kind.CAUSE_OVER, cause)
        self._tripped = None
        if done is not NOTHING:
            self._orders.reply(t_ns, done.answers)
        logbook.bus_notices(t_ns, self.inbox.notices(), self.readback.report(), self.inbox, self.outbox)
        if skipped >= SKIP_NOTICE:
            logbook.notice(t_ns, Kind.CLOCK, skipped, 0)

    # -- what the tick is made of -------------------------------------------------------------------------------
    def _moving(self) -> bool:
        """The stroke moves, or is commanded to by more than the correction of a held stroke."""
        return abs(self.inbox.speed_mm_s) >= STOPPED_MM_S or self.law.command_mm_s != self._stroke_hold.command_mm_s

    def _enable(self, power: Power) -> bool:
        """The drive's hard-wired enable: set to switch it on, and until it has been off for its brake's time."""
        snapshot = self.observer.snapshot
        lingers = snapshot.drive_may_be_on or not snapshot.power.overdue
        return power is Power.ON or (self.outbox.enable.on and lingers)

    def _off_waits(self, t_ns: int, *, unsafe: bool) -> bool:
        """The power stays on a little longer: the stroke still moves, or too few commands of no speed were sent."""
        held = abs(self.observer.snapshot.stroke_hold.excursion_mm) <= SAID_MM
        return (self._moving() or unsafe) and t_ns < self._off_until and held

    def _look_at_load(self, t_ns: int) -> None:
        """Take note of what carries the load; where the mode keeps the stroke, a change is an event."""
        snapshot, machine = self.observer.snapshot, self.machine
        before, shown, rest = snapshot.held_by, snapshot.power_off, snapshot.load_at_rest
        self.observer.look_at_load(self._watch.standing)
        if snapshot.power_off != shown and snapshot.power_off > PowerOff.AWAITED:
            since_s = self.observer.power_off.since_s(snapshot.t_ns)
            self._logbook.notice(t_ns, Kind.POWER_OFF, snapshot.power_off, int(self.brake.fails), value=since_s)
        if snapshot.held_by is not before and not machine.mode.moves_stroke:
            text = (machine.trial or machine.pending or machine.mode).name.encode()
            until_ns = self._orders.powered_until_ns if machine.trial is not None else machine.carry_until_ns
            left_s = max(0, until_ns - t_ns) * 1e-9
            self._logbook.held(t_ns, before, snapshot.held_by, left_s, text)
        braked = self.observer.snapshot.power.braked and before in _ON_BRAKE and snapshot.held_by in _ON_BRAKE
        braked = braked and not machine.mode.moves_stroke
        if braked and (rest.rests if not snapshot.load_at_rest.rests else self._moved_on_brake):
            self._moved_on_brake = rest.rests
            text = machine.mode.name.encode()
            self._logbook.notice(t_ns, Kind.LOAD_AT_REST, rest, snapshot.load_at_rest, text)

    def _park(self, t_ns: int) -> None:
        """Let the brake take a load that the motor has held for long enough, or lower it where the brake slips."""
        machine, trial = self.machine, self._orders.trial
        until_ns = self._orders.powered_until_ns if trial is not None else machine.carry_until_ns
        measures = trial is not None and not trial.power_s
        powered = machine.drive_wanted and not (machine.stopping or self._ending.delayed)
        if machine.mode is Mode.FAULT and machine.carry_until_ns:
            self._carry_on(t_ns)
        elif self._parking.due(
            t_ns, machine.mode, self.observer.snapshot, powered=powered, until_ns=until_ns, measures=measures
        ):
            machine.park(went_off=not self.observer.snapshot.drive_enabled)
            self._first_second.begin(self.observer.snapshot)

    def _undo_parking(self, t_ns: int) -> None:
        """Have the motor take the load back from a brake that slips in its first second, if nothing else is wrong."""
        first = self._first_second
        if not first.parks:
            return
        first.look(self.observer.snapshot, moves=bool(self._watch.standing & _MOVES_BIT))
        if not first.sank_mm or self._watch.standing & ~SLIP_BITS:
            return
        trip = Trip(Fault.BRAKE_SLIPS, first.sank_mm, UNDO_MM, text=UNDONE_TEXT)
        if self.machine.undo_parking(trip, t_ns):
            self._tripped = trip
            self._logbook.trip(t_ns, Kind.TRIP, trip)
            self._orders.note_slip(first.sank_mm)
            self.brake.set(f"it has slipped by {first.sank_mm:.2f} mm right after a parking")
            self._carried.begin(Witness.BOTH, self._watch.standing, self.observer.snapshot)
        first.end()

    def _look_at_brake(self, t_ns: int, trip: Trip | None) -> Trip | None:
        """Whether the brake is known not to hold; returns what trips then of what trips now."""
        snapshot, brake = self.observer.snapshot, self.brake
        brake.look(self._watch.standing, snapshot, braked=snapshot.drive_off and self.observer.snapshot.power.braked)
        if brake.changed:
            self._take_note_of_brake(t_ns)
        return self._trip_of_carried(snapshot) if self._on_motor else trip

    def _take_note_of_brake(self, t_ns: int) -> None:
        """The brake is known not to hold from now on, or to hold again."""
        brake = self.brake
        brake.noted()
        tension_n, wanted_n = number(self._rope.tension_n), brake.wanted_n if brake.fails else 0.0
        text = brake.why.encode()[:80]
        self._logbook.event(t_ns, Kind.BRAKE_FLAG, int(brake.fails), int(brake.assumed), tension_n, wanted_n, text)

    def _trip_of_carried(self, snapshot: Snapshot) -> Trip | None:
        """What ends a carrying by the motor that alone can hold the load; all other causes are reported."""
        carried, standing = self._carried, self._watch.standing
        carried.look(standing, snapshot, self.law.command_mm_s, 1 + self.observer.just_skipped)
        if carried.strayed_mm:
            return Trip(
                Fault.DRIVE_NOT_FOLLOWING, carried.strayed_mm, FOLLOWS_MM, Action.QUICK_STOP, WITNESS_TEXT
            )  # fmt: skip
        off = self.machine.drive_wanted and not snapshot.drive_enabled  # nothing carries any more
        heeded = standing if off else carried.heeded(standing)
        found = self._watch.strongest(snapshot, heeded) if heeded else None
        return found and replace(found, action=max(found.action, Action.QUICK_STOP))

    def _releasing(self, estimate: Estimate, cosine: float, added_mm_s: float) -> float:
        """Lower the load by the tension, or by the encoder alone where the cell is in doubt."""
        lowering_mm_s = None
        if self._on_motor:
            lowering_mm_s = self._carried.lowering_mm_s(estimate.stroke_mm)
        if lowering_mm_s is None:
            return self.law.releasing(estimate, cosine, added_mm_s)
        return self.law.limited(lowering_mm_s, estimate.stroke_mm)

    def _lowered(self, estimate: Estimate) -> bool:
        """The rope is slack."""
        if self._on_motor and self._carried.by is not Witness.BOTH:
            return self._carried.lowered(estimate.stroke_mm, self.observer.snapshot.t_ns)
        return self.law.slack(estimate)

    @property
    def _on_motor(self) -> bool:
        """The motor alone can hold the load: it carries for a brake that does not, or by a witness that is named."""
        return self.machine.carries and (self.brake.fails or self._carried.named is not Witness.BOTH)

    def _carry_on(self, t_ns: int) -> None:
        """The motor carries while nothing but the slip is wrong; when its time is over, it lowers the load.

        For a brake that is known not to hold it does so whatever else is wrong, see `_trip_of_carried`.
        """
        machine = self.machine
        ended = self._watch.standing & ~SLIP_BITS and not self._on_motor
        if ended or not self.observer.snapshot.drive_enabled:
            machine.park()
        elif t_ns >= machine.carry_until_ns:
            machine.lower(t_ns)

    def _watch_stroke(self, now_ns: int) -> None:
        """Latch the stroke where the mode keeps it, and write an event when it leaves the latch."""
        hold, machine, snapshot, trial = self._stroke_hold, self.machine, self.observer.snapshot, self._orders.trial
        moves = machine.mode.moves_stroke or (trial is not None and trial.moves)
        if moves or self.homed.doubted:  # an unconfirmed position cannot be held
            hold.follow()
        else:
            hold.watch(now_ns, snapshot, self.law.command_mm_s)
            if hold.left:
                self._logbook.event(now_ns, Kind.STROKE_LEFT, machine.mode, value=hold.seen.excursion_mm, limit=SAID_MM)
        if moves or (trial is not None and machine.mode is Mode.DISARMED):  # a weight of a tare or a calibration
            self._held_tension.follow()
        else:
            latched = math.isfinite(hold.reference_mm)
            self._held_tension.watch(snapshot, 1 + self.observer.just_skipped, latched=latched)
            if machine.mode is Mode.DISARMED and not machine.taking:  # hands have lifted it off the brake: no loss
                self._held_tension.forget_loss()

    def _correction(self, *, powered: bool) -> float:
        """Speed in mm/s that brings a held stroke back to its latch."""
        hold, observer = self._stroke_hold, self.observer
        speed_mm_s = hold.correct(observer.snapshot, 1 + observer.just_skipped, powered=powered)
        if hold.creeps:
            self._logbook.event(observer.snapshot.t_ns, Kind.DRIVE_CREEPS, value=hold.creep_mm_s, limit=CREEP_MM_S)
        return speed_mm_s

    def _escalate(self, t_ns: int) -> None:
        """Follow a reaction that has not helped against the latched fault by the next stronger one."""
        machine, slack = self.machine, self.observer.slack
        if machine.fault is not Fault.NONE and self._on_motor:  # what ends that is decided by `_trip_of_carried`
            return
        over = machine.action is Action.RAMP_DOWN and machine.mode is Mode.FAULT
        action = Action.HOLD if over else machine.action
        found = self._escalator.look(machine.fault, action, self.observer.snapshot, t_ns)
        if found is not None:
            text = b"brake fails" if self.brake.fails else b""
            self._logbook.event(t_ns, Kind.ESCALATION, found.fault, found.symptom, found.value, found.limit, text)
            if found.trip is not None:
                machine.trip(found.trip, t_ns, slack=slack)

    def _end(self, t_ns: int) -> None:
        """End as requested: at once, or when the motor has lowered a load that the brake does not hold."""
        machine, ending, before = self.machine, self._ending, self._ending.step
        ending.look(
            t_ns, self.repeated_stops, carries=self._carries, lowers=machine.mode is Mode.RELEASING,
            lowered=machine.fault is Fault.NONE or machine.action is Action.RAMP_DOWN,
        )  # fmt: skip
        if ending.step is not None and ending.step is not before:
            seconds = ending.left_s if ending.delayed else (t_ns - ending.since_ns) * 1e-9
            self._logbook.event(t_ns, Kind.ENDING, ending.step, value=seconds, limit=number(self.inbox.tension_n))
        if ending.due and machine.drive_wanted:
            self._orders.lower_to_end(t_ns)
        elif not ending.delayed:
            self._stop_until = t_ns + STOP_LIMIT_NS + stopping_ns(self.settings)
            machine.stop()

    @property
    def _carries(self) -> bool:
        """The motor has a load that would sink without it, by CARRY or LOWER or on a brake known not to hold."""
        machine = self.machine
        if machine.carries:
            return True
        if not (self.brake.fails and machine.drive_wanted) or machine.mode is Mode.FAULT:
            return False
        return machine.mode is Mode.RELEASING or not self.observer.slack

    def _check_signs(self, now_ns: int) -> None:
        signs, inbox = self._signs, self.inbox
        signs.see(self.law.command_mm_s, inbox.stroke_mm, inbox.tension_n)
        if signs.passed:
            self._held_tension.found_stiffness(signs.slope_n_mm)
            self._probe.found_stiffness(signs.slope_n_mm)
            stiffness = self.settings.plant.stiffness_n_mm
            self._logbook.event(now_ns, Kind.SIGNS, int(signs.warns), value=signs.slope_n_mm, limit=stiffness)

    def _finish_stop(self, t_ns: int) -> None:
        """Once the stroke stands still, let the drive close its brake; end the loop once it is seen off and braked."""
        still = not self._moving()
        late = t_ns >= self._stop_until
        if still or late:
            self.machine.power_off()
        if (still and self.observer.snapshot.power.braked) or late:
            self.finished = True
            inbox = self.inbox
            self._logbook.event(t_ns, Kind.STOPPED, value=number(inbox.stroke_mm), limit=number(inbox.tension_n))

    def _stop_safely(self, t_ns: int, error: Exception) -> None:
        """First send the safe command: no speed, controlword unchanged. Then latch FAULT and record the exception."""
        self._failing += 1
        try:
            word = self.outbox.controlword
            if self._failing > FAILING_TICKS:  # failing ticks do not watch the stroke
                word = next_controlword(drive_state(self.inbox.statusword), Power.QUICK_STOP)
            if self.machine.silent or self._failing > SILENT_TICKS:
                self.outbox.silence(t_ns)
            else:
                self.outbox.command(word, 0.0, t_ns)
        except Exception:  # noqa: BLE001 - the bus itself fails: the drive stops by its own supervision
            self.outbox.count_failure()
        self.law.follow_speed(0.0)
        self.observer.filter.command(0.0)
        self.machine.trip(Trip(Fault.LOOP_EXCEPTION, 0.0, 0.0), t_ns)
        delayed = (self._ending.delayed or self._carries) and self._failing <= FAILING_TICKS
        if self.machine.stopping or (self.stop_requested and not delayed):
            self.machine.stop()
            self.finished = True
        try:
            self._logbook.notice(t_ns, Kind.EXCEPTION, 0, 0, _place(error))
        except Exception:  # noqa: BLE001 - no event can be written; the latched fault is in every record
            self.exceptions_untold += 1


def _place(error: BaseException) -> bytes:
    """Exception and the line it came from, for the event's 80 bytes."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f"{trace.tb_frame.f_code.co_name}:{trace.tb_lineno}" if trace is not None else "?"
    return f"{type(error).__name__} in {where}: {error}".encode()[:80]
