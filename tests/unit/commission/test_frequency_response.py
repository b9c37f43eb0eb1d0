"""Frequency response from records whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.commission.frequency_response import FEWEST_PERIODS, PlantResponse, plant_response
from rigctl.commission.identification import IdentificationError
from rigctl.model.states import Flag
from tests.builders.synthetic_response import BAND, PLANT, TICK_S, amplitudes, records

TICKS = round(BAND.period_s / TICK_S)
TAIL = [each for each in BAND.harmonics if each > BAND.highest_hz * BAND.period_s]


def found(**options: float) -> PlantResponse:
    return plant_response(amplitudes(records(**options)))  # type: ignore[arg-type]


def test_without_noise_it_is_the_plants() -> None:
    response = found(noise_n=0.0)
    truth = PLANT.response(response.frequencies_hz)
    assert response.tension.value == pytest.approx(truth[0], rel=1e-6)
    for rounded, true in ((response.stroke, truth[1]), (response.speed, truth[2])):  # alike in each period
        assert np.mean(np.abs(rounded.value - true) <= 1.5 * rounded.gain_error) > 0.9
    assert response.sensitivity.value == pytest.approx(np.ones(len(truth[0])), abs=1e-12)
    assert response.tension.coherence == pytest.approx(np.ones(len(truth[0])), abs=1e-6)


def test_19_of_20_intervals_hold_the_truth() -> None:
    inside: list[bool] = []
    for seed in range(20):
        response = found(seed=seed)
        tension, truth = response.tension, PLANT.response(response.frequencies_hz)[0]
        inside += list(np.abs(np.abs(tension.value) - np.abs(truth)) <= tension.gain_error)
        off_deg = np.degrees(np.abs(np.angle(tension.value / truth)))
        inside += list(off_deg <= tension.phase_error_deg)
    assert 0.93 <= np.mean(inside) <= 0.99  # of 720; what is not excited adds a little to each


def test_more_noise_makes_wider_intervals_and_less_coherence() -> None:
    quiet, noisy = found(noise_n=0.01).tension, found(noise_n=0.3).tension
    assert np.median(noisy.phase_error_deg / quiet.phase_error_deg) == pytest.approx(30.0, rel=0.3)
    assert (noisy.coherence < quiet.coherence).all()
    assert noisy.coherence.min() < 0.3
    assert quiet.coherence[: -len(TAIL)].min() > 0.999


def test_in_a_closed_loop_the_plant_is_found_although_the_noise_goes_round_it() -> None:
    """Without the instrument the estimate tends to -1 / C where the noise is large."""
    gain = -8.0  # mm/s per N, fed back at once

    def loop(hz: np.ndarray[tuple[int], np.dtype[np.float64]]) -> np.ndarray[tuple[int, int], np.dtype[np.complex128]]:
        closed = 1.0 / (1.0 - gain * PLANT.response(hz)[0])
        return np.stack([closed, gain * closed])

    response = plant_response(amplitudes(records(sensitivity=loop, noise_n=0.3, periods=40)))
    truth = PLANT.response(response.frequencies_hz)[0]
    off = np.abs(np.abs(response.tension.value) - np.abs(truth))
    assert np.mean(off <= response.tension.gain_error) > 0.85
    direct = response.sensitivity
    off = np.abs(np.abs(direct.value) - np.abs(loop(response.frequencies_hz)[0]))
    assert np.mean(off <= direct.gain_error) > 0.85


def test_what_is_not_linear_widens_the_intervals_although_every_period_is_the_same() -> None:
    plain = records(noise_n=0.001)
    bent = plain.copy()
    bent["tension_n"] += 0.5 * (plain["tension_n"] - 300.0) ** 2
    straight, curved = (plant_response(amplitudes(each)).tension for each in (plain, bent))
    off = np.abs(np.abs(curved.value) - np.abs(straight.value))
    assert (curved.gain_error > 2.0 * straight.gain_error).mean() > 0.9
    assert np.mean(off <= curved.gain_error) > 0.8


def test_a_drift_is_not_taken_for_an_answer() -> None:
    drifting = records(noise_n=0.0)
    drifting["tension_n"] += 0.02 * TICK_S * np.arange(len(drifting))
    drifting["stroke_mm"] += 0.05 * TICK_S * np.arange(len(drifting))
    response = plant_response(amplitudes(drifting))
    assert response.tension.value == pytest.approx(PLANT.response(response.frequencies_hz)[0], rel=1e-5)


def test_records_after_the_measurement_are_left_out() -> None:
    whole = records()
    more = np.concatenate([whole, whole[:500]])
    more["seq"] = np.arange(len(more))
    assert plant_response(amplitudes(more, spare=500)).tension.value == pytest.approx(
        plant_response(amplitudes(whole)).tension.value
    )


def test_periods_with_skipped_ticks_are_left_out() -> None:
    cut = records(periods=12)
    cut["skipped"][5 * TICKS + 100 :] = 3
    kept = amplitudes(cut)
    assert (kept.periods, kept.left_out) == (10, 2)  # that period and the next
    assert found(periods=12).tension.value == pytest.approx(plant_response(kept).tension.value, rel=0.3)
    cut["skipped"] = np.arange(len(cut)) // 1000
    with pytest.raises(IdentificationError, match="skip periods in 12 of 12 periods of the excitation: repeat it"):
        amplitudes(cut)


def test_missing_records_and_too_few_periods_are_refused() -> None:
    whole = records()
    with pytest.raises(IdentificationError, match=f"5 periods on record, {FEWEST_PERIODS} are needed"):
        amplitudes(whole[: 5 * TICKS + 1])
    with pytest.raises(IdentificationError, match="0 periods on record"):
        amplitudes(whole[:1])
    with pytest.raises(IdentificationError, match="records of the measurement are missing"):
        amplitudes(np.delete(whole, 7000)[-11 * TICKS - 1 :])


def test_periods_in_which_the_command_was_limited_are_left_out() -> None:
    cut = records(periods=12)
    cut["flags"][5 * TICKS + 100] = Flag.LIMITED_ACCELERATION  # as the cell's noise alone does
    assert amplitudes(cut).periods == 12
    cut["flags"][5 * TICKS + 100 : 5 * TICKS + 200] = Flag.LIMITED_SPEED
    assert amplitudes(cut).periods == 10
    cut["flags"] = Flag.LIMITED_SPEED
    with pytest.raises(IdentificationError, match="the command was limited in 12 of 12 periods"):
        amplitudes(cut)
