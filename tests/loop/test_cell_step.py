"""A tension that steps from one sample to the next and stays so is a fault; what a payload or a hand does is none."""

from __future__ import annotations

import pytest

from hil.faults.in_device import CELL, reads
from hil.faults.stand import Stand
from hil.lockstep import Lockstep
from rigctl.control.bus.cell_step import STAYS
from rigctl.model.faults import Fault
from rigctl.model.states import Mode


@pytest.mark.parametrize(("rig", "gain"), [(Mode.TENSIONING, 1.05), (Mode.COMPENSATING, 1.017)], indirect=["rig"])
def test_a_gain_that_changes_by_a_step_of_5_newtons_is_found_at_once(rig: Lockstep, gain: float) -> None:
    true_n = rig.rig.plant.truth.tension_n
    reads(CELL, times=gain)(Stand(rig, "seed"))
    rig.run(0.001 * (STAYS + 5))
    assert rig.loop.machine.fault is Fault.INNOVATION
    rig.run(0.5)
    assert abs(rig.rig.plant.truth.tension_n - true_n) < 3.0


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_single_bad_sample_and_three_times_the_noise_are_ridden_through(rig: Lockstep) -> None:
    step = reads(CELL, noise=0.1, spikes=80.0)(Stand(rig, "seed"))
    for tick in range(2000):
        assert step is not None
        step(tick * 1e-3)
        rig.tick()
    assert rig.loop.machine.fault is Fault.NONE
