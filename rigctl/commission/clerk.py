"""The clerk: puts on record what trials found, in a thread of its own, so that no command ever waits for a disk.

First on record, then in force: what cannot be written down changes nothing, and what the loop then refuses is
withdrawn by another entry.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy.typing as npt

from rigctl.commission import findings, ledger
from rigctl.commission.findings import Finding, FindingError, Measured
from rigctl.commission.ledger import IN_FORCE, LedgerError, Standing, in_force
from rigctl.config import RigSettings
from rigctl.control.modes import Verb
from rigctl.telemetry.request import Request
from rigctl.telemetry.runtime import Runtime

LOOK_NS = 500_000_000  # how often what is in force is looked at


@dataclass(frozen=True)
class Filed:
    """A finding on record with what then stands, or the reason why there is none."""

    finding: Finding | None = None
    standing: Standing | None = None
    reason: str = ""
    text: str = ""


class Clerk:
    """Keeps the ledger of one rig. ``file`` and ``withdraw`` return at once; results come by ``done``."""

    def __init__(self, runtime: Runtime, settings: RigSettings) -> None:
        self._runtime, self._settings = runtime, settings
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="clerk", daemon=True)
        self._look_ns = 0
        self.standing = in_force(runtime)
        self._thread.start()

    def close(self) -> None:
        """Finish what is in hand."""
        self._work.put(None)
        self._thread.join(timeout=2.0)

    def impossible(self, request: Request) -> str | None:
        """See `findings.impossible`."""
        return findings.impossible(self._settings, request)

    def file(self, request: Request, reply: Any, done: Callable[[Filed], None]) -> None:
        """Put on record what the loop's ``reply`` says, then call ``done`` in the clerk's thread."""
        measured = Measured(float(reply["value"]), float(reply["spread"]), time.time_ns())
        t_ns = int(reply["t_ns"])
        self._work.put(lambda: done(self._file(request, measured, t_ns)))

    def withdraw(self, filed: Filed) -> None:
        """The loop would not take it: say so in the ledger."""
        self._work.put(lambda: self._withdraw(filed))

    def put_in_force(self, filed: Filed) -> None:
        """The loop has taken it."""
        if filed.standing is not None:
            self._show(filed.standing)

    def overdue(self, now_ns: int, wall_ns: int) -> float | None:
        """What the loop is to be told of the due date, when that has changed; looked at twice a second."""
        if now_ns < self._look_ns:
            return None
        self._look_ns = now_ns + LOOK_NS
        self.standing = in_force(self._runtime)
        passed = self.standing.due is not None and self.standing.due <= ledger.utc(wall_ns)
        if not passed or self.standing.overdue:
            return None
        self._show(replace(self.standing, overdue=True))
        return float(self.standing.correction.overdue)

    def _show(self, standing: Standing) -> None:
        self.standing = standing
        self._runtime.write_json(IN_FORCE, standing)

    def _serve(self) -> None:
        while (work := self._work.get()) is not None:
            work()

    def _file(self, request: Request, measured: Measured, t_ns: int) -> Filed:
        settings = self._settings
        try:
            if request.verb is Verb.IDENTIFY:
                finding = findings.identify(settings, request, self._records_of(measured, t_ns), measured.wall_ns)
                if settings.ledger is None:
                    return Filed(replace(finding, text=f"{finding.text} (not on record: no calibration section)"))
            else:
                find = findings.tare if request.verb is Verb.TARE else findings.calibrate
                finding = find(settings, request, self.standing, measured)
            entries = ledger.append(settings, finding.entry)
        except FindingError as error:
            return Filed(reason="out_of_bounds", text=str(error))
        except LedgerError as error:
            return Filed(reason="not_recorded", text=f"{error}; nothing was changed")
        return Filed(finding, ledger.standing(settings, entries, measured.wall_ns))

    def _records_of(self, measured: Measured, t_ns: int) -> npt.NDArray[Any]:
        """The ticks of an excitation that ended at ``t_ns``: its answer's value is how long it took."""
        records = self._runtime.record_reader(from_start=True).read()
        return records[(records["t_ns"] <= t_ns) & (records["t_ns"] > t_ns - round(measured.mean_n * 1e9))]

    def _withdraw(self, filed: Filed) -> None:
        if filed.finding is not None:
            with contextlib.suppress(LedgerError):  # the operator has been told already that it is not in force
                ledger.append(self._settings, findings.withdrawn(self._settings, filed.finding.entry, time.time_ns()))
