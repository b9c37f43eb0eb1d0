"""The figures of the study's runs, on signals whose figures are known."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from hil.plant.inputs import pack
from hil.plant.kernel import profile
from hil.plant.layout import HEIGHT, MECHANISM, RUN_OUT
from hil.studies.paper import claims
from hil.studies.paper.cases import FIGURE_9, NO_SPRING, SPEEDS_DEG_S, cases, speed, stiffness
from hil.studies.paper.claim_tables import remark
from hil.studies.paper.claims import CLAIMS, Claim, ClaimResult
from hil.studies.paper.run_truth import RunTruth
from hil.studies.planned_run import STIFFNESSES_N_MM
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from tests.builders.rig_bench import SETTINGS

T_S = np.arange(0.0, 30.0, 0.001)


def signals(peak_n: float = 301.0, plateau_n: float = 300.5, lag_deg: float = 0.7, peak_s: float = 4.0) -> RunTruth:
    """A rise to a peak, then a plateau; the lag does the same, the pulley goes 0.25 mm, the normal angle to 0.07."""
    shape = np.where(peak_s > T_S, T_S / peak_s, np.maximum(0.5, 1.0 - (T_S - peak_s)))
    vertical = 300.0 + np.where(peak_s + 0.5 > T_S, (peak_n - 300.0) * shape, plateau_n - 300.0)
    lag = np.where(peak_s + 0.5 > T_S, lag_deg * shape, 0.6)
    ones = np.ones_like(T_S)
    return RunTruth(T_S, vertical, vertical, lag, -0.07 * shape, 0.25 * shape, 50.0 * ones, 0.0 * ones)


def as_printed() -> dict[str, RunTruth]:
    """Runs that have the paper's own figures."""
    runs = {stiffness(k): signals(300.0 + 3.0 * eta, peak_s=5.0 - 0.02 * k) for k, eta in claims.ETA_PCT.items()}
    runs[NO_SPRING] = signals(455.0, 435.0, 0.8, 4.5)
    for i, w in enumerate(SPEEDS_DEG_S):
        if w != 0.5:
            run = signals(300.6 + 0.3 * i, peak_s=5.5 - 0.5 * i, lag_deg=0.6 + 0.1 * i)
            run = run._replace(pulley_mm=run.pulley_mm * (0.8 + 0.2 * i))
            runs[speed(w)] = run
    for i, w in enumerate(SPEEDS_DEG_S):
        wave = (1.0 + i) * np.sin(4.0 * T_S)
        run = runs[speed(w)]
        runs[speed(w)] = run._replace(
            vertical_n=run.vertical_n + np.where(T_S > 10.0, 0.01 * wave, 0.0),
            normal_deg=run.normal_deg + np.where(T_S > 10.0, 0.001 * wave, 0.0),
        )
    turn = signals(300.0, 291.0, 0.6)
    runs[FIGURE_9] = turn._replace(vertical_n=turn.vertical_n + 0.1 * np.sin(20.0 * T_S))
    return runs


def test_a_model_with_the_papers_figures_agrees_with_every_claim() -> None:
    differing = [row.claim.id for row in claims.judge(as_printed()) if not row.ok]
    assert not differing


@pytest.mark.parametrize(
    ("case", "change", "suspect"),
    [
        (NO_SPRING, {"vertical_n": 1.1}, "fig4_k1000_peak_fz"),
        (NO_SPRING, {"tangential_deg": 1.2}, "fig4_k1000_plateau_lag"),
        (stiffness(13.0), {"tangential_deg": 0.8}, "fig5_k13_peak_lag"),
        (stiffness(27.0), {"pulley_mm": 2.0}, "fig5_k27_travel"),
        (stiffness(27.0), {"pulley_mm": 1.1}, "fig5_travel_spread"),
        (stiffness(34.0), {"normal_deg": 0.1}, "fig5_k34_normal"),
        (speed(2.0), {"pulley_mm": 0.5}, "fig7_travel"),
        (FIGURE_9, {"tangential_deg": 2.0}, "fig9_following"),
        (FIGURE_9, {"vertical_n": 0.95}, "fig9_accuracy"),
    ],
)
def test_a_claim_sees_what_is_wrong(case: str, change: dict[str, float], suspect: str) -> None:
    runs = as_printed()
    runs[case] = runs[case]._replace(**{name: getattr(runs[case], name) * by for name, by in change.items()})
    assert suspect in {row.claim.id for row in claims.judge(runs) if not row.ok}


