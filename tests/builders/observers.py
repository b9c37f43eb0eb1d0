"""An observer whose inbox and outbox the test fills: no bus, no machine that decides, no probe."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.outbox import Outbox
from rigctl.control.bus.readback import Readback
from rigctl.control.excitation.loop_probe import NoProbe
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.control.load.held_tension import HeldTension
from rigctl.control.load.homed import Homed, LastStroke
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.load.stroke_hold import StrokeHold
from rigctl.control.observer import Observer
from rigctl.control.power.machine import Machine
from rigctl.control.watch.signs import SignCheck
from tests.builders import inboxes


def alone(settings: RigSettings) -> tuple[Observer, Inbox, SimpleNamespace]:
    """The observer with its inbox, and the two figures that it reads of the outbox."""
    inbox, sent = inboxes.alone(settings), SimpleNamespace(synced_ns=0, controlword=0)
    observer = Observer(
        settings, inbox, cast("Outbox", sent), Machine(), TensionLaw(settings, Gains(0.0, 0.0, 0.0)),
        Homed(settings.cylinder, LastStroke()), Readback((), settings, 0), StrokeHold(settings),
        HeldTension(settings), SignCheck(settings), NoProbe(settings), RopeMemory(settings),
    )  # fmt: skip
    return observer, inbox, sent
