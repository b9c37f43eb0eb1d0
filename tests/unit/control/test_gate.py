"""The innovation gate, alone and in the filter and the loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.control.law.estimator import TensionFilter, filter_model
from rigctl.control.law.gate import Gate
from rigctl.model.samples import Verdict
from tests.builders.paths import ROOT

MODEL = filter_model(config.load(ROOT / "config/paper_rig.yaml"))
BURST_N = MODEL.f.item(0, 2) * MODEL.burst_mm_s  # tension that a burst causes in a tick


def settled() -> TensionFilter:
    """A filter at 300 N and rest, its gain settled."""
    kalman = TensionFilter(MODEL)
    kalman.reset(300.0, 0.0)
    for _ in range(500):
        tick(kalman, 300.0)
    return kalman


def tick(kalman: TensionFilter, tension_n: float | None, speed_mm_s: float | None = 0.0) -> None:
    kalman.update(tension_n, speed_mm_s)
    kalman.predict()
    kalman.command(0.0)


def test_it_opens_with_the_ticks_since_a_sample_was_believed() -> None:
    gate = Gate(5.0, 0.1)
    for _ in range(8):
        assert not gate.believes(4.9, 1e-4)
        gate.pass_ticks(1)
    assert gate.rejects == 8
    assert gate.verdict == Verdict.REJECTED
    assert gate.believes(4.9, 1e-4)  # 5 sigma of ten ticks' burst is 5.0
    assert (gate.rejects, gate.verdict, gate.surprised) == (0, Verdict.USED, True)


def test_the_running_nis_is_the_mean_of_the_normalised_squares() -> None:
    gate, noise = Gate(5.0, 0.0), np.random.default_rng(1)
    for y in 2.0 * noise.standard_normal(20_000):
        gate.believes(float(y), 4.0)
        gate.pass_ticks(1)
    assert gate.nis == pytest.approx(1.0, abs=0.15)  # a thousand samples: sigma 0.03
    for y in 3.0 * noise.standard_normal(20_000):
        gate.believes(float(y), 4.0)
        gate.pass_ticks(1)
    assert gate.nis == pytest.approx(2.25, abs=0.35)


@pytest.mark.parametrize("spike_n", [-50.0, 5.0, 0.4, 2e6])
def test_a_spike_is_left_out(spike_n: float) -> None:
    """Also one that a burst could be: 0.4 N."""
    kalman, undisturbed = settled(), settled()
    tick(kalman, 300.0 + spike_n)
    tick(undisturbed, None)
    assert kalman.cell.verdict == Verdict.REJECTED
    assert kalman.state == undisturbed.state


def test_a_jump_no_rig_can_make_is_counted_until_it_is_a_fault() -> None:
    kalman = settled()
    for _ in range(20):
        tick(kalman, 350.0)
    assert kalman.cell.rejects == 20
    assert kalman.state[0] == pytest.approx(300.0, abs=0.1)


def test_two_samples_beyond_the_gate_are_a_burst_only_on_the_same_side() -> None:
    gate = Gate(5.0, 0.1)

    def believes(y: float) -> bool:
        gate.pass_ticks(1)
        return gate.believes(y, 1e-4)

    assert [believes(y) for y in (0.2, -0.2, 0.2, 0.2, 0.2, -0.2)] == [False, False, False, True, True, False]
    assert believes(0.01)
    assert not believes(0.2), "a good sample in between ends it"
    gate.absent()
    assert believes(0.2), "one that is missing does not: an inclinometer's are, in nine ticks of ten"


def test_a_jolt_is_followed() -> None:
    kalman, tension, worst = settled(), 300.0, 0.0
    for n in range(40):
        tension += 0.45 if n < 20 else 0.0  # 75 mm/s at 6 N/mm, for 20 ms
        tick(kalman, tension)
        worst = max(worst, abs(kalman.state[0] - tension))
        assert kalman.cell.rejects <= 1, "the first sample of a change"
    assert worst < 1.0
    assert abs(kalman.state[0] - tension) < 0.1


def test_a_rejected_speed_does_not_keep_the_tension_out() -> None:
    kalman = settled()
    tick(kalman, 300.1, 500.0)
    assert kalman.drive.verdict == Verdict.REJECTED
    assert kalman.cell.verdict == Verdict.USED
    assert kalman.state[0] > 300.0


def test_what_is_missing_is_absent_and_a_slack_rope_is_idle() -> None:
    kalman = settled()
    tick(kalman, None, math.nan)
    assert kalman.cell.verdict == kalman.drive.verdict == Verdict.ABSENT
    kalman.reset(0.0, 0.0)
    assert kalman.cell.verdict == Verdict.IDLE


@given(st.lists(st.one_of(st.none(), st.floats(-1e7, 1e7)), min_size=50, max_size=200))
def test_what_is_ahead_stays_finite_whatever_comes(samples: list[float | None]) -> None:
    kalman = settled()
    for n, tension in enumerate(samples):
        kalman.update(tension, None if n % 7 == 3 else (tension or 0.0) % 13.0)
        kalman.predict(1 + n % 3)
        kalman.command(1.0)
        assert all(map(math.isfinite, kalman.ahead()))
