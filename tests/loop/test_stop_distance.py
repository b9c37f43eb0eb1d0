"""When the loop dies, the drive stops by itself within the distance that the check of the rig file assumes."""

from __future__ import annotations

import pytest

from hil.lockstep import Lockstep
from hil.nodes.power_stage import StagePhase
from rigctl.config.bounds import Stop
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

DEAD_TICKS = 500


@pytest.mark.parametrize("target_n", [350.0, 250.0])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_dead_loops_stroke_stops_within_the_distance_the_check_prints(rig: Lockstep, target_n: float) -> None:
    assert rig.command(Verb.TARGET, target_n) is Refusal.NONE
    rig.run(0.5)
    speed, before = rig.rig.truth.speed_mm_s, rig.rig.truth
    assert abs(speed) > 7.0
    stroke_mm, tension_n = before.stroke_mm, before.tension_n
    rig.clock.skip = DEAD_TICKS
    rig.clock.next_tick()  # the rig goes on without commands
    stop, tension = Stop.of(rig.settings), rig.settings.tension
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED
    moved_mm = abs(rig.rig.truth.stroke_mm - stroke_mm)
    assert 0.1 < moved_mm <= stop.distance_mm * abs(speed) / tension.speed_max_mm_s * 1.05  # ripple of the screw
    assert abs(rig.rig.truth.tension_n - tension_n) <= stop.newtons * 1.05
