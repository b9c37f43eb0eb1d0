"""Slack is taken up with a cell that has frozen: the motor's current shows that the rope gets tight."""

from __future__ import annotations

import pytest

from hil.faults.in_device import CELL, reads
from hil.faults.stand import Stand, Step
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.faults import Fault
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.control.tension import Gains
from tests.builders.rig_bench import changed

TENTH = 0.1
NOISE_N = 0.03


def taken_up(rig: Lockstep, step: Step | None, seconds: float) -> float:
    """Highest true tension in a TENSIONING from a slack rope on, until FAULT or the time is over."""
    assert rig.command(Verb.TENSION) is Refusal.NONE
    highest_n = 0.0
    for tick in range(round(seconds * 1000)):
        if step is not None:
            step(tick * 1e-3)
        rig.tick()
        highest_n = max(highest_n, rig.rig.plant.truth.tension_n)
        if rig.loop.machine.mode is Mode.FAULT:
            rig.run(1.0)  # on the brake
            break
    return max(highest_n, rig.rig.plant.truth.tension_n)


@pytest.mark.parametrize(
    ("spring_n_mm", "slack_mm"), [pytest.param(6.0, 0.0, id="soft, no slack"), pytest.param(30.0, 8.0, id="stiff")]
)
def test_a_cell_frozen_on_a_slack_rope_lets_the_stroke_go_to_a_tenth_of_the_target_however_often_it_is_given(
    settings: RigSettings, gains: Gains, spring_n_mm: float, slack_mm: float
) -> None:
    rigged = changed(settings, plant={"spring_n_mm": spring_n_mm}, simulation={"rope": {"slack_mm": slack_mm}})
    with lockstep(rigged, gains) as rig:
        rig.run(0.2)
        step = reads(CELL, times=0.0, noise=NOISE_N)(Stand(rig, "seed"))
        assert rig.command(Verb.ARM) is Refusal.NONE
        for _ in range(3):
            assert taken_up(rig, step, 8.0) < TENTH * settings.tension.target_n
            assert rig.loop.machine.fault is Fault.LOAD_UNSEEN
            assert rig.command(Verb.RESET) is Refusal.NONE
            rig.run_until(Mode.HOLD, 1.0)


@pytest.mark.gate("0.0-20")
@pytest.mark.parametrize(("slack_mm", "status_rate_hz"), [(0.0, 20), (30.0, 20), (30.0, 5)])
def test_a_rope_that_the_cell_shows_is_tensioned_as_before(
    settings: RigSettings, gains: Gains, slack_mm: float, status_rate_hz: int
) -> None:
    """A reading of a slow status may be of before the motion: without friction, which is no force of the rope."""
    rope, cylinder = {"rope": {"slack_mm": slack_mm}}, {"status_rate_hz": status_rate_hz}
    with lockstep(changed(settings, simulation=rope, cylinder=cylinder), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.1)  # the status has been sent just before
        assert taken_up(rig, None, 8.0) > TENTH * settings.tension.target_n
        assert rig.loop.machine.fault is Fault.NONE


def test_without_its_current_the_cell_alone_shows_a_tight_rope(settings: RigSettings, gains: Gains) -> None:
    """What the catalogue's row would be without the witness: the test above can fail."""
    with lockstep(changed(settings, cylinder={"force_per_ampere_n": None}), gains) as rig:
        rig.run(0.2)
        step = reads(CELL, times=0.0, noise=NOISE_N)(Stand(rig, "seed"))
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert taken_up(rig, step, 3.0) > TENTH * settings.tension.target_n
