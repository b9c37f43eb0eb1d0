"""The charts of the error and of the loop's timing."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from rigctl.metrics.error_statistics import error_n
from rigctl.metrics.phases import JudgedPhase
from rigctl.metrics.tension_error import error_pct
from rigctl.report import sensor_budget
from rigctl.report.drawing import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    RED,
    Chart,
    figure,
    finished,
    legend,
    unit_of_time,
)
from rigctl.report.findings import Findings
from rigctl.report.trace import trace

POINTS, BINS = 3000, 121
LEAST_US = 0.5
Floats = npt.NDArray[np.float64]


def error(found: Findings, phase: JudgedPhase) -> Chart:
    """The error against time, with the cell's sensor budget as a band."""
    eta_pct = error_pct(found.recording.records["vertical_n"][phase.judged], phase.target_n)
    t_ns = found.recording.records["t_ns"][phase.judged]
    t_s = (t_ns - t_ns[0]) * 1e-9
    drawn = figure(2.6)
    axes = drawn.subplots()
    axes.plot(*trace(t_s, eta_pct, POINTS), color=BLUE, linewidth=0.6, label="error the cell saw")
    size = max(1, round(found.rate_hz))
    smooth = np.convolve(eta_pct, np.full(size, 1.0 / size), "valid") if len(eta_pct) > 2 * size else eta_pct[:0]
    offset = size // 2
    axes.plot(
        *trace(t_s[offset : offset + len(smooth)], smooth, POINTS), color=ORANGE, linewidth=1.1, label="mean over 1 s"
    )
    if found.budget:
        half = 100.0 * sensor_budget.combined_n(found.budget) / phase.target_n
        axes.axhspan(-half, half, color=PALE, alpha=0.55, zorder=0, label=f"sensor budget ±{half:.2g} %")
    at = int(np.nanargmax(np.abs(eta_pct)))
    axes.plot(t_s[at], eta_pct[at], "o", color=RED, markersize=3.5, label=f"largest {eta_pct[at]:+.3g} %")
    axes.set_ylabel("error of vertical tension, %")
    axes.set_xlabel("judged time, s")
    axes.margins(x=0.01)
    legend(axes)
    return finished(drawn, f"Error of the vertical tension in phase {phase.number}, from the cell, against "
                    f"{phase.target_n:g} N. Grey: what the cell itself may have wrong (root of squares).")  # fmt: skip


def histogram(found: Findings) -> Chart:
    """Histogram of the error, with the normal distribution of the same mean and spread."""
    assert found.whole is not None  # the caller draws it only with phases
    parts = [error_n(found.recording.records, phase) for phase in found.phases]
    errors = np.concatenate(parts)
    errors = errors[np.isfinite(errors)]
    mean, spread = found.whole.mean_n, found.whole.spread_n
    largest = max(float(np.max(np.abs(errors - mean))), 1e-9)
    edges = mean + np.linspace(-largest, largest, BINS + 1)
    counts, _ = np.histogram(errors, edges)
    width = edges[1] - edges[0]
    drawn = figure(2.7)
    axes = drawn.subplots()
    axes.stairs(counts, edges, fill=True, color=BLUE, alpha=0.55, label=f"{len(errors):,} samples".replace(",", " "))
    if spread > 0.0:
        x = np.linspace(edges[0], edges[-1], 400)
        y = len(errors) * width * norm.pdf(x, mean, spread)
        axes.plot(x, y, color=INK, linewidth=1.0, label=f"normal, mean {mean:+.4f} N, spread {spread:.4f} N")
    axes.set_yscale("log")
    axes.set_ylim(0.5, max(2.0, 2.5 * float(np.max(counts))))
    axes.set_xlabel("error of vertical tension, N")
    axes.set_ylabel("samples in a bin")
    legend(axes)
    return finished(drawn, "Histogram of the error over all judged phases, and the normal distribution fitted to it.")


