"""Whether a drive that was commanded off is without power: what shows it, or that nothing does.

The command is no evidence. Neither is the drive's own state alone: a drive whose firmware has failed may report any.
Nor is a load at rest alone, which a motor may carry.
"""

from __future__ import annotations

from rigctl.control.load.load_at_rest import REST_NS, LoadRest
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import LoadAtRest, PowerOff

WAIT_NS = 5_000_000_000  # the drive's own supervision (2 s at most), then rest


class PowerOffWatch:
    """Watches from the command on, until the fault behind it is reset."""

    def __init__(self) -> None:
        self._from_ns = 0
        self.shown = PowerOff.NONE

    def since_s(self, t_ns: int) -> float:
        """Time since the command in s."""
        return (t_ns - self._from_ns) * 1e-9

    def look(self, fault: Fault, action: Action, snapshot: Snapshot, load: LoadRest, *, braked: bool) -> PowerOff:
        """One tick with ``fault`` latched and ``action`` taken.

        ``load``: has looked at this tick. ``braked``: see `rigctl.control.power.power_seen.PowerDetector`.
        """
        if fault is Fault.NONE or action < Action.POWER_OFF:
            self.shown = PowerOff.NONE
            return self.shown
        if self.shown is PowerOff.NONE:
            self.shown, self._from_ns = PowerOff.AWAITED, snapshot.t_ns
        rest_ns = min(load.tension_ns, snapshot.t_ns - self._from_ns)
        shown = self._evidence(snapshot, rest_ns, load, braked=braked)
        if shown is not PowerOff.AWAITED:
            self.shown = shown
        elif self.shown.confirmed:
            moves = load.shown is LoadAtRest.MOVES and not self._drive_at_rest(snapshot)
            on = not braked and self.shown is not PowerOff.INPUT
            self.shown = PowerOff.UNCONFIRMED if moves or on else self.shown
        elif snapshot.t_ns - self._from_ns > WAIT_NS:
            self.shown = PowerOff.UNCONFIRMED
        return self.shown

    def _evidence(self, snapshot: Snapshot, rest_ns: int, load: LoadRest, *, braked: bool) -> PowerOff:
        """``rest_ns``: 0 where the tension says nothing."""
        if snapshot.torque_off:
            return PowerOff.INPUT
        if not braked or not load.shown.rests:
            return PowerOff.AWAITED
        if not load.slack:
            return PowerOff.TENSION if rest_ns >= REST_NS else PowerOff.AWAITED
        return PowerOff.STROKE if self._drive_at_rest(snapshot, REST_NS) else PowerOff.AWAITED

    def _drive_at_rest(self, snapshot: Snapshot, at_least_ns: int = 1) -> bool:
        """The drive reports a state without power, and its stroke has stood still since the command or longer."""
        still_ns = min(snapshot.still_ns, snapshot.power.off_ns, snapshot.t_ns - self._from_ns)
        return snapshot.drive_heard and still_ns >= at_least_ns
