"""Puts on record what a trial found, or says why it is not: first the ledger's entry, then the setting for the loop.

A finding that cannot be written changes nothing; one that the loop then refuses is withdrawn by another entry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry, LedgerError, Standing
from rigctl.model.requests import Request
from rigctl.model.verbs import Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.calibration_findings import CalibrationFinding, FindingError, Measured
from rigctl.operations.creep_finding import creep
from rigctl.operations.evaluation import EvaluationError
from rigctl.operations.gain_admission import NotAdmittedError
from rigctl.operations.rig_in_operation import CellInOperation, RigInOperation


@dataclass(frozen=True)
class Filed:
    """A finding on record with the standing that follows from it, or the reason why there is none."""

    finding: CalibrationFinding | None = None
    standing: Standing | None = None
    reason: str = ""
    text: str = ""
    design: dict[str, Any] | None = None  # only after a change of gains


def file(rig: RigInOperation, request: Request, measured: Measured, t_ns: int) -> Filed:
    """Put on record what a trial that ended at ``t_ns`` found; any exception becomes a reason."""
    design = None
    try:
        if request.verb is Verb.GAINS:
            design = rig.admitted(request.gain_file, request.name)
            finding = findings.gains(rig.settings, request, dict(rig.design), design, measured.wall_ns)
        else:
            finding = _found(rig, request, measured, t_ns)
        return put_on_record(rig, finding, measured.wall_ns, design)
    except (FindingError, EvaluationError) as error:
        return Filed(reason="out_of_bounds", text=str(error))
    except NotAdmittedError as error:
        return Filed(reason="not_admitted", text=str(error))
    except LedgerError as error:
        return Filed(reason="not_recorded", text=f"{error}; nothing was changed")
    except Exception as error:  # noqa: BLE001 - an exception would end the caller, and no later trial be answered
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return Filed(reason="out_of_bounds", text=f"the measurement cannot be judged ({what}); nothing was changed")


def _found(rig: RigInOperation, request: Request, measured: Measured, t_ns: int) -> CalibrationFinding:
    if request.verb not in (Verb.IDENTIFY, Verb.RESPONSE):
        return of_cell(rig, request, measured, t_ns)
    began_ns = t_ns - round(measured.duration_s * 1e9)
    if request.verb is Verb.IDENTIFY:
        return findings.identify(rig.settings, request, rig.records(began_ns, t_ns), measured.wall_ns)
    found = rig.response(rig.excited(began_ns, t_ns))
    return findings.response(rig.settings, request, found, measured.wall_ns)


def of_cell(rig: CellInOperation, request: Request, measured: Measured, t_ns: int) -> CalibrationFinding:
    """What a TARE or CALIBRATE that ended at ``t_ns`` found.

    Raises:
        FindingError: nothing, or what it found may not be adopted.
        LedgerError: the ledger cannot be read.
    """
    if math.isfinite(request.creep_s):
        return creep(rig.settings, request, rig.standing, measured, rig.load_bins(t_ns))
    if request.verb is Verb.TARE:
        return findings.tare(rig.settings, request, rig.standing, measured, rig.entries())
    return findings.calibrate(rig.settings, request, rig.standing, measured)


def put_on_record(
    rig: CellInOperation, finding: CalibrationFinding, wall_ns: int, design: dict[str, Any] | None = None
) -> Filed:
    """File a finding; what is in force does not change yet.

    Raises:
        LedgerError: it could not be written.
    """
    if rig.settings.ledger is None:
        text = f"{finding.text} (not on record: no calibration section)"
        return Filed(replace(finding, text=text), design=design)
    entries = rig.append(finding.entry)
    return Filed(finding, ledger.standing(rig.settings, entries, wall_ns), design=design)


def withdraw(rig: CellInOperation, given: Entry, wall_ns: int) -> Standing | None:
    """File the withdrawal of an entry; the standing that holds again, if it was a calibration check's.

    Raises:
        LedgerError: it could not be written.
    """
    entries = rig.append(findings.withdrawn(rig.settings, given, wall_ns))
    return None if given.passed is None else ledger.standing(rig.settings, entries, wall_ns)
