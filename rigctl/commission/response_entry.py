"""A frequency response as an entry of the ledger: plain numbers, with the half widths of their 95 % intervals."""

from __future__ import annotations

from typing import Any

import numpy as np

from rigctl.commission.frequency_response import PlantResponse, Ratio, Spectra
from rigctl.commission.identification import Estimated
from rigctl.commission.measured_margins import MeasuredMargins
from rigctl.commission.motion import Array
from rigctl.commission.plant_fit import PlantFit
from rigctl.commission.proposal import rounded
from rigctl.config.plant_section import PlantSettings

COLUMNS = (
    "hz", "gain", "gain_error", "phase_deg", "phase_error_deg", "coherence", "sensitivity", "sensitivity_error",
)  # fmt: skip
"""Of a line: the tension per command in N s/mm with its phase, and the command per excitation, which is |S|."""
CURVE_POINTS = 60
_DIGITS = 6  # significant ones

Figures = dict[str, Any]


def figures(response: PlantResponse, found: MeasuredMargins, spectra: Spectra, assumed: PlantSettings) -> Figures:
    """The figures of an entry; mode, tension, stroke and peaks are the caller's to add."""
    plant = found.plant
    return {
        "plant": _plant(plant),
        "payload_kg": assumed.payload_kg,
        "fit": _short(plant.misfit),
        "margins": {
            "measured": found.measured,
            "ms_input": _pair(found.ms_input),
            "ms_output": _pair(found.ms_output),
            "peak_hz": _short(found.peak_hz),
            "covered_hz": _short(found.covered_hz),
            "beyond": found.beyond,
            "at_least": _short(found.at_least),
        },
        "columns": list(COLUMNS),
        "lines": _lines(response.frequencies_hz, response.tension, response.sensitivity),
        "curves": _curves(found),
        "periods": spectra.periods,
        "left_out": spectra.left_out,
        "period_s": spectra.period_s,
        "tick_s": spectra.tick_s,
        "applied": False,
    }


def values(plant: PlantFit) -> dict[str, float | None]:
    """What the plant was found to be, by the names of the entry."""
    model = plant.model
    return {
        "stiffness_n_mm": _short(model.stiffness),
        "lag_s": _short(model.lag_s),
        "delay_s": _short(model.delay_s),
        "sensor_delay_s": _short(model.sensor_delay_s),
        "damping_n_s_mm": _short(model.damping),
        "mechanism_n_mm": None if plant.mechanism_n_mm is None else _short(plant.mechanism_n_mm.value),
    }


def values_assumed(plant: PlantSettings) -> dict[str, float | None]:
    """The same as the rig file has them; None for what it does not have."""
    return {
        "stiffness_n_mm": _short(plant.stiffness_n_mm),
        "lag_s": plant.cylinder_lag_s,
        "delay_s": plant.command_delay_s,
        "sensor_delay_s": None,
        "damping_n_s_mm": None,
        "mechanism_n_mm": plant.mechanism_n_mm,
    }


def in_words(found: MeasuredMargins) -> str:
    """One line for the operator."""
    plant, ms = found.plant, found.ms
    parts = [
        f"stiffness {_words(plant.stiffness_n_mm)} N/mm",
        f"lag {_words(plant.lag_s, 1e3)} ms",
        f"delay {_words(plant.delay_s, 1e3)} ms",
    ]
    if plant.mechanism_n_mm is not None:
        parts.append(f"mechanism {_words(plant.mechanism_n_mm)} N/mm")
    elif plant.mechanism_above is not None:
        parts.append(f"mechanism stiffer than {plant.mechanism_above:.0f} N/mm")
    if found.measured and found.beyond:
        parts.append(f"Ms at least {found.at_least:.3f} measured up to {found.covered_hz:.2g} Hz")
        parts.append(f"{_words(ms)} predicted at {found.peak_hz:.2g} Hz, as plant found and controller continue it")
    else:
        parts.append(f"Ms {_words(ms)} {'measured' if found.measured else 'predicted'} at {found.peak_hz:.2g} Hz")
    return ", ".join(parts)


def _words(found: Estimated, factor: float = 1.0) -> str:
    value, error = rounded(found.value * factor, found.error * factor)
    return f"{value} +- {error}"


def _plant(plant: PlantFit) -> Figures:
    mechanism = _pair(plant.mechanism_n_mm)
    above = None if plant.mechanism_above is None else _short(plant.mechanism_above)
    return {
        "stiffness_n_mm": _pair(plant.stiffness_n_mm),
        "lag_s": _pair(plant.lag_s),
        "delay_s": _pair(plant.delay_s),
        "sensor_delay_s": _pair(plant.sensor_delay_s),
        "damping_n_s_mm": {**_pair(plant.damping_n_s_mm), "value": _short(plant.model.damping)},  # held: no error
        "mechanism_n_mm": {**mechanism, "above": above},
        "mechanism_damping": _pair(plant.mechanism_damping),
    }


def _pair(found: Estimated | None) -> Figures:
    if found is None:
        return {"value": None, "error": None}
    return {"value": _short(found.value), "error": _short(found.error)}


def _lines(frequencies_hz: Array, tension: Ratio, sensitivity: Ratio) -> list[list[float]]:
    phase_deg = np.degrees(np.unwrap(np.angle(tension.value)))
    columns = (
        frequencies_hz, np.abs(tension.value), tension.gain_error, phase_deg, tension.phase_error_deg,
        tension.coherence, np.abs(sensitivity.value), sensitivity.gain_error,
    )  # fmt: skip
    return [[_short(value) for value in line] for line in np.column_stack(columns).tolist()]


def _curves(found: MeasuredMargins) -> Figures:
    """Sensitivities between the lines, of fewer points than were computed."""
    curves = found.curves
    at = np.unique(np.linspace(0, len(curves.frequencies_hz) - 1, CURVE_POINTS).round().astype(int))
    shown = {"hz": curves.frequencies_hz, "input": np.abs(curves.at_input), "output": np.abs(curves.at_output)}
    return {name: [_short(value) for value in column[at].tolist()] for name, column in shown.items()}


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
