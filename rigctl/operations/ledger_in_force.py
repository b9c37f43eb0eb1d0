"""Settings for the loop that follow from the ledger: what it does not use yet, whether the calibration is overdue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Protocol

from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry, LedgerError, Standing
from rigctl.ipc.ring import RingError
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations import left_over
from rigctl.operations.left_over import InForce, LeftOver
from rigctl.operations.rig_in_operation import CellInOperation

SETTLE_NS = 2_000_000_000  # a setting the loop has not taken by then it will never take


class LedgerInOperation(CellInOperation, Protocol):
    """The ledger of a rig whose loop goes on without it."""

    def loop_has(self) -> InForce:
        """What the loop uses."""

    def put_in_force(self, standing: Standing) -> None:
        """Show these values as those in force."""

    def withdraw(self, given: Entry) -> None:
        """Have an entry withdrawn, now or soon."""

    def say(self, text: str) -> None:
        """A line for the log."""


class LedgerInForce:
    """Makes ledger and loop agree; `settings_due` is called again and again, by one thread."""

    def __init__(self, rig: LedgerInOperation) -> None:
        self._rig = rig
        self._compared = self._overdue_changed = False
        self._left_over: LeftOver | None = None
        self._settle_ns = 0

    def unanswered(self) -> None:
        """The loop gave no answer to a setting: compare the ledger with what it uses, see `left_over`."""
        self._compared = False

    def overdue_changed(self) -> None:
        """The loop may have another date than the standing in force: it gets it with the settings that are due next."""
        self._overdue_changed = True

    def settings_due(self, now_ns: int, wall_ns: int) -> Sequence[SettingOrder]:
        """Settings for the loop that follow from the ledger and its due date."""
        rig = self._rig
        due = [*self._bring_together(now_ns, wall_ns)]
        overdue = ledger.is_overdue(rig.settings, rig.standing.due, datetime.fromtimestamp(wall_ns / 1e9, UTC))
        if rig.standing.due is not None and overdue != rig.standing.overdue:
            rig.put_in_force(replace(rig.standing, overdue=overdue))
            self._overdue_changed = True
        if self._overdue_changed:
            self._overdue_changed = False
            due.append(SettingOrder(Setting.OVERDUE, (float(rig.standing.correction.overdue),)))
        return due

    def _bring_together(self, now_ns: int, wall_ns: int) -> Sequence[SettingOrder]:
        """Compare ledger and loop once after a start and after every missing answer; settings that make them agree."""
        rig = self._rig
        if self._left_over is not None:
            return self._settle(self._left_over, now_ns)
        if self._compared:
            return ()
        self._compared = True
        try:
            entries, has = rig.entries(), rig.loop_has()
        except (LedgerError, RingError, OSError) as error:
            rig.say(str(error))
            return ()
        found = left_over.find(rig.settings, entries, has, rig.standing, wall_ns)
        if found is None:
            return ()
        if found.orders is None:
            rig.say("the ledger says something else than what is in force; it holds from the daemon's next start")
            return ()
        self._left_over, self._settle_ns = found, now_ns + SETTLE_NS
        return found.orders

    def _settle(self, found: LeftOver, now_ns: int) -> Sequence[SettingOrder]:
        """Show a left-over entry as in force once the loop uses it; withdraw the entry if the loop does not take it."""
        if self._rig.loop_has() == found.wanted:
            self._rig.say(f"{found}, left over from before, is in force")
            self._rig.put_in_force(found.standing)
        elif now_ns < self._settle_ns:
            return ()
        else:
            self._rig.say(f"{found}, left over from before, was not taken by the loop: withdrawn from the ledger")
            self._rig.withdraw(found.entry)
        self._left_over, self._overdue_changed = None, True
        return ()
