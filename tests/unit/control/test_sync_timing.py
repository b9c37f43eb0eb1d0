"""Samples latched late, and a filter that knows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.control.bus.sync_timing import SyncTiming
from rigctl.control.law.estimator import TensionFilter, filter_model
from tests.builders import observers
from tests.builders.paths import ROOT

SETTINGS = changed(config.load(ROOT / "config/paper_rig.yaml"), {"plant.spring_n_mm": 34.0})
MODEL = filter_model(SETTINGS)
K = SETTINGS.plant.stiffness_n_mm
MS = 1_000_000


def test_the_mean_offset_of_the_sync_is_no_jitter() -> None:
    timing = SyncTiming(1e-3)
    for n in range(100):
        assert timing.late_s(n * MS + 120_000, n * MS) == pytest.approx(0.0, abs=1e-12)
    assert timing.late_s(100 * MS + 620_000, 100 * MS) == pytest.approx(0.5e-3)
    assert timing.late_s(101 * MS + 120_000, 101 * MS) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("synced_ns", [0, -5 * MS, 7 * MS])
def test_a_tick_without_a_sync_and_an_overrun_say_nothing(synced_ns: int) -> None:
    timing = SyncTiming(1e-3)
    timing.late_s(100_000, 0)
    assert timing.late_s(10 * MS + synced_ns if synced_ns else 0, 10 * MS) == 0.0


@pytest.mark.parametrize("given", [False, True])
def test_a_filter_that_is_given_the_jitter_is_not_disturbed_by_it(given: bool) -> None:
    kalman, speed_mm_s = TensionFilter(replace(MODEL, gate_sigma=100.0)), 6.0  # the rope is stretched at 6 mm/s
    kalman.reset(100.0, 0.0)
    late = np.random.default_rng(1).uniform(-0.5e-3, 0.5e-3, 4000)
    errors = []
    for n, by_s in enumerate(late):
        reading_n = 100.0 + K * speed_mm_s * (n * MODEL.period_s + by_s)
        kalman.update(reading_n, 0.0, late_s=float(by_s) if given else 0.0)
        kalman.predict()
        if n > 2000:
            errors.append(kalman.state[2] - speed_mm_s)
    assert (np.std(errors) < 1e-3) == given
    if not given:
        assert np.std(errors) > 0.02


@pytest.mark.parametrize(("late_ms", "known"), [(0.5, True), (3.0, False)])
def test_a_sync_later_than_a_period_changes_no_estimate(late_ms: float, known: bool) -> None:
    """The rope is stretched at 6 mm/s. What was latched 3 ms late might be of any tick; its time is not made up."""
    usual, late = stretched_with_a_last_sync_at(0.1), stretched_with_a_last_sync_at(0.1 + late_ms)
    assert (late != usual) is known


def stretched_with_a_last_sync_at(last_ms: float) -> float:
    """The estimate of the disturbance speed; each SYNC was sent 0.1 ms after its grid point, the last one here."""
    observer, inbox, sent = observers.alone(SETTINGS)
    inbox.drive.stroke_mm = 50.0
    for tick in range(200):
        now_ns = (1000 + tick) * MS
        inbox.cell.tension_n = 300.0 + K * 6e-3 * tick
        inbox.cell_fresh = inbox.drive_fresh = True
        observer.look(now_ns, 0)
        observer.look_at_control(now_ns, 0, (50.0, 300.0))
        estimate = observer.estimate(0, regulated=True)
        observer.filter.command(0.0)
        sent.synced_ns = now_ns + round((last_ms if tick == 198 else 0.1) * MS)
    return estimate.disturbance_mm_s
