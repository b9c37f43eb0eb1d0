"""One tick: receive, estimate, decide, send, record."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import can

from rigctl.config import RigSettings
from rigctl.control import modes, safety, trials
from rigctl.control.clock import Clock
from rigctl.control.correction import Correction, tare_limit_n
from rigctl.control.estimator import TensionFilter, filter_model
from rigctl.control.inbox import Inbox
from rigctl.control.inclination import InclinationFilter, Stretch
from rigctl.control.machine import Machine
from rigctl.control.modes import Event, Mode, Setting, Situation, Verb
from rigctl.control.outbox import Outbox
from rigctl.control.run_out import RunOutTable, stale_ns
from rigctl.control.safety import Check, Fault, Sight, Trip, Watch
from rigctl.control.signs import SignCheck
from rigctl.control.tension import Estimate, Gains, TensionLaw
from rigctl.devices.drive import Power, next_controlword
from rigctl.devices.objects import DriveState, drive_state
from rigctl.telemetry.events import Kind
from rigctl.telemetry.record import COMMAND_LIFETIME_NS, Flag, Quality
from rigctl.telemetry.ring import RingReader, RingWriter

STOPPED_MM_S = 0.05
STOP_LIMIT_NS = 2_000_000_000
COMMANDS_PER_TICK = 4
NOTICE_NS = 1_000_000_000
NOTICES_KEPT = 64
LEAST_COSINE = 0.5  # a rope at 60 deg: nothing beyond it is believed
SKIP_NOTICE = 5  # ticks skipped at once that are worth an event
_OFF = frozenset({DriveState.READY_TO_SWITCH_ON, DriveState.SWITCH_ON_DISABLED})
_STALE = Quality.STALE.value
LawFactory = Callable[[RigSettings, Gains, Inbox], TensionLaw]
_ENABLED, _ARMING = Flag.DRIVE_ENABLED.value, Flag.ARMING.value


@dataclass(frozen=True)
class Rings:
    """Where a loop's records, events and replies go, and where its commands come from."""

    records: RingWriter
    events: RingWriter
    replies: RingWriter
    commands: RingReader


