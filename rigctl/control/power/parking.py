"""HOLD and FAULT end on the brake: when the drive's own brake sequence takes the load from the motor.

IEC 61800-5-2 has the words: SOS (safe operating stop) while the motor holds the stroke, SBC (safe brake control) when
the brake has taken it. A motor that holds for longer than seconds holds on the word of one encoder.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.power.power_seen import STILL_NS
from rigctl.control.snapshot import Snapshot
from rigctl.model.states import Mode

REST_NS = 500_000_000
"""Spare time for a stroke to come to rest, beyond which the drive's own stop has to bring it there."""
UNDO_MM = 0.04
"""Of stroke: 0.2 mm/s, at which STROKE_MOVES takes the drive off for good, take longer for it than that row's 0.2 s."""
UNDO_SHARE = 0.5
"""Of that way the tension has to show so much: the rope's stiffness may be off, and a payload may move."""
UNDONE_TEXT = " right after it had taken the load, the motor takes it back"
_UNDO_SMOOTH_S = 0.02  # of the cell's noise


class Parking:
    """Times how long the motor has held. ``due``: whether the brake takes the load now."""

    def __init__(self, settings: RigSettings, stop_ns: int) -> None:
        """``stop_ns``: time in which a drive that obeys stops."""
        self._park_ns = round(settings.hold.park_s * 1e9)
        self._rest_ns = stop_ns + REST_NS
        self._brake = settings.cylinder.brake_waiver is None
        self._mode = Mode.DISARMED
        self._since_ns = 0

    def due(
        self, t_ns: int, mode: Mode, snapshot: Snapshot, *, powered: bool, until_ns: int, measures: bool = False
    ) -> bool:
        """Whether the brake takes the load now.

        In HOLD that is after ``hold.park_s`` at standstill, in FAULT at standstill; in both, once a stop should long
        have ended, without it: a stroke that does not come to rest is not held.

        Args:
            t_ns: now.
            mode: the mode.
            snapshot: of this tick.
            powered: the motor has the load.
            until_ns: the motor keeps the load until then, for a trial or a CARRY; 0: no.
            measures: a trial waits for the brake, which takes the load at standstill, as in FAULT.
        """
        if not powered or not mode.parks or t_ns < until_ns or mode is not self._mode:
            self._mode, self._since_ns = mode, t_ns
            return False
        if not self._brake:
            return False
        if mode is Mode.FAULT and not snapshot.drive_enabled:  # it has closed its brake by itself
            return True
        held_ns, wanted_ns = t_ns - self._since_ns, STILL_NS if mode is Mode.FAULT or measures else self._park_ns
        if min(held_ns, snapshot.still_ns) >= wanted_ns:
            return True
        return held_ns >= self._rest_ns + (0 if mode is Mode.FAULT else self._park_ns)


class FirstSecond:
    """The first second after a parking, in which a brake that slips is found by stroke and tension together.

    ``sank_mm``: how far the load has sunk on the closed brake, shown by both; 0 otherwise. Later, or by one of them
    alone, nothing is switched on but by CARRY. ``parks``: the second is not over.
    """

    def __init__(self, settings: RigSettings) -> None:
        plant = settings.plant
        self._stiffness = plant.slow_stiffness_n_mm
        self._least_mm = max(UNDO_MM, settings.tension_cell.noise_n / self._stiffness)
        self._share = settings.loop.period_ns * 1e-9 / _UNDO_SMOOTH_S
        self._slack_n = settings.tension.slack_n
        self.sank_mm = 0.0
        self.end()

    def begin(self, snapshot: Snapshot) -> None:
        """The brake is to take the load. A motor that has not held it at standstill is not to have it back."""
        self.end()
        self.parks = snapshot.drive_enabled and snapshot.still_ns >= STILL_NS

    def end(self) -> None:
        """The second is over, or something else has been decided about the load."""
        self.parks = False
        self.sank_mm = 0.0
        self._from_mm = self._from_n = self._tension_n = math.nan
        self._closed = False

    def look(self, snapshot: Snapshot, *, moves: bool) -> None:
        """One tick; the way counts from the end of the brake's time on, but from `SEATED_NS` at the latest.

        ``moves``: STROKE_MOVES is active, which no play is: the way counts from the motor's end on then. Its 0.2 s may
        be over before the brake's time is.
        """
        unseen = not (snapshot.cell_heard and snapshot.drive_heard) or snapshot.cell_quality
        if unseen or not math.isfinite(snapshot.tension_n + snapshot.stroke_mm) or snapshot.power.first_second_over:
            self.end()
            return
        if math.isnan(self._tension_n):
            self._tension_n = snapshot.tension_n
        self._tension_n += (snapshot.tension_n - self._tension_n) * self._share
        if not snapshot.drive_off:
            if math.isfinite(self._from_mm):  # it has come on again
                self.end()
            return
        closed = snapshot.power.seated
        if math.isnan(self._from_mm) or (closed and not self._closed):
            self._from_mm, self._from_n = snapshot.stroke_mm, self._tension_n
        self._closed = closed
        if not (closed or moves):
            return
        way_mm = self._from_mm - snapshot.stroke_mm
        fell_mm = (self._from_n - self._tension_n) / self._stiffness
        shown = way_mm > self._least_mm and fell_mm > UNDO_SHARE * way_mm and snapshot.tension_n > self._slack_n
        self.sank_mm = way_mm if shown else 0.0
