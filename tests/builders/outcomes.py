"""The safety table's watch and the machine, with what they have reported over all ticks of a test."""

from __future__ import annotations

from typing import Any

from rigctl.control.power.arming import ArmingStep
from rigctl.control.power.machine import Answer, Change, Machine
from rigctl.control.power.stage import NOT_LEFT, TickSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.safety import Trip, Watch
from rigctl.model.states import Mode


class WatchLog(Watch):
    """``limits`` and ``causes``: rows of each kind that began (True) or ended."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.limits: list[tuple[Trip, bool]] = []
        self.causes: list[tuple[Trip, bool]] = []

    def trips(self, snapshot: Snapshot, mode: Mode, t_ns: int) -> Trip | None:
        """Trip of one tick."""
        trip, (limits, causes) = self.look(snapshot, mode, t_ns), self.reports()
        self.limits += limits
        self.causes += causes
        return trip


class MachineLog(Machine):
    """``changes`` of mode and ``answers`` to commands, all of them unless the test clears the lists."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._all_changes: list[Change] = []
        self._all_answers: list[Answer] = []

    def _take(self) -> None:
        done = self.outcome()
        self._all_changes += done.changes
        self._all_answers += done.answers

    def prepared(self, t_ns: int) -> None:
        """All that goes before the drive's power has come."""
        self.follow(TickSeen(t_ns, prepared=ArmingStep.READY))

    def follow_drive(
        self, enabled: bool, t_ns: int, *, drive_faulted: bool = False, cause_present: bool = False
    ) -> bool:
        """One tick of a drive that has been commanded on or reset; whether it has not followed a reset."""
        if self.sequence.preparing:
            self.prepared(t_ns)
        latched = self.mode is Mode.FAULT
        return self.follow(TickSeen(t_ns, enabled, drive_faulted, cause=cause_present, latched=latched)) is NOT_LEFT

    @property
    def changes(self) -> list[Change]:
        self._take()
        return self._all_changes

    @property
    def answers(self) -> list[Answer]:
        self._take()
        return self._all_answers
