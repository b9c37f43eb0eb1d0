"""Tensioning with a cell that has frozen on a slack rope, or has a wrong scale: the motor's current shows the rope."""

from __future__ import annotations

import pytest

from hil.faults.in_device import CELL, reads
from hil.faults.stand import Stand, Step
from hil.lockstep import Lockstep, lockstep
from hil.scenario.layered_rig import with_set
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.load.take_up import limit_n
from rigctl.design.margins import design_and_check
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.paths import ROOT
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


@pytest.mark.gate("0.6-0.0")
@pytest.mark.parametrize(("scale", "preload_n"), [(0.5, 0.0), (0.6, 0.0), (0.8, 0.0), (0.6, 100.0)])
def test_a_cell_of_wrong_scale_is_found_before_the_tension_is_above_its_limit(
    settings: RigSettings, gains: Gains, scale: float, preload_n: float
) -> None:
    """It had been COMPENSATING at 498 N for 300 with a scale of 0.6: a soft mechanism has such a stiffness as well."""
    with lockstep(settings, gains) as rig:
        if preload_n:
            rig.rig.plant.preload(preload_n)
        reads(CELL, times=scale)(Stand(rig, "seed"))
        rig.run(0.6)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.3)
        reached_n = taken_up(rig, None, 15.0)
        assert rig.loop.machine.fault is Fault.LOAD_UNSEEN
        assert reached_n < settings.safety.tension_high_n
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run_until(Mode.HOLD, 1.0)
        assert taken_up(rig, None, 1.0) < reached_n + 1.0, "a second TENSION moves nothing"
        assert rig.loop.machine.fault is Fault.LOAD_UNSEEN
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run_until(Mode.HOLD, 1.0)
        assert rig.command(Verb.RELEASE) is Refusal.NONE
        rig.run_until(Mode.HOLD, 15.0)
        assert rig.rig.plant.truth.tension_n < 1.0, "the way out"


def test_without_its_current_a_cell_of_wrong_scale_takes_the_tension_above_its_limit(
    settings: RigSettings, gains: Gains
) -> None:
    """The test above can fail."""
    with lockstep(changed(settings, cylinder={"force_per_ampere_n": None}), gains) as rig:
        reads(CELL, times=0.6)(Stand(rig, "seed"))
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert taken_up(rig, None, 8.5) > settings.safety.tension_high_n


SETS = sorted(path.name for path in (ROOT / "config/sets").glob("*.yaml"))


@pytest.mark.parametrize(
    ("rig_file", "set_name"), [("paper_rig", ""), ("plain_rig", ""), *(("paper_rig", name) for name in SETS)]
)
@pytest.mark.study
def test_no_shipped_rig_nor_set_comes_near_the_limit(rig_file: str, set_name: str) -> None:
    """The largest excess of the current is 1.5 N, of 20 N and more."""
    path = ROOT / f"config/{rig_file}.yaml"
    shipped = with_set(path, ROOT / "config/sets" / set_name) if set_name else config.load(path)
    shipped = changed(shipped, safety={"stuck_samples": None})  # an ideal cell repeats itself at rest
    most_n = 0.0
    with lockstep(shipped, design_and_check(shipped).gains) as rig:
        rig.run(0.6)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        while rig.loop.machine.mode is not Mode.COMPENSATING:
            rig.tick()
            assert rig.loop.machine.fault is Fault.NONE
            most_n = max(most_n, rig.view.taken_up_apart_n)
    assert 0.0 < most_n < 0.4 * limit_n(shipped.tension.slack_n, shipped.tension.target_n)
