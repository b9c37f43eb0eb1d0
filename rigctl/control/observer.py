"""The snapshot and the estimate of a tick, from the newest samples in the inbox."""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_correction import CellHistory
from rigctl.control.bus.channels import NEVER_NS
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.outbox import Outbox
from rigctl.control.bus.readback import Readback
from rigctl.control.bus.recent_count import RecentCount
from rigctl.control.bus.sync_timing import SyncTiming
from rigctl.control.excitation.loop_probe import NoProbe
from rigctl.control.law.estimator import TensionFilter, filter_model
from rigctl.control.law.inclination import InclinationFilter, Stretch
from rigctl.control.law.run_out import RunOutTable, stale_ns
from rigctl.control.law.stretch_lead import StretchLead
from rigctl.control.law.tension import Estimate, TensionLaw
from rigctl.control.load.held_tension import HeldTension
from rigctl.control.load.homed import Homed
from rigctl.control.load.load_at_rest import LoadRest
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.load.sinking import Sinking
from rigctl.control.load.stroke_hold import StrokeHold
from rigctl.control.load.take_up import TakeUp
from rigctl.control.power.drive_status import DriveStatus
from rigctl.control.power.machine import Machine
from rigctl.control.power.power_off import PowerOffWatch
from rigctl.control.power.power_seen import ON_COMMANDS, PowerDetector, Standstill
from rigctl.control.power.stage import held_by
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.plausibility import Plausibility
from rigctl.control.watch.signs import SignCheck
from rigctl.devices.objects import (
    OFF_STATES,
    STATUS_FOLLOWS,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
    STATUS_WARNING,
    STOPPING_STATES,
    UNPOWERED_STATES,
    Controlword,
    drive_state,
)
from rigctl.ipc.correction import Correction
from rigctl.model.device_states import DriveState
from rigctl.model.states import EStop, Flag, Mode

_SECOND_NS = 1_000_000_000
IO_NODE = EStop.IO_NODE.value
_LIMITED_STROKE, _ENABLE = Flag.LIMITED_STROKE.value, Controlword.ENABLE_OPERATION.value
UNLOADED_REJECTS = 3  # rejects after which, with the drive off, a rope loaded or let go by hand is believed
LEAST_COSINE = 0.5  # a rope at 60 deg; larger angles are not believed


