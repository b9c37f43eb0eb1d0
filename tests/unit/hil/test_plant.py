"""The plant as the simulated rig uses it: commands in, truth out. Its physics are in ``tests/plant``."""

from __future__ import annotations

import itertools

import pytest

from hil.plant import Plant
from hil.plant.layout import MECHANISM
from hil.plant.moves import out_and_back
from rigctl.config import rig_file as config
from tests.plant.bench import MS, REPOSITORY, SETTINGS, S, build, loaded, look

BEYOND_MM = 5.0
"""Default of ``stop_margin_mm``."""


def test_a_rig_file_without_a_simulation_is_no_plant() -> None:
    with pytest.raises(ValueError, match="simulation: found nothing"):
        Plant(SETTINGS.model_copy(update={"simulation": None}), 0)


def test_it_starts_plumb_slack_and_at_rest() -> None:
    truth = build().truth
    assert (truth.tension_n, truth.stroke_mm, truth.speed_mm_s) == (0.0, 0.0, 0.0)
    assert (truth.tangential_rad, truth.rail_rad, truth.pulley_mm, truth.mechanism_rad) == (0.0, 0.0, 0.0, 0.0)
    assert not truth.moving


def test_it_rests_under_its_preload() -> None:
    for axes in ({}, {"tangential_n_mm": 60.0, "normal_n_mm": 60.0, "vertical_n_mm": 60.0}):
        plant = loaded({"mechanism": axes})
        plant.advance(S)
        assert plant.truth.tension_n == pytest.approx(300.0, rel=1e-9)
        assert plant.truth.rail_rad == plant.truth.pulley_mm == 0.0


def test_the_paper_rig_stays_where_friction_holds_it() -> None:
    plant = Plant(config.load(REPOSITORY / "config/paper_rig.yaml"), 0)
    plant.preload(300.0)
    plant.advance(S)
    assert plant.truth.tension_n == pytest.approx(300.0, abs=0.01)  # with the file's rail, screw and rope
    assert plant.truth.rail_rad == plant.truth.pulley_mm == 0.0


def test_the_drive_keeps_its_acceleration_limit() -> None:
    plant = build()
    plant.set_drive(400.0, braked=False)
    speeds = [truth.speed_mm_s for truth in look(plant, 0.06)]
    steps = [after - before for before, after in itertools.pairwise(speeds)]
    assert max(steps) == pytest.approx(2000.0 * 1e-3)


def test_a_command_counts_after_its_delay() -> None:
    plant = build()
    plant.set_drive(10.0, braked=False)
    seen = list(look(plant, 0.01, 100_000))
    assert {truth.speed_mm_s for truth in seen if truth.t_ns <= 2 * MS} == {0.0}
    assert seen[20].speed_mm_s > 0.0  # 2.1 ms


def test_commands_on_the_way_are_not_overtaken() -> None:
    """Each command acts for as long as it was in force, one delay later."""
    plant = build()
    plant.set_drive(10.0, braked=False)
    plant.advance(MS)
    plant.set_drive(0.0, braked=False)
    plant.advance(S)
    assert plant.truth.stroke_mm == pytest.approx(10.0 * 1e-3, rel=1e-9)  # 1 ms of motion; the rest of the lag is e^-50


def test_the_stroke_ends_at_the_mechanical_stop() -> None:
    plant = build({"rope": {"slack_mm": 500.0}})
    plant.set_drive(40.0, braked=False)
    plant.advance(5 * S)
    assert plant.truth.stroke_mm == SETTINGS.cylinder.stroke_max_mm + BEYOND_MM
    assert plant.truth.speed_mm_s == 0.0
    assert plant.at_stroke_end
    plant.set_drive(-40.0, braked=False)
    plant.advance(6 * S)
    assert not plant.at_stroke_end


def test_the_brake_holds_the_stroke_exactly() -> None:
    plant = loaded()
    before = plant.truth.stroke_mm
    plant.set_drive(100.0, braked=True)
    plant.advance(plant.t_ns + S)
    assert (plant.truth.stroke_mm, plant.truth.speed_mm_s) == (before, 0.0)


def test_a_motion_is_under_way_until_its_last_track_ends() -> None:
    plant = loaded()
    plant.start_motion({MECHANISM: out_and_back(0.1, 0.1, 0.1)}, 0)
    assert plant.moving
    plant.advance(4 * S)
    assert not plant.moving
    assert plant.truth.mechanism_rad == pytest.approx(0.0, abs=1e-12)


def test_between_grid_points_truth_moves_on_but_the_plant_does_not() -> None:
    plant = loaded()
    plant.start_motion({MECHANISM: out_and_back(0.5, 0.1, 10.0)}, 0)
    plant.advance(S)
    state, angle = plant.state.copy(), plant.truth.mechanism_rad
    plant.advance(S + 50_000)
    assert (plant.state == state).all()
    assert plant.truth.mechanism_rad == pytest.approx(angle + 0.1 * 50e-6)


def test_an_earlier_time_changes_nothing() -> None:
    plant = loaded()
    plant.advance(S)
    before = plant.truth
    plant.advance(S // 2)
    assert plant.truth == before