def test_every_required_figure_of_the_issue_is_a_claim() -> None:
    ids = {claim.id for claim in CLAIMS}
    assert len(ids) == len(CLAIMS)
    for k in STIFFNESSES_N_MM:
        assert {f"fig6_k{k:g}_peak_eta", f"fig5_k{k:g}_peak_lag", f"fig5_k{k:g}_plateau_lag"} <= ids
    bounds = {claim.id: (claim.low, claim.high) for claim in CLAIMS}
    assert bounds["fig4_k1000_peak_fz"] == (443.0, 467.0)
    assert bounds["fig4_k1000_plateau_fz"] == (420.0, 450.0)
    assert bounds["fig6_k6_peak_eta"] == pytest.approx((0.8 * 0.31, 1.2 * 0.31))
    assert bounds["fig6_k27_peak_eta"] == pytest.approx((0.75 * 1.20, 1.25 * 1.20))


def test_a_quantity_that_does_not_exist_differs() -> None:
    claim = Claim("x", "4", "peak", "s", 4.0, 3.5, 5.0, lambda _runs: math.nan)
    assert not ClaimResult(claim, math.nan).ok


def test_a_known_shortfall_is_told_only_where_it_differs() -> None:
    claim = Claim("x", "4", "peak", "s", 4.0, 3.5, 5.0, lambda _runs: 0.0, "printed", "because")
    assert remark(ClaimResult(claim, 4.0)) == "printed"
    assert remark(ClaimResult(claim, 6.0)) == "printed; ours differs: because"
    assert ClaimResult(claim, 6.0).explained
    assert not ClaimResult(claim._replace(shortfall=""), 6.0).explained


def test_the_first_peak_is_the_first_one_that_matters() -> None:
    run = signals(peak_s=4.0)
    ripple = np.where(T_S < 1.0, 0.005 * np.sin(40.0 * T_S), 0.0)  # before the rise
    later = np.where(T_S > 20.0, 0.2, 0.0)  # as high again, much later
    assert run._replace(vertical_n=run.vertical_n + ripple).first_peak_s() == pytest.approx(4.0, abs=0.002)
    assert run.first_peak_s() == pytest.approx(4.0, abs=0.002)
    assert math.isnan(run._replace(vertical_n=T_S).first_peak_s())
    assert run._replace(vertical_n=run.vertical_n + later).first_peak_s() == pytest.approx(4.0, abs=0.002)


def test_only_spring_and_move_change_from_case_to_case() -> None:
    def without_spring(settings: RigSettings) -> RigSettings:
        return changed(settings, {"plant.spring_n_mm": 1.0, "simulation.rope.damping_n_s_mm": None})

    assert {without_spring(case.settings(SETTINGS)).model_dump_json() for case in cases()} == {
        without_spring(SETTINGS).model_dump_json()
    }


def test_the_level_errors_of_figure_9_add_up_to_one_and_a_half_millimetres() -> None:
    turn = next(case for case in cases() if case.name == FIGURE_9)
    inputs = pack(turn.tracks)
    angle = profile(inputs, MECHANISM, 0.5 * turn.seconds)[0]
    assert math.degrees(angle) == pytest.approx(13.0)
    closer = profile(inputs, HEIGHT, 0.5 * turn.seconds)[0] - profile(inputs, RUN_OUT, angle)[0]
    assert closer == pytest.approx(1.5)
    places = [profile(inputs, HEIGHT, t)[0] for t in np.linspace(0.0, turn.seconds, 200)]
    assert places[0] == places[-1] == pytest.approx(0.0, abs=1e-12)
    assert max(abs(b - a) for a, b in pairwise(places)) < 0.02
