"""Plot of a design: Bode, Nyquist, and the sensitivities with their limit, for every plant of the family."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, filter_model
from rigctl.design import plant_family
from rigctl.design.closed_loop import controller
from rigctl.design.design_text import GAINS
from rigctl.design.gains import filter_gain
from rigctl.design.margins import Responses, frequency_grid, responses
from rigctl.design.plant_family import ComplexArray, Family, Member
from rigctl.design.verdict import Design, MemberMargins

SIZE_INCHES, DOTS_PER_INCH = (12.0, 13.0), 110
NYQUIST_WINDOW = (-2.9, 2.0, -1.8, 1.2)  # real and imaginary part; L itself goes to infinity at low frequency
SHOWN_DB, SHOWN_DEG = (-60.0, 60.0), (-540.0, 120.0)
SHOWN_HZ = 0.02
SAME = 5e-4  # scales nearer to 1 print as 1
# Okabe and Ito: distinct for colour-blind readers and in print
WORST = "#D00000"
COLOURS = ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#CC79A7", "#8A6D3B")


@dataclass(frozen=True)
class Curve:
    """Curve of one plant of the family."""

    plant: Member
    margins: MemberMargins
    answer: Responses
    colour: str
    nominal: bool  # the plant in the file, unscaled
    worst: bool  # that of the largest sensitivity peak

    def plot(self, axis: Axes, x: Array, y: Array) -> None:
        """A line in this plant's style: nominal thick and black, worst red, delay doubled dashed, unstable dotted."""
        style = ":" if not self.margins.stable else "--" if self.plant.delay_scale > 1 else "-"
        if self.nominal:
            axis.plot(x, y, color="black", linestyle=style, linewidth=2.4, zorder=5)
        elif self.worst:
            axis.plot(x, y, color=WORST, linestyle=style, linewidth=1.8, zorder=4)
        else:
            axis.plot(x, y, color=self.colour, linestyle=style, linewidth=0.8, alpha=0.8)


def draw(settings: RigSettings, found: Design, file: pathlib.Path, family: Family | None = None) -> None:
    """Write the picture; the name's suffix gives its format (.png, .svg, .pdf). ``family``: None for the assumed one.

    Raises:
        OSError: it cannot be written.
    """
    model = filter_model(settings)
    members = list((family or plant_family.assumed(settings)).members)
    hz = frequency_grid(members, model.period_s)
    hz = hz[hz >= SHOWN_HZ]
    law = controller(model, found.gains, filter_gain(model))  # open
    answers = responses(members, law, hz[:-1], model.period_s)  # at Nyquist itself a phase is 0 or 180 by rounding
    colours = dict(zip(dict.fromkeys(plant.k_m for plant in members), COLOURS, strict=False))
    own = _nearest(members, settings.plant.mechanism_n_mm)
    worst = max(found.margins, key=lambda margins: margins.ms_worst)
    curves = [
        Curve(plant, margins, answer, colours[plant.k_m], plant is own, margins is worst)
        for plant, margins, answer in zip(members, found.margins, answers, strict=True)
    ]
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    gains = ", ".join(f"{name} {getattr(found.gains, name):.4g} {unit}".rstrip() for name, unit, _ in GAINS)
    figure.suptitle(f"{settings.rig}: {found.verdict()}\n{gains}", fontsize=11)
    axes = figure.subplots(3, 2)
    _bode(axes[0, 0], axes[1, 0], curves, hz[:-1])
    _nyquist(axes[0, 1], curves, found.limit)
    _sensitivity(axes[1, 1], curves, hz[:-1], found.limit, "plant's input", lambda curve: curve.answer.s_input)
    _sensitivity(axes[2, 1], curves, hz[:-1], found.limit, "tension output", lambda curve: curve.answer.s_output)
    _disturbance(axes[2, 0], curves, hz[:-1], model.period_s)
    figure.legend(handles=_legend(curves), loc="outside lower center", ncols=5, fontsize=9)
    figure.savefig(file, dpi=DOTS_PER_INCH, format=file.suffix[1:].lower())


def _nearest(members: list[Member], k_m: float | None) -> Member:
    """The plant of the family that is nearest to the one in the settings."""
    alike = [plant for plant in members if plant.k_m == k_m] or members
    return min(alike, key=lambda p: abs(p.k_scale - 1.0) + abs(p.lag_scale - 1.0) + abs(p.delay_scale - 1.0))


def _bode(gain: Axes, phase: Axes, curves: list[Curve], hz: Array) -> None:
    for curve in curves:
        loop = curve.answer.loop
        curve.plot(gain, hz, 20.0 * np.log10(np.abs(loop)))
        curve.plot(phase, hz, np.degrees(np.unwrap(np.angle(loop))))
    gain.axhline(0.0, color="grey", linewidth=1.0)
    gain.set_ylim(*SHOWN_DB)
    _frequency_axis(gain, "loop at the plant's input: gain, dB")
    phase.axhline(-180.0, color="grey", linewidth=1.0)
    phase.set_ylim(*SHOWN_DEG)
    phase.set_yticks(np.arange(SHOWN_DEG[0], SHOWN_DEG[1], 90.0))
    _frequency_axis(phase, "loop at the plant's input: phase, deg")


