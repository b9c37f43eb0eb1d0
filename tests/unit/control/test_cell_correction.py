"""The loop's correction of the cell undoes the simulated cell's errors, whatever the load's history."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.nodes.low_pass import LowPass
from rigctl.config import rig_file as config
from rigctl.config.compensation_section import CompensationSettings
from rigctl.control.bus.cell_correction import TEMPERATURE_S, CellCorrection, CellHistory
from rigctl.ipc.correction import Correction, CreepTerm, creep_fits
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
RIG = PAPER.model_copy(update={"compensation": CompensationSettings(temperature="drive")})
S = 1_000_000_000
CREEP = (CreepTerm(1.5e-4, 20.0), CreepTerm(-4e-5, 700.0))
ROUNDING_N = 1e-9  # of doubles at 300 N, over thousands of steps


class Cell:
    """The forward model, by the low-pass of the simulated rig: c = F + sum a y."""

    def __init__(self, creep: Sequence[CreepTerm] = CREEP) -> None:
        self._terms = [(term.share, LowPass(term.time_s)) for term in creep]
        self.creep_n = 0.0

    def reading(self, load_n: float, elapsed_s: float) -> float:
        """After a straight course of the load."""
        self.creep_n = math.fsum(share * passed.update(load_n, elapsed_s) for share, passed in self._terms)
        return load_n + self.creep_n


def started(correction: Correction, held_s: float = math.nan, history: CellHistory | None = None) -> CellCorrection:
    made = CellCorrection(RIG)
    made.put(correction, held_s=held_s, history=history)
    return made


steps = st.lists(st.tuples(st.floats(0.0, 400.0), st.sampled_from((0.001, 0.002, 0.37, 40.0))), min_size=1, max_size=80)


@given(steps)
def test_the_inverse_is_exact_for_any_load_that_is_a_straight_line_between_samples(
    course: list[tuple[float, float]],
) -> None:
    cell, correction = Cell(), started(Correction(creep=CREEP), held_s=0.0)
    t_ns = 5 * S
    assert correction.tension_n(cell.reading(0.0, 0.0), t_ns) == 0.0
    for load_n, elapsed_s in course:
        t_ns += round(elapsed_s * S)
        reading_n = cell.reading(load_n, elapsed_s)
        assert correction.tension_n(reading_n, t_ns) == pytest.approx(load_n, abs=ROUNDING_N)
        assert correction.creep_n == pytest.approx(cell.creep_n, abs=ROUNDING_N)


def test_at_the_loops_rate_no_error_adds_up() -> None:
    cell, correction = Cell(), started(Correction(creep=CREEP), held_s=0.0)
    correction.tension_n(cell.reading(0.0, 0.0), 0)
    worst_n = 0.0
    for tick in range(1, 60_000):
        load_n = min(300.0, 0.05 * tick) + 5.0 * math.sin(0.003 * tick)
        found_n = correction.tension_n(cell.reading(load_n, 0.001), tick * S // 1000)
        worst_n = max(worst_n, abs(found_n - load_n))
    assert worst_n < ROUNDING_N


def test_without_the_section_zero_and_scale_alone_are_applied() -> None:
    plain = CellCorrection(PAPER)
    plain.put(Correction(0.25, 1.01, creep=CREEP, zero_c=20.0, zero_n_k=0.1))
    plain.feel(30.0, S)
    for tick, reading_n in enumerate((3.0, 299.7, 300.1)):
        assert plain.tension_n(reading_n, tick) == (reading_n - 0.25) * 1.01
    assert (plain.creep_n, plain.doubt_n) == (0.0, 0.0)
    assert all(map(math.isnan, plain.crept))


def test_the_section_without_a_creep_on_the_ledger_changes_no_bit() -> None:
    found = started(Correction(0.25, 1.01))
    assert found.tension_n(299.7, 1) == (299.7 - 0.25) * 1.01


def test_two_samples_of_one_instant_are_no_step_of_time() -> None:
    correction = started(Correction(creep=CREEP), held_s=0.0)
    correction.tension_n(0.0, S)
    correction.tension_n(100.0, S)
    before = correction.crept
    correction.tension_n(100.0, S)
    assert correction.crept == before


def test_an_unknown_history_is_taken_as_the_present_load_and_the_doubt_decays_with_the_creep() -> None:
    cell, correction = Cell(), started(Correction(creep=CREEP))
    load_n = RIG.tension.target_max_n
    correction.tension_n(cell.reading(load_n, 1e-9), 0)  # in truth the load has come this instant: the worst case
    for elapsed_s in (0.1, 10.0, 10.0, 200.0, 700.0):
        found_n = correction.tension_n(cell.reading(load_n, elapsed_s), correction._t_ns + round(elapsed_s * S))
        assert abs(found_n - load_n) <= correction.doubt_n * (1 + 1e-3)  # the load itself is known to a part of this
    assert correction.doubt_n < 0.4 * load_n * sum(abs(term.share) for term in CREEP)


@pytest.mark.parametrize("held_s", [0.0, 15.0, 1800.0])
def test_a_creep_put_in_force_under_a_load_that_came_a_known_time_ago_goes_on_from_there(held_s: float) -> None:
    cell, correction = Cell(), CellCorrection(RIG)
    cell.reading(0.0, 1.0)
    cell.reading(294.2, 1e-6)
    cell.reading(294.2, held_s)
    correction.put(Correction(creep=CREEP), held_s=held_s)
    assert correction.tension_n(cell.reading(294.2, 0.001), S) == pytest.approx(294.2, abs=1e-5)
    assert correction.doubt_n == 0.0


def test_the_next_loop_goes_on_with_the_history_of_the_one_before() -> None:
    cell, first = Cell(), started(Correction(creep=CREEP), held_s=0.0)
    first.tension_n(cell.reading(0.0, 0.0), 0)
    first.tension_n(cell.reading(300.0, 1.0), 1 * S)
    first.tension_n(cell.reading(300.0, 29.0), 30 * S)
    next_loop = started(Correction(creep=CREEP), history=CellHistory(30 * S, first.crept))
    found_n = next_loop.tension_n(cell.reading(300.0, 2.0), 32 * S)
    assert found_n == pytest.approx(300.0, abs=1e-4)
    assert 0.0 < next_loop.doubt_n < 0.15 * 350.0 * 1.5e-4  # two seconds of any load: a tenth of the fast term


def test_a_zero_or_scale_put_in_force_leaves_the_history_alone() -> None:
    correction = started(Correction(creep=CREEP), held_s=0.0)
    for tick, load_n in enumerate((0.0, 300.0, 300.0)):
        correction.tension_n(load_n, tick * S)
    before = correction.crept
    correction.put(Correction(0.5, 1.001, creep=CREEP))
    assert correction.crept == before
    assert correction.newest_n(300.0) == pytest.approx((300.0 - 0.5) * 1.001 - correction.creep_n)


def test_the_zero_follows_the_temperature_through_a_low_pass() -> None:
    correction = started(Correction(0.1, zero_c=20.0, zero_n_k=0.02))
    assert correction.zero_drift_n == 0.0  # no temperature yet
    correction.feel(25.0, 0)
    assert correction.zero_drift_n == pytest.approx(0.1)
    correction.feel(30.0, round(TEMPERATURE_S * S))
    assert correction.temperature_c == pytest.approx(30.0 - 5.0 * math.exp(-1))
    correction.feel(math.nan, round(9e9 * TEMPERATURE_S))
    assert correction.temperature_c == pytest.approx(30.0 - 5.0 * math.exp(-1))  # held while none comes
    assert correction.tension_n(1.0, S) == pytest.approx(0.9 - correction.zero_drift_n)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_zero_and_drift_together_stay_within_the_limit_of_a_tare(sign: float) -> None:
    assert RIG.calibration is not None
    limit_n = RIG.calibration.tare_limit_n
    correction = started(Correction(sign * 9.9, zero_c=20.0, zero_n_k=sign * 0.1))
    correction.feel(80.0, 0)
    assert correction.offset_n == sign * limit_n
    assert correction.tension_n(0.0, S) == -sign * limit_n


def test_a_creep_beyond_what_a_sound_cell_has_does_not_fit() -> None:
    good = (CreepTerm(2e-4, 30.0), CreepTerm(1e-4, 600.0))
    assert creep_fits(())
    assert creep_fits(good)
    bad = [
        good[:1], (CreepTerm(9e-4, 30.0), CreepTerm(-2e-4, 600.0)), (good[0], CreepTerm(1e-4, 0.5)),
        (good[0], CreepTerm(1e-4, 1e5)), (good[0], CreepTerm(math.nan, 60.0)), (good[0], CreepTerm(1e-4, math.nan)),
    ]  # fmt: skip
    assert not any(map(creep_fits, bad))
    for terms in itertools.chain(bad):
        assert not Correction(creep=terms).fits(RIG)