def spectrum(found: Findings) -> Chart | None:
    """Amplitude spectrum, with the frequencies of pendulum, bounce, shake and loop marked."""
    shown = found.spectrum
    if shown is None:
        return None
    drawn = figure(3.0)
    axes = drawn.subplots()
    keep = shown.frequency_hz > 0.0
    frequency, amplitude = _thinned(shown.frequency_hz[keep], np.maximum(shown.amplitude_n[keep], 1e-9))
    axes.loglog(frequency, amplitude, color=BLUE)
    axes.set_xlim(frequency[0], frequency[-1])
    top = max(amplitude) * 12.0
    axes.set_ylim(max(min(amplitude) * 0.5, top * 1e-7), top)
    for name, hz in sorted(found.lines.items(), key=lambda line: line[1]):
        loop = name == "loop bandwidth"
        axes.axvline(hz, color=GREEN if loop else GREY, linewidth=1.0 if loop else 0.7, linestyle="-" if loop else ":")
        text = f"{name} {hz:.2g} Hz" if not name.startswith("shake") else name
        axes.annotate(text, (hz, 0.985), xycoords=("data", "axes fraction"), rotation=90, ha="right", va="top",
                      fontsize=6, color=GREEN if loop else GREY)  # fmt: skip
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("amplitude, N")
    hz, newtons = shown.largest
    axes.plot(hz, newtons, "o", color=RED, markersize=3.5)
    axes.annotate(f"{newtons:.2g} N at {hz:.3g} Hz", (hz, newtons), xytext=(5, 4), textcoords="offset points",
                  fontsize=7, color=RED)  # fmt: skip
    return finished(drawn, f"Amplitude spectrum of the error over all judged phases: {shown.segments} segments of "
                    f"{1.0 / shown.resolution_hz:.3g} s, flat-top window; a sine shows its amplitude, noise its rms "
                    f"times √2 in {shown.noise_hz:.2g} Hz.")  # fmt: skip


def _thinned(frequency: Floats, amplitude: Floats, per_decade: int = 500) -> tuple[Floats, Floats]:
    """The largest amplitude for each place of a logarithmic axis."""
    place = np.round(np.log10(frequency) * per_decade).astype(np.int64)
    starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
    return frequency[starts], np.maximum.reduceat(amplitude, starts)


def lateness(found: Findings) -> Chart:
    """Lateness of every tick as a histogram, and over the recording."""
    records, figures = found.recording.records, found.timing
    late_us = np.asarray(records["lateness_ns"], np.float64) / 1000.0
    work_us = np.asarray(records["work_ns"], np.float64) / 1000.0
    drawn = figure(2.9)
    left, right = drawn.subplots(1, 2, width_ratios=[1.25, 1])
    end = max(2.0 * figures.period_us, float(np.max(late_us)), float(np.max(work_us)), 10.0)
    edges = np.geomspace(LEAST_US, end * 1.1, 90)
    for values, colour, label in ((work_us, GREEN, "work"), (late_us, BLUE, "lateness")):
        counts, _ = np.histogram(np.clip(values, LEAST_US, None), edges)
        left.stairs(counts, edges, fill=True, color=colour, alpha=0.5, label=label)
    left.axvline(figures.period_us, color=RED, linewidth=1.0)
    left.annotate("period", (figures.period_us, 0.98), xycoords=("data", "axes fraction"), rotation=90, ha="right",
                  va="top", fontsize=6.5, color=RED)  # fmt: skip
    left.set_xscale("log")
    left.set_yscale("log")
    left.set_ylim(0.5, None)
    left.set_xlabel("µs")
    left.set_ylabel("ticks in a bin")
    legend(left)
    unit, per = unit_of_time((found.recording.end_ns - found.recording.start_ns) * 1e-9)
    t_s = (records["t_ns"] - found.recording.start_ns) * 1e-9
    right.plot(*_scaled(trace(t_s, np.maximum(late_us, LEAST_US), 1200), per), color=BLUE, linewidth=0.5)
    right.axhline(figures.period_us, color=RED, linewidth=1.0)
    right.set_yscale("log")
    right.set_ylim(LEAST_US, 10 ** math.ceil(math.log10(end * 1.1)))
    right.set_xlabel(f"time, {unit}")
    right.set_ylabel("lateness, µs")
    return finished(drawn, "Lateness of the ticks after their grid points and work of the ticks, as histograms, and "
                    f"lateness over the recording. Red: one period; {figures.missed_deadlines} of the grid's periods "
                    "had no tick.")  # fmt: skip


def _scaled(line: tuple[Floats, Floats], per: float) -> tuple[Floats, Floats]:
    return line[0] / per, line[1]
