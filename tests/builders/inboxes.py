"""An inbox whose bus the test fills, or whose samples it sets: no runtime folder, nothing to read back."""

from __future__ import annotations

from typing import cast

import can

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.readback import FOREIGN_AFTER_NS, Readback
from rigctl.control.logbook import Rings


def alone(settings: RigSettings, bus: can.BusABC | None = None) -> Inbox:
    """An inbox by the rig file; every SDO answer is to another master. Without a bus it is never drained."""
    readback = Readback((), settings, -FOREIGN_AFTER_NS)
    return Inbox(cast("can.BusABC", bus), settings, Rings.in_own_memory().frames, readback)
