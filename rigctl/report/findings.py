"""The figures of a report from a recording, computed once for both page and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.ipc.ledger import IN_FORCE, Standing
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.metrics import timing
from rigctl.metrics.error_statistics import ErrorStatistics, error_n, statistics
from rigctl.metrics.phases import SETTLE_S, JudgedPhase, phases
from rigctl.model.quantity import count
from rigctl.recorder.audit_log import moment
from rigctl.recorder.recording import Recording
from rigctl.report import bus, culprits, happenings, sensor_budget, spectrum, verdict

NEEDED = (
    "seq", "t_ns", "tick", "skipped", "lateness_ns", "work_ns", "mode", "fault", "tension_n", "tension_quality",
    "tangential_rad", "normal_rad", "inclination_quality", "stroke_mm", "speed_mm_s", "command_mm_s", "target_n",
    "setpoint_n", "vertical_n", "tangential_estimate_rad", "normal_estimate_rad", "frames_sent", "frames_received",
    "frames_lost", "frames_refused", "send_failures", "error_frames",
)  # fmt: skip
ADVICE = (
    "The error is that of the tension the cell measured, times the cosines of the measured inclination. It is not the "
    "true force on the payload: what cell and amplifier have wrong is in no figure of this page but the sensor budget."
)


class ReportError(ValueError):
    """A recording from which no report can be made; ``str()`` is one line."""


@dataclass(frozen=True)
class Findings:
    """The figures of a report."""

    recording: Recording
    rate_hz: float
    settings: RigSettings | None
    active: dict[str, Any]
    control: dict[str, Any]
    standings: list[tuple[int, Standing]]
    """Calibrations in force during the recording, each with its start (CLOCK_MONOTONIC, ns), the oldest first."""
    ledger: list[dict[str, Any]]
    gains: Gains | None
    phases: list[JudgedPhase]
    by_phase: list[ErrorStatistics]
    whole: ErrorStatistics | None
    spectrum: spectrum.Spectrum | None
    lines: dict[str, float]
    timing: timing.Timing
    bus: bus.Bus
    events: list[happenings.Happening]
    trips: list[happenings.RecordedTrip]
    culprits: list[culprits.RecordedCulprit]
    """Of every time that a fault was latched; none where the settings cannot be read."""
    modes: list[happenings.ModeSpan]
    operators: list[str]
    budget: list[sensor_budget.Error]
    verdict: verdict.ReportVerdict
    remarks: list[str]
    """Remarks that limit the value of the other figures."""

    @property
    def shown(self) -> JudgedPhase | None:
        """The longest phase, which is drawn in detail."""
        return max(self.phases, key=lambda phase: (phase.after - phase.first, -phase.number), default=None)

    @property
    def notes(self) -> list[str]:
        """What operators wrote down meanwhile."""
        return [item.text for item in self.events if item.what == "operator note"]

    def utc(self, t_ns: int) -> str:
        """A time of CLOCK_MONOTONIC on the wall clock, to the millisecond."""
        wall_ns = t_ns + self.recording.wall_offset_ns
        try:
            return moment(wall_ns)
        except (ValueError, OverflowError, OSError):  # a clock that was never set, or a damaged file
            return f"{wall_ns} ns"


def find(recording: Recording) -> Findings:
    """Compute all figures.

    Raises:
        ReportError: there are no records, or they are not of this kind.
    """
    records = recording.records
    where = recording.files[0].path
    if not len(records):
        raise ReportError(f"{where}: found no record, expected a recording of a loop that ran")
    if missing := [name for name in NEEDED if name not in (records.dtype.names or ())]:
        raise ReportError(f"{where}: its records have no {', '.join(missing)}: written by another version of rigctl")
    found = phases(records)
    at_ns = found[0].entered_ns if found else recording.end_ns
    active, control = recording.table(ACTIVE, at_ns) or {}, recording.table("control.json", at_ns) or {}
    settings, gains = _settings(active), _gains(active)
    rate_hz = _rate(recording, settings)
    by_phase = [statistics(records, [phase], rate_hz) for phase in found]
    judged = [phase for phase, figures in zip(found, by_phase, strict=True) if figures is not None]
    whole = statistics(records, judged, rate_hz)
    target_n = judged[0].target_n if judged else None
    parts = [(_seconds(records, phase), error_n(records, phase)) for phase in judged]
    return Findings(
        recording=recording,
        rate_hz=rate_hz,
        settings=settings,
        active=active,
        control=control,
        standings=_standings(recording),
        ledger=_entries(recording, recording.end_ns),
        gains=gains,
        phases=judged,
        by_phase=[figures for figures in by_phase if figures is not None],
        whole=whole,
        spectrum=spectrum.spectrum(parts, rate_hz),
        lines=spectrum.named_lines(settings, gains) if settings is not None else {},
        timing=timing.timing(records, rate_hz),
        bus=bus.bus(records, settings),
        events=happenings.happenings(recording),
        trips=happenings.trips(recording),
        culprits=culprits.culprits(recording, settings) if settings is not None else [],
        modes=happenings.mode_spans(records),
        operators=happenings.operators(recording),
        budget=_budget(recording, settings, target_n, at_ns) if settings is not None else [],
        verdict=verdict.judge(records, judged, whole, settings, rate_hz),
        remarks=_remarks(recording, settings),
    )


def _seconds(records: npt.NDArray[np.void], phase: JudgedPhase) -> npt.NDArray[np.float64]:
    t_ns = records["t_ns"][phase.judged]
    return np.asarray(t_ns - t_ns[0], np.float64) * 1e-9


def _settings(active: dict[str, Any]) -> RigSettings | None:
    try:
        return RigSettings.model_validate(active.get("settings"))
    except (ValidationError, RecursionError):
        return None


def _gains(active: dict[str, Any]) -> Gains | None:
    design = active.get("design")
    try:
        return msgspec.convert(design.get("gains"), Gains) if isinstance(design, dict) else None
    except msgspec.MsgspecError:
        return None


def _budget(
    recording: Recording, settings: RigSettings, target_n: float | None, at_ns: int
) -> list[sensor_budget.Error]:
    """The budget of the cell as calibrated and compensated then; of its class where nothing is known."""
    before = [standing for since_ns, standing in _standings(recording) if since_ns <= at_ns]
    if not before:
        return sensor_budget.budget(settings, target_n)
    try:
        at = datetime.fromtimestamp((at_ns + recording.wall_offset_ns) / 1e9, UTC)
    except (ValueError, OverflowError, OSError):
        return sensor_budget.budget(settings, target_n)
    return sensor_budget.compensated(settings, before[-1], target_n, at)


def _standings(recording: Recording) -> list[tuple[int, Standing]]:
    found = []
    for document in recording.generations:
        if document.name == IN_FORCE:
            try:
                found.append((document.t_ns, msgspec.json.decode(document.data, type=Standing)))
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                continue
    return found


def _entries(recording: Recording, t_ns: int) -> list[dict[str, Any]]:
    """Entries of the ledger in force at ``t_ns``, the oldest first."""
    found = (recording.table("calibration_ledger.json", t_ns) or {}).get("entries")
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def _rate(recording: Recording, settings: RigSettings | None) -> float:
    if settings is not None:
        return float(settings.loop.rate_hz)
    steps = np.diff(recording.records["t_ns"])
    step_ns = float(np.median(steps)) if len(steps) else 0.0
    return 1e9 / step_ns if step_ns > 0.0 else 1000.0


def _remarks(recording: Recording, settings: RigSettings | None) -> list[str]:
    said = [
        f"{file.path.name} is cut short or damaged ({file.note}); everything up to there is in this report"
        for file in recording.files
        if not file.complete
    ]
    for gap in recording.gaps:
        if gap.ring == "records":
            t_s = (gap.t_ns - recording.start_ns) * 1e-9
            said.append(f"{count(gap.count, 'record')} {'is' if gap.count == 1 else 'are'} missing after {t_s:.3f} s")
    others = sum(gap.count for gap in recording.gaps if gap.ring != "records")
    if others:
        rings = sorted({gap.ring for gap in recording.gaps if gap.ring != "records"})
        said.append(
            f"{count(others, 'slot')} of other rings {'is' if others == 1 else 'are'} missing ({', '.join(rings)})"
        )
    if unseen := _overwritten(recording):
        were = "was" if unseen == 1 else "were"
        said.append(
            f"{count(unseen, 'CAN frame')} {were} overwritten before the recorder had read them: not in the file"
        )
    if settings is None:
        said.append("its settings cannot be read by this version of rigctl: the rig's own limits are not judged")
    return said


def _overwritten(recording: Recording) -> int:
    """Frames overwritten in their ring before the recorder read them; each recorder process counts from 0."""
    total = before = 0
    for item in recording.said.get("recorder", []):
        lost = item.details.get("lost")
        count = lost.get("frames") if isinstance(lost, dict) else None
        if isinstance(count, int):
            total += count - before if count >= before else count
            before = count
    return total


def as_dict(found: Findings) -> dict[str, Any]:
    """As JSON values; a figure that is not finite becomes null."""
    recording, peak = found.recording, found.spectrum.largest if found.spectrum else None
    document = _finite(
        {
            "rig": recording.rig,
            "run": recording.run,
            "files": [{"file": f.path.name, "bytes": f.size, "sha256": f.sha256, "complete": f.complete, "note": f.note}
                      for f in recording.files],
            "sha256": recording.sha256,
            "complete": recording.complete,
            "start": found.utc(recording.start_ns),
            "end": found.utc(recording.end_ns),
            "duration_s": (recording.end_ns - recording.start_ns) * 1e-9,
            "operators": found.operators,
            "basis": "cell",
            "settle_s": SETTLE_S,
            "verdict": found.verdict.word,
            "criteria": [asdict(row) for row in found.verdict.criteria],
            "error": asdict(found.whole) if found.whole else None,
            "phases": [
                {"number": phase.number, "entered": found.utc(phase.entered_ns), "target_n": phase.target_n,
                 "ended": phase.ended, "faulted": phase.faulted, **asdict(figures)}
                for phase, figures in zip(found.phases, found.by_phase, strict=True)
            ],
            "largest_line": None if peak is None else {"hz": peak[0], "amplitude_n": peak[1]},
            "lines_hz": found.lines,
            "sensor_budget_n": {**{error.name: error.newtons for error in found.budget},
                                "combined": sensor_budget.combined_n(found.budget)} if found.budget else None,
            "timing": asdict(found.timing),
            "bus": asdict(found.bus),
            "trips": [{"t": found.utc(trip.t_ns), "reason": trip.reason, "dump": trip.dump} for trip in found.trips],
            "culprits": [{"t": found.utc(one.t_ns), **one.culprit.as_message()} for one in found.culprits],
            "remarks": found.remarks,
        }
    )  # fmt: skip
    assert isinstance(document, dict)
    return document


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
