"""The creep found in records of a load's step, against the creep that made them."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence

import numpy as np
import pytest

from rigctl.commission import creep
from rigctl.control.excitation.trials import CREEP_BINS, CREEP_SETTLE_S, LoadBin
from rigctl.ipc.correction import CreepTerm

CREEP = (CreepTerm(8e-5, 40.0), CreepTerm(1.6e-4, 600.0))
WEIGHT_N = 294.2


def record(
    terms: Sequence[CreepTerm] = CREEP, seconds: float = 1800.0, seed: int = 1, *, noise_n: float = 0.03,
    drift_n_s: float = 0.0, celsius: Sequence[float] = (math.nan, 0.0), step_n: float = WEIGHT_N,
) -> list[LoadBin]:  # fmt: skip
    """Bins as the loop would make them of 1000 samples a second; ``celsius``: at first, and its change per second."""
    draw = random.Random(seed).gauss
    edges = [CREEP_SETTLE_S * (seconds / CREEP_SETTLE_S) ** (i / CREEP_BINS) for i in range(CREEP_BINS + 1)]
    start_n = WEIGHT_N - step_n if step_n < 0 else 0.0
    bins = [LoadBin(2000, start_n + draw(0.0, noise_n / math.sqrt(2000)), noise_n, -120.0, celsius[0])]
    for low, high in itertools.pairwise(edges):
        samples = max(1, round(1000 * (high - low)))
        times = np.linspace(low, high, 50)
        crept = sum(term.share * -np.expm1(-times / term.time_s) for term in terms)
        mean_n = float(np.mean(start_n + step_n * (1 + crept) + drift_n_s * times))
        at_s = 0.5 * (low + high)
        bins.append(LoadBin(samples, mean_n + draw(0.0, noise_n / math.sqrt(samples)), noise_n, at_s,
                            celsius[0] + celsius[1] * at_s))  # fmt: skip
    return bins


def course(terms: Sequence[CreepTerm], t_s: float) -> float:
    return sum(term.share * -math.expm1(-t_s / term.time_s) for term in terms)


def test_two_exponentials_are_found_with_their_uncertainties() -> None:
    found = creep.fit(record())
    for term, true, share_u, time_u_s in zip(found.terms, CREEP, found.share_u, found.time_u_s, strict=True):
        assert term.share == pytest.approx(true.share, abs=2 * share_u)
        assert term.time_s == pytest.approx(true.time_s, abs=2 * time_u_s)
    assert found.total == pytest.approx(course(CREEP, 1800.0), abs=found.total_u)
    assert found.total_u < 0.05 * found.total
    assert found.told
    assert found.misfit < 1.6


def test_the_stated_uncertainty_covers_the_true_creep_in_95_percent_of_records() -> None:
    """Binomial: of 60 at 95 %, fewer than 51 come once in 2000."""
    inside = 0
    for seed in range(60):
        found = creep.fit(record(seed=seed))
        random_u = math.sqrt(max(0.0, found.creep_u**2 - (found.drift_n / WEIGHT_N) ** 2))
        times = [0.0, 30.0, 300.0, 1800.0, 5000.0]
        inside += all(abs(course(found.terms, t_s) - course(CREEP, t_s)) <= random_u for t_s in times)
    assert inside >= 51


@pytest.mark.parametrize("terms", [(CreepTerm(2.45e-4, 300.0),), (CreepTerm(-1.2e-4, 100.0),)])
def test_a_single_creep_is_stated_as_well_as_two(terms: tuple[CreepTerm, ...]) -> None:
    found = creep.fit(record(terms))
    assert found.total == pytest.approx(course(terms, 1800.0), abs=1.5 * found.total_u)
    for t_s in (10.0, 100.0, 1000.0, 1800.0):
        assert course(found.terms, t_s) == pytest.approx(course(terms, t_s), abs=found.creep_u)


def test_a_cell_without_creep_has_none_that_is_told() -> None:
    found = creep.fit(record(()))
    assert abs(found.total) < 2 * found.total_u
    assert not found.told


def test_a_change_that_drift_can_make_is_no_creep() -> None:
    """0.02 % of 294 N in an hour would be a creep of 0.06 N; here the zero drifts by as much as it may."""
    found = creep.fit(record((), drift_n_s=0.9 * creep.DRIFT_N_S))
    assert not found.told


def test_a_known_drift_with_the_temperature_is_taken_out() -> None:
    warming = (20.0, 2.0 / 1800.0)
    bins = record(drift_n_s=0.02 * warming[1], celsius=warming)
    wrong, right = creep.fit(bins), creep.fit(bins, zero_n_k=0.02, u_n_k=0.001)
    assert right.total == pytest.approx(course(CREEP, 1800.0), abs=1.5 * right.total_u)
    assert abs(wrong.total - course(CREEP, 1800.0)) > 5 * wrong.total_u
    assert right.drift_n == pytest.approx(0.001 * 2.0, rel=0.1)  # the last part ends before the record
    assert right.told


def test_taking_the_weight_off_shows_the_same_creep() -> None:
    found = creep.fit(record(step_n=-WEIGHT_N))
    assert found.total == pytest.approx(course(CREEP, 1800.0), abs=1.5 * found.total_u)


def test_a_shorter_record_says_less() -> None:
    long, short = creep.fit(record()), creep.fit(record(seconds=120.0))
    assert short.creep_u > 3 * long.creep_u


@pytest.mark.parametrize(("bins", "why"), [(record()[:9], "8 parts"), (record(step_n=0.2), "nothing was hung")])
def test_what_is_no_record_of_a_step_is_refused(bins: list[LoadBin], why: str) -> None:
    with pytest.raises(creep.CreepError, match=why):
        creep.fit(bins)
