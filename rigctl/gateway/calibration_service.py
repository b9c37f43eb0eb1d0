"""The calibration service: puts on record what trials found, in its own thread so that no command waits for a disk."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.gateway.excited_records import ExcitedRecords
from rigctl.gateway.rig_on_rings import RigOnRings
from rigctl.ipc.ledger import Entry, LedgerError, Standing
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.requests import Request
from rigctl.model.verbs import SettingOrder
from rigctl.operations import calibration_findings as findings
from rigctl.operations import filing
from rigctl.operations.calibration_findings import Measured
from rigctl.operations.filing import Filed

READ_NS = 500_000_000  # between two readings of the standing in force


class CalibrationService:
    """Keeps the ledger of one rig. ``file`` and ``withdraw`` return at once; a result arrives through ``done``."""

    def __init__(self, runtime: Runtime, settings: RigSettings) -> None:
        self._settings = settings
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="calibration", daemon=True)
        self._read_ns = 0
        self._rig = RigOnRings(runtime, settings, self._work.put)
        self._thread.start()

    @property
    def excited(self) -> ExcitedRecords:
        """Records of an excitation."""
        return self._rig.kept

    @property
    def standing(self) -> Standing:
        """The ledger's values in force."""
        return self._rig.standing

    def close(self) -> None:
        """Finish the queued work and end the thread."""
        self._work.put(None)
        self._thread.join(timeout=2.0)

    def impossible(self, request: Request) -> str | None:
        """See `findings.impossible`."""
        return findings.impossible(self._settings, request)

    def file(self, request: Request, reply: Any, done: Callable[[Filed], None]) -> None:
        """Put on record what the loop's ``reply`` says, then call ``done`` in the calibration service's thread."""
        measured = Measured.of(reply, time.time_ns())
        t_ns = int(reply["t_ns"])
        self._work.put(lambda: done(filing.file(self._rig, request, measured, t_ns)))

    def withdraw(self, filed: Filed) -> None:
        """Withdraw in the ledger a finding that the loop refused."""
        if filed.finding is not None:
            self._rig.withdraw(filed.finding.entry)

    def put_in_force(self, filed: Filed) -> None:
        """Publish as in force a finding that the loop has taken."""
        if filed.design is not None:
            self._rig.put_design_in_force(filed.design)
        if filed.standing is not None:
            self._rig.put_in_force(filed.standing)

    def unanswered(self, filed: Filed) -> None:
        """The loop gave no answer: compare the ledger with the correction in its events."""
        if filed.standing is not None:
            self._rig.ledger_in_force.unanswered()

    def settings_due(self, now_ns: int, wall_ns: int) -> Sequence[SettingOrder]:
        """See `LedgerInForce.settings_due`; computed twice a second."""
        if now_ns < self._read_ns:
            return ()
        self._read_ns = now_ns + READ_NS
        self._rig.read()
        return self._rig.ledger_in_force.settings_due(now_ns, wall_ns)

    def record(self, written: Entry) -> None:
        """Write an entry of the gateway's own to the ledger, if the rig has one, after what is being written."""
        if self._settings.ledger is not None:
            self._work.put(lambda: self._append(written))

    def _append(self, written: Entry) -> None:
        try:
            self._rig.append(written)
        except LedgerError as error:
            self._rig.say(f"the {written.what} are not on record: {error}")

    def _serve(self) -> None:
        while (work := self._work.get()) is not None:
            work()
