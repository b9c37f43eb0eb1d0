"""A TARGET while COMPENSATING moves the stroke on purpose: nothing that watches the stroke takes that for a finding."""

from __future__ import annotations

import pytest

from hil.faults.in_controller import trip
from hil.faults.in_device import CELL, reads
from hil.faults.in_plant import payload_moves
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import GROW_S, SETTLED_S
from rigctl.control.excitation.probe_plan import plan
from rigctl.control.excitation.sensor_probe import ProbeFinding
from rigctl.control.law.tension import Gains
from rigctl.control.watch.unseen_travel import MOST_SHARE
from rigctl.design.gains import design
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.excited import built
from tests.loop.conftest import entered

AFTER_S = 0.7
"""From the end of a ramp to a tension that has settled."""
LAG_MM = 0.3
"""On the ramp the stroke is 0.2 mm behind, 8.4 mm/s times the drive's lag and delay; the screw's play is 0.05 mm."""


def take(rig: Lockstep, target_n: float) -> float:
    """Give a TARGET and run until its ramp has ended and the tension has settled; returns the largest travel in mm."""
    way_n = abs(target_n - rig.loop.law.setpoint_n)
    assert rig.command(Verb.TARGET, target_n) is Refusal.NONE
    travel_mm = 0.0
    for _ in range(round((way_n / rig.settings.tension.ramp_n_s + AFTER_S) * rig.settings.loop.rate_hz)):
        rig.tick()
        travel_mm = max(travel_mm, abs(rig.view.travel_mm))
    assert rig.loop.machine.fault is Fault.NONE
    assert rig.rig.truth.vertical_n == pytest.approx(target_n, abs=0.2)
    return travel_mm


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_the_stroke_that_the_set_point_moves_is_no_travel(rig: Lockstep) -> None:
    """300 N to 220 N are 13 mm of stroke: beyond `travel_mm` of the rig file, 12 mm, they ended in FAULT."""
    assert max(take(rig, target_n) for target_n in (220.0, 60.0, 350.0, 300.0)) < LAG_MM


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_what_the_payload_moves_is_travel_after_a_new_target_too(rig: Lockstep) -> None:
    take(rig, 220.0)
    payload_moves(-2.0, 4.0)(Stand(rig, "travel"))
    rig.run(1.0)
    assert rig.view.travel_mm == pytest.approx(-2.0, abs=LAG_MM)


@pytest.mark.study
@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_spring_of_the_assumed_family_moves_more_or_less_stroke(
    settings: RigSettings, gains: Gains, share: float
) -> None:
    """A spring 20 % softer ended in LOAD_UNSEEN: its stroke is 25 % longer, and the tolerance was 20 % all the same."""
    stiffness = share * settings.plant.stiffness_n_mm
    with lockstep(settings, gains, built=built(settings, stiffness=stiffness)) as rig:
        rig.run(0.2)
        entered(rig, Mode.COMPENSATING)
        for target_n in (60.0, 350.0):
            take(rig, target_n)


@pytest.mark.starts_in(Mode.COMPENSATING)
@pytest.mark.parametrize("tensions", [False, True], ids=["on the ramp down", "tensioned to less"])
def test_a_load_that_goes_unseen_is_bounded_by_the_set_point_in_force(rig: Lockstep, tensions: bool) -> None:
    """A tenth of 350 N may go unseen until the ramp to 60 N has left them: the payload moves by 3 mm, 18 N."""
    take(rig, 350.0)
    if tensions:
        assert rig.command(Verb.HOLD) is Refusal.NONE
        rig.run(1.0)
    payload_moves(-3.0, 4.0)(Stand(rig, "unseen"))
    if not tensions:
        rig.run(1.0)
    assert rig.command(Verb.TARGET, 60.0) is Refusal.NONE
    if tensions:
        assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run(0.5)
    assert rig.loop.machine.fault is Fault.NONE


@pytest.mark.starts_in(Mode.COMPENSATING)
@pytest.mark.parametrize("target_n", [60.0, 350.0])
def test_a_cell_that_does_not_show_the_ramp_is_found(rig: Lockstep, target_n: float) -> None:
    """The limit of the disturbance in the shipped file comes first, after 0.25 s, the unseen travel at a tenth."""
    reads(CELL, noise=rig.settings.tension_cell.noise_n, freezes=True)(Stand(rig, "frozen"))
    assert rig.command(Verb.TARGET, target_n) is Refusal.NONE
    rig.run(1.5)
    assert rig.loop.machine.fault in (Fault.LIMIT, Fault.LOAD_UNSEEN)
    assert abs(rig.rig.truth.tension_n - 300.0) < MOST_SHARE * 300.0


@pytest.mark.gate("60.0-3.0-hold", "350.0-0.6-fault")
@pytest.mark.starts_in(Mode.COMPENSATING)
@pytest.mark.parametrize("verdict", ["hold", "fault"])
@pytest.mark.parametrize(("target_n", "after_s"), [(60.0, 0.1), (60.0, 3.0), (350.0, 0.6)])
def test_a_ramp_that_is_cut_short_ends_on_the_brake_without_a_finding(
    rig: Lockstep, target_n: float, after_s: float, verdict: str
) -> None:
    """Stroke and tension of the held load are latched at standstill, those of the parked one with the brake closed."""
    assert rig.command(Verb.TARGET, target_n) is Refusal.NONE
    rig.run(after_s)
    cause = Fault.NONE
    if verdict == "hold":
        assert rig.command(Verb.HOLD) is Refusal.NONE
    else:
        cause = Fault.LIMIT
        trip(rig, Action.HOLD, cause)
    found = 0.0
    for _ in range(round((rig.settings.hold.park_s + 2.0) * rig.settings.loop.rate_hz)):
        rig.tick()
        found = max(found, rig.view.shown_loss)
    assert rig.rig.drive.control.stage.braked
    assert (rig.loop.machine.fault, found) == (cause, 0.0)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_the_probe_is_off_until_the_ramp_has_ended(rig: Lockstep) -> None:
    rig.run(SETTLED_S + GROW_S)
    assert rig.run(0.2)["excitation_mm_s"].any()
    take(rig, 280.0)
    assert not rig.run(SETTLED_S - AFTER_S)["excitation_mm_s"].any()
    assert rig.run(1.0)["excitation_mm_s"].any()


@pytest.mark.study
@pytest.mark.starts_in(Mode.COMPENSATING)
@pytest.mark.parametrize("target_n", [340.0, 220.0, 60.0])
def test_a_ramp_is_no_answer_to_the_probe(rig: Lockstep, target_n: float) -> None:
    """A TARGET ended in CELL_FROZEN within a second, or its ramp passed for an answer three times as large."""
    planned = plan(rig.settings, design(rig.settings))
    rig.run(SETTLED_S + GROW_S + planned.detection_s + planned.period_s)
    assert rig.view.probe_found is ProbeFinding.WHOLE
    take(rig, target_n)
    rig.run(SETTLED_S + GROW_S + planned.detection_s + planned.period_s)
    assert rig.view.probe_found is ProbeFinding.WHOLE
    assert rig.view.probe_share == pytest.approx(1.0, abs=0.5)