class Observer:
    """Reads the inbox and runs the filters. ``snapshot`` is for safety, ``estimate`` for the law.

    Every field of the snapshot is assigned here, in one place: by `look` from the devices' samples, by
    `look_at_control` from the loop's other parts, and by `estimate` from the filters. A detector's findings are its
    own, in a group that the snapshot holds.
    """

    def __init__(
        self, settings: RigSettings, inbox: Inbox, outbox: Outbox, machine: Machine, law: TensionLaw, homed: Homed,
        readback: Readback, stroke_hold: StrokeHold, held_tension: HeldTension, signs: SignCheck, probe: NoProbe,
        rope: RopeMemory,
    ) -> None:  # fmt: skip
        self.inbox = inbox
        self._outbox, self._machine, self._law, self._homed = outbox, machine, law, homed
        self._readback, self._signs, self._probe = readback, signs, probe
        self._held_tension = held_tension
        self._plausibility, self._take_up = Plausibility(settings), TakeUp(settings)
        self._went_off = True  # the drive has been off since it was last commanded to be enabled
        self._period_s = settings.loop.period_ns * 1e-9
        self._fastest_mm_s = 0.0  # speed seen or commanded since the drive's newest sample
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        self._bus_silent_ns = settings.safety.bus_silent_ms * 1_000_000
        self._power, self._status = PowerDetector(settings), DriveStatus(settings)
        self._sinking = Sinking(settings, rope)
        self.snapshot = Snapshot(
            heartbeats_t_ns=inbox.network.heartbeats_t_ns, node_states=inbox.network.states, power=self._power.seen,
            sinking=self._sinking.seen, plausibility=self._plausibility.seen,
            held_tension=held_tension.seen, stroke_hold=stroke_hold.seen, take_up=self._take_up.seen,
            probe=probe.seen, signs=signs.seen, readback=readback.seen, drive_status=self._status.seen,
        )  # fmt: skip
        self.filter = TensionFilter(filter_model(settings))
        self.inclination = InclinationFilter(settings)
        self.tension_n, self.tight_ns = 0.0, 0  # newest good sample; when the rope was last slack
        self.cosine = 1.0  # of the rope against the vertical
        self.run_out_mm_s = 0.0  # disturbance speed from the run-out table
        self.just_skipped = 0
        self.sensitivity_peak = self.sensitivity_peak_error = math.nan  # of this COMPENSATING, from the gateway
        self._stretch = Stretch(settings.plant.rope_length_mm, 1.0 / settings.loop.rate_hz)
        leads = settings.estimator.inclination_swing_hz is not None
        self._stretch_lead = StretchLead(settings) if leads else None
        self.skips = RecentCount(settings.safety.overrun_window_ms * 1_000_000)  # ticks that were skipped
        self._errors = RecentCount(_SECOND_NS)  # error frames
        self._slack_n = settings.tension.slack_n
        self.slack = True  # the rope does not pull
        # Plain frames come at the device's own time: a SYNC says nothing about them.
        by_sync = settings.tension_cell.dbc is None
        self._sync_timing = SyncTiming(1.0 / settings.loop.rate_hz) if by_sync else None
        self._grid_ns = self._last_grid_ns = NEVER_NS
        rail, run_out = settings.rail_encoder, settings.run_out
        self._rail_stale_ns = stale_ns(rail) if rail is not None else 0
        self._io_fitted, self._warmth_fitted = settings.io is not None, settings.cell_temperature_divisor > 0
        self._io_stale_ns = settings.io.stale_ms * 1_000_000 if settings.io is not None else 0
        self._run_out = RunOutTable(run_out, settings) if run_out is not None else None
        self._standstill = Standstill(settings)
        self.power_off = PowerOffWatch()
        self._load_rest = LoadRest(settings)
        self._rested = False  # the load has been at rest on the closed brake

    def look(self, now_ns: int, skipped: int) -> None:
        """Make this tick's snapshot from the inbox; ``skipped`` ticks passed since the last one."""
        inbox, snapshot, network, drive = self.inbox, self.snapshot, self.inbox.network, self.inbox.drive
        statusword = drive.statusword
        inbox.cell.fuse(drive.stroke_mm, drive.speed_mm_s, now_ns)
        self.just_skipped = skipped
        snapshot.t_ns = now_ns
        skips, errors = self.skips, self._errors
        if skipped:
            skips.add(now_ns, skipped)
        if skips.count:
            skips.look(now_ns)
        state = drive_state(statusword)
        snapshot.tension_n, snapshot.cell_quality = inbox.cell.tension_n, inbox.cell.quality
        snapshot.reading_n = inbox.cell.reading_n
        snapshot.cell_age_ns = now_ns - inbox.cell.t_ns
        snapshot.cell_heard = snapshot.cell_age_ns <= self._stale_ns
        snapshot.inclination_quality = inbox.slope.quality
        snapshot.inclination_age_ns = now_ns - inbox.slope.t_ns
        snapshot.rail_age_ns = now_ns - inbox.rail.t_ns
        snapshot.stroke_mm, snapshot.speed_mm_s = drive.stroke_mm, drive.speed_mm_s
        snapshot.tangential_rad, snapshot.normal_rad = inbox.slope.tangential_rad, inbox.slope.normal_rad
        snapshot.drive_age_ns = now_ns - drive.t_ns
        snapshot.drive_heard = snapshot.drive_age_ns <= self._stale_ns
        snapshot.drive_enabled = state is DriveState.OPERATION_ENABLED
        snapshot.drive_off = state in OFF_STATES
        snapshot.drive_faulted = state is DriveState.FAULT or state is DriveState.FAULT_REACTION_ACTIVE
        snapshot.still_ns = self._standstill.look(now_ns, drive.stroke_mm, drive.speed_mm_s, snapshot.drive_heard)
        self._status.look(now_ns, inbox, off=snapshot.drive_off)
        self._power.look(
            now_ns, state, self._outbox.controlword, snapshot.still_ns,
            heard=snapshot.drive_heard, current=snapshot.drive_status.flows,
        )  # fmt: skip
        self._sinking.look(now_ns, snapshot)
        self._look_at_fitted(now_ns)
        snapshot.e_stop = inbox.drive_status.e_stop | (inbox.inputs.e_stop and IO_NODE)
        snapshot.drive_warning = statusword & STATUS_WARNING != 0
        snapshot.drive_local = not statusword & STATUS_REMOTE
        snapshot.drive_limited = statusword & STATUS_INTERNAL_LIMIT != 0
        snapshot.drive_ignores = snapshot.drive_enabled and not statusword & STATUS_FOLLOWS
        snapshot.master_age_ns, snapshot.master_words = now_ns - network.master_t_ns, network.master_words
        snapshot.bus_age_ns = now_ns - inbox.bus_t_ns
        if network.error_frames != errors.total:
            errors.add(now_ns, network.error_frames - errors.total)
        if errors.count:
            errors.look(now_ns)
        snapshot.error_frames, snapshot.skipped_in_window = errors.count, skips.count
        snapshot.device_restarted = network.restarted
        snapshot.sensor_emergency, snapshot.drive_emergency = network.sensor_emergency, network.drive_emergency
        self._plausibility.look(
            inbox, self._law.command_mm_s if snapshot.drive_enabled else 0.0, ticks=1 + skipped,
            drive_enabled=snapshot.drive_enabled, slack=self.slack, mode=self._machine.mode,
        )  # fmt: skip

    def look_at_control(self, t_ns: int, commanded_ns: int, travel_from: tuple[float, float]) -> None:
        """Add to the snapshot what the loop itself wants and has found; after `look`.

        ``commanded_ns``: when an operator gave the last command. ``travel_from``: stroke in mm and vertical set-point
        in N at the begin of COMPENSATING; the stroke that the set-point has moved since then is no travel.
        """
        snapshot, law, machine, now_ns = self.snapshot, self._law, self._machine, self.snapshot.t_ns
        self._last_grid_ns, self._grid_ns = self._grid_ns, t_ns
        snapshot.lateness_ns, snapshot.command_age_ns = now_ns - t_ns, t_ns - commanded_ns
        compensating = machine.mode is Mode.COMPENSATING
        tight = (compensating or machine.mode is Mode.TENSIONING) and not self.slack
        from_mm, from_n = travel_from
        wanted_mm = (law.setpoint_n - from_n) / (self.cosine * self._probe.stiffness_n_mm)
        snapshot.travel_mm = self.inbox.drive.stroke_mm - from_mm - wanted_mm if compensating else 0.0
        if not compensating:
            self.sensitivity_peak = self.sensitivity_peak_error = math.nan
        least = self.sensitivity_peak - self.sensitivity_peak_error
        snapshot.least_peak = least if least > 0.0 else 0.0
        snapshot.vertical_error_n = self.inbox.cell.tension_n * self.cosine - law.setpoint_n if tight else 0.0
        probe, setpoint_n = self._probe, law.setpoint_n if compensating else max(law.setpoint_n, law.target_n)
        ramping = machine.mode is Mode.TENSIONING and self._signs.passed and not self.slack
        probe.look(snapshot, self.cosine, setpoint_n / self.cosine, ramping=ramping, compensating=compensating)
        status, tensioning = snapshot.drive_status, machine.mode is Mode.TENSIONING
        self._take_up.look(
            status.current_a, status.age_ns, law.command_mm_s, snapshot.tension_n, law.target_n, slack=self.slack,
            tensioning=tensioning,
        )  # fmt: skip
        snapshot.stroke_limited = law.limits & _LIMITED_STROKE != 0
        snapshot.rope_lost = law.rope_lost if tensioning else self._held_tension.lost
        snapshot.drive_wanted = machine.sequence.motor and not machine.sequence.ends
        enabled, commanded = snapshot.drive_enabled, self._outbox.controlword == _ENABLE
        # The stroke's latch watches motion under our own command.
        snapshot.drive_powered = not (snapshot.drive_off or snapshot.drive_faulted or commanded)
        self._went_off = not commanded and (self._went_off or snapshot.drive_off)
        # A silent drive may have obeyed long ago.
        snapshot.drive_not_requested = snapshot.drive_heard and enabled and self._went_off
        self._look_at_power()
        snapshot.drive_off_pending = snapshot.drive_may_be_on and not commanded
        snapshot.stroke_unconfirmed, snapshot.stroke_jump_mm = self._homed.doubted, self._homed.jump_mm
        if self._readback.lost or snapshot.readback.lost:
            self._readback.show()

    @property
    def shown_off(self) -> bool:
        """The drive is off, its brake closed, up to the tick that sends a word that leads to power."""
        return self.snapshot.power.braked and self._outbox.controlword not in ON_COMMANDS

    def look_at_load(self, standing: int) -> None:
        """What carries the load, whether it rests and a power off is confirmed, after this tick's decision.

        ``standing``: the causes that are active, see `Fault.bit`.
        """
        snapshot, machine, rest, seen = self.snapshot, self._machine, self._load_rest, self.snapshot.power
        braked = seen.braked
        snapshot.load_at_rest = rest.look(standing | machine.fault.bit, snapshot)
        snapshot.power_off = self.power_off.look(machine.fault, machine.sequence.action, snapshot, rest, braked=braked)
        rests = snapshot.load_at_rest.rests
        self._rested &= braked
        settles = not self._rested and seen.settles and not snapshot.sinking.speed_mm_s
        self._rested |= braked and rests and seen.left_alone
        snapshot.held_by = held_by(
            machine.sequence,
            machine.mode,
            known=snapshot.drive_heard,
            enabled=snapshot.drive_enabled,
            braked=braked,
            rests=rests and self._rested,
            settles=settles,
        )

    def _look_at_power(self) -> None:
        """Whether the drive may have power, by commands and fresh samples; and what it may have moved unseen."""
        snapshot, fresh = self.snapshot, self.inbox.drive_fresh
        state = snapshot.power.state
        commanded_on, powered = self._outbox.controlword in ON_COMMANDS, state not in UNPOWERED_STATES
        reported = powered if fresh else snapshot.drive_may_be_on
        snapshot.drive_may_be_on = commanded_on or reported or snapshot.drive_status.lasts
        snapshot.drive_stops = state in STOPPING_STATES
        speed_mm_s = max(abs(snapshot.speed_mm_s) if fresh else self._fastest_mm_s, abs(self._law.command_mm_s))
        self._fastest_mm_s = speed_mm_s
        passed_s = (1 + self.just_skipped) * self._period_s
        unseen = snapshot.drive_may_be_on and not fresh
        snapshot.unseen_mm = snapshot.unseen_mm + speed_mm_s * passed_s if unseen else 0.0

    def take_margins(self, peak: float, error: float) -> None:
        """Take the sensitivity peak measured in this COMPENSATING and its uncertainty; NaN: there is none."""
        self.sensitivity_peak, self.sensitivity_peak_error = peak, error

    def change_filter(self, other: TensionFilter) -> None:
        """Go on with another filter, which has taken over the state of this one."""
        self.filter = other

    def forget_sinking(self) -> None:
        """What the stroke did on the brake before now is acknowledged."""
        self._sinking.forget()

    def _look_at_fitted(self, now_ns: int) -> None:
        """What only some rigs have."""
        inbox, snapshot = self.inbox, self.snapshot
        if self._sync_timing is not None:
            alive = now_ns - inbox.bus_t_ns <= self._bus_silent_ns
            snapshot.sync_age_ns = min(snapshot.drive_age_ns, snapshot.cell_age_ns) if alive else 0
        snapshot.force_gap_n, snapshot.second_known = inbox.second.gap_n, inbox.second.known
        snapshot.second_age_ns, snapshot.second_quality = now_ns - inbox.second.t_ns, inbox.second.quality
        if self._warmth_fitted:
            snapshot.warmth_age_ns = now_ns - inbox.cell_temperature.t_ns
        if self._io_fitted:
            snapshot.io_age_ns = now_ns - inbox.inputs.t_ns
            enable, fresh = self._outbox.enable, snapshot.io_age_ns <= self._io_stale_ns
            snapshot.torque_off = fresh and inbox.inputs.drive_off
            snapshot.enable_ignored = enable.fitted and fresh and inbox.inputs.drive_off is enable.on

    def estimate(self, skipped: int, *, regulated: bool) -> Estimate:
        """The filters' estimate, predicted to when a command acts; ``regulated``: the run-out table may learn.

        Raises:
            ArithmeticError: the estimate is not finite; the filter has been reset.
        """
        inbox, kalman, slope, ahead = self.inbox, self.filter, self.inclination, self._stretch_lead
        if inbox.slope_fresh:
            slope.update(inbox.slope.tangential_rad, inbox.slope.normal_rad)
            if ahead is not None and slope.believed:
                ahead.update(inbox.slope.tangential_rad, inbox.slope.normal_rad)
        else:
            slope.absent()
        tangential, _, normal, _ = slope.state
        self.cosine = max(LEAST_COSINE, math.cos(tangential) * math.cos(normal))
        stretch_mm_s, lead_mm_s = self._stretch.speed_mm_s(self.cosine), 0.0
        if ahead is not None:
            stretch_mm_s, lead_mm_s = ahead.speeds_mm_s()
            ahead.pass_ticks(1 + skipped)
        if inbox.cell_fresh:
            self.tension_n = inbox.cell.tension_n
            self.slack = inbox.cell.tension_n < self._slack_n
        if self.slack:
            self.tight_ns = self.snapshot.t_ns
            kalman.reset(self.tension_n, inbox.drive.speed_mm_s)
            self.run_out_mm_s = 0.0
            if self._run_out is not None:
                self._run_out.lose()
        else:
            if self._run_out is not None:
                known = not inbox.rail.quality and self.snapshot.rail_age_ns <= self._rail_stale_ns
                self.run_out_mm_s = self._run_out.step(
                    inbox.rail.rad, 1 + skipped, kalman.state[2], fresh=inbox.rail_fresh, known=known, learns=regulated
                )
            timing, known_mm_s = self._sync_timing, stretch_mm_s + self.run_out_mm_s
            kalman.update(
                inbox.cell.tension_n if inbox.cell_fresh else None,
                inbox.drive.speed_mm_s if inbox.drive_fresh else None,
                known_mm_s,
                # Where no SYNC latches the samples, none is late.
                timing.late_s(self._outbox.synced_ns, self._last_grid_ns) if timing is not None else 0.0,
            )
            if kalman.cell.rejects >= UNLOADED_REJECTS and not self.snapshot.drive_enabled:
                kalman.reset(self.tension_n, inbox.drive.speed_mm_s, known_mm_s)
        kalman.predict(1 + skipped)
        slope.pass_ticks(1 + skipped)
        snapshot = self.snapshot
        snapshot.rejects = max(kalman.cell.rejects, kalman.drive.rejects)
        snapshot.slope_rejects = max(slope.tangential.rejects, slope.normal.rejects)
        snapshot.cell_nis = kalman.cell.nis
        tension_n, speed_mm_s, disturbance_mm_s, swing_lead_mm_s = kalman.ahead()
        lead_mm_s += swing_lead_mm_s
        snapshot.disturbance_mm_s = disturbance_mm_s
        if not math.isfinite(tension_n + speed_mm_s + disturbance_mm_s + lead_mm_s):
            kalman.reset(self.tension_n, 0.0, kalman.known_mm_s)
            raise ArithmeticError("the estimate is not finite")
        if self._run_out is not None:
            disturbance_mm_s += self._run_out.lead_mm_s
        return Estimate(tension_n, speed_mm_s, disturbance_mm_s, inbox.drive.stroke_mm, lead_mm_s)

    def correct(self, correction: Correction, *, held_s: float = math.nan, history: CellHistory | None = None) -> None:
        """Apply a correction and restart the filter there: the step it makes in the reading is no innovation."""
        self.inbox.cell.correct(correction, held_s=held_s, history=history)
        self._held_tension.latch_anew()
        self._take_up.forget()
        if math.isfinite(self.inbox.cell.tension_n):
            self.tension_n = self.inbox.cell.tension_n
            self.slack = self.tension_n < self._slack_n
            self.filter.reset(self.tension_n, self.inbox.drive.speed_mm_s, self.filter.known_mm_s)
