"""HOLD and FAULT end on the brake: when the drive's own brake sequence takes the load from the motor.

IEC 61800-5-2 has the words: SOS (safe operating stop) while the motor holds the stroke, SBC (safe brake control) when
the brake has taken it. A motor that holds for longer than seconds holds on the word of one encoder.
"""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from rigctl.control.arming import STILL_NS
from rigctl.control.modes import Mode
from rigctl.control.snapshot import Snapshot

REST_NS = 500_000_000
"""Spare time for a stroke to come to rest, beyond which the drive's own stop has to bring it there."""
_KEEPS = frozenset({Mode.HOLD, Mode.FAULT})


class Parking:
    """Times how long the motor has held. ``due``: whether the brake takes the load now."""

    def __init__(self, settings: RigSettings, stop_ns: int) -> None:
        """``stop_ns``: time in which a drive that obeys stops."""
        self._park_ns = round(settings.hold.park_s * 1e9)
        self._rest_ns = stop_ns + REST_NS
        self._brake = settings.cylinder.brake_waiver is None
        self._mode = Mode.DISARMED
        self._since_ns = 0

    def due(self, t_ns: int, mode: Mode, snapshot: Snapshot, *, powered: bool, until_ns: int) -> bool:
        """Whether the brake takes the load now.

        In HOLD that is after ``hold.park_s`` at standstill, in FAULT at standstill; in both, once a stop should long
        have ended, without it: a stroke that does not come to rest is not held.

        Args:
            t_ns: now.
            mode: the mode.
            snapshot: of this tick.
            powered: the motor has the load.
            until_ns: the motor keeps the load until then, for a trial or a CARRY; 0: no.
        """
        if not powered or mode not in _KEEPS or t_ns < until_ns or mode is not self._mode:
            self._mode, self._since_ns = mode, t_ns
            return False
        if not self._brake:
            return False
        if mode is Mode.FAULT and not snapshot.drive_enabled:  # it has closed its brake by itself
            return True
        held_ns, wanted_ns = t_ns - self._since_ns, STILL_NS if mode is Mode.FAULT else self._park_ns
        if min(held_ns, snapshot.still_ns) >= wanted_ns:
            return True
        return held_ns >= self._rest_ns + (0 if mode is Mode.FAULT else self._park_ns)
