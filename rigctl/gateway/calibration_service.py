"""The calibration service: puts on record what trials found, in its own thread so that no command waits for a disk.

A finding is first written to the ledger, then put in force. A finding that cannot be written changes nothing; one that
the loop then refuses is withdrawn by another entry.
"""

from __future__ import annotations

import contextlib
import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy.typing as npt

from rigctl.commission.load_record import bins_of
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import LoadBin
from rigctl.design.admission import NotAdmittedError, admit
from rigctl.gateway import calibration_findings as findings
from rigctl.gateway import left_over
from rigctl.gateway.calibration_findings import CalibrationFinding, FindingError, Measured
from rigctl.gateway.evaluation import EvaluationError, evaluate
from rigctl.gateway.excited_records import ExcitedRecords
from rigctl.gateway.left_over import LeftOver
from rigctl.ipc import ledger
from rigctl.ipc.ledger import IN_FORCE, Entry, LedgerError, Standing, in_force
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import ACTIVE, DESIGN, Runtime
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, SettingOrder, Verb

READ_NS = 500_000_000  # between two readings of the standing in force
SETTLE_NS = 2_000_000_000  # a setting the loop has not taken by then it will never take


@dataclass(frozen=True)
class Filed:
    """A finding on record with the standing that follows from it, or the reason why there is none."""

    finding: CalibrationFinding | None = None
    standing: Standing | None = None
    reason: str = ""
    text: str = ""
    design: dict[str, Any] | None = None  # only after a change of gains


