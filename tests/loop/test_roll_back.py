"""The motor takes the load from the brake through the real loop, and gives it back; the plant's truth judges."""

from __future__ import annotations

import pytest

from hil.lockstep import Lockstep, lockstep
from hil.studies.roll_back.study import LIMIT_MM, RollBackCase, cases, settings_of, taken_over
from rigctl.config.changed_settings import changed
from rigctl.control.law.tension import Gains
from rigctl.devices import objects
from rigctl.devices.startup import StartupError
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.rig_bench import SETTINGS


@pytest.mark.parametrize(
    "case", [RollBackCase(6.0, 50.0, 10.0), RollBackCase(34.0, 350.0, -10.0), RollBackCase(34.0, 350.0, 10.0)]
)
def test_with_a_preload_the_load_stays_within_the_limit(gains: Gains, case: RollBackCase) -> None:
    moved = taken_over(SETTINGS, gains, case)
    assert case.error_pct is not None
    expected_mm = case.load_n * case.error_pct * 1e-2 / 575.6  # N/mm, of the speed controller's integrator
    assert moved.sank_mm - moved.rose_mm == pytest.approx(expected_mm, abs=0.004)  # 1.5 N in a per mille
    assert moved.most_mm <= LIMIT_MM
    assert (moved.ended, moved.braked_mm <= 0.01) == ("HOLD", True)


def test_without_a_preload_the_load_sinks_by_more(gains: Gains) -> None:
    moved = taken_over(SETTINGS, gains, RollBackCase(6.0, 350.0, None))
    assert moved.sank_mm == pytest.approx(350.0 / 575.6, rel=0.02)


def offset_n(rig: Lockstep) -> float:
    """Preload that has reached the drive."""
    return float(rig.rig.drive._speed_control.offset_n)


def test_the_offset_stays_while_the_motor_carries_the_load(gains: Gains) -> None:
    with lockstep(settings_of(SETTINGS, RollBackCase(6.0, 300.0, 0.0)), gains) as rig:
        rig.rig.plant.preload(250.0)
        rig.run(0.6)
        assert offset_n(rig) == pytest.approx(250.0, abs=2.0)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.3)
        held = offset_n(rig)
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run_until(Mode.COMPENSATING, 20.0)
        assert rig.rig.truth.tension_n == pytest.approx(300.0, abs=3.0)
        assert offset_n(rig) == held
        assert rig.hold() is Refusal.NONE
        assert rig.command(Verb.DISARM) is Refusal.NONE
        rig.run(3.0)
        assert rig.record["held_by"] == HeldBy.BRAKE
        assert offset_n(rig) == pytest.approx(300.0, abs=3.0)


def test_a_drive_without_a_torque_offset_is_refused_by_name(gains: Gains) -> None:
    stock = changed(settings_of(SETTINGS, RollBackCase(6.0, 300.0, 0.0)), {"cylinder.eds": "eds/stock_drive.eds"})
    stock = changed(stock, {"cylinder.velocity_object": objects.VELOCITY_ACTUAL, "cylinder.velocity_pdo": 3})
    stock = changed(stock, {"cylinder.temperature_object": None})
    with pytest.raises(StartupError, match="found no object 0x60B2:00"), lockstep(stock, gains):
        pass


def test_a_torque_offset_that_another_tool_left_is_taken_back(gains: Gains) -> None:
    with lockstep(SETTINGS, gains) as rig:
        offsets = [setting for setting in rig.report.supervision if setting.name == "torque offset"]
        assert [setting.ok for setting in offsets] == [True]


def test_the_drawn_cases_are_the_same_each_time_and_cover_loads_and_springs() -> None:
    drawn = cases(2, 7)
    assert drawn == cases(2, 7) != cases(2, 8)
    assert sum(case.error_pct is None for case in drawn) * 3 == len(drawn)
    assert {case.load_n for case in drawn} >= {50.0, 350.0}
    assert {case.spring_n_mm for case in drawn} >= {6.0, 34.0}
