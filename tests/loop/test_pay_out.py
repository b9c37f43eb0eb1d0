"""A slack rope whose cylinder is at the end of its stroke: `release` MM pays it back."""

from __future__ import annotations

import math

import pytest

from hil.faults.in_plant import rope_breaks
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import PAYS_OUT_MM_S, Gains
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import STROKE_SPARE_MM, Refusal, Verb

LIMIT_S = 60.0
LENGTH_MM = 20.0


@pytest.fixture
def rig_settings(settings: RigSettings) -> RigSettings:
    """A cylinder whose way out goes on where the rope of the paper's rig is slack."""
    cylinder = settings.cylinder.model_copy(update={"stroke_min_mm": -40.0})
    return settings.model_copy(update={"cylinder": cylinder})


def pays_out(rig: Lockstep, length_mm: float = LENGTH_MM) -> None:
    """It takes its time at 2 mm/s, ends in HOLD and where it should."""
    before_mm, began_ns = rig.rig.truth.stroke_mm, rig.clock.now()
    assert rig.command(Verb.RELEASE, length_mm) is Refusal.NONE
    rig.run_until(Mode.HOLD, LIMIT_S)
    lasted_s = (rig.clock.now() - began_ns) * 1e-9
    rig.run(0.5)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.HOLD, Fault.NONE)
    assert before_mm - rig.rig.truth.stroke_mm == pytest.approx(length_mm, abs=0.2)
    assert lasted_s == pytest.approx(length_mm / PAYS_OUT_MM_S, rel=0.15)


@pytest.mark.starts_in(Mode.HOLD)
def test_a_rope_that_has_broken_is_paid_back_from_the_end_of_the_stroke(rig: Lockstep) -> None:
    """RELEASE said "rope is slack already", and TENSION ran into STROKE_END again."""
    rope_breaks()(Stand(rig, "broken"))
    for _ in range(4):
        rig.run(1.0)
        if rig.loop.machine.fault is not Fault.NONE:
            assert rig.command(Verb.RESET) is Refusal.NONE
        if rig.loop.machine.mode is Mode.DISARMED:
            assert rig.command(Verb.ARM, 1.0) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run_until(Mode.FAULT, 200.0)
        rig.run(1.0)
        if rig.loop.machine.fault is Fault.STROKE_END:
            break
    assert rig.loop.machine.fault is Fault.STROKE_END
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert rig.loop.machine.mode is Mode.HOLD
    assert rig.command(Verb.RELEASE) is Refusal.ALREADY
    pays_out(rig)
    assert rig.command(Verb.DISARM) is Refusal.NONE


def test_a_rig_that_was_disarmed_at_the_end_gets_away_by_arm_near_end(settings: RigSettings, gains: Gains) -> None:
    near = {"stroke_min_mm": -100.0, "stroke_max_mm": 1.0}  # the rope is slack at 0
    cylinder = settings.cylinder.model_copy(update=near)
    with lockstep(settings.model_copy(update={"cylinder": cylinder}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.STROKE_NEAR_END
        assert rig.command(Verb.ARM, 1.0) is Refusal.NONE
        pays_out(rig)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_tight_rope_and_a_length_beyond_the_stroke_are_refused(rig: Lockstep) -> None:
    assert rig.command(Verb.HOLD) is Refusal.NONE
    assert rig.command(Verb.RELEASE, LENGTH_MM) is Refusal.TIGHT
    assert rig.command(Verb.RELEASE) is Refusal.NONE
    rig.run_until(Mode.HOLD, LIMIT_S)
    rig.run(0.5)
    room_mm = rig.record["stroke_mm"] - rig.settings.cylinder.stroke_min_mm - STROKE_SPARE_MM
    for length_mm in (-1.0, room_mm + 0.1, math.inf):
        assert rig.command(Verb.RELEASE, length_mm) is Refusal.OUT_OF_RANGE
    assert rig.command(Verb.RELEASE, math.nan) is Refusal.ALREADY, "no length: a ramp to slack"
    pays_out(rig, room_mm)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_length_is_for_hold_alone(rig: Lockstep) -> None:
    assert rig.command(Verb.RELEASE, LENGTH_MM) is Refusal.WRONG_MODE
    assert rig.loop.machine.mode is Mode.COMPENSATING
    assert rig.command(Verb.RELEASE) is Refusal.NONE
    assert rig.command(Verb.RELEASE, LENGTH_MM) is Refusal.ALREADY
    assert rig.command(Verb.HOLD) is Refusal.NONE


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_hold_ends_it_and_a_release_after_it_ramps_as_ever(rig: Lockstep) -> None:
    assert rig.command(Verb.RELEASE) is Refusal.NONE
    rig.run_until(Mode.HOLD, LIMIT_S)
    rig.run(0.5)
    before_mm = rig.rig.truth.stroke_mm
    assert rig.command(Verb.RELEASE, LENGTH_MM) is Refusal.NONE
    rig.run(2.0)
    assert rig.command(Verb.HOLD) is Refusal.NONE
    rig.run(1.0)
    assert before_mm - rig.rig.truth.stroke_mm == pytest.approx(2.0 * PAYS_OUT_MM_S, abs=0.5)
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run_until(Mode.COMPENSATING, LIMIT_S)
    assert rig.command(Verb.RELEASE) is Refusal.NONE
    rig.run_until(Mode.HOLD, LIMIT_S)
    assert rig.rig.truth.tension_n < rig.settings.tension.slack_n
