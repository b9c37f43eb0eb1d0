"""The charts of the test itself: its course, the paper's Fig. 9, inclination, stroke and speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from rigctl.metrics.phases import JudgedPhase
from rigctl.report.drawing import (
    BAND,
    BLUE,
    GREEN,
    GREY,
    INK,
    MODE_COLOURS,
    ORANGE,
    RED,
    SEVERITY_COLOURS,
    TEAL,
    VIOLET,
    Chart,
    figure,
    finished,
    legend,
    unit_of_time,
)
from rigctl.report.findings import Findings
from rigctl.report.trace import trace
from rigctl.report.verdict import REQUIREMENT_PCT

POINTS = 2400
Floats = npt.NDArray[np.float64]
LEADS_IN_NS = 2_000_000_000
"""Time shown before the judged part of a phase drawn in detail."""
NARROW = 0.045
"""Share of the band below which a mode has no room for its name."""
NAMED = 12
"""Largest number of trips with names; more names would overlap."""


def overview(found: Findings) -> Chart:
    """The whole recording on one time axis: vertical tension, stroke, and below them modes, events and trips."""
    records, start_ns = found.recording.records, found.recording.start_ns
    length_s = max((found.recording.end_ns - start_ns) * 1e-9, 1e-3)
    unit, per = unit_of_time(length_s)
    t_s = (records["t_ns"] - start_ns) * 1e-9
    drawn = figure(3.7)
    force, stroke, band = drawn.subplots(3, 1, sharex=True, height_ratios=[4, 2, 1.3])
    x, y = trace(t_s, records["vertical_n"], POINTS)
    force.plot(x / per, y, color=BLUE, label="vertical tension")
    x, y = trace(t_s, records["target_n"], POINTS)
    force.plot(x / per, y, color=INK, linewidth=0.7, linestyle=(0, (4, 3)), label="target")
    for number, phase in enumerate(found.phases):
        begin, end = ((int(records["t_ns"][at]) - start_ns) * 1e-9 / per for at in (phase.first, phase.after - 1))
        half = phase.target_n * REQUIREMENT_PCT / 100.0
        label = f"judged, ±{REQUIREMENT_PCT:g} %" if number == 0 else None
        force.fill_between([begin, end], phase.target_n - half, phase.target_n + half, color=BAND, label=label)
        force.annotate(f"{phase.number}", ((begin + end) / 2, phase.target_n - half), ha="center", va="top",
                       xytext=(0, -1), textcoords="offset points", fontsize=7, color=GREEN)  # fmt: skip
    force.set_ylabel("vertical tension, N")
    legend(force)
    x, y = trace(t_s, records["stroke_mm"], POINTS)
    stroke.plot(x / per, y, color=VIOLET)
    stroke.set_ylabel("stroke, mm")
    _modes(band, found, start_ns, per, length_s / per)
    band.set_xlabel(f"time since {found.utc(start_ns)}, {unit}")
    for axes in (force, stroke, band):
        for trip in found.trips:
            axes.axvline((trip.t_ns - start_ns) * 1e-9 / per, color=RED, linewidth=1.0)
    for trip in found.trips[:NAMED]:
        force.annotate(trip.name, ((trip.t_ns - start_ns) * 1e-9 / per, 0.06), xycoords=("data", "axes fraction"),
                       rotation=90, ha="right", va="bottom", fontsize=6, color=RED)  # fmt: skip
    _missing(found, (force, stroke), start_ns, per)
    return finished(drawn, "The whole recording: vertical tension from the cell, stroke, modes (band), events (ticks: "
                    "grey information, orange warning, red error) and trips (red lines). Green: what is judged, with "
                    "the number of the phase.")  # fmt: skip


def _modes(axes: Axes, found: Findings, start_ns: int, per: float, length: float) -> None:
    for span in found.modes:
        begin, end = ((t_ns - start_ns) * 1e-9 / per for t_ns in (span.start_ns, span.end_ns))
        axes.barh(0.0, end - begin, 0.8, begin, color=MODE_COLOURS.get(span.name, GREY), linewidth=0)
        room = (end - begin) / length
        if room > NARROW:
            name = span.name if room > 0.012 * len(span.name) else span.name[:4].capitalize() + "."
            axes.text((begin + end) / 2, 0.0, name, ha="center", va="center", fontsize=6)
    for event in found.events:
        t = (event.t_ns - start_ns) * 1e-9 / per
        if 0.0 <= t <= length:
            axes.plot([t, t], [0.65, 1.15], color=SEVERITY_COLOURS[event.severity], linewidth=0.8)
    axes.set_ylim(-0.5, 1.25)
    axes.set_xlim(0.0, length)
    axes.set_yticks([0.0, 0.9], ["mode", "events"])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")


def _missing(found: Findings, all_axes: tuple[Axes, ...], start_ns: int, per: float) -> None:
    t_ns = found.recording.records["t_ns"]
    for gap in found.recording.gaps:
        if gap.ring == "records":
            at = min(int(np.searchsorted(t_ns, gap.t_ns, side="right")), len(t_ns) - 1)
            begin, end = ((t - start_ns) * 1e-9 / per for t in (gap.t_ns, int(t_ns[at])))
            for axes in all_axes:
                axes.axvspan(begin, end, facecolor="none", edgecolor=RED, hatch="////", linewidth=0.0, alpha=0.5)


def figure_9(found: Findings, phase: JudgedPhase) -> Chart:
    """The paper's Fig. 9: tension in the rope, its vertical component, tangential and normal inclination."""
    t_s, part = _drawn(found, phase)
    drawn = figure(4.6)
    (a, b), (c, d) = drawn.subplots(2, 2, sharex=True)
    for axes, name, label, title, colour, scale in (
        (a, "tension_n", "tension, N", "(a) tension in the rope", BLUE, 1.0),
        (b, "vertical_n", "vertical tension, N", "(b) vertical component of the tension", BLUE, 1.0),
        (c, "tangential_rad", "inclination, deg", "(c) tangential inclination", TEAL, 180.0 / np.pi),
        (d, "normal_rad", "inclination, deg", "(d) normal inclination", ORANGE, 180.0 / np.pi),
    ):
        axes.plot(*trace(t_s, part[name] * scale, POINTS // 2), color=colour)
        axes.set_ylabel(label)
        axes.set_title(title)
    half = phase.target_n * REQUIREMENT_PCT / 100.0
    b.axhspan(phase.target_n - half, phase.target_n + half, color=BAND, zorder=0)
    for axes in (a, b):
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, phase.target_n - 1.2 * half), max(high, phase.target_n + 1.2 * half))
    b.annotate(f"±{REQUIREMENT_PCT:g} % of {phase.target_n:g} N", (0.98, phase.target_n + half), ha="right", va="top",
               xycoords=("axes fraction", "data"), xytext=(0, -2), textcoords="offset points", fontsize=7,
               color=GREEN)  # fmt: skip
    for axes in (c, d):
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, -0.2), max(high, 0.2))
    for axes in (c, d):
        axes.set_xlabel("time in the phase, s")
    return finished(drawn, f"The paper's Fig. 9 from this recording, phase {phase.number}: tension in the rope, its "
                    "vertical component, tangential and normal inclination.")  # fmt: skip


