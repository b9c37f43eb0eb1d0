"""The report's tables as rows of text, with rounded figures and units."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import yaml

from rigctl.metrics.error_statistics import ErrorStatistics
from rigctl.metrics.tension_error import PERCENTILES
from rigctl.model.quantity import unit_of
from rigctl.report import sensor_budget
from rigctl.report.findings import Findings

KEY_SETTINGS = (
    "loop.rate_hz", "loop.priority", "can.interface", "can.bitrate_bit_s", "tension_cell.range_n",
    "tension_cell.noise_n", "inclinometer.rate_hz", "cylinder.stroke_min_mm", "cylinder.stroke_max_mm",
    "plant.spring_n_mm", "plant.rope_n_mm", "plant.rope_length_mm", "plant.payload_kg", "plant.cylinder_lag_s",
    "plant.command_delay_s", "plant.mechanism_n_mm", "tension.target_n", "tension.ramp_n_s", "tension.speed_max_mm_s",
    "tension.acceleration_max_mm_s2", "safety.tension_high_n", "safety.tension_low_n", "safety.stale_ms",
    "safety.overrun_ticks",
)  # fmt: skip
LEDGER_SHOWN = 8
_GAIN_UNITS = {"k_tension": "mm/s per N", "k_speed": "", "k_integral": "mm/s per N s"}


class TableRow(NamedTuple):
    """A quantity with its value and unit."""

    name: str
    value: str
    unit: str = ""


def number(value: Any, digits: int = 4) -> str:
    """A figure to significant digits; another value as it is, None as a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return "–"
    return f"{value:,}".replace(",", " ") if isinstance(value, int) else f"{value:.{digits}g}"


def mapping(found: Any) -> dict[str, Any]:
    """A mapping from a document in the recording; empty if it is not one, as another version may have written it."""
    return found if isinstance(found, dict) else {}


def listed(found: Any) -> list[dict[str, Any]]:
    """The mappings in a list, likewise."""
    return [item for item in found if isinstance(item, dict)] if isinstance(found, list) else []


def _peak(value: Any) -> float:
    """A peak from JSON; an unstable loop has null there, which is infinite here."""
    return float(value) if isinstance(value, (int, float)) else math.inf


def duration(seconds: float) -> str:
    """A duration in words."""
    if seconds < 120.0:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    return (f"{hours} h " if hours else "") + f"{rest // 60} min {rest % 60:02d} s"


def error_rows(figures: ErrorStatistics) -> list[TableRow]:
    """Statistics of the error."""
    return [
        TableRow("judged time", f"{figures.seconds:.1f}", "s"),
        TableRow("samples", number(figures.samples)),
        TableRow("largest error", f"{figures.eta_max_pct:.4f}", "%"),
        TableRow("99 % of samples within", f"{figures.eta_p99_pct:.4f}", "%"),
        TableRow("rms error", f"{figures.eta_rms_pct:.4f}", "%"),
        TableRow("mean error", f"{figures.mean_n:+.4f}", "N"),
        TableRow("spread (standard deviation)", f"{figures.spread_n:.4f}", "N"),
        TableRow("vertical tension, least", f"{figures.vertical_min_n:.2f}", "N"),
        TableRow("vertical tension, largest", f"{figures.vertical_max_n:.2f}", "N"),
        TableRow("samples of a sensor not good", number(figures.not_good)),
    ]


def timing_rows(found: Findings) -> list[tuple[str, ...]]:
    """Percentiles of lateness and work, in microseconds."""
    figures = found.timing
    return [
        (name, *(f"{values[key]:.0f}" for key in PERCENTILES))
        for name, values in (("lateness", figures.lateness_us), ("work", figures.work_us))
    ]


def move_rows(found: Findings) -> list[tuple[str, str]]:
    """Marked moves: when each ended, and what was learnt from it or why nothing was."""
    told = ("learnt", "not learnt")
    return [(found.utc(event.t_ns), event.text) for event in found.events if event.what in told]


def budget_rows(found: Findings) -> list[tuple[str, str, str, str]]:
    """The sensor budget: name, N, percent of the target, source."""
    errors = found.budget
    if not errors or found.settings is None:
        return []
    target_n = found.phases[0].target_n if found.phases else found.settings.tension.target_n
    rows = [(e.name, f"{e.newtons:.3f}", f"{100 * e.newtons / target_n:.3f}", e.source) for e in errors]
    for name, total_n, source in (
        ("root of squares", sensor_budget.combined_n(errors), "independent contributions, JCGM 100"),
        ("sum", math.fsum(error.newtons for error in errors), "all at once and of one sign"),
        ("noise, rms", found.settings.tension_cell.noise_n, "of the cell as the rig file has it; random, in the error"),
    ):
        rows.append((name, f"{total_n:.3f}", f"{100 * total_n / target_n:.3f}", source))
    return rows


def calibration_rows(found: Findings) -> list[tuple[str, ...]]:
    """Each calibration in force during the recording: start, phases judged with it, zero, scale and dates."""
    rows: list[tuple[str, ...]] = []
    starts = [since_ns for since_ns, _ in found.standings]
    ends = [*starts[1:], None]
    for i, ((since_ns, standing), until_ns) in enumerate(zip(found.standings, ends, strict=True)):
        judged = [
            str(phase.number)
            for phase in found.phases
            if (i == 0 or phase.entered_ns >= since_ns) and (until_ns is None or phase.entered_ns < until_ns)
        ]
        rows.append((
            found.utc(since_ns), ", ".join(judged) or "none", f"{standing.zero_n:+z.4f}", f"{standing.scale:.6f}",
            standing.tared or "none on record", standing.due or "no check that passed is on record",
            "yes" if standing.overdue else "no", standing.waiver or "",
        ))  # fmt: skip
    return rows


