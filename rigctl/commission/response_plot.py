"""Picture of a frequency response from its entry in the ledger: plant with intervals, coherence, sensitivities."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rigctl.commission.motion import Array
from rigctl.commission.plant_fit import RATIO_ASSUMED, PlantModel

SIZE_INCHES, DOTS_PER_INCH = (9.0, 11.0), 110
COHERENT = 0.9
MEASURED, FITTED, OUTPUT = "#0072B2", "#D55E00", "#009E73"  # Okabe and Ito: distinct for colour-blind readers


def draw(entry: dict[str, Any], file: pathlib.Path) -> None:
    """Write the picture; the name's suffix gives its format (.png, .svg, .pdf).

    Args:
        entry: of a frequency response, as `rigctl.ipc.ledger.Entry` in plain values.
        file: where to.

    Raises:
        OSError: it cannot be written.
    """
    figures = entry["figures"]
    lines = dict(zip(figures["columns"], np.array(figures["lines"], np.float64).T, strict=True))
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    gain, phase, coherence, sensitivity = figure.subplots(4, 1, sharex=True, height_ratios=(3, 2, 1, 3))
    _plant(gain, phase, lines, figures)
    _coherence(coherence, lines)
    _sensitivity(sensitivity, lines, figures)
    for axis in (gain, phase, coherence, sensitivity):
        axis.set_xscale("log")
        axis.grid(visible=True, which="both", alpha=0.25)
    sensitivity.set_xlabel("frequency, Hz")
    where = f"{figures['mode']}, {figures['tension_n']:.0f} N, stroke {figures['stroke_mm']:.1f} mm"
    figure.suptitle(f"{entry['rig']}: frequency response, {where}, {entry['when']}", fontsize=11)
    figure.savefig(file, dpi=DOTS_PER_INCH)


def _plant(gain: Axes, phase: Axes, lines: dict[str, Array], figures: dict[str, Any]) -> None:
    hz = lines["hz"]
    good = lines["coherence"] >= COHERENT
    fine = np.geomspace(hz[0] / 1.2, hz[-1] * 1.1, 600)
    fitted = _model(figures).responses(fine, figures["tick_s"])[0]
    gain.loglog(fine, np.abs(fitted), color=FITTED, linewidth=1.2, label="fit")
    turned = np.degrees(np.unwrap(np.angle(fitted)))
    nearest = int(np.argmin(np.abs(fine - hz[0])))
    turned += 360.0 * np.round((lines["phase_deg"][0] - turned[nearest]) / 360.0)
    phase.plot(fine, turned, color=FITTED, linewidth=1.2)
    for which, face in ((good, MEASURED), (~good, "white")):
        label = f"measured, 95 %{'' if face == MEASURED else f'; coherence < {COHERENT:g}'}"
        style: dict[str, Any] = {
            "fmt": "o",
            "markersize": 4.5,
            "color": MEASURED,
            "markerfacecolor": face,
            "elinewidth": 0.9,
        }
        if not which.any():
            continue
        low = np.minimum(lines["gain_error"], 0.95 * lines["gain"])  # a bar to zero has no place on this scale
        gain.errorbar(hz[which], lines["gain"][which], [low[which], lines["gain_error"][which]], label=label, **style)
        phase.errorbar(hz[which], lines["phase_deg"][which], np.minimum(lines["phase_error_deg"], 90.0)[which], **style)
    gain.set_ylabel("tension per command, N s/mm")
    gain.legend(loc="lower left")
    phase.set_ylabel("phase, deg")
    shown = turned[(fine >= hz[0]) & (fine <= hz[-1])]
    phase.set_ylim(float(shown.min()) - 40.0, float(shown.max()) + 40.0)


def _coherence(axis: Axes, lines: dict[str, Array]) -> None:
    axis.plot(lines["hz"], lines["coherence"], "o-", markersize=4, linewidth=0.8, color=MEASURED)
    axis.axhline(COHERENT, color="gray", linewidth=0.8, linestyle=":")
    axis.set_ylim(0.0, 1.05)
    axis.set_ylabel("coherence")


def _sensitivity(axis: Axes, lines: dict[str, Array], figures: dict[str, Any]) -> None:
    curves, margins = figures["curves"], figures["margins"]
    axis.plot(curves["hz"], curves["input"], color=FITTED, linewidth=1.2, label=_ms("plant input", margins["ms_input"]))
    axis.plot(curves["hz"], curves["output"], color=OUTPUT, linewidth=1.2, label=_ms("tension", margins["ms_output"]))
    if margins["measured"]:
        shown = lines["sensitivity_error"] < lines["sensitivity"]
        axis.errorbar(
            lines["hz"][shown], lines["sensitivity"][shown], lines["sensitivity_error"][shown], fmt="o", markersize=4.5,
            color=MEASURED, elinewidth=0.9, label="measured at the input, 95 %",
        )  # fmt: skip
    axis.set_ylabel("|S|" if margins["measured"] else "|S|, predicted")
    axis.set_ylim(bottom=0.0)
    axis.legend(loc="upper left")


def _ms(where: str, pair: dict[str, float]) -> str:
    return f"{where}: Ms {pair['value']:.2f} +- {pair['error']:.2f}"


def _model(figures: dict[str, Any]) -> PlantModel:
    value = {name: pair["value"] for name, pair in figures["plant"].items()}
    return PlantModel(
        value["stiffness_n_mm"], value["damping_n_s_mm"], value["lag_s"], value["delay_s"], value["sensor_delay_s"],
        1.0, value["mechanism_n_mm"], value["mechanism_damping"] or RATIO_ASSUMED, figures["payload_kg"],
    )  # fmt: skip