def _nyquist(axis: Axes, curves: list[Curve], limit: float) -> None:
    for curve in curves:
        curve.plot(axis, curve.answer.loop.real, curve.answer.loop.imag)
    axis.add_patch(Circle((-1.0, 0.0), 1.0 / limit, facecolor="red", alpha=0.12))
    axis.add_patch(Circle((-1.0, 0.0), 1.0 / limit, fill=False, edgecolor="red"))
    axis.plot(-1.0, 0.0, "+", color="red", markersize=10)
    axis.annotate(f"|S| > {limit:g}", (-1.0, 0.12), color="red", ha="center", fontsize=9)
    left, right, low, high = NYQUIST_WINDOW
    axis.set_xlim(left, right)
    axis.set_ylim(low, high)
    axis.set_aspect("equal")
    axis.set_title("Nyquist, loop at the plant's input", fontsize=10)
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    axis.grid(visible=True, alpha=0.3)


def _sensitivity(
    axis: Axes, curves: list[Curve], hz: Array, limit: float, place: str, values: Callable[[Curve], ComplexArray]
) -> None:
    peaks = [(0.0, float(hz[0]))]
    for curve in curves:
        modulus = np.abs(values(curve))
        curve.plot(axis, hz, modulus)
        if curve.margins.stable:
            peaks.append((float(modulus.max()), float(hz[modulus.argmax()])))
    peak, at = max(peaks)
    axis.axhline(limit, color="red", linewidth=1.2)
    axis.annotate(f"limit {limit:g}", (1.2 * hz[0], limit), color="red", fontsize=9, va="bottom")
    axis.plot(at, peak, "o", color="red", markersize=4, zorder=6)
    axis.set_ylim(0.0, max(1.25 * limit, min(1.1 * peak, 4.0 * limit)))
    _frequency_axis(axis, f"|S| at the {place}: highest stable peak {peak:.3f} at {at:.3g} Hz")


def _disturbance(axis: Axes, curves: list[Curve], hz: Array, period_s: float) -> None:
    per_position = np.abs(np.exp(2j * np.pi * hz * period_s) - 1.0) / period_s
    for curve in curves:
        locked = np.abs(curve.answer.disturbance) * per_position
        curve.plot(axis, hz, locked * np.abs(curve.answer.s_output))
        if curve.nominal:
            axis.loglog(hz, locked, color="grey", linewidth=2.4)
    _frequency_axis(axis, "true tension per mm of disturbance, N/mm (grey: stroke locked)")
    axis.set_yscale("log")


def _frequency_axis(axis: Axes, title: str) -> None:
    axis.set_xscale("log")
    axis.set_title(title, fontsize=10)
    axis.set_xlabel("Hz")
    axis.grid(visible=True, which="both", alpha=0.25)
    axis.margins(x=0.0)


def _legend(curves: list[Curve]) -> list[Line2D]:
    nominal = next(curve for curve in curves if curve.nominal)
    handles = [Line2D([], [], color="black", linewidth=2.4, label="plant in the file")]
    handles.append(_worst_in_words(next(curve for curve in curves if curve.worst)))
    seen: dict[float | None, str] = {curve.plant.k_m: curve.colour for curve in curves}
    for k_m, colour in seen.items():
        handles.append(Line2D([], [], color=colour, label="rigid" if k_m is None else f"K_m {k_m:.4g} N/mm"))
    longest = max(curve.plant.delay_scale for curve in curves)
    handles.append(Line2D([], [], color="grey", linestyle="-", label=f"delay x {nominal.plant.delay_scale:.3g}"))
    handles.append(Line2D([], [], color="grey", linestyle="--", label=f"delay x {longest:.3g}"))
    if not all(curve.margins.stable for curve in curves):
        handles.append(Line2D([], [], color="grey", linestyle=":", label="unstable"))
    return handles


def _worst_in_words(curve: Curve) -> Line2D:
    plant, margins = curve.plant, curve.margins
    k_m = "rigid" if plant.k_m is None else f"K_m {plant.k_m:.3g}"
    scales = {"k": plant.k_scale, "lag": plant.lag_scale, "delay": plant.delay_scale}
    scaled = "".join(f", {name} x {scale:.3g}" for name, scale in scales.items() if abs(scale - 1.0) > SAME)
    ms = f"Ms {margins.ms_worst:.3f}" if margins.stable else "unstable"
    colour, width = ("black", 2.4) if curve.nominal else (WORST, 1.8)
    return Line2D([], [], color=colour, linewidth=width, label=f"worst plant ({k_m}{scaled}): {ms}")