def ledger_rows(found: Findings) -> list[tuple[str, ...]]:
    """The last entries of the ledger: date, kind, operator, result, changes, figures.

    An identification changes nothing: its result is shown beside the value of the rig file.
    """
    rows: list[tuple[str, ...]] = []
    for entry in found.ledger[-LEDGER_SHOWN:]:
        before, after = mapping(entry.get("before")), mapping(entry.get("after"))
        figures = mapping(entry.get("figures"))
        applied = figures.get("applied") is not False
        said = [
            f"{key} {number(value)}" for key, value in sorted(figures.items())
            if key != "applied" and not isinstance(value, (dict, list))
        ]  # fmt: skip
        differs = [key for key in sorted(after) if before.get(key) != after.get(key)]
        if applied:
            changes = [f"{key} {number(before.get(key))} → {number(after.get(key))}" for key in differs]
        else:
            changes = []
            said += [f"{key} found {number(after[key])} (rig file {number(before.get(key))})" for key in differs]
        passed = entry.get("passed")
        result = "passed" if passed is True else "FAILED" if passed is False else ""
        rows.append((str(entry.get("when", "")), str(entry.get("what", "")), str(entry.get("operator", "")), result,
                     "; ".join(changes) or "nothing changed", ", ".join(said)))  # fmt: skip
    return rows


def settings_rows(found: Findings) -> list[TableRow]:
    """The most important settings."""
    settings = mapping(found.active.get("settings"))
    rows = []
    for path in KEY_SETTINGS:
        section, key = path.split(".")
        values = mapping(settings.get(section))
        if key in values:
            rows.append(TableRow(path, number(values[key], 6), unit_of(key)))
    return rows


def settings_yaml(found: Findings) -> str:
    """All settings in force."""
    settings = mapping(found.active.get("settings"))
    return yaml.safe_dump(settings, sort_keys=False, allow_unicode=True, width=100)


def gain_rows(found: Findings) -> list[TableRow]:
    """Gains in force at the first phase."""
    gains = mapping(mapping(found.active.get("design")).get("gains"))
    return [TableRow(name, number(value, 6), _GAIN_UNITS.get(name, "")) for name, value in gains.items()]


def margin_rows(found: Findings) -> list[tuple[str, ...]]:
    """Margins over the family of plants; the last column marks the worst."""
    members = listed(mapping(found.active.get("design")).get("margins"))
    peaks = [max(_peak(member.get("ms")), _peak(member.get("ms_output"))) for member in members]
    rows: list[tuple[str, ...]] = []
    for member, peak in zip(members, peaks, strict=True):
        k_m = member.get("k_m")
        rows.append((
            "rigid" if k_m is None else number(k_m), number(member.get("k_scale")), number(member.get("delay_scale")),
            number(member.get("ms")), number(member.get("ms_output")), number(member.get("gm_db"), 3),
            number(member.get("pm_deg"), 3), number(member.get("dm_ms"), 3), "worst" if peak == max(peaks) else "",
        ))  # fmt: skip
    return rows


def measured_rows(found: Findings) -> list[tuple[str, ...]]:
    """Each measurement of the margins while COMPENSATING: when it came, Ms, its uncertainty."""
    records = found.recording.records
    if "sensitivity_peak" not in (records.dtype.names or ()):
        return []
    peak, error = records["sensitivity_peak"], records["sensitivity_peak_error"]
    new = peak > 0.0  # before the first measurement it is NaN
    new[1:] &= (peak[1:] != peak[:-1]) | (error[1:] != error[:-1])
    return [
        (found.utc(int(records["t_ns"][i])), f"{peak[i]:.3f}", f"{error[i]:.3f}") for i in np.flatnonzero(new).tolist()
    ]


def design_words(found: Findings) -> list[str]:
    """The verdict on the design, and its warnings."""
    design = mapping(found.active.get("design"))
    warnings = design.get("warnings")
    said = [design.get("verdict"), *(warnings if isinstance(warnings, list) else [])]
    return [str(line) for line in said if line]


def realtime_rows(found: Findings) -> list[tuple[str, str, str]]:
    """Real-time settings: name, value in force, warning ("" for none)."""
    return [
        (str(item.get("name", "")), str(item.get("in_force", "")),
         "" if item.get("ok") is True else str(item.get("warning") or "not granted"))
        for item in listed(found.control.get("realtime"))
    ]  # fmt: skip


def device_rows(found: Findings) -> list[tuple[str, str, str]]:
    """Devices by their own identity objects: name, node, serial number."""
    return [
        (str(item.get("name", "")), f"node {item.get('node', '?')}", f"serial {item.get('serial', '?')}")
        for item in listed(found.control.get("devices"))
    ]


def bus_rows(found: Findings) -> list[TableRow]:
    """Frames, and the worst-case load."""
    figures = found.bus
    load = "not known" if figures.load is None else f"{100 * figures.load:.1f}"
    return [
        TableRow("frames sent", number(figures.sent)),
        TableRow("frames received", number(figures.received)),
        TableRow("frames lost", number(figures.lost)),
        TableRow("frames refused (length, value)", number(figures.refused)),
        TableRow("unsent frames", number(figures.unsent)),
        TableRow("CAN error frames", number(figures.error_frames)),
        TableRow(f"load at worst (limit {100 * figures.load_limit:.0f} %)", load, "" if figures.load is None else "%"),
    ]
