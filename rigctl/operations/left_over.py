"""A ledger entry that was written but not put in force: the next gateway makes ledger and loop agree.

An entry is on record before the loop gets its settings. In between, the gateway may be killed or the loop may give no
answer. The newest entry is then sent to the loop again; if the loop refuses it (it moves, or the rope is loaded), the
entry is withdrawn. Any other difference means that somebody else changed the ledger; such a change takes effect at the
next start of the daemon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.ipc import ledger
from rigctl.ipc.correction import creep_text
from rigctl.ipc.ledger import Entry, Standing
from rigctl.model.events import Kind
from rigctl.model.loop_event import LoopEvent
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations.calibration_findings import zero_order
from rigctl.operations.creep_finding import creep_order

InForce = tuple[float, float, str]
"""Zero in N, scale, and the creep in words; without ``compensation.creep`` the creep is empty."""


@dataclass(frozen=True)
class LeftOver:
    """``entry`` is on record but not in force; ``orders`` put it in force, None where that cannot be known."""

    entry: Entry
    standing: Standing
    orders: tuple[SettingOrder, ...] | None

    wanted: InForce

    def __str__(self) -> str:
        """The entry's name for messages."""
        return f"the {self.entry.what} by {self.entry.operator} of {self.entry.when}"


def loop_has(settings: RigSettings, events: npt.NDArray[Any], last: Standing) -> InForce:
    """What the loop uses, from its newest CORRECTION and CREEP events; without such events ``last``.

    ``events``: slots of the ring of events, oldest first. ``last``: what was last put in force.
    """
    zero_n, scale, creep = _of(settings, last)
    reported = events[(events["kind"] == Kind.CORRECTION) | (events["kind"] == Kind.CREEP)]
    newest = {event.kind: event.fields for event in LoopEvent.of_slots(reported)}
    if Kind.CORRECTION in newest:
        zero_n, scale = (float(newest[Kind.CORRECTION][name]) for name in ("zero_n", "scale"))
    if Kind.CREEP in newest and settings.compensation is not None and settings.compensation.creep:
        creep = newest[Kind.CREEP]["terms"]
    return zero_n, scale, creep


def find(settings: RigSettings, entries: Sequence[Entry], has: InForce, now: Standing, wall_ns: int) -> LeftOver | None:
    """The ledger's newest entry if the loop does not use it; ``has``: what it uses, ``now``: what was last in force."""
    if not entries or settings.calibration is None:
        return None
    standing, newest = ledger.standing(settings, entries, wall_ns), entries[-1]
    wanted = _of(settings, standing)
    if (wanted, standing.due) == (_of(settings, now), now.due) and wanted == has:
        return None
    orders = []
    if newest.what == "creep" and wanted[:2] == has[:2]:
        orders = [creep_order(standing)]
    elif newest.what in ("tare", "calibrate") and wanted[2] == has[2]:
        before = newest.before.get("zero_n"), newest.before.get("scale")
        if has[:2] not in (before, wanted[:2]):
            return LeftOver(newest, standing, None, wanted)
        orders += [zero_order(standing)] if wanted[0] != has[0] else []
        orders += (
            [SettingOrder(Setting.SCALE, (standing.scale, math.nan, standing.second_scale))]
            if wanted[1] != has[1]
            else []
        )
    else:
        return LeftOver(newest, standing, None, wanted)
    return LeftOver(newest, standing, tuple(orders), wanted)


def _of(settings: RigSettings, standing: Standing) -> InForce:
    section = settings.compensation
    creep = creep_text(standing.creep) if section is not None and section.creep else ""
    return standing.zero_n, standing.scale, creep
