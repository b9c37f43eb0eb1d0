"""When a power-off counts as shown, and how long that took."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.load.load_at_rest import LoadRest
from rigctl.control.power.power_off import WAIT_NS, PowerOffWatch
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import PowerOff
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
COMMANDED_NS, MS = 7_000_000_000, 1_000_000


class Stop:
    """A power-off that was commanded at ``COMMANDED_NS``; nothing but the input of the drive can show it."""

    def __init__(self) -> None:
        self.watch, self._load = PowerOffWatch(), LoadRest(PAPER)

    def look(self, after_ns: int, *, torque_off: bool = False) -> PowerOff:
        snapshot = Snapshot(t_ns=COMMANDED_NS + after_ns, torque_off=torque_off)
        self._load.look(Fault.DRIVE_STALE.bit, snapshot)
        return self.watch.look(Fault.DRIVE_STALE, Action.POWER_OFF, snapshot, self._load, braked=False)


def test_the_time_counts_from_the_command() -> None:
    stop = Stop()
    assert stop.look(0) is PowerOff.AWAITED
    assert stop.look(250 * MS, torque_off=True) is PowerOff.INPUT
    assert stop.watch.since_s(COMMANDED_NS + 250 * MS) == pytest.approx(0.25)


def test_what_nothing_shows_is_unconfirmed_after_the_wait() -> None:
    stop = Stop()
    stop.look(0)
    assert stop.look(WAIT_NS) is PowerOff.AWAITED
    assert stop.look(WAIT_NS + MS) is PowerOff.UNCONFIRMED
    assert stop.look(WAIT_NS + 2 * MS, torque_off=True) is PowerOff.INPUT
