"""What a trial's answer means: the ledger entry, the text for the operator, and the settings for the loop.

Pure functions of the request, the loop's figures and the ledger's standing; nothing is written here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy.typing as npt

from rigctl.commission import proposal
from rigctl.commission.identification import IdentificationError
from rigctl.config.settings import CalibrationSettings, RigSettings
from rigctl.control.modes import Setting, SettingOrder, Verb
from rigctl.control.tension import Gains
from rigctl.ipc.correction import SCALE_BOUND, Correction
from rigctl.ipc.ledger import Entry, Standing, entry
from rigctl.wire.command_request import Request

EMPTY_SHARE = 0.1
"""Share of the reference below which a cell carries no weight; a cell out of tolerance is wrong by a few percent."""


class FindingError(ValueError):
    """The measurement gives no finding; ``str()`` says why, in one line."""


@dataclass(frozen=True)
class Measured:
    """The loop's figures, and the wall-clock time: TARE, CALIBRATE mean and rms of the cell's reading in N."""

    mean_n: float
    rms_n: float
    wall_ns: int
    duration_s: float = math.nan  # IDENTIFY


@dataclass(frozen=True)
class CalibrationFinding:
    """``good`` False: the finding is put on record, but the operator's command has failed."""

    entry: Entry
    text: str
    good: bool = True
    order: SettingOrder | None = None  # puts it in force in the loop


def impossible(settings: RigSettings, request: Request) -> str | None:
    """Why this rig cannot carry out a request, known before anything is measured; None if it can."""
    section = settings.calibration
    if request.verb not in (Verb.TARE, Verb.CALIBRATE):
        return None
    if section is None:
        return "the rig file has no calibration section"
    if request.shunt and section.shunt_n is None:
        return "calibration.shunt_n is not in the rig file"
    if request.shunt and (request.adopt or math.isfinite(request.value)):
        return "the shunt has its reference in the rig file, and tells nothing of the cell's scale"
    if math.isfinite(request.value) and not 0.0 < request.value <= settings.tension_cell.range_n:
        return f"the weight must be above 0 to {settings.tension_cell.range_n:g} N"
    return None


def tare(settings: RigSettings, request: Request, now: Standing, measured: Measured) -> CalibrationFinding:
    """The mean reading becomes the cell's zero."""
    after = replace(now, zero_n=round(measured.mean_n, 6))
    written = entry(
        settings, "tare", request.operator, measured.wall_ns,
        before=_pair(now), after=_pair(after), figures={"mean_n": measured.mean_n, "rms_n": measured.rms_n},
    )  # fmt: skip
    text = f"zero {now.zero_n:+z.3f} -> {after.zero_n:+z.3f} N (rms {measured.rms_n:.3f} N)"
    return CalibrationFinding(written, text, order=SettingOrder(Setting.ZERO, (after.zero_n,)))


