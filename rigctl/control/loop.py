"""One tick: receive, estimate, decide, send, record."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import can

from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_correction import CellHistory
from rigctl.control.bus.hold_sockets import GivenHolds, HoldSource
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.outbox import CONTROLWORD_WRITTEN, Outbox
from rigctl.control.bus.readback import Readback
from rigctl.control.clock import Clock
from rigctl.control.commands.orders import Orders
from rigctl.control.excitation import frequency_trial
from rigctl.control.excitation.loop_probe import LoopProbe, NoProbe
from rigctl.control.excitation.probe_plan import plan
from rigctl.control.law.gain_table import GainTable
from rigctl.control.law.move_learning import MoveLearning
from rigctl.control.law.tension import Estimate, Gains, TensionLaw
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.held_load import HeldLoad
from rigctl.control.load.held_tension import HeldTension
from rigctl.control.load.homed import Homed, LastStroke
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.load.stroke_hold import StrokeHold
from rigctl.control.load.stroke_motion import StrokeMotion
from rigctl.control.logbook import Logbook, Rings, number
from rigctl.control.observer import Observer
from rigctl.control.power.drive_command import STOP_LIMIT_NS, DriveCommand
from rigctl.control.power.ending import Ending
from rigctl.control.power.machine import NOTHING, Machine, Outcome
from rigctl.control.power.power_seen import stopping_ns
from rigctl.control.power.stage import NOT_LEFT, TickSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.limits import rows as limit_rows
from rigctl.control.watch.safety import Trip, Watch
from rigctl.control.watch.signs import SignCheck
from rigctl.devices.drive import LeftInDrive, Power, next_controlword
from rigctl.devices.objects import drive_state
from rigctl.devices.process_data import ProcessData
from rigctl.devices.sdo import Watched
from rigctl.ipc.correction import Correction
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode, PowerOff
from rigctl.model.verbs import Verb

COMMANDS_PER_TICK = 4
FAILING_TICKS = 100  # consecutive ticks that end in an exception, after which the drive stops and goes off
SILENT_TICKS = 1000  # and after which it is left to its own supervision, whether it has gone off or not
SKIP_NOTICE = 5  # ticks skipped at once from which an event is written
_ENDS_BY_ITSELF = frozenset({Mode.TENSIONING, Mode.RELEASING})
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

        ``host_checks``: failing bits of `rigctl.model.checks.HOST_CHECKS`, until the gateway sends newer ones.
        ``law``: makes another law for comparison with ours; the law may read the inbox.
        ``correction``: of the tension cell, from the ledger. ``watched``: objects start-up has verified in the devices.
        ``found``: what a former controller had left in the drive, for the record.
        ``process_data``: as start-up found it; None: as the rig file has it. ``last_stroke``: the last known stroke.
        ``kept_brake``: whether the brake was known not to hold in the loop before.
        ``cell_history``: of the cell's creep in the loop before; None: not known. ``holds``: HOLD from this computer's
        users; None: there are none.
        """
        self.settings = settings
        self.machine = Machine(stopping_ns(settings), brake_test=settings.cylinder.brake_test)
        self._commanded_ns = started_ns = clock.now()
        self.readback = Readback(watched, settings, started_ns)
        self.homed = Homed(settings.cylinder, last_stroke)
        self.inbox = Inbox(bus, settings, rings.frames, self.readback, process_data)
        self.outbox = Outbox(bus, settings, rings.frames, process_data)
        self.law = TensionLaw(settings, gains) if law is None else law(settings, gains, self.inbox)
        self.learning = MoveLearning(settings, self.law) if settings.learning is not None else None
        self._signs = SignCheck(settings)
        stroke, tension = StrokeHold(settings), HeldTension(settings)
        frequency_trial.prepare(settings)
        quantum_mm = self.inbox.drive.quantum_mm
        self._probe = LoopProbe(settings, plan(settings, gains), quantum_mm) if law is None else NoProbe(settings)
        self._rope = RopeMemory(settings)
        self.observer = Observer(
            settings, self.inbox, self.outbox, self.machine, self.law, self.homed, self.readback, stroke,
            tension, self._signs, self._probe, self._rope,
        )  # fmt: skip
        self.finished = self.stop_requested = False
        self.exceptions_unreported = 0
        self.repeated_stops = 0  # requests to end after the first: the next one leaves a load that delays the end
        self._clock, self._commands = clock, rings.commands
        self._holds: HoldSource = GivenHolds() if holds is None else holds
        self._watch = Watch(settings, limit_rows(settings))
        self._ending = Ending(settings)
        self._tripped: Trip | None = None  # not in a record yet, as is what the machine has done
        self._done = NOTHING
        self._logbook = logbook = Logbook(settings, rings)
        self._load = load = HeldLoad(
            settings, self.machine, self.observer, self.law, self._watch, logbook, self._rope, stroke, tension,
            kept_brake,
        )  # fmt: skip
        self.brake = load.brake
        self._drive = DriveCommand(settings, clock, self.machine, self.observer, self.outbox, self.law, stroke)
        self._orders = Orders(
            settings, self.machine, self.observer, self.law, self._watch, logbook, self.readback, self.homed,
            self.learning, self._holds, load.brake, load.carried, self._rope,
            supervised=supervised,
        )  # fmt: skip
        self._motion = StrokeMotion(
            settings, self.machine, self.observer, self.law, logbook, self._orders, load, self._signs, self._probe,
            self.learning, GainTable.of(settings, gains) if law is None else None,
        )  # fmt: skip
        self._work_ns = self._failing = self._tick = 0  # of a tick; ticks in a row that failed; the tick's number
        logbook.event(started_ns, Kind.STARTED, rings.commands.cursor, rings.holds.head)
        for index, value, left in found:
            logbook.event(started_ns, Kind.FOUND_AT_START, settings.cylinder.node, index << 8, value, left)
        if self.brake.changed:
            load.note_brake(started_ns)
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
            self._load.look(t_ns, self._orders.powered_until_ns)
            speed_mm_s = self._motion.speed_mm_s(estimate)
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
            found = self.homed.look(inbox.drive.stroke_mm, inbox.drive.speed_mm_s, now_ns)
            if found is not None:
                self._logbook.stroke(now_ns, found)
        self._load.watch_stroke(now_ns, self._orders.trial, doubted=self.homed.doubted)
        if not self._signs.passed and machine.mode is Mode.TENSIONING:
            self._motion.check_signs(now_ns)
        observer.look_at_control(t_ns, self._commanded_ns, self._motion.travel_from)

    def _decide(self, t_ns: int, estimate: Estimate) -> None:
        machine, snapshot, orders, held = self.machine, self.observer.snapshot, self._orders, self._load
        trip = self._watch.look(snapshot, machine.watched_mode, t_ns)
        self._rope.look(self._watch.standing, snapshot)
        load = machine.fault is not Fault.NONE or not snapshot.drive_enabled or machine.sequence.carries
        trip = held.look_at_brake(t_ns, trip) if load else trip
        self._tripped = held.undo_parking(t_ns) or self._tripped
        if trip is not None and machine.trip(trip, t_ns, slack=self.observer.slack):
            self._tripped = trip
            self._logbook.trip(t_ns, Kind.TRIP, trip)
        held.escalate(t_ns)
        self._take_orders(t_ns)
        if self.stop_requested and not machine.sequence.ends:
            self._end(t_ns)
        orders.prepare(t_ns)
        if machine.sequence.pending is not None:
            self._follow_drive(t_ns, snapshot)
        if machine.sequence.disarming or snapshot.power.braked is not machine.sequence.off:
            machine.follow_off(t_ns, off=snapshot.power.braked)
        orders.go_on(t_ns)
        held.park(t_ns, orders.trial, orders.powered_until_ns, delayed=self._ending.delayed)
        if machine.mode in _ENDS_BY_ITSELF:
            self._motion.end_mode(estimate)
        self._take_outcome(estimate)

    def _follow_drive(self, t_ns: int, snapshot: Snapshot) -> None:
        """Go on with a command that waits for the drive: to be enabled, or to leave its fault state."""
        machine = self.machine
        if not (machine.sequence.taking or machine.sequence.resetting):
            return
        fault, cause = machine.fault, machine.sequence.resetting and self._watch.present(snapshot) is not Fault.NONE
        latched = machine.mode is Mode.FAULT
        seen = TickSeen(t_ns, snapshot.drive_enabled, snapshot.drive_faulted, cause=cause, latched=latched)
        if machine.follow(seen) is NOT_LEFT:
            self._tripped = trip = Trip(machine.fault, 1.0, 0.0, machine.sequence.action)
            self._logbook.trip(t_ns, Kind.TRIP, trip)
        elif machine.fault is Fault.NONE is not fault:
            self._orders.acknowledged(fault, t_ns)
        if machine.sequence.motor:
            self._load.latch_anew()  # the motor took the load from the brake

    def _take_outcome(self, estimate: Estimate) -> None:
        """Keep what the machine has done for the record, and begin the modes that it has entered."""
        done = self.machine.outcome()
        if done is not NOTHING:
            self._done = self._done.then(done)
            self._motion.begin_modes(done.changes, estimate)

    def _take_orders(self, t_ns: int) -> None:
        """HOLD comes first, so that no queue of commands delays it."""
        if (hold := self._holds.take(t_ns)) is not None:
            self._orders.take_hold(hold, t_ns)
            self._commanded_ns = t_ns
        if self._commands.waits:
            for slot in self._commands.read(COMMANDS_PER_TICK):
                if self._orders.take(slot, t_ns):
                    self._commanded_ns = t_ns
            if self.machine.sequence.pending is Verb.BRAKE_TEST and self.observer.snapshot.drive_enabled:
                self._load.first_second.begin(self.observer.snapshot)

    def _send(self, t_ns: int, speed_mm_s: float) -> None:
        machine, outbox = self.machine, self.outbox
        if machine.sequence.ends:
            self._finish_stop(t_ns)
        if machine.sequence.silent:
            self._be_silent(t_ns)
            return
        self._drive.send(t_ns, speed_mm_s)
        request = self.readback.request(t_ns, armed=machine.mode is not Mode.DISARMED)
        if request is not None and not outbox.request(*request):
            self.readback.unsent()
        if t_ns >= self._drive.start_again_ns:
            self._drive.start_again(t_ns)

    def _be_silent(self, t_ns: int) -> None:
        """Leave the drive to its own supervision, until a start anew is accepted."""
        self.readback.wrote(self.settings.cylinder.node, CONTROLWORD_WRITTEN)
        self.outbox.silence(self._clock.now())
        if self.machine.sequence.anew:
            self.finished = True
            self._logbook.event(t_ns, Kind.START_ANEW, self.machine.fault)

    def _record(self, t_ns: int, woke_ns: int) -> None:
        logbook, machine = self._logbook, self.machine
        arming = machine.sequence.pending is not None or machine.sequence.disarming or self.readback.reading_all
        carries = (self.brake.fails or arming or machine.sequence.carry_until_ns > 0) and self._load.carries
        logbook.record(
            self._tick, t_ns, woke_ns - t_ns, self._work_ns, machine, self.observer, self.law, self.outbox,
            self._commands.cursor, self._watch.standing, self._orders.shown_checks,
            added_mm_s=self._motion.added_mm_s, learned_mm_s=self._motion.learned_mm_s, brake_fails=self.brake.shown,
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
        logbook.bus_notices(t_ns, self.inbox.network.notices(), self.readback.report(), self.inbox, self.outbox)
        if skipped >= SKIP_NOTICE:
            logbook.notice(t_ns, Kind.CLOCK, skipped, 0)

    # -- what the tick is made of -------------------------------------------------------------------------------
    def _end(self, t_ns: int) -> None:
        """End as requested: at once, or when the motor has lowered a load that the brake does not hold."""
        machine, ending, before = self.machine, self._ending, self._ending.step
        ending.look(
            t_ns, self.repeated_stops, carries=self._load.carries, lowers=machine.mode is Mode.RELEASING,
            lowered=machine.fault is Fault.NONE or machine.sequence.action is Action.RAMP_DOWN,
        )  # fmt: skip
        if ending.step is not None and ending.step is not before:
            seconds = ending.left_s if ending.delayed else (t_ns - ending.since_ns) * 1e-9
            self._logbook.event(t_ns, Kind.ENDING, ending.step, value=seconds, limit=number(self.inbox.cell.tension_n))
        if ending.due and machine.sequence.motor:
            self._orders.lower_to_end(t_ns)
        elif not ending.delayed:
            machine.stop(t_ns + STOP_LIMIT_NS + stopping_ns(self.settings))

    def _finish_stop(self, t_ns: int) -> None:
        """Once the stroke stands still, let the drive close its brake; end the loop once it is seen off and braked."""
        still = not self._drive.moves
        late = t_ns >= self.machine.sequence.until_ns
        self.machine.follow(TickSeen(t_ns, ended=still or late))
        if (still and self.observer.snapshot.power.braked) or late:
            self.finished = True
            stroke_mm, tension_n = self.inbox.drive.stroke_mm, self.inbox.cell.tension_n
            self._logbook.event(t_ns, Kind.STOPPED, value=number(stroke_mm), limit=number(tension_n))

    def _stop_safely(self, t_ns: int, error: Exception) -> None:
        """First send the safe command: no speed, controlword unchanged. Then latch FAULT and record the exception."""
        self._failing += 1
        try:
            word = self.outbox.controlword
            if self._failing > FAILING_TICKS:  # failing ticks do not watch the stroke
                word = next_controlword(drive_state(self.inbox.drive.statusword), Power.QUICK_STOP)
            if self.machine.sequence.silent or self._failing > SILENT_TICKS:
                self.outbox.silence(t_ns)
            else:
                self.outbox.command(word, 0.0, t_ns)
        except Exception:  # noqa: BLE001 - the bus itself fails: the drive stops by its own supervision
            self.outbox.count_failure()
        self.law.follow_speed(0.0)
        self.observer.filter.command(0.0)
        self.machine.trip(Trip(Fault.LOOP_EXCEPTION, 0.0, 0.0), t_ns)
        delayed = (self._ending.delayed or self._load.carries) and self._failing <= FAILING_TICKS
        if self.machine.sequence.ends or (self.stop_requested and not delayed):
            self.machine.stop()
            self.finished = True
        try:
            self._logbook.notice(t_ns, Kind.EXCEPTION, 0, 0, _place(error))
        except Exception:  # noqa: BLE001 - no event can be written; the latched fault is in every record
            self.exceptions_unreported += 1


def _place(error: BaseException) -> bytes:
    """Exception and the line it came from, for the event's 80 bytes."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f"{trace.tb_frame.f_code.co_name}:{trace.tb_lineno}" if trace is not None else "?"
    return f"{type(error).__name__} in {where}: {error}".encode()[:80]
