"""The entry of a frequency response, and its picture."""

from __future__ import annotations

import pathlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rigctl.commission import response_entry
from rigctl.commission.frequency_response import ComplexArray, plant_response
from rigctl.commission.measured_margins import MeasuredMargins, measure
from rigctl.commission.motion import Array
from tests.builders.linear_plant import TruePlant
from tests.builders.synthetic_response import PLANT, amplitudes, open_loop, records
from tests.unit.conftest import Rig


def proportional(hz: Array) -> tuple[ComplexArray, ComplexArray]:
    return np.full(len(hz), -1.0 + 0.0j), np.zeros(len(hz), np.complex128)


def made(rig: Rig, plant: TruePlant = PLANT) -> tuple[dict[str, Any], MeasuredMargins]:
    found, settings = amplitudes(records(plant, sensitivity=open_loop)), rig()
    margins = measure(found, settings.plant, proportional, measured=False)
    figures = response_entry.figures(plant_response(found), margins, found, settings.plant)
    figures |= {"mode": "HOLD", "tension_n": 300.0, "stroke_mm": 52.0}
    return {"rig": "paper_rig", "when": "2026-01-01T00:00:00Z", "figures": figures}, margins


def test_a_rigid_mechanism_is_said_to_be_stiffer_than_what_was_excluded(rig: Rig) -> None:
    entry, margins = made(rig)
    mechanism = entry["figures"]["plant"]["mechanism_n_mm"]
    assert (mechanism["value"], mechanism["error"]) == (None, None)
    assert mechanism["above"] > 100.0
    words = response_entry.in_words(margins)
    assert words.startswith("stiffness ")
    assert "mechanism stiffer than " in words
    assert response_entry.values(margins.plant)["mechanism_n_mm"] is None


def test_a_resonance_gives_the_mechanisms_stiffness_and_damping(rig: Rig) -> None:
    entry, margins = made(rig, replace(PLANT, mechanism=60.0))
    plant = entry["figures"]["plant"]
    assert plant["mechanism_n_mm"]["value"] == pytest.approx(60.0, rel=0.03)
    assert plant["mechanism_damping"]["value"] == pytest.approx(0.02, rel=0.5)
    assert ", mechanism 6" in response_entry.in_words(margins) or ", mechanism 5" in response_entry.in_words(margins)


@pytest.mark.parametrize("mechanism", [None, 60.0])
@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_picture_is_drawn_from_the_entry_alone(
    rig: Rig, tmp_path: pathlib.Path, mechanism: float | None, suffix: str
) -> None:
    from rigctl.commission import response_plot

    entry, _ = made(rig, replace(PLANT, mechanism=mechanism))
    file = tmp_path / f"response{suffix}"
    response_plot.draw(entry, file)
    assert file.stat().st_size > 20_000
