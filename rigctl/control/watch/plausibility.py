"""Comparisons that no single signal shows: stroke against command, and tension against stroke.

Each figure is updated every tick and decays over a time constant, so that small steady errors do not add up.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_step import CellStep
from rigctl.control.bus.inbox import Inbox
from rigctl.control.findings import PlausibilitySeen
from rigctl.model.states import Mode
from rigctl.model.verbs import STROKE_TOLERANCE_MM

STROKE_MEMORY_S = 1.0
CONTRADICTION_MEMORY_S = 0.2
STRETCH_MEMORY_S = 2.0
UNREST_S = 0.1
OVERSHOOT = 1.25
"""Of a command, which a drive may exceed."""
COMMANDED_LAGS = 2.0
"""Memory of commands in lags of the drive: its speed follows the one before last for one lag."""
GROWTHS = 2
"""Growing samples in a row: a count of a coarse encoder that toggles makes one."""
TAKING_S, TAKING_MM_S_N = 0.1, 0.055
"""While the motor takes a load from the brake, the load turns it back by up to so much per newton: 2 / (e m w) for a
speed controller of 27 Hz, a factory setting, on 80 kg."""
LARGEST_STEP_NOISES = 150.0  # and 1 mm of stretch; a larger step counts as this sum
RATE_S = 0.005
LATCH_TICKS = 1  # a value latched by the drive in one tick is read in the next


class DriveModel:
    """The stroke that the drive's lag and delay make of the commands sent; ``speed_mm_s``: its speed now."""

    def __init__(self, settings: RigSettings) -> None:
        plant = settings.plant
        self._dt = dt = 1.0 / settings.loop.rate_hz
        self._share = 1.0 - math.exp(-dt / plant.cylinder_lag_s)
        self._sent = [0.0] * (round(plant.command_delay_s / dt) + LATCH_TICKS)
        self._at = 0
        self.speed_mm_s = 0.0

    def follow(self, speed_mm_s: float) -> None:
        """A drive that moved by itself, or not at all, has this speed."""
        self.speed_mm_s = speed_mm_s

    def advance(self, command_mm_s: float, ticks: int) -> float:
        """``ticks`` under the command sent in the last one; returns the way in mm."""
        sent, travel_mm = self._sent, 0.0
        delays = min(ticks, len(sent))
        for _ in range(delays):
            delayed, sent[self._at] = sent[self._at], command_mm_s
            self._at = (self._at + 1) % len(sent)
            self.speed_mm_s += (delayed - self.speed_mm_s) * self._share
            travel_mm += self.speed_mm_s * self._dt
        if rest := ticks - delays:  # all under the last command, in one step however long the loop was stopped
            left_mm_s, keep = self.speed_mm_s - command_mm_s, (1.0 - self._share) ** rest
            self.speed_mm_s = command_mm_s + left_mm_s * keep
            travel_mm += (rest * command_mm_s + left_mm_s * (1.0 - keep) * (1.0 - self._share) / self._share) * self._dt
        return travel_mm


