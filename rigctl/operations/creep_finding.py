"""What the record of a cell's creep means: its entry, the text for the operator, and the setting for the loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rigctl.commission import creep as creep_fit
from rigctl.commission.creep import CreepError, CreepFit, course
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import LoadBin
from rigctl.ipc.correction import CREEP_FASTEST_S, CREEP_TERMS, SCALE_BOUND, CreepTerm
from rigctl.ipc.ledger import Standing, entry
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations.calibration_findings import CalibrationFinding, FindingError, Measured, reference_of

MISFIT = 3.0  # residuals over scatter from which a record is said not to be two exponentials


def creep_order(now: Standing, held_s: float = math.nan) -> SettingOrder:
    """Puts the creep in force in the loop; ``held_s``: see `rigctl.control.bus.cell_correction.CellCorrection.put`."""
    terms = now.creep or (CreepTerm(0.0, CREEP_FASTEST_S),) * CREEP_TERMS
    return SettingOrder(Setting.CREEP, (*(value for term in terms for value in term), held_s))


def creep(
    settings: RigSettings, request: Request, now: Standing, measured: Measured, bins: Sequence[LoadBin]
) -> CalibrationFinding:
    """The cell's creep from the parts of its record; with ``adopt`` it is taken out from now on.

    Raises:
        FindingError: no creep can be fitted, or it may not be adopted.
    """
    section, compensation = settings.calibration, settings.compensation
    assert section is not None  # `impossible` refuses a rig file without it
    followed = compensation is not None and compensation.temperature is not None and now.zero_u_n_k is not None
    known = {"zero_n_k": now.zero_n_k, "u_n_k": now.zero_u_n_k or 0.0} if followed else {}
    try:
        found = creep_fit.fit(bins, zero_n=now.zero_n + measured.beside_n, **known)
    except CreepError as error:
        raise FindingError(str(error)) from None
    weight_n = reference_of(section, request)
    hangs = not measured.held and abs(abs(found.step_n) / weight_n - 1.0) <= SCALE_BOUND
    verdict = _creep_verdict(found, now, weight_n, held=measured.held, hangs=hangs)
    good = found.told and hangs
    figures = {
        "step_n": found.step_n, "seen_s": found.seen_s, "total_pct": 100 * found.total,
        "total_u_pct": 100 * found.total_u, "share_u": list(found.share_u), "time_u_s": list(found.time_u_s),
        "drift_n": found.drift_n, "misfit": found.misfit, "verdict": verdict, "applied": request.adopt,
        "parts": [[part.after_s, part.mean_n, part.samples, part.rms_n] for part in bins],
    }  # fmt: skip
    after = replace(now, creep=found.terms, creep_u=found.creep_u, creep_seen_s=found.seen_s)
    text = f"{creep_fit.in_words(found)}; {verdict}"
    if request.adopt and not (good and found.step_n > 0.0 and after.correction.fits(settings)):
        raise FindingError(f"{text}; nothing was changed")
    written = entry(
        settings, "creep", request.operator, measured.wall_ns,
        before=now.crept, after=after.crept if request.adopt else {}, figures=figures,
    )  # fmt: skip
    order = creep_order(after, found.seen_s) if request.adopt else None
    return CalibrationFinding(written, text, good=good, order=order)


def _creep_verdict(found: CreepFit, now: Standing, weight_n: float, *, held: bool, hangs: bool) -> str:
    """What the record tells, and what it cannot."""
    if held:
        return "of cell, rope, spring and mechanism together: a held rope does not tell them apart"
    if not hangs:
        return f"the load's step of {found.step_n:z.2f} N is not the weight ({weight_n:g} N): a rope makes the same"
    if not found.told:
        return f"it is not beyond noise and a drift of the zero by {found.drift_n:.3f} N"
    words = "of the cell alone: nothing else carries the weight"
    if found.misfit > MISFIT:
        words += f", but two exponentials miss the record by {found.misfit:.1f} times its scatter"
    if now.creep:
        apart = abs(found.total - course(now.creep, found.seen_s))
        known = math.hypot(found.total_u, now.creep_u or 0.0)
        words += f"; {'agrees' if apart <= known else 'does NOT agree'} with the creep in force"
        words += f" ({100 * apart:.4f} % apart, uncertainty {100 * known:.4f} %)"
    return words
