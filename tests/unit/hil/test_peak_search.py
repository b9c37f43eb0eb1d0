"""The search for the largest |S|: drawn loops with weak damping, whose truth is python-control's."""

from __future__ import annotations

import numpy as np
import pytest

from hil.studies.compare.local_peak import SensitivityLine, local_peaks
from hil.studies.compare.peak_search import BUDGET_S, CLOSER, FIRST, LOW_HZ, SearchPass, largest
from tests.bench.peaks import searched
from tests.builders.drawn_loops import TOP_HZ, Loop, drawn

MISSED = 0.02
LOOPS = 8


@pytest.fixture(scope="module")
def loops() -> list[Loop]:
    return drawn(1, LOOPS)


def test_no_peak_of_a_drawn_loop_hides_and_its_interval_has_the_truth(loops: list[Loop]) -> None:
    for loop in loops:
        found = searched(loop, 0.0)
        assert abs(found["missed"]) <= MISSED
        assert found["inside"]
        assert found["seconds"] <= BUDGET_S


def test_an_interval_has_the_errors_of_the_lines(loops: list[Loop]) -> None:
    """Two of 8 outside an interval of 95 % are less likely than 6 %; an error of 0.01 is that of the simulated rig."""
    found = [searched(loop, 0.01) for loop in loops]
    assert sum(not each["inside"] for each in found) <= 1
    assert all(each["error"] > 0.001 for each in found)


def test_a_search_takes_no_more_than_its_time_however_little_it_learns() -> None:
    """Lines of noise alone."""
    rng, passes = np.random.default_rng(1), list[SearchPass]()

    def measure(excitation: SearchPass) -> list[SensitivityLine]:
        passes.append(excitation)
        both = zip(("input", "output"), excitation.harmonics, strict=True)
        return [
            SensitivityLine(place, harmonic / excitation.period_s, 1.0 + complex(*rng.normal(size=2)), 0.5)
            for place, harmonics in both
            for harmonic in harmonics
        ]

    found = largest(measure, [], TOP_HZ)
    assert found.seconds == sum(each.seconds for each in passes) <= BUDGET_S
    assert found.error > 0.1
    assert len(passes) > 1


def test_the_first_pass_begins_at_its_lowest_frequency_and_no_line_is_of_both_places() -> None:
    first = list[SearchPass]()

    def measure(excitation: SearchPass) -> list[SensitivityLine]:
        first.append(excitation)
        both = zip(("input", "output"), excitation.harmonics, strict=True)
        return [SensitivityLine(place, each / excitation.period_s, 1.0 + 0j, 0.0) for place, of in both for each in of]

    largest(measure, [], TOP_HZ)
    for excitation in first:
        assert not set(excitation.harmonics[0]) & set(excitation.harmonics[1])
    lines = sorted({*first[0].harmonics[0], *first[0].harmonics[1]})
    assert lines[0] / FIRST.period_s == pytest.approx(LOW_HZ)
    assert lines[-1] / FIRST.period_s > 0.95 * TOP_HZ
    assert all(each.seconds + FIRST.seconds <= BUDGET_S for each in CLOSER)


def test_the_top_between_two_lines_is_that_of_a_resonance() -> None:
    """S = 1 / (a + j b (f - f0)): its top is 1 / a at f0, and a line apart it is far lower."""
    lines = [SensitivityLine("input", hz, 1.0 / (0.6 + 4.0j * (hz - 10.13)), 1e-6) for hz in np.arange(9.0, 11.5, 0.1)]
    highest = max(local_peaks(lines), key=lambda peak: peak.ms)
    assert highest.ms == pytest.approx(1.0 / 0.6, abs=1e-4)
    assert highest.hz == pytest.approx(10.13, abs=1e-3)
    assert max(abs(line.value) for line in lines) < 1.0 / 0.6 - 0.02
