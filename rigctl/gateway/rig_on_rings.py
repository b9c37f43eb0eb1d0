"""A rig in operation (`rigctl.operations.rig_in_operation`) over the rings and files of the run-time folder."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy.typing as npt

from rigctl.commission.load_record import bins_of
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import LoadBin
from rigctl.gateway.evaluation_process import evaluate
from rigctl.gateway.excited_records import ExcitedRecords
from rigctl.gateway.gains_process import admit
from rigctl.ipc import ledger
from rigctl.ipc.ledger import IN_FORCE, Entry, LedgerError, Standing, in_force
from rigctl.ipc.runtime_folder import ACTIVE, DESIGN, Runtime
from rigctl.operations import filing, left_over
from rigctl.operations.ledger_in_force import LedgerInForce
from rigctl.operations.left_over import InForce


class RigOnRings:
    """Its calculations have processes of their own."""

    def __init__(self, runtime: Runtime, settings: RigSettings, soon: Callable[[Callable[[], None]], None]) -> None:
        """``soon``: has work done in the thread that waits for disks."""
        self.settings = settings
        self._runtime, self._soon = runtime, soon
        self._showing = threading.Lock()
        self.kept = ExcitedRecords(runtime, settings.loop.rate_hz)
        self.standing = in_force(runtime)
        self.ledger_in_force = LedgerInForce(self)

    def read(self) -> None:
        """Read what has been put in force, and the new records."""
        self.kept.poll()
        self.standing = in_force(self._runtime, self.standing)

    @property
    def design(self) -> Mapping[str, Any]:
        """The design in force."""
        design: dict[str, Any] = self._runtime.read_json(ACTIVE)["design"]
        return design

    def entries(self) -> list[Entry]:
        """See `ledger.read`."""
        return ledger.read(self.settings)

    def append(self, written: Entry) -> list[Entry]:
        """See `ledger.append`."""
        return ledger.append(self.settings, written)

    def load_bins(self, until_ns: int) -> list[LoadBin]:
        """Parts of the record of a load's step, from the ring of events."""
        events = self._events()
        return bins_of(events[events["t_ns"] <= until_ns])

    def records(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        """Records that the ring still holds."""
        records = self._runtime.records.reader(from_start=True).read()
        return records[(records["t_ns"] <= until_ns) & (records["t_ns"] > after_ns)]

    def excited(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        """See `ExcitedRecords.between`."""
        return self.kept.between(after_ns, until_ns)

    def response(self, records: npt.NDArray[Any]) -> dict[str, Any]:
        """See `evaluate`."""
        return evaluate(self._runtime, "response", records)

    def admitted(self, text: str, name: str) -> dict[str, Any]:
        """See `admit`."""
        return admit(self._runtime, text, name)

    def loop_has(self) -> InForce:
        """See `left_over.loop_has`."""
        return left_over.loop_has(self.settings, self._events(), in_force(self._runtime))

    def put_in_force(self, standing: Standing) -> None:
        """Show these values as those in force."""
        with self._showing:
            self.standing = standing
            self._write(IN_FORCE, standing)

    def put_design_in_force(self, design: dict[str, Any]) -> None:
        """Show a design as the one in force."""
        if active := self._runtime.known(ACTIVE):
            self._write(DESIGN, {"run_id": active.get("run_id", ""), "design": design})

    def withdraw(self, given: Entry) -> None:
        """Withdraw an entry soon; a calibration check that was before it holds again."""
        self._soon(lambda: self._strike_out(given))

    def say(self, text: str) -> None:
        """A line on standard error."""
        sys.stderr.write(f"gateway: {text}\n")

    def _events(self) -> npt.NDArray[Any]:
        return self._runtime.events.reader(from_start=True).read()

    def _write(self, name: str, value: object) -> None:
        """Write a file of the runtime folder; a failure does not end the thread, as the loop has its settings."""
        try:
            self._runtime.write_json(name, value)
        except OSError as error:
            self.say(f"{self._runtime.directory / name} cannot be written: {error.strerror}")

    def _strike_out(self, given: Entry) -> None:
        with contextlib.suppress(LedgerError):  # the operator's answer already says that it is not in force
            standing = filing.withdraw(self, given, time.time_ns())
            if standing is not None:
                self.put_in_force(standing)
                self.ledger_in_force.overdue_changed()
