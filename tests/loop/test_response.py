"""A frequency response on the simulated rig with its known truth: from the command to the entry of the ledger."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from rigctl.commission import response_entry
from rigctl.commission.identification import IdentificationError
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.frequency_trial import HELD, REGULATED, STRAY_N
from rigctl.control.law.tension import Gains
from rigctl.design.gains import design
from rigctl.model.states import Flag, Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations.evaluation import law_response, response
from tests.builders.excited import built, respond, tensioned
from tests.builders.linear_plant import true_plant, true_sensitivities
from tests.builders.paths import ROOT

FINE_HZ = np.geomspace(0.05, 499.0, 6000)
LIMITED = int(Flag.LIMITED_SPEED | Flag.LIMITED_ACCELERATION | Flag.LIMITED_STROKE)
COHERENT, GAIN_SHARE, PHASE_DEG = 0.9, 0.02, 3.0  # what issue 14 promises


PAPER = config.load(ROOT / "config/paper_rig.yaml")


def sprung(spring_n_mm: float | None) -> RigSettings:
    return PAPER.model_copy(update={"plant": PAPER.plant.model_copy(update={"spring_n_mm": spring_n_mm})})


def found(settings: RigSettings, gains: Gains, records: npt.NDArray[Any]) -> dict[str, Any]:
    """As the ledger keeps it."""
    kept: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(response(settings, gains, records)))
    return kept


def columns(entry: dict[str, Any]) -> dict[str, npt.NDArray[np.float64]]:
    lines = np.array(entry["figures"]["lines"])
    return dict(zip(entry["figures"]["columns"], lines.T, strict=True))


def check_form(entry: dict[str, Any], mode: Mode, settings: RigSettings) -> None:
    """What `rigctl tune` reads is there."""
    figures = entry["figures"]
    assert set(entry["after"]) == set(entry["before"])
    assert all(math.isfinite(value) for value in entry["after"].values() if value is not None)
    assert set(figures["plant"]) == {*entry["after"], "mechanism_damping"}
    assert all({"value", "error"} <= set(pair) for pair in figures["plant"].values())
    assert figures["columns"] == list(response_entry.COLUMNS)
    assert len(figures["lines"]) <= 32
    assert (figures["mode"], figures["payload_kg"]) == (mode.name, settings.plant.payload_kg)
    assert figures["tension_n"] == pytest.approx(300.0, abs=2.0)
    assert 0.2 < figures["peak_n"] < HELD.tension_n
    assert figures["peak_mm_s"] <= HELD.share * settings.tension.speed_max_mm_s * 1.001
    assert figures["fit"] < 1.5
    assert ("predicted" if mode is Mode.HOLD else "measured") in entry["text"]
    assert len(msgspec.json.encode(entry)) < 12_000


@pytest.mark.study
@pytest.mark.parametrize(
    ("mode", "spring_n_mm", "as_built"),
    [
        pytest.param(Mode.HOLD, 6.0, {"lag_scale": 1.2, "delay_scale": 2.0}, marks=pytest.mark.long),
        pytest.param(Mode.COMPENSATING, 34.0, {"mechanism": 60.0}, marks=pytest.mark.long),
        (Mode.COMPENSATING, 6.0, {}),
    ],
)
def test_the_response_is_the_true_one_wherever_it_is_coherent(
    mode: Mode, spring_n_mm: float, as_built: dict[str, Any]
) -> None:
    settings = sprung(spring_n_mm)
    gains, real = design(settings), built(settings, **as_built)
    with tensioned(real, gains, mode) as run:
        ended, records = respond(run)
        assert ended is Refusal.NONE
        assert run.loop.machine.mode is mode
    bound_n = (REGULATED if mode is Mode.COMPENSATING else HELD).tension_n
    assert np.abs(records["vertical_n"] - 300.0).max() < bound_n + STRAY_N
    assert np.mean((records["flags"] & LIMITED) != 0) < 1e-3  # the cell's noise alone reaches them now and then
    entry, true = found(settings, gains, records), true_plant(real)
    check_form(entry, mode, settings)
    lines = columns(entry)
    coherent = lines["coherence"] >= COHERENT
    assert np.count_nonzero(coherent) >= 10
    truth = true.response(lines["hz"])[0]
    assert np.abs(lines["gain"] / np.abs(truth) - 1.0)[coherent].max() < GAIN_SHARE
    off_deg = np.degrees(np.angle(np.exp(1j * np.radians(lines["phase_deg"])) / truth * np.abs(truth)))
    assert np.abs(off_deg)[coherent].max() < PHASE_DEG

    plant = entry["figures"]["plant"]
    for name, value in (
        ("stiffness_n_mm", true.stiffness), ("lag_s", true.lag), ("damping_n_s_mm", true.damping)
    ):  # fmt: skip
        assert abs(plant[name]["value"] - value) <= 1.5 * plant[name]["error"], name
    assert plant["delay_s"]["value"] == pytest.approx(true.delay, abs=0.15e-3)
    if true.mechanism is None:
        assert plant["mechanism_n_mm"]["value"] is None
        assert plant["mechanism_n_mm"]["above"] > 20.0 * true.stiffness
    else:
        assert plant["mechanism_n_mm"]["value"] == pytest.approx(true.mechanism, rel=0.05)
    margins = entry["figures"]["margins"]
    acting = law_response(settings, gains)(FINE_HZ)
    peaks = np.abs(true_sensitivities(true, *acting, FINE_HZ)).max(axis=1)
    assert margins["measured"] is (mode is Mode.COMPENSATING)
    assert margins["ms_input"]["value"] == pytest.approx(peaks[0], abs=0.1)
    assert margins["ms_output"]["value"] == pytest.approx(peaks[1], abs=0.1)


@pytest.mark.gate("3")
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.COMPENSATING])
def test_a_hold_ends_it_at_once_and_an_ended_one_gives_no_figures(mode: Mode) -> None:
    settings = PAPER
    gains = design(settings)
    with tensioned(settings, gains, mode) as run:
        given = run.give(Verb.RESPONSE, math.nan)
        records = run.run(6.0)
        assert records["excitation_mm_s"].any()
        assert run.hold() is Refusal.NONE
        after = run.run(1.0)
        assert not after["excitation_mm_s"].any()
        assert run.loop.machine.mode is Mode.HOLD
        replies = run.runtime.replies.reader(from_start=True).read()
        assert Refusal(int(replies["reason"][replies["id"] == given][0])) is Refusal.ABORTED
        assert abs(after["command_mm_s"][-1]) < 0.1
    with pytest.raises(IdentificationError):
        response(settings, gains, records)
