"""The snapshot and the estimate of a tick, from the newest samples in the inbox."""

from __future__ import annotations

import math
from collections import deque

from rigctl.config.settings import RigSettings
from rigctl.control.arming import Standstill
from rigctl.control.estimator import TensionFilter, filter_model
from rigctl.control.inbox import Inbox
from rigctl.control.inclination import InclinationFilter, Stretch
from rigctl.control.run_out import RunOutTable, stale_ns
from rigctl.control.safety import EStop, Snapshot, status_stale_ns
from rigctl.control.tension import Estimate
from rigctl.devices.objects import (
    OFF_STATES,
    STATUS_FOLLOWS,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
    STATUS_WARNING,
    DriveState,
    drive_state,
)
from rigctl.ipc.correction import Correction

_SECOND_NS = 1_000_000_000
IO_NODE = EStop.IO_NODE.value
UNLOADED_REJECTS = 3  # rejects after which, with the drive off, a rope loaded or let go by hand is believed
LEAST_COSINE = 0.5  # a rope at 60 deg; larger angles are not believed


class Observer:
    """Reads the inbox and runs the filters. ``snapshot`` is for safety, ``estimate`` for the law."""

    def __init__(self, settings: RigSettings, inbox: Inbox) -> None:
        self.inbox = inbox
        self.snapshot = Snapshot(heartbeats_t_ns=inbox.heartbeats_t_ns, node_states=inbox.states)
        self.filter = TensionFilter(filter_model(settings))
        self.inclination = InclinationFilter(settings)
        self.tension_n = 0.0  # newest good sample
        self.cosine = 1.0  # of the rope against the vertical
        self.run_out_mm_s = 0.0  # disturbance speed from the run-out table
        self.rail_age_ns = 0
        self.skipped = self.just_skipped = 0
        self._stretch = Stretch(settings.plant.rope_length_mm, 1.0 / settings.loop.rate_hz)
        self._skips: deque[tuple[int, int]] = deque(maxlen=4096)
        self._errors: deque[tuple[int, int]] = deque(maxlen=4096)  # time, error frames up to then
        self._errors_before = 0  # error frames older than a second
        self._window_ns = settings.safety.overrun_window_ms * 1_000_000
        self._slack_n = settings.tension.slack_n
        rail, run_out = settings.rail_encoder, settings.run_out
        self.rail_stale_ns = stale_ns(rail) if rail is not None else 0
        self._status_stale_ns = status_stale_ns(settings)
        self._io_fitted = settings.io is not None
        self._e_stop_fitted = settings.cylinder.e_stop_input is not None
        self._run_out = RunOutTable(run_out, settings) if run_out is not None else None
        self._standstill = Standstill(settings)
        self._off_since_ns: int | None = None

    @property
    def slack(self) -> bool:
        """The rope does not pull."""
        return self.tension_n < self._slack_n

    def look(self, now_ns: int, skipped: int) -> None:
        """Make this tick's snapshot from the inbox; ``skipped`` ticks passed since the last one."""
        inbox, snapshot = self.inbox, self.snapshot
        self.just_skipped = skipped
        snapshot.t_ns = now_ns
        if skipped:
            self.skipped += skipped
            self._skips.append((now_ns, skipped))
        while self._skips and now_ns - self._skips[0][0] > self._window_ns:
            self._skips.popleft()
        state = drive_state(inbox.statusword)
        snapshot.tension_n, snapshot.cell_quality = inbox.tension_n, inbox.cell_quality
        snapshot.reading_n = inbox.reading_n
        snapshot.cell_age_ns = now_ns - inbox.cell_t_ns
        snapshot.inclination_quality = inbox.slope_quality
        snapshot.inclination_age_ns = now_ns - inbox.slope_t_ns
        self.rail_age_ns = snapshot.rail_age_ns = now_ns - inbox.rail_t_ns
        snapshot.stroke_mm, snapshot.speed_mm_s = inbox.stroke_mm, inbox.speed_mm_s
        snapshot.tangential_rad, snapshot.normal_rad = inbox.tangential_rad, inbox.normal_rad
        snapshot.drive_age_ns = now_ns - inbox.drive_t_ns
        snapshot.drive_enabled = state is DriveState.OPERATION_ENABLED
        snapshot.brake_slip_known &= not snapshot.drive_enabled
        snapshot.drive_off = state in OFF_STATES
        snapshot.drive_faulted = state is DriveState.FAULT or state is DriveState.FAULT_REACTION_ACTIVE
        if not (snapshot.drive_off or state is DriveState.FAULT):
            self._off_since_ns = None
        elif self._off_since_ns is None:
            self._off_since_ns = now_ns
        snapshot.off_ns = 0 if self._off_since_ns is None else now_ns - self._off_since_ns
        snapshot.still_ns = self._standstill.look(now_ns, inbox.stroke_mm, inbox.speed_mm_s, snapshot.drive_age_ns)
        self._look_at_drive_status(now_ns)
        if self._io_fitted:
            snapshot.io_age_ns = now_ns - inbox.io_t_ns
            snapshot.e_stop = inbox.e_stop | (inbox.io_e_stop and IO_NODE)
        snapshot.drive_powered = not snapshot.drive_off and not snapshot.drive_faulted
        snapshot.drive_warning = bool(inbox.statusword & STATUS_WARNING)
        snapshot.drive_local = not inbox.statusword & STATUS_REMOTE
        snapshot.drive_limited = bool(inbox.statusword & STATUS_INTERNAL_LIMIT)
        snapshot.drive_ignores = snapshot.drive_enabled and not inbox.statusword & STATUS_FOLLOWS
        snapshot.rival_age_ns, snapshot.rival_words = now_ns - inbox.rival_t_ns, inbox.rival_words
        snapshot.bus_age_ns = now_ns - inbox.bus_t_ns
        snapshot.error_frames = self._recent_error_frames(now_ns)
        snapshot.skipped_in_window = sum(n for _, n in self._skips) if self._skips else 0
        snapshot.device_restarted = inbox.restarted
        snapshot.sensor_emergency, snapshot.drive_emergency = inbox.sensor_emergency, inbox.drive_emergency

    def _look_at_drive_status(self, now_ns: int) -> None:
        """Current, temperature and E-stop, where the drive's status is configured; a stale status counts as unknown."""
        if not self._status_stale_ns:
            return
        inbox, snapshot = self.inbox, self.snapshot
        snapshot.status_age_ns = now_ns - inbox.drive_status_t_ns
        stale = snapshot.status_age_ns > self._status_stale_ns
        snapshot.drive_temperature_c = math.nan if stale else inbox.drive_temperature_c
        snapshot.drive_current_a = math.nan if stale else inbox.drive_current_a
        snapshot.e_stop, snapshot.e_stop_unseen = inbox.e_stop, stale and self._e_stop_fitted

    def estimate(self, skipped: int, *, regulated: bool) -> Estimate:
        """The filters' estimate, predicted to when a command acts; ``regulated``: the run-out table may learn.

        Raises:
            ArithmeticError: the estimate is not finite; the filter has been reset.
        """
        inbox, kalman, slope = self.inbox, self.filter, self.inclination
        if inbox.slope_fresh:
            slope.update(inbox.tangential_rad, inbox.normal_rad)
        else:
            slope.absent()
        tangential, _, normal, _ = slope.state
        self.cosine = max(LEAST_COSINE, math.cos(tangential) * math.cos(normal))
        stretch_mm_s = self._stretch.speed_mm_s(self.cosine)
        if inbox.cell_fresh:
            self.tension_n = inbox.tension_n
        if self.tension_n < self._slack_n:
            kalman.reset(self.tension_n, inbox.speed_mm_s)
            kalman.known_mm_s = self.run_out_mm_s = 0.0
            if self._run_out is not None:
                self._run_out.lose()
        else:
            if self._run_out is not None:
                self.run_out_mm_s = self._run_out_speed(self._run_out, 1 + skipped, regulated)
            kalman.known_mm_s = stretch_mm_s + self.run_out_mm_s
            kalman.update(
                inbox.tension_n if inbox.cell_fresh else None, inbox.speed_mm_s if inbox.drive_fresh else None
            )
            if kalman.cell.rejects >= UNLOADED_REJECTS and not self.snapshot.drive_enabled:
                kalman.reset(self.tension_n, inbox.speed_mm_s)
        kalman.predict(1 + skipped)
        slope.pass_ticks(1 + skipped)
        snapshot = self.snapshot
        snapshot.rejects = max(kalman.cell.rejects, kalman.drive.rejects)
        snapshot.slope_rejects = max(slope.tangential.rejects, slope.normal.rejects)
        snapshot.cell_nis = kalman.cell.nis
        tension_n, speed_mm_s, disturbance_mm_s = kalman.ahead()
        snapshot.disturbance_mm_s = disturbance_mm_s
        if not math.isfinite(tension_n + speed_mm_s + disturbance_mm_s):
            kalman.reset(self.tension_n, 0.0)
            raise ArithmeticError("the estimate is not finite")
        if self._run_out is not None:
            disturbance_mm_s += self._run_out.lead_mm_s
        return Estimate(tension_n, speed_mm_s, disturbance_mm_s, inbox.stroke_mm)

    def correct(self, correction: Correction) -> None:
        """Apply a correction and restart the filter there: the step it makes in the reading is no innovation."""
        self.inbox.correct(correction)
        if math.isfinite(self.inbox.tension_n):
            self.tension_n = self.inbox.tension_n
            self.filter.reset(self.tension_n, self.inbox.speed_mm_s)

    def _recent_error_frames(self, now_ns: int) -> int:
        """CAN error frames within the last second."""
        total, seen = self.inbox.error_frames, self._errors
        if total and (not seen or seen[-1][1] != total):
            seen.append((now_ns, total))
        while seen and now_ns - seen[0][0] > _SECOND_NS:
            self._errors_before = seen.popleft()[1]
        return total - self._errors_before

    def _run_out_speed(self, table: RunOutTable, ticks: int, regulated: bool) -> float:
        """Disturbance speed from the table, which learns what the filter found beside it in the tick before."""
        inbox = self.inbox
        if inbox.rail_quality or self.rail_age_ns > self.rail_stale_ns:
            table.lose()
            return 0.0
        table.follow(inbox.rail_rad, ticks, fresh=inbox.rail_fresh)
        if regulated:
            table.learn(self.filter.state[2])
        else:
            table.forget_pass()
        return table.speed_mm_s
