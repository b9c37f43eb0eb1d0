"""What a trial's answer means: the ledger entry, the text for the operator, and the settings for the loop.

Pure functions of the request, the loop's figures and the ledger's standing; nothing is written here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy.typing as npt

from rigctl.commission import proposal
from rigctl.commission.cell_uncertainty import drift, scale_u, zero_u_n
from rigctl.commission.identification import IdentificationError, pairs_of
from rigctl.config.settings import CalibrationSettings, RigSettings
from rigctl.control.excitation.trials import CREEP_LONGEST_S, CREEP_SHORTEST_S
from rigctl.control.law.tension import Gains
from rigctl.ipc.correction import SCALE_BOUND, Correction
from rigctl.ipc.ledger import Entry, Standing, entry
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Setting, SettingOrder, Verb

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
    duration_s: float = math.nan  # IDENTIFY, RESPONSE, and CALIBRATE of a creep
    samples: float = 1.0
    creep_n: float = 0.0  # of the tension, taken out meanwhile
    creep_doubt_n: float = 0.0
    beside_n: float = 0.0  # zero in force beside the tare's
    cell_c: float | None = None
    held: bool = False  # in HOLD: a creep's load hangs on the rope
    second_n: float = math.nan  # mean reading of the second force path

    @property
    def when(self) -> datetime:
        """The wall-clock time."""
        return datetime.fromtimestamp(self.wall_ns / 1e9, UTC)

    @classmethod
    def of(cls, reply: Any, wall_ns: int) -> Measured:
        """Figures of a ``REPLY`` slot."""

        def known(name: str, otherwise: float = 0.0) -> float:
            value = float(reply[name])
            return value if math.isfinite(value) else otherwise

        cell_c = float(reply["cell_c"])
        return cls(
            float(reply["reading_n"]), float(reply["rms_n"]), wall_ns, float(reply["duration_s"]),
            known("samples", 1.0), known("creep_n"), known("creep_doubt_n"), known("zero_drift_n"),
            cell_c if math.isfinite(cell_c) else None, int(reply["mode"]) == Mode.HOLD, known("second_n", math.nan),
        )  # fmt: skip


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
    if math.isfinite(request.creep_s) and (why := _impossible_creep(settings, request)) is not None:
        return why
    if request.shunt and (request.adopt or math.isfinite(request.value)):
        return "the shunt has its reference in the rig file, and tells nothing of the cell's scale"
    if math.isfinite(request.value) and not 0.0 < request.value <= settings.tension_cell.range_n:
        return f"the weight must be above 0 to {settings.tension_cell.range_n:g} N"
    return None


def _impossible_creep(settings: RigSettings, request: Request) -> str | None:
    if not CREEP_SHORTEST_S <= request.creep_s <= CREEP_LONGEST_S:
        return f"the creep is recorded for {CREEP_SHORTEST_S:g} to {CREEP_LONGEST_S:g} s"
    if request.shunt:
        return "a shunt does not creep"
    if request.adopt and (settings.compensation is None or not settings.compensation.creep):
        return "compensation.creep is not on in the rig file: record the creep without adopting it"
    return None


def tare(
    settings: RigSettings, request: Request, now: Standing, measured: Measured, entries: Sequence[Entry] = ()
) -> CalibrationFinding:
    """The mean reading, less the creep of an earlier load, becomes the cell's zero; ``entries``: those before."""
    zero_n = measured.mean_n - measured.creep_n / now.scale
    known_u_n = zero_u_n(settings, now, measured.rms_n, measured.samples, measured.creep_doubt_n)
    after = replace(now, zero_n=round(zero_n, 6), zero_u_n=known_u_n, zero_c=measured.cell_c)
    figures: dict[str, Any] = {"mean_n": measured.mean_n, "rms_n": measured.rms_n}
    figures |= {"creep_n": measured.creep_n} if measured.creep_n else {}
    if math.isfinite(measured.second_n):
        after = replace(after, second_zero_n=round(measured.second_n, 6))
        figures |= {"second_n": measured.second_n}
    text = f"zero {now.zero_n:+z.3f} -> {after.zero_n:+z.3f} N (rms {measured.rms_n:.3f} N)"

    def of(standing: Standing) -> Entry:
        return entry(
            settings, "tare", request.operator, measured.wall_ns,
            before=_pair(now), after=_pair(standing), figures=figures,
        )  # fmt: skip

    section = settings.compensation
    if section is not None and section.temperature is not None and section.zero_n_k is None:
        told = drift([*entries, of(after)])
        if told is not None:
            after = replace(after, zero_n_k=told.zero_n_k, zero_u_n_k=told.zero_u_n_k)
            figures |= {"drift": str(told)}
            text += f"; {told}"
    return CalibrationFinding(of(after), text, order=zero_order(after))


def zero_order(now: Standing) -> SettingOrder:
    """Puts the zero in force in the loop, with its temperature and drift where they are known."""
    if now.zero_c is None and now.second_zero_n is None:
        return SettingOrder(Setting.ZERO, (now.zero_n,))
    celsius = (math.nan, math.nan) if now.zero_c is None else (now.zero_c, now.zero_n_k)
    second = math.nan if now.second_zero_n is None else now.second_zero_n
    return SettingOrder(Setting.ZERO, (now.zero_n, *celsius, second))