def inclination(found: Findings, phase: JudgedPhase) -> Chart:
    """Both inclinations against time, and against each other."""
    t_s, part = _drawn(found, phase)
    tangential, normal = (np.degrees(part[name]) for name in ("tangential_rad", "normal_rad"))
    drawn = figure(2.9)
    grid = drawn.add_gridspec(1, 2, width_ratios=[1.7, 1])
    left = drawn.add_subplot(grid[0, 0])
    left.plot(*trace(t_s, tangential, POINTS), color=TEAL, label="tangential")
    left.plot(*trace(t_s, normal, POINTS), color=ORANGE, label="normal")
    left.set_ylabel("inclination, deg")
    left.set_xlabel("time in the phase, s")
    legend(left)
    right: Any = drawn.add_subplot(grid[0, 1], projection="polar")
    step = max(1, len(part) // POINTS)
    right.plot(np.arctan2(normal, tangential)[::step], np.hypot(tangential, normal)[::step], color=TEAL, linewidth=0.6)
    right.set_title("deg; tangential to the right, normal up", loc="center", fontsize=7, fontweight="normal")
    right.set_xticks(np.radians([0, 90, 180, 270]), [""] * 4)
    right.set_rlabel_position(45)
    right.yaxis.set_major_locator(_few())
    right.tick_params(labelsize=6.5)
    right.spines["polar"].set_color(GREY)
    return finished(drawn, f"Inclination of the rope in phase {phase.number}, as the inclinometer sends it: against "
                    "time, and as a polar trace of the rope's direction.")  # fmt: skip


def _few() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(4)


def motion(found: Findings, phase: JudgedPhase) -> Chart:
    """Stroke, and speed with command."""
    t_s, part = _drawn(found, phase)
    drawn = figure(3.2)
    above, below = drawn.subplots(2, 1, sharex=True)
    above.plot(*trace(t_s, part["stroke_mm"], POINTS), color=VIOLET)
    above.set_ylabel("stroke, mm")
    below.plot(*trace(t_s, part["command_mm_s"], POINTS), color=GREEN, label="command", linewidth=0.6)
    below.plot(*trace(t_s, part["speed_mm_s"], POINTS), color=VIOLET, label="speed", linewidth=0.6)
    below.set_ylabel("speed, mm/s")
    below.set_xlabel("time in the phase, s")
    legend(below)
    return finished(drawn, f"Stroke of the cylinder, its speed and the command in phase {phase.number}.")


def _drawn(found: Findings, phase: JudgedPhase) -> tuple[Floats, npt.NDArray[np.void]]:
    """Records of a phase with its lead-in, and their times since the start of the lead-in."""
    records = found.recording.records
    judged_ns = int(records["t_ns"][phase.first])
    begin_ns = max(phase.entered_ns, judged_ns - LEADS_IN_NS)
    first = int(np.searchsorted(records["t_ns"], begin_ns))
    part = records[first : phase.after]
    return (part["t_ns"] - begin_ns) * 1e-9, part