class Loop:
    """The fixed-rate loop. Bus and clock are passed in; nothing here knows whether they are real."""

    def __init__(
        self,
        settings: RigSettings,
        gains: Gains,
        bus: can.BusABC,
        clock: Clock,
        rings: Rings,
        *,
        supervised: bool,
        law: LawFactory | None = None,
        correction: Correction | None = None,
    ) -> None:
        """``supervised``: start-up has verified that the drive stops by itself when we go silent.

        ``law``: makes another law than ours, to be compared with it; it may look into the inbox.
        ``correction``: of the tension cell, from the ledger.
        """
        self.settings = settings
        self.machine = Machine()
        self.inbox = Inbox(bus, settings)
        self.outbox = Outbox(bus, settings)
        self.filter = TensionFilter(filter_model(settings))
        self.inclination = InclinationFilter(settings)
        self._stretch = Stretch(settings.plant.rope_length_mm, 1.0 / settings.loop.rate_hz)
        self.law = TensionLaw(settings, gains) if law is None else law(settings, gains, self.inbox)
        self.exceptions_untold = 0
        self.finished = False
        self.stop_requested = False
        self._clock, self._rings, self._supervised = clock, rings, supervised
        self._watch, self._sight = Watch(settings), Sight()
        self._tick = self._skipped = self._work_ns = 0
        self._just_skipped = self._failures = 0
        self._noticed: dict[tuple[Kind, int, int], int] = {}  # not again before
        self._skips: deque[tuple[int, int]] = deque(maxlen=4096)
        self._window_ns = settings.safety.overrun_window_ms * 1_000_000
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        self._slope_stale_ns = settings.safety.inclination_stale_ms * 1_000_000
        rail, run_out = settings.rail_encoder, settings.run_out
        self._rail_stale_ns = stale_ns(rail) if rail is not None else 0
        self._run_out = RunOutTable(run_out, settings) if run_out is not None else None
        self._run_out_mm_s, self._rail_age_ns = 0.0, 0
        self._slack_n = settings.tension.slack_n
        self._cosine, self._tension_n, self._power = 1.0, 0.0, Power.OFF
        self._stop_until = self._off_until = 0
        self._trial: trials.Trial | None = None
        self._signs = SignCheck(settings)
        self._found = (0.0, 0.0)  # value and spread of the last trial
        rings.events.write(clock.now(), Kind.STARTED, 0, 0, 0.0, 0.0, b"")
        if correction is not None:
            self._sight.calibration_overdue = correction.overdue
            self._correct(correction, clock.now())

    @property
    def drive_off(self) -> bool:
        """The drive was last seen off, its brake closed."""
        return drive_state(self.inbox.statusword) in _OFF

    # -- the tick -----------------------------------------------------------------------------------------------
    def tick(self) -> None:
        """One period. Whatever goes wrong in it, the drive gets a command, and that command is to stop."""
        t_ns, skipped = self._clock.next_tick()
        woke_ns = self._clock.now()
        try:
            self._receive(woke_ns, skipped)
            estimate = self._estimate(skipped)
            self._decide(t_ns, estimate)
            speed = self._speed(estimate)
            self._send(t_ns, speed)
        except Exception as error:  # noqa: BLE001 - the edge of the tick: recorded, latched, and the stroke held
            self._stop_safely(t_ns, error)
        try:
            self._record(t_ns, woke_ns)
            self._publish(t_ns)
        except Exception as error:  # noqa: BLE001 - the same edge, for what is written down
            self._stop_safely(t_ns, error)
        self._work_ns = self._clock.now() - woke_ns

    def run(self) -> None:
        """Tick until told to stop and stopped."""
        while not self.finished:
            self.tick()

    def _receive(self, now_ns: int, skipped: int) -> None:
        inbox, sight = self.inbox, self._sight
        inbox.drain(now_ns, self.outbox.syncs)
        self._tick += 1 + skipped
        self._just_skipped = skipped
        if skipped:
            self._skipped += skipped
            self._skips.append((now_ns, skipped))
        while self._skips and now_ns - self._skips[0][0] > self._window_ns:
            self._skips.popleft()
        state = drive_state(inbox.statusword)
        sight.tension_n, sight.cell_quality = inbox.tension_n, inbox.cell_quality
        sight.reading_n = inbox.reading_n
        sight.cell_age_ns = now_ns - inbox.cell_t_ns
        sight.inclination_quality = inbox.slope_quality
        sight.inclination_age_ns = now_ns - inbox.slope_t_ns
        self._rail_age_ns = now_ns - inbox.rail_t_ns
        sight.stroke_mm = inbox.stroke_mm
        sight.drive_age_ns = now_ns - inbox.drive_t_ns
        sight.drive_enabled = state is DriveState.OPERATION_ENABLED
        sight.drive_faulted = state is DriveState.FAULT or state is DriveState.FAULT_REACTION_ACTIVE
        sight.bus_age_ns = now_ns - inbox.bus_t_ns
        sight.skipped_in_window = sum(n for _, n in self._skips) if self._skips else 0
        sight.stroke_limited = self.law.limits & Flag.LIMITED_STROKE.value != 0
        sight.speed_error_mm_s = abs(inbox.speed_mm_s - self.law.command_mm_s) if sight.drive_enabled else 0.0
        sight.rope_lost, sight.device_restarted = self.law.rope_lost, inbox.restarted
        if not self._signs.passed and self.machine.mode is Mode.TENSIONING:
            self._check_signs(now_ns)
        sight.drive_wanted = self.machine.drive_wanted and not self.machine.stopping

    def _estimate(self, skipped: int) -> Estimate:
        inbox, kalman, slope = self.inbox, self.filter, self.inclination
        if inbox.slope_fresh:
            slope.update(inbox.tangential_rad, inbox.normal_rad)
        else:
            slope.absent()
        tangential, _, normal, _ = slope.state
        self._cosine = max(LEAST_COSINE, math.cos(tangential) * math.cos(normal))
        stretch_mm_s = self._stretch.speed_mm_s(self._cosine)
        if inbox.cell_fresh:
            self._tension_n = inbox.tension_n
        if self._tension_n < self._slack_n:
            kalman.reset(self._tension_n, inbox.speed_mm_s)
            kalman.known_mm_s = self._run_out_mm_s = 0.0
            if self._run_out is not None:
                self._run_out.lose()
        else:
            if self._run_out is not None:
                self._run_out_mm_s = self._run_out_speed(self._run_out, 1 + skipped)
            kalman.known_mm_s = stretch_mm_s + self._run_out_mm_s
            kalman.update(
                inbox.tension_n if inbox.cell_fresh else None, inbox.speed_mm_s if inbox.drive_fresh else None
            )
        kalman.predict(1 + skipped)
        slope.pass_ticks(1 + skipped)
        self._sight.rejects = max(kalman.cell.rejects, kalman.drive.rejects)
        tension_n, speed_mm_s, disturbance_mm_s = kalman.ahead()
        if not math.isfinite(tension_n + speed_mm_s + disturbance_mm_s):
            kalman.reset(self._tension_n, 0.0)
            raise ArithmeticError("the estimate is not finite")
        if self._run_out is not None:
            disturbance_mm_s += self._run_out.lead_mm_s
        return Estimate(tension_n, speed_mm_s, disturbance_mm_s, inbox.stroke_mm)

    def _run_out_speed(self, table: RunOutTable, ticks: int) -> float:
        """What the table knows; what the filter finds beside it in the tick before, it learns."""
        inbox = self.inbox
        if inbox.rail_quality or self._rail_age_ns > self._rail_stale_ns:
            table.lose()
            return 0.0
        table.follow(inbox.rail_rad, ticks, fresh=inbox.rail_fresh)
        if self.machine.mode is Mode.COMPENSATING:
            table.learn(self.filter.state[2])
        else:
            table.forget_pass()
        return table.speed_mm_s

    def _decide(self, t_ns: int, estimate: Estimate) -> None:
        machine, sight, law = self.machine, self._sight, self.law
        trip = self._watch.trips(sight, machine.mode, t_ns)
        if trip is not None and machine.mode is not Mode.FAULT:
            self._trip(trip, t_ns)
        for slot in self._rings.commands.read(COMMANDS_PER_TICK):
            self._command(slot, t_ns)
        if self.stop_requested and not machine.stopping:
            self._stop_until = t_ns + STOP_LIMIT_NS
            machine.stop()
        machine.follow_drive(sight.drive_enabled, t_ns)
        if self._trial is not None:
            self._attend(self._trial)
        if machine.mode is Mode.TENSIONING and law.tensioned(estimate):
            machine.on(Event.TENSIONED)
        elif machine.mode is Mode.RELEASING and law.slack(estimate):
            machine.on(Event.SLACK)
        for change in machine.changes:
            if change.after in (Mode.TENSIONING, Mode.RELEASING):
                law.begin(estimate.tension_n * self._cosine, estimate.speed_mm_s)
                self._signs.begin(estimate.stroke_mm, self._tension_n)

    def _speed(self, estimate: Estimate) -> float:
        law, mode = self.law, self.machine.mode
        if not self._sight.drive_enabled:
            law.follow_speed(0.0)
            law.hold(estimate)
            speed = 0.0
        elif mode is Mode.TENSIONING:
            speed = law.tensioning(estimate, self._cosine)
        elif mode is Mode.COMPENSATING:
            speed = law.compensating(estimate, self._cosine)
        elif mode is Mode.RELEASING:
            speed = law.releasing(estimate, self._cosine)
        elif mode is Mode.HOLD and self._trial is not None:
            speed = law.limited(self._trial.wanted_mm_s, estimate.stroke_mm)
        else:
            speed = law.hold(estimate)
        self.filter.command(speed)
        return speed

    def _send(self, t_ns: int, speed_mm_s: float) -> None:
        machine, sight, outbox = self.machine, self._sight, self.outbox
        if machine.stopping:
            self._finish_stop(t_ns)
        self._power = machine.power(t_ns, drive_enabled=sight.drive_enabled, drive_faulted=sight.drive_faulted)
        if self._power is Power.OFF and sight.drive_enabled and self._moving() and t_ns < self._off_until:
            self._power = Power.ON  # stop first, then power off: a brake is no place to stop a moving load
        elif self._power is not Power.OFF:
            self._off_until = t_ns + STOP_LIMIT_NS
        state = drive_state(self.inbox.statusword)
        outbox.command(next_controlword(state, self._power, outbox.controlword), speed_mm_s)

    def _moving(self) -> bool:
        return abs(self.inbox.speed_mm_s) >= STOPPED_MM_S or self.law.command_mm_s != 0.0

    # -- what the tick is made of -------------------------------------------------------------------------------
    def _trip(self, trip: Trip, t_ns: int) -> None:
        self.machine.trip(trip)
        self._rings.events.write(t_ns, Kind.TRIP, trip.fault, 0, trip.value, trip.limit, b"")

    def _command(self, slot: object, t_ns: int) -> None:
        given_ns, id_, code, value = (slot[name].item() for name in ("t_ns", "id", "verb", "value"))  # type: ignore[index]
        machine, tension = self.machine, self.settings.tension
        if code not in Verb._value2member_map_ and code not in Setting._value2member_map_:
            self._reply(t_ns, id_, modes.Refusal.UNKNOWN, 0, 0.0)
            return
        if abs(t_ns - given_ns) > COMMAND_LIFETIME_NS:
            self._reply(t_ns, id_, modes.Refusal.EXPIRED, 0, 0.0)
            return
        if code in Setting._value2member_map_:
            self._reply(t_ns, id_, self._set(Setting(code), value, t_ns), 0, value)
            return
        situation = Situation(
            failed_checks=int(self._failed_checks()),
            cause_present=self._watch.present(self._sight) is not Fault.NONE,
            drive_enabled=self._sight.drive_enabled and machine.drive_wanted,
            drive_faulted=self._sight.drive_faulted,
            slack=self._tension_n < self._slack_n,
            unloaded=abs(self.inbox.reading_n) <= tare_limit_n(self.settings),
            target_min_n=tension.target_min_n,
            target_max_n=tension.target_max_n,
        )
        fault = machine.fault
        machine.command(id_, Verb(code), value, situation, t_ns)
        self._trial = trials.begin(machine.trial, self.settings, self.inbox) if machine.trial is not None else None
        if fault is not machine.fault:
            self._rings.events.write(t_ns, Kind.RESET, fault, 0, 0.0, 0.0, b"")
        if code == Verb.TARGET and machine.answers and machine.answers[-1].refusal is modes.Refusal.NONE:
            self.law.target_n = value

    def _check_signs(self, now_ns: int) -> None:
        signs, inbox = self._signs, self.inbox
        fault = signs.see(self.law.command_mm_s, inbox.stroke_mm, inbox.tension_n)
        self._sight.drive_reversed, self._sight.cell_reversed = fault is Fault.SIGN_DRIVE, fault is Fault.SIGN_CELL
        if signs.passed:
            stiffness = self.settings.plant.stiffness_n_mm
            self._rings.events.write(now_ns, Kind.SIGNS, 0, 0, signs.slope_n_mm, stiffness, b"")

    def _attend(self, trial: trials.Trial) -> None:
        """Show a trial this tick; its answer is due when it is over, or when something has put an end to it."""
        if self.machine.trial is not None:
            verdict = trial.see(self.inbox, self._sight)
            if verdict is None:
                return
            self._found = _number(trial.value), _number(trial.spread)
            self.machine.end_trial(verdict)
        self._trial = None

    def _set(self, setting: Setting, value: float, t_ns: int) -> modes.Refusal:
        """What is on record takes effect: standing still, and within its bounds."""
        if setting is Setting.OVERDUE:
            self._sight.calibration_overdue = value != 0.0
            return modes.Refusal.NONE
        inbox = self.inbox
        if self.machine.mode not in (Mode.DISARMED, Mode.HOLD) or self.machine.stopping:
            return modes.Refusal.WRONG_MODE
        if setting is Setting.ZERO and not abs(inbox.reading_n) <= tare_limit_n(self.settings):
            return modes.Refusal.LOADED
        now = inbox.correction
        wanted = replace(now, zero_n=value) if setting is Setting.ZERO else replace(now, scale=value)
        if not wanted.fits(self.settings):
            return modes.Refusal.OUT_OF_RANGE
        self._correct(wanted, t_ns)
        return modes.Refusal.NONE

    def _correct(self, correction: Correction, t_ns: int) -> None:
        """Read the cell anew; the filter starts again from there, for a step in what is seen is no innovation."""
        self.inbox.correct(correction)
        if math.isfinite(self.inbox.tension_n):
            self._tension_n = self.inbox.tension_n
            self.filter.reset(self._tension_n, self.inbox.speed_mm_s)
        self._rings.events.write(t_ns, Kind.CORRECTION, 0, 0, correction.zero_n, correction.scale, b"")

    def _failed_checks(self) -> Check:
        verified = self._supervised and not self.inbox.restarted
        return safety.preflight(self._sight, self.settings, supervision_verified=verified)

    def _finish_stop(self, t_ns: int) -> None:
        """Once the stroke stands still, let the drive close its brake; once it has, the loop may end."""
        still = not self._moving()
        late = t_ns >= self._stop_until
        if still or late:
            self.machine.power_off()
        if (still and not self._sight.drive_enabled) or late:
            self.finished = True
            self._rings.events.write(
                t_ns, Kind.STOPPED, 0, 0, _number(self.inbox.stroke_mm), _number(self.inbox.tension_n), b""
            )

    def _stop_safely(self, t_ns: int, error: Exception) -> None:
        """The safe command first: no speed, the drive as it is. Then FAULT, latched, and a word about why."""
        try:
            self.outbox.command(self.outbox.controlword, 0.0)
        except Exception:  # noqa: BLE001 - the bus itself fails: the drive stops by its own supervision
            self.outbox.failures += 1
        self.law.follow_speed(0.0)
        self.filter.command(0.0)
        self.machine.trip(Trip(Fault.LOOP_EXCEPTION, 0.0, 0.0))
        if self.machine.stopping or self.stop_requested:
            self.machine.stop()
            self.finished = True
        try:
            self._notice(t_ns, Kind.EXCEPTION, 0, 0, _place(error))
        except Exception:  # noqa: BLE001 - nowhere left to say it; the latched fault is in every record
            self.exceptions_untold += 1

    def _record(self, t_ns: int, woke_ns: int) -> None:
        inbox, outbox, sight, law, kalman = self.inbox, self.outbox, self._sight, self.law, self.filter
        x, slope = kalman.state, self.inclination
        flags = law.limits | (_ENABLED if sight.drive_enabled else 0) | (_ARMING if self.machine.arming else 0)
        self._rings.records.write(
            t_ns,
            self._tick,
            self._skipped,
            woke_ns - t_ns,
            self._work_ns,
            self.machine.mode,
            self.machine.fault,
            flags,
            inbox.tension_n,
            inbox.reading_n,
            sight.cell_age_ns,
            inbox.cell_quality | (_STALE if sight.cell_age_ns > self._stale_ns else 0),
            inbox.tangential_rad,
            inbox.normal_rad,
            sight.inclination_age_ns,
            inbox.slope_quality | (_STALE if sight.inclination_age_ns > self._slope_stale_ns else 0),
            inbox.stroke_mm,
            inbox.speed_mm_s,
            sight.drive_age_ns,
            _STALE if sight.drive_age_ns > self._stale_ns else 0,
            inbox.statusword,
            outbox.controlword,
            law.command_mm_s,
            law.target_n,
            law.rope_setpoint_n,
            inbox.tension_n * self._cosine,
            x[0],
            x[1],
            x[2],
            law.integral_mm_s,
            kalman.cell.innovation,
            kalman.cell.variance,
            kalman.cell.verdict,
            kalman.cell.nis,
            kalman.drive.innovation,
            kalman.drive.variance,
            kalman.drive.verdict,
            kalman.drive.nis,
            *slope.state,
            slope.tangential.innovation,
            slope.tangential.variance,
            slope.tangential.verdict,
            slope.tangential.nis,
            slope.normal.innovation,
            slope.normal.variance,
            slope.normal.verdict,
            slope.normal.nis,
            kalman.known_mm_s - self._run_out_mm_s,
            outbox.sent,
            inbox.received,
            inbox.frames_missing(),
            inbox.refused,
            outbox.failures,
            inbox.error_frames,
            inbox.rail_rad,
            inbox.rail_quality | (_STALE if self._rail_age_ns > self._rail_stale_ns else 0),
            self._run_out_mm_s,
        )

    def _publish(self, t_ns: int) -> None:
        """What is not in every tick: mode changes, answers, notices of the bus."""
        machine, events = self.machine, self._rings.events
        if machine.changes:
            for change in machine.changes:
                events.write(t_ns, Kind.MODE, change.before, change.after, float(change.event), 0.0, b"")
            machine.changes.clear()
        if machine.answers:
            for answer in machine.answers:
                checks = int(self._failed_checks()) if answer.refusal is modes.Refusal.PREFLIGHT else 0
                value = self.law.target_n if answer.verb in (Verb.TARGET, Verb.TENSION) else _number(self._tension_n)
                if answer.refusal is modes.Refusal.CAUSE_PRESENT:
                    value = float(self._watch.present(self._sight))
                elif answer.refusal is modes.Refusal.LOADED:
                    value = _number(self.inbox.reading_n)
                spread = 0.0
                if answer.verb in modes.TRIED_IN and answer.refusal is modes.Refusal.NONE:
                    value, spread = self._found
                self._reply(t_ns, answer.id, answer.refusal, checks, value, spread)
            machine.answers.clear()
        inbox = self.inbox
        for kind, notices in (
            (Kind.EMERGENCY, inbox.emergencies),
            (Kind.NODE_STATE, inbox.node_states),
            (Kind.BUS_ERROR, inbox.bus_errors),
        ):
            if notices:
                for a, b in notices:
                    self._notice(t_ns, kind, a, b)
                notices.clear()
        if self._just_skipped >= SKIP_NOTICE:
            self._notice(t_ns, Kind.CLOCK, self._just_skipped, 0)
        if self.outbox.failures != self._failures:
            self._failures = self.outbox.failures
            self._notice(t_ns, Kind.SEND_FAILED, 0, 0, self.outbox.failure_text.encode()[:80])

    def _notice(self, t_ns: int, kind: Kind, a: int, b: int, text: bytes = b"") -> None:
        """An event, the same one at most once a second: a babbling bus must not drown the others."""
        if t_ns >= self._noticed.get((kind, a, b), 0):
            if len(self._noticed) >= NOTICES_KEPT:
                self._noticed.clear()
            self._noticed[kind, a, b] = t_ns + NOTICE_NS
            self._rings.events.write(t_ns, kind, a, b, 0.0, 0.0, text)

    def _reply(
        self, t_ns: int, id_: int, refusal: modes.Refusal, checks: int, value: float, spread: float = 0.0
    ) -> None:
        accepted = refusal is modes.Refusal.NONE
        self._rings.replies.write(t_ns, id_, accepted, refusal, checks, self.machine.mode, value, spread)


def _number(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _place(error: BaseException) -> bytes:
    """Exception and the line it came from, for the event's 80 bytes."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f"{trace.tb_frame.f_code.co_name}:{trace.tb_lineno}" if trace is not None else "?"
    return f"{type(error).__name__} in {where}: {error}".encode()[:80]