class Plausibility:
    """Makes ``seen`` of signals that are compared with each other; call ``look`` every tick."""

    def __init__(self, settings: RigSettings) -> None:
        plant = settings.plant
        self._dt = dt = 1.0 / settings.loop.rate_hz
        self._stiffness = plant.stiffness_n_mm
        self._drive = DriveModel(settings)
        self._stroke_keep = math.exp(-dt / STROKE_MEMORY_S)
        self._contradiction_keep = math.exp(-dt / CONTRADICTION_MEMORY_S)
        self._stretch_keep = math.exp(-dt / STRETCH_MEMORY_S)
        self._stroke_mm = self._tension_n = self._smooth_n = self._repeated_n = math.nan
        self._largest_n = LARGEST_STEP_NOISES * settings.tension_cell.noise_n + plant.stiffness_n_mm
        self._compliance, self._yield_share = 0.0, 0.0  # of the mechanism: mm/N, and what it gives way by in a tick
        if plant.mechanism_n_mm is not None:
            self._compliance = 1.0 / plant.mechanism_n_mm
            self._yield_share = 1.0 - math.exp(-dt * math.sqrt(1e3 * plant.mechanism_n_mm / plant.payload_kg))
        self._yielded_mm = math.nan
        self._unrest_share = dt / UNREST_S
        self._step, self._unmeasured = CellStep(settings), 0  # ticks since the cell's newest sample
        self._unheard, self._modelled_mm = 0, 0.0  # ticks since the drive's newest sample; modelled distance in them
        self.seen = PlausibilitySeen()
        self._commanded_keep = math.exp(-dt / (COMMANDED_LAGS * plant.cylinder_lag_s))
        self._highest_mm_s = self._lowest_mm_s = 0.0  # command, with its memory
        self._beyond_mm_s, self._growths = 0.0, 0
        self._enabled_s = 0.0

    def look(
        self, inbox: Inbox, command_mm_s: float, *, ticks: int, drive_enabled: bool, slack: bool, mode: Mode
    ) -> None:
        """One tick, ``ticks`` after the last; ``command_mm_s`` was sent in the last one, ``mode`` is the mode after it.

        Of a held stroke the stretch is latched instead (`rigctl.control.load.held_tension`).
        """
        seen = self.seen
        self._unmeasured += ticks
        if inbox.cell_fresh:
            self._look_at_cell(inbox, slack)
        self._modelled_mm += self._drive.advance(command_mm_s, ticks)
        self._unheard += ticks
        self._look_for_runaway(inbox, command_mm_s, ticks, drive_enabled)
        moved_mm = said_mm = modelled_mm = 0.0
        if inbox.drive_fresh:
            if math.isfinite(self._stroke_mm):
                moved_mm = inbox.drive.stroke_mm - self._stroke_mm
                said_mm = inbox.drive.speed_mm_s * self._unheard * self._dt
                modelled_mm = self._modelled_mm
            self._stroke_mm, self._unheard, self._modelled_mm = inbox.drive.stroke_mm, 0, 0.0
        if drive_enabled:
            seen.speed_error_mm_s = abs(inbox.drive.speed_mm_s - self._drive.speed_mm_s)
            seen.stroke_error_mm = self._stroke_keep * seen.stroke_error_mm + moved_mm - modelled_mm
        else:
            self._drive.follow(inbox.drive.speed_mm_s)
            seen.speed_error_mm_s = seen.stroke_error_mm = 0.0
        # A jump while the drive is off is the stroke's own fault; its trace must not trip the arming that follows.
        jumped = not drive_enabled and abs(moved_mm - said_mm) > STROKE_TOLERANCE_MM
        apart_mm = 0.0 if jumped else moved_mm - said_mm
        seen.contradiction_mm = self._contradiction_keep * seen.contradiction_mm + apart_mm
        self._look_at_stretch(inbox, drive_enabled and mode.moves_stroke, moved_mm, slack)

    def _look_for_runaway(self, inbox: Inbox, command_mm_s: float, ticks: int, drive_enabled: bool) -> None:
        keep = self._commanded_keep**ticks
        self._highest_mm_s = max(command_mm_s, self._highest_mm_s * keep, 0.0)
        self._lowest_mm_s = min(command_mm_s, self._lowest_mm_s * keep, 0.0)
        self._enabled_s = self._enabled_s + ticks * self._dt if drive_enabled else 0.0
        if not inbox.drive_fresh:
            return
        speed_mm_s, before_mm_s = inbox.drive.speed_mm_s, self._beyond_mm_s
        beyond_mm_s = max(speed_mm_s - OVERSHOOT * self._highest_mm_s, OVERSHOOT * self._lowest_mm_s - speed_mm_s, 0.0)
        self._beyond_mm_s = beyond_mm_s if drive_enabled else 0.0
        self._growths = self._growths + 1 if self._beyond_mm_s > before_mm_s else 0
        taking = self._enabled_s < TAKING_S and math.isfinite(inbox.cell.tension_n)
        allowed_mm_s = TAKING_MM_S_N * max(0.0, inbox.cell.tension_n) if taking else 0.0
        self.seen.runaway_mm_s = max(0.0, self._beyond_mm_s - allowed_mm_s) if self._growths >= GROWTHS else 0.0

    def _look_at_cell(self, inbox: Inbox, slack: bool) -> None:
        seen = self.seen
        self._step.look(inbox.cell.reading_n, self._unmeasured, seen.cell_unrest_n, slack=slack)
        seen.cell_step_n, self._unmeasured = self._step.step_n, 0
        step_n = abs(inbox.cell.reading_n - self._repeated_n)
        seen.cell_repeats = seen.cell_repeats + 1 if step_n == 0.0 else 0
        self._repeated_n = inbox.cell.reading_n
        if math.isfinite(step_n):
            seen.cell_unrest_n += (min(step_n, self._largest_n) - seen.cell_unrest_n) * self._unrest_share
        if not math.isfinite(self._smooth_n):
            self._smooth_n = inbox.cell.tension_n
        seen.tension_rate_n_s = (inbox.cell.tension_n - self._smooth_n) / RATE_S
        self._smooth_n += (inbox.cell.tension_n - self._smooth_n) * min(1.0, self._dt / RATE_S)

    def _look_at_stretch(self, inbox: Inbox, moving: bool, moved_mm: float, slack: bool) -> None:
        seen = self.seen
        if not moving or not math.isfinite(self._tension_n):
            seen.unexplained_mm, self._yielded_mm = 0.0, math.nan
        else:  # a slack rope takes up stroke without a change of tension, but does not lose tension either
            gained_mm = (inbox.cell.tension_n - self._tension_n) / self._stiffness if inbox.cell_fresh else 0.0
            explained_mm = (0.0 if slack else moved_mm) - self._yields_mm()
            seen.unexplained_mm = self._stretch_keep * seen.unexplained_mm + gained_mm - explained_mm
        if inbox.cell_fresh:
            self._tension_n = inbox.cell.tension_n

    def _yields_mm(self) -> float:
        """What the mechanism gives way by in this tick under the tension, of first order at its own frequency."""
        if not math.isfinite(self._yielded_mm):
            self._yielded_mm = self._compliance * self._tension_n
        step_mm = (self._compliance * self._tension_n - self._yielded_mm) * self._yield_share
        self._yielded_mm += step_mm
        return step_mm
