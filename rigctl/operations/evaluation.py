"""What the records of a multisine show: the plant's frequency response, and the margins of the loop in force."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.commission import measured_margins, response_entry
from rigctl.commission.frequency_response import ComplexArray, PlantResponse, plant_response, spectra
from rigctl.commission.identification import IdentificationError
from rigctl.commission.measured_margins import Controller
from rigctl.commission.motion import Array
from rigctl.commission.proposal import left_out_in_words
from rigctl.commission.sensitivity_check import SensitivityDifference, difference
from rigctl.config.settings import RigSettings
from rigctl.control.excitation import frequency_trial, margin_probe
from rigctl.control.excitation.multisine import Multisine
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Gains
from rigctl.model.states import Mode
from rigctl.model.unmeasured import Unmeasured

SAME_MM_S = 1e-9  # one period's multisine is the next one's, to rounding
VAGUE = 0.2  # a sensitivity peak less certain than that says nothing of a limit


class EvaluationError(ValueError):
    """The records cannot be evaluated; ``str()`` says why, in one line, ``reason`` its kind."""

    def __init__(self, why: str, reason: int = Unmeasured.OTHER) -> None:
        super().__init__(why)
        self.reason = reason


def response(settings: RigSettings, gains: Gains, records: npt.NDArray[Any]) -> dict[str, Any]:
    """What the records of a `FrequencyTrial` show: ``after``, ``before``, ``figures`` of an entry, and its ``text``.

    Raises:
        IdentificationError: they do not determine the plant.
    """
    if not len(records):
        raise IdentificationError("the records of the excitation are not there any more")
    measured, after = frequency_trial.measured_ticks(settings)
    regulated = int(records["mode"][-1]) == Mode.COMPENSATING
    part = records[-(measured + after + 2) :]
    signal = frequency_trial.signal(settings, regulated=regulated)
    return _judged(settings, gains, part, signal, spare=after, regulated=regulated)


def _judged(
    settings: RigSettings, gains: Gains, records: npt.NDArray[Any], signal: Multisine, *, spare: int, regulated: bool
) -> dict[str, Any]:
    found = spectra(records, signal.harmonics, signal.ticks, 1.0 / settings.loop.rate_hz, spare=spare)
    margins = measured_margins.measure(found, settings.plant, law_response(settings, gains), measured=regulated)
    within = records[: len(records) - spare] if spare else records
    tension_n = float(within["tension_n"].mean())
    measured = plant_response(found)
    left_out = left_out_in_words(
        "periods, in which the loop skipped ticks or the command was limited, and after those,",
        found.left_out, found.periods,
    )  # fmt: skip
    figures = response_entry.figures(measured, margins, found, settings.plant) | {
        "mode": Mode(int(records["mode"][-1])).name,
        "tension_n": round(tension_n, 3),
        "stroke_mm": round(float(within["stroke_mm"].mean()), 3),
        "peak_n": round(float(np.abs(within["tension_n"] - tension_n).max()), 3),
        "peak_mm_s": round(float(np.abs(within["excitation_mm_s"]).max()), 4),
    }
    text = ", ".join(part for part in (response_entry.in_words(margins), left_out) if part)
    if regulated:
        differs = compared(settings, gains, measured)
        figures["difference"] = None if differs is None else differs.as_dict()
        text += "" if differs is None else f"; WARNING: {differs.in_words()}"
    return {
        "before": response_entry.values_assumed(settings.plant),
        "after": response_entry.values(margins.plant),
        "figures": figures,
        "text": text,
    }


def compared(settings: RigSettings, gains: Gains, measured: PlantResponse) -> SensitivityDifference | None:
    """Where the measured sensitivity is not one of the family over which the gains in force were judged."""
    from rigctl.design.in_use import family_in_use
    from rigctl.design.margins import predicted_band

    found, hz = measured.sensitivity, measured.frequencies_hz
    low, high = predicted_band(settings, gains, family_in_use(settings), hz)
    return difference(hz, np.abs(found.value), found.gain_error, low, high)


def margins(settings: RigSettings, gains: Gains, records: npt.NDArray[Any]) -> dict[str, Any]:
    """Sensitivity peak, its uncertainty and its frequency from the last minute of a `MarginProbe`.

    Raises:
        IdentificationError: the multisine was not at its level for long enough.
    """
    shape, tick_s = margin_probe.signal(settings), 1.0 / settings.loop.rate_hz
    excitation = records["excitation_mm_s"]
    changes = np.flatnonzero(np.abs(excitation[shape.ticks :] - excitation[: -shape.ticks]) >= SAME_MM_S)
    steady = records[int(changes[-1]) + 1 if len(changes) else 0 :]
    peak_mm_s = margin_probe.level(settings) * shape.peak_mm_s
    if not len(steady) or abs(float(np.abs(steady["excitation_mm_s"]).max()) - peak_mm_s) > SAME_MM_S:
        raise IdentificationError("the margins' multisine is not at its level", Unmeasured.UNSTEADY)
    part = steady[-(margin_probe.WINDOW_PERIODS * shape.ticks + 1) :]
    found = spectra(part, shape.harmonics, shape.ticks, tick_s)
    measured = measured_margins.measure(found, settings.plant, law_response(settings, gains))
    if not measured.ms.error <= VAGUE:
        raise IdentificationError(
            f"the margins' multisine is too weak here: Ms {measured.ms.value:.2f} +- {measured.ms.error:.2f}; a larger "
            "margins.probe_n, or `rigctl identify --response`",
            Unmeasured.WEAK,
        )
    differs = compared(settings, gains, plant_response(found))
    return {
        "ms": measured.ms.value,
        "error": measured.ms.error,
        "peak_hz": measured.peak_hz,
        "periods": found.periods,
        "difference": None if differs is None else differs.as_dict(),
    }


def law_response(settings: RigSettings, gains: Gains) -> Controller:
    """Law and filter of the running loop as a function of frequency."""
    from rigctl.design.closed_loop import controller
    from rigctl.design.gains import filter_gain

    model = filter_model(settings)
    law, tick_s = controller(model, gains, filter_gain(model)), 1.0 / settings.loop.rate_hz

    def at(frequencies_hz: Array) -> tuple[ComplexArray, ComplexArray]:
        per_tension, per_speed = law.response(np.exp(2j * np.pi * frequencies_hz * tick_s))
        return per_tension, per_speed

    return at
