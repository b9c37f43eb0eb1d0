"""The loop's estimate from its sensors, and the treatment of a sensor that it rejects."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hil.lockstep import Lockstep
from hil.plant.inputs import Track
from hil.plant.layout import HEIGHT, MECHANISM
from hil.plant.moves import out_and_back
from rigctl.config.settings import RigSettings
from rigctl.model.faults import Fault
from rigctl.model.samples import Verdict
from rigctl.model.states import Mode


@pytest.fixture
def rig_settings(settings: RigSettings) -> RigSettings:
    """Without the file's limits: its limit of the disturbance is as long as the jolt, so that the noise decides."""
    return settings.model_copy(update={"limits": []})


def with_error(rig: Lockstep, error: Callable[[int], float]) -> None:
    """Add ``error``, in N by the number of the sample from now on, to the cell's reading."""
    measurement: Any = rig.rig.cell._measurement
    sample, count = measurement.sample, iter(range(1_000_000))

    def wrong() -> tuple[object, float]:
        status, tension_n = sample()
        return status, tension_n + error(next(count))

    measurement.sample = wrong


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_spike_of_the_cell_is_left_out_and_moves_nothing(rig: Lockstep) -> None:
    with_error(rig, lambda n: 80.0 if n == 10 else 0.0)
    records = rig.run(1.0)
    rejected = records[records["tension_verdict"] == Verdict.REJECTED]
    assert len(rejected) == 1
    assert abs(rejected["innovation_n"][0]) > 5.0 * math.sqrt(rejected["innovation_n2"][0])
    assert rig.loop.machine.mode is Mode.COMPENSATING
    assert np.ptp(records["stroke_mm"]) < 0.025


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_cell_that_jumps_and_stays_there_is_a_fault_within_20_ms(rig: Lockstep) -> None:
    before = rig.rig.truth.stroke_mm
    with_error(rig, lambda _n: 40.0)  # far from any limit of the tension
    records = rig.run(0.1)
    first = int(np.argmax(records["tension_verdict"] == Verdict.REJECTED))
    tripped = int(np.argmax(records["mode"] == Mode.FAULT))
    assert rig.loop.machine.fault is Fault.INNOVATION
    assert 0 < tripped - first <= 20
    assert abs(rig.rig.truth.stroke_mm - before) < 0.02


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_jolt_of_the_mechanism_is_believed(rig: Lockstep) -> None:
    rise = 0.02
    track = Track(
        segments=np.array([(0.0, 0.0, 0.0, 3.0 / rise**2, -2.0 / rise**3), (rise, 1.0, 0.0, 0.0, 0.0)]), end=rise
    )
    rig.rig.plant.start_motion({HEIGHT: track}, rig.rig.plant.t_ns)
    records = rig.run(1.0)
    assert rig.loop.machine.mode is Mode.COMPENSATING
    left_out = records["tension_verdict"] == Verdict.REJECTED
    assert not np.any(left_out[1:] & left_out[:-1]), "the sample after one that may be noise is believed"
    late = records[450:]  # detected after 0.37 to 0.41 s, depending on the cell's noise
    assert np.max(np.abs(late["estimate_n"] - 300.0)) < 0.3  # back within 0.1 %


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_every_sensor_says_what_became_of_its_samples(rig: Lockstep) -> None:
    records = rig.run(2.0)
    assert set(np.unique(records["tension_verdict"])) == {Verdict.USED}
    assert set(np.unique(records["speed_verdict"])) == {Verdict.USED}
    slope = records["tangential_verdict"]
    assert np.mean(slope == Verdict.USED) == pytest.approx(0.1, abs=0.002)  # 100 Hz in a loop of 1 kHz
    assert np.all(slope[slope != Verdict.USED] == Verdict.ABSENT)
    for name in ("innovation_n2", "speed_innovation_mm2_s2", "tangential_innovation_rad2", "normal_innovation_rad2"):
        assert np.all(records[name] > 0.0)
    assert 0.2 < records["tension_nis"][-1] < 5.0
    rig.run(0.1)


def test_a_slack_rope_is_idle(rig: Lockstep) -> None:
    assert set(np.unique(rig.run(0.5)["tension_verdict"])) == {Verdict.IDLE}


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_the_estimated_inclination_follows_the_rope_between_the_samples(rig: Lockstep) -> None:
    move = out_and_back(math.radians(4.0), math.radians(0.5), math.radians(0.5))
    rig.rig.plant.start_motion({MECHANISM: move}, rig.rig.plant.t_ns)
    errors, rates = [], []
    for _ in range(6000):
        rig.loop.tick()
        record = rig.record
        errors.append(record["tangential_estimate_rad"] - rig.rig.truth.tangential_rad)
        rates.append(record["tangential_rate_rad_s"])
    assert np.sqrt(np.mean(np.square(errors))) < math.radians(0.02)  # the sensor's own filter is 8 ms late
    assert np.median(rates[2000:3000]) == pytest.approx(6.545 / 1800.0, rel=0.1)  # full speed, the rail still sticks