def scale_order(now: Standing) -> SettingOrder:
    """Puts the scale in force in the loop, and the calibration is not overdue."""
    second = () if now.second_zero_n is None else (now.second_scale,)
    return SettingOrder(Setting.SCALE, (now.scale, 0.0, *second))


def calibrate(settings: RigSettings, request: Request, now: Standing, measured: Measured) -> CalibrationFinding:
    """Compare the corrected reading with its reference; with ``adopt`` find the scale that makes them agree.

    Raises:
        FindingError: nothing hangs on the cell, or no scale within the bounds makes them agree.
    """
    section = settings.calibration
    assert section is not None  # `impossible` refuses a rig file without it
    reference_n = reference_of(section, request)
    reading_n = Correction(now.zero_n + measured.beside_n, now.scale).applied(measured.mean_n) - measured.creep_n
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
    figures: dict[str, Any] = {
        "reference_n": reference_n, "reading_n": reading_n, "deviation_pct": deviation_pct, "rms_n": measured.rms_n,
        "tolerance_pct": section.tolerance_pct, "against": "shunt" if request.shunt else "weight",
    }  # fmt: skip
    known_u = None if request.shunt else scale_u(
        settings, now, measured.rms_n, measured.samples, measured.creep_doubt_n, measured.cell_c, measured.when,
        reference_n,
    )  # fmt: skip
    if known_u is not None and not request.adopt:  # a deviation that is known and not corrected (JCGM 100, F.2.4.5)
        known_u += abs(deviation_pct) / 100.0
    after = replace(now, scale=scale, scale_u=now.scale_u if request.shunt else known_u)
    second_text = ""
    if math.isfinite(measured.second_n) and now.second_zero_n is not None and not request.shunt:
        second_n = (measured.second_n - now.second_zero_n) * now.second_scale
        figures |= {"second_n": second_n}
        second_text = f"; second force path {second_n:z.2f} N"
        if request.adopt and second_n > EMPTY_SHARE * reference_n:
            after = replace(after, second_scale=now.second_scale * reference_n / second_n)
            second_text += f", scale {now.second_scale:.5f} -> {after.second_scale:.5f}"
            if not after.correction.fits(settings):
                raise FindingError(
                    f"the scale of the second force path would be {after.second_scale:.4f}: nothing changed"
                )
    figures |= {} if known_u is None else {"u_pct": 100.0 * known_u}
    written = entry(
        settings, "calibrate", request.operator, measured.wall_ns,
        before=_pair(now), after=_pair(after), figures=figures, passed=passed,
    )  # fmt: skip
    found = f"read {reading_n:z.2f} N, reference {reference_n:g} N: {deviation_pct:+.3f} %"
    found += "" if known_u is None else f", uncertainty {100.0 * known_u:.3f} % (k = 2)"
    if request.adopt:
        found += f", scale {now.scale:.5f} -> {scale:.5f}{second_text}"
        return CalibrationFinding(written, found, order=scale_order(after))
    found += f"{second_text}, {'within' if passed else 'NOT within'} {section.tolerance_pct:g} %"
    blocked = not passed and section.waiver is None
    return CalibrationFinding(written, found, good=passed, order=SettingOrder(Setting.OVERDUE, (float(blocked),)))


def identify(settings: RigSettings, request: Request, records: npt.NDArray[Any], wall_ns: int) -> CalibrationFinding:
    """Plant parameters from the records of the excitation; changes nothing.

    Raises:
        FindingError: the records do not determine them.
    """
    try:
        signals = proposal.signals_of(records, settings.loop.period_ns * 1e-9)
        pairs, found = pairs_of(signals), proposal.rows(signals, settings)
    except IdentificationError as error:
        raise FindingError(str(error)) from None
    written = entry(
        settings, "identify", request.operator, wall_ns,
        before={row["key"]: row["before"] for row in found}, after={row["key"]: row["found"] for row in found},
        figures={
            "rows": found, "repetitions": len(pairs.kept), "left_out": pairs.late, "applied": False,
            "tension_n": float(records["tension_n"].mean()),
        },
    )  # fmt: skip
    return CalibrationFinding(written, proposal.in_words(found, pairs))


def response(settings: RigSettings, request: Request, found: dict[str, Any], wall_ns: int) -> CalibrationFinding:
    """A frequency response as `rigctl.operations.evaluation.response` found it; changes nothing."""
    written = entry(
        settings, "response", request.operator, wall_ns,
        before=found["before"], after=found["after"], figures=found["figures"],
    )  # fmt: skip
    return CalibrationFinding(written, str(found["text"]))


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
    return standing.pair


def reference_of(section: CalibrationSettings, request: Request) -> float:
    """The force of the shunt or of the weight that a request names, N."""
    if request.shunt:
        assert section.shunt_n is not None  # `impossible` refuses a shunt without a reference
        return section.shunt_n
    return request.value if math.isfinite(request.value) else section.reference_n