def calibrate(settings: RigSettings, request: Request, now: Standing, measured: Measured) -> CalibrationFinding:
    """Compare the corrected reading with its reference; with ``adopt`` find the scale that makes them agree.

    Raises:
        FindingError: nothing hangs on the cell, or no scale within the bounds makes them agree.
    """
    section = settings.calibration
    assert section is not None  # `impossible` refuses a rig file without it
    reference_n = _reference_n(section, request)
    reading_n = Correction(now.zero_n, now.scale).applied(measured.mean_n)
    if abs(reading_n) < EMPTY_SHARE * reference_n:
        raise FindingError(
            f"the cell reads {reading_n:z.2f} N against a reference of {reference_n:g} N: "
            f"{'the shunt is not on' if request.shunt else 'no weight hangs on the cell'}; nothing was recorded, the "
            "check before stays in force (if it is in place, the cell or its wiring is broken: do not arm)"
        )
    deviation_pct = 100.0 * (reading_n / reference_n - 1.0)
    scale = now.scale * reference_n / reading_n if request.adopt and reading_n > 0.0 else now.scale
    if request.adopt and (reading_n <= 0.0 or abs(scale - 1.0) > SCALE_BOUND):
        raise FindingError(
            f"read {reading_n:z.2f} N, reference {reference_n:g} N ({deviation_pct:+.2f} %): the scale would leave "
            f"{1 - SCALE_BOUND:g} to {1 + SCALE_BOUND:g}; nothing was changed"
        )
    passed = request.adopt or abs(deviation_pct) <= section.tolerance_pct
    figures = {
        "reference_n": reference_n, "reading_n": reading_n, "deviation_pct": deviation_pct, "rms_n": measured.rms_n,
        "tolerance_pct": section.tolerance_pct, "against": "shunt" if request.shunt else "weight",
    }  # fmt: skip
    written = entry(
        settings, "calibrate", request.operator, measured.wall_ns,
        before=_pair(now), after=_pair(replace(now, scale=scale)), figures=figures, passed=passed,
    )  # fmt: skip
    found = f"read {reading_n:z.2f} N, reference {reference_n:g} N: {deviation_pct:+.3f} %"
    if request.adopt:
        found += f", scale {now.scale:.5f} -> {scale:.5f}"
        return CalibrationFinding(written, found, order=SettingOrder(Setting.SCALE, (scale, 0.0)))
    found += f", {'within' if passed else 'NOT within'} {section.tolerance_pct:g} %"
    blocked = not passed and section.waiver is None
    return CalibrationFinding(written, found, good=passed, order=SettingOrder(Setting.OVERDUE, (float(blocked),)))


def identify(settings: RigSettings, request: Request, records: npt.NDArray[Any], wall_ns: int) -> CalibrationFinding:
    """Plant parameters from the records of the excitation; changes nothing.

    Raises:
        FindingError: the records do not determine them.
    """
    try:
        found = proposal.rows(proposal.signals_of(records, 1.0 / settings.loop.rate_hz), settings)
    except IdentificationError as error:
        raise FindingError(str(error)) from None
    written = entry(
        settings, "identify", request.operator, wall_ns,
        before={row["key"]: row["before"] for row in found}, after={row["key"]: row["found"] for row in found},
        figures={"rows": found, "applied": False, "tension_n": float(records["tension_n"].mean())},
    )  # fmt: skip
    return CalibrationFinding(written, proposal.in_words(found))


def gains(
    settings: RigSettings, request: Request, before: dict[str, Any], after: dict[str, Any], wall_ns: int
) -> CalibrationFinding:
    """A change of gains: ``before`` is the design in force, ``after`` the admitted one, both as in ``active.json``."""
    old, new = before["gains"], after["gains"]
    written = entry(
        settings, "gains", request.operator, wall_ns, before=old, after=new,
        figures={key: after[key] for key in ("ms_max", "limit", "waiver", "source")},
    )  # fmt: skip
    changed = ", ".join(f"{name} {old[name]:.4g} -> {new[name]:.4g}" for name in new)
    order = SettingOrder(Setting.LAW_GAINS, Gains(**new).in_order)
    return CalibrationFinding(written, f"{changed}; {after['verdict']}", order=order)


def withdrawn(settings: RigSettings, given: Entry, wall_ns: int) -> Entry:
    """The entry that withdraws ``given`` because the loop refused it: the values before it hold again."""
    figures = {"withdraws": given.when}
    return entry(
        settings, f"{given.what} withdrawn", given.operator, wall_ns,
        before=given.after, after=given.before, figures=figures, passed=None if given.passed is None else False,
    )  # fmt: skip


def _pair(standing: Standing) -> dict[str, float | None]:
    return {"zero_n": standing.zero_n, "scale": standing.scale}


def _reference_n(section: CalibrationSettings, request: Request) -> float:
    if request.shunt:
        assert section.shunt_n is not None  # `impossible` refuses a shunt without a reference
        return section.shunt_n
    return request.value if math.isfinite(request.value) else section.reference_n