class CalibrationService:
    """Keeps the ledger of one rig. ``file`` and ``withdraw`` return at once; a result arrives through ``done``."""

    def __init__(self, runtime: Runtime, settings: RigSettings) -> None:
        self._runtime, self._settings = runtime, settings
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="calibration", daemon=True)
        self._showing = threading.Lock()
        self._read_ns = self._settle_ns = 0
        self._ledger_compared = self._overdue_changed = False
        self._left_over: LeftOver | None = None
        self.excited = ExcitedRecords(runtime, settings.loop.rate_hz)
        self.standing = in_force(runtime)
        self._thread.start()

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
        self._work.put(lambda: done(self._file(request, measured, t_ns)))

    def withdraw(self, filed: Filed) -> None:
        """Withdraw in the ledger a finding that the loop refused."""
        self._work.put(lambda: self._withdraw(filed))

    def put_in_force(self, filed: Filed) -> None:
        """Publish as in force a finding that the loop has taken."""
        if filed.design is not None and (active := self._runtime.known(ACTIVE)):
            self._write(DESIGN, {"run_id": active.get("run_id", ""), "design": filed.design})
        if filed.standing is not None:
            self._show(filed.standing)

    def unanswered(self, filed: Filed) -> None:
        """The loop gave no answer: compare the ledger with the correction in its events, see `left_over`."""
        if filed.standing is not None:
            self._ledger_compared = False

    def settings_due(self, now_ns: int, wall_ns: int) -> Sequence[SettingOrder]:
        """Settings for the loop that follow from the ledger and its due date; computed twice a second."""
        if now_ns < self._read_ns:
            return ()
        self._read_ns = now_ns + READ_NS
        self.excited.poll()
        self.standing = in_force(self._runtime, self.standing)
        due = [*self._bring_together(now_ns, wall_ns)]
        overdue = ledger.is_overdue(self._settings, self.standing.due, datetime.fromtimestamp(wall_ns / 1e9, UTC))
        if self.standing.due is not None and overdue != self.standing.overdue:
            self._show(replace(self.standing, overdue=overdue))
            self._overdue_changed = True
        if self._overdue_changed:
            self._overdue_changed = False
            due.append(SettingOrder(Setting.OVERDUE, (float(self.standing.correction.overdue),)))
        return due

    def _bring_together(self, now_ns: int, wall_ns: int) -> Sequence[SettingOrder]:
        """Compare ledger and loop once after a start and after every missing answer; settings that make them agree."""
        if self._left_over is not None:
            return self._settle(self._left_over, now_ns)
        if self._ledger_compared:
            return ()
        self._ledger_compared = True
        try:
            entries, has = ledger.read(self._settings), left_over.loop_has(self._settings, self._runtime)
        except (LedgerError, RingError, OSError) as error:
            self._say(str(error))
            return ()
        found = left_over.find(self._settings, entries, has, self.standing, wall_ns)
        if found is None:
            return ()
        if found.orders is None:
            self._say("the ledger says something else than what is in force; it holds from the daemon's next start")
            return ()
        self._left_over, self._settle_ns = found, now_ns + SETTLE_NS
        return found.orders

    def _settle(self, found: LeftOver, now_ns: int) -> Sequence[SettingOrder]:
        """Show a left-over entry as in force once the loop uses it; withdraw the entry if the loop does not take it."""
        if left_over.loop_has(self._settings, self._runtime) == found.wanted:
            self._say(f"{found}, left over from before, is in force")
            self._show(found.standing)
        elif now_ns < self._settle_ns:
            return ()
        else:
            self._say(f"{found}, left over from before, was not taken by the loop: withdrawn from the ledger")
            self._work.put(lambda: self._strike_out(found.entry))
        self._left_over, self._overdue_changed = None, True
        return ()

    def _show(self, standing: Standing) -> None:
        with self._showing:
            self.standing = standing
            self._write(IN_FORCE, standing)

    def _write(self, name: str, value: object) -> None:
        """Write a file of the runtime folder; a failure does not end the thread, as the loop has its settings."""
        try:
            self._runtime.write_json(name, value)
        except OSError as error:
            self._say(f"{self._runtime.directory / name} cannot be written: {error.strerror}")

    def record(self, written: Entry) -> None:
        """Write an entry of the gateway's own to the ledger, if the rig has one, after what is being written."""
        if self._settings.ledger is not None:
            self._work.put(lambda: self._append(written))

    def _append(self, written: Entry) -> None:
        try:
            ledger.append(self._settings, written)
        except LedgerError as error:
            self._say(f"the {written.what} are not on record: {error}")

    def _serve(self) -> None:
        while (work := self._work.get()) is not None:
            work()

    def _file(self, request: Request, measured: Measured, t_ns: int) -> Filed:
        settings, design = self._settings, None
        try:
            if request.verb is Verb.IDENTIFY:
                finding = findings.identify(settings, request, self._records_of(measured, t_ns), measured.wall_ns)
            elif request.verb is Verb.RESPONSE:
                excited = self.excited.between(t_ns - round(measured.duration_s * 1e9), t_ns)
                found = evaluate(self._runtime, "response", excited)
                finding = findings.response(settings, request, found, measured.wall_ns)
            elif request.verb is Verb.GAINS:
                design = admit(self._runtime, request.gain_file, request.name)
                before = self._runtime.read_json(ACTIVE)["design"]
                finding = findings.gains(settings, request, before, design, measured.wall_ns)
            elif math.isfinite(request.creep_s):
                finding = findings.creep(settings, request, self.standing, measured, self._bins_of(t_ns))
            elif request.verb is Verb.TARE:
                finding = findings.tare(settings, request, self.standing, measured, ledger.read(settings))
            else:
                finding = findings.calibrate(settings, request, self.standing, measured)
            if settings.ledger is None:
                finding = replace(finding, text=f"{finding.text} (not on record: no calibration section)")
                return Filed(finding, design=design)
            entries = ledger.append(settings, finding.entry)
        except (FindingError, EvaluationError) as error:
            return Filed(reason="out_of_bounds", text=str(error))
        except NotAdmittedError as error:
            return Filed(reason="not_admitted", text=str(error))
        except LedgerError as error:
            return Filed(reason="not_recorded", text=f"{error}; nothing was changed")
        except Exception as error:  # noqa: BLE001 - an exception would end the thread, and no later trial be answered
            what = " ".join(f"{type(error).__name__}: {error}".split())
            return Filed(reason="out_of_bounds", text=f"the measurement cannot be judged ({what}); nothing was changed")
        return Filed(finding, ledger.standing(settings, entries, measured.wall_ns), design=design)

    def _records_of(self, measured: Measured, t_ns: int) -> npt.NDArray[Any]:
        """Records of an excitation that ended at ``t_ns``."""
        records = self._runtime.records.reader(from_start=True).read()
        return records[(records["t_ns"] <= t_ns) & (records["t_ns"] > t_ns - round(measured.duration_s * 1e9))]

    def _bins_of(self, t_ns: int) -> list[LoadBin]:
        """Parts of the record of a load's step that ended at ``t_ns``, from the last one before the step on."""
        events = self._runtime.events.reader(from_start=True).read()
        return bins_of(events[events["t_ns"] <= t_ns])

    def _withdraw(self, filed: Filed) -> None:
        if filed.finding is not None:
            self._strike_out(filed.finding.entry)

    def _strike_out(self, given: Entry) -> None:
        """Write the withdrawal to the ledger; that of a calibration check also restores the result before it."""
        with contextlib.suppress(LedgerError):  # the operator's answer already says that it is not in force
            wall_ns = time.time_ns()
            entries = ledger.append(self._settings, findings.withdrawn(self._settings, given, wall_ns))
            if given.passed is not None:
                self._show(ledger.standing(self._settings, entries, wall_ns))
                self._overdue_changed = True

    @staticmethod
    def _say(text: str) -> None:
        sys.stderr.write(f"gateway: {text}\n")
