"""Which entry of a gain table is in force, and that a change is bumpless."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rigctl.config.changed_settings import changed
from rigctl.control.law.estimator import TensionFilter, filter_model
from rigctl.control.law.gain_table import GainTable, InForce, ScheduledGains, TableEntry, plain
from rigctl.control.law.tension import Estimate, Gains, TensionLaw
from tests.builders.rig_bench import SETTINGS

SOFT, HARD = Gains(1.6, 0.15, 1.2), Gains(1.3, 0.15, 1.0)
DWELL_S = 0.5


def scheduled(*entries: TableEntry) -> ScheduledGains:
    return ScheduledGains(*HARD.in_order, entries, DWELL_S)


def two() -> ScheduledGains:
    return scheduled(TableEntry(300.0, HARD), TableEntry(100.0, SOFT, {"plant.spring_n_mm": 5.0}))


def looked(table: GainTable, tension_n: float, stroke_mm: float = 50.0, ticks: int = 600) -> list[InForce]:
    now = TensionFilter(filter_model(SETTINGS))
    return [taken for _ in range(ticks) if (taken := table.look(tension_n, stroke_mm, now)) is not None]


def table_of(gains: Gains) -> GainTable:
    found = GainTable.of(SETTINGS, gains)
    assert found is not None
    return found


def test_the_nearest_entry_is_taken_after_the_dwell_time_and_kept_near_the_middle() -> None:
    table = table_of(two())
    assert looked(table, 100.0, ticks=499) == []
    (taken,) = looked(table, 100.0, ticks=5)
    assert (taken.number, taken.gains) == (1, SOFT)
    assert taken.stiffness_n_mm == pytest.approx(1.0 / (1.0 / 5.0 + 1.0 / 1000.0))
    assert looked(table, 208.0, ticks=1500) == []  # nearer to 300, but not by enough
    (back,) = looked(table, 260.0, ticks=1500)
    assert back.number == 0


def test_entries_at_one_tension_are_told_apart_by_stroke() -> None:
    table = table_of(scheduled(TableEntry(300.0, HARD, stroke_mm=20.0), TableEntry(300.0, SOFT, stroke_mm=80.0)))
    assert looked(table, 300.0, 30.0, 1500) == []
    assert [taken.number for taken in looked(table, 300.0, 75.0, 1500)] == [1]


def test_tension_and_stroke_count_by_the_spans_of_the_entries() -> None:
    table = table_of(scheduled(TableEntry(300.0, HARD, stroke_mm=20.0), TableEntry(200.0, SOFT, stroke_mm=80.0)))
    assert looked(table, 290.0, 60.0, 1500) == []  # 0.1 + 0.67 of the spans from the one, 0.9 + 0.33 from the other
    (taken,) = looked(table, 270.0, 78.0, 1500)  # 0.3 + 0.97, 0.7 + 0.03
    assert taken.number == 1


def test_gains_without_a_choice_have_no_table() -> None:
    assert GainTable.of(SETTINGS, HARD) is None
    assert GainTable.of(SETTINGS, scheduled(TableEntry(300.0, HARD))) is None
    assert plain(two()) == HARD


def test_a_table_crosses_to_the_loop_as_json() -> None:
    line = msgspec.json.encode({"k_tension": 1.3, "k_speed": 0.15, "k_integral": 1.0})
    assert msgspec.json.decode(line, type=ScheduledGains) == ScheduledGains(*HARD.in_order)
    assert msgspec.json.decode(msgspec.json.encode(two()), type=ScheduledGains) == two()


@pytest.mark.parametrize("quiet", [None, 3.0])
def test_a_filter_that_takes_over_goes_on_with_state_and_commands_of_the_other(quiet: float | None) -> None:
    base = changed(SETTINGS, {"estimator.quiet_disturbance_walk_mm_s": quiet})
    now, other = (TensionFilter(filter_model(changed(base, {"plant.spring_n_mm": spring}))) for spring in (6.0, 5.0))
    rng = np.random.default_rng(1)
    for i in range(400):
        now.update(300.0 + 0.03 * rng.standard_normal(), 0.1)
        now.predict()
        now.ahead()
        now.command(0.001 * i)
    other.take_over(now)
    assert other.state == now.state
    assert other.ahead()[1:] == pytest.approx(now.ahead()[1:])
    for _ in range(5):
        for each in (now, other):
            each.update(300.0, 0.4)
            each.predict()
    assert other.state[0] == pytest.approx(now.state[0], abs=0.1)
    other.update(None, 0.4)  # an absent sample is carried by the covariance
    other.predict()
    assert np.isfinite(other.state).all()


def test_a_change_of_gains_and_stiffness_does_not_step_the_command() -> None:
    law = TensionLaw(SETTINGS, HARD)
    law.target_n = 300.0
    law.start_ramp(300.0, 0.0)
    estimate = Estimate(300.5, 0.3, -0.2, 50.0)
    before = [law.compensating(estimate, 1.0) for _ in range(50)]
    law.change_gains(SOFT, 5.0)
    after = law.compensating(estimate, 1.0)
    step = abs(before[-1] - before[-2])
    assert abs(after - before[-1]) <= 2.0 * step


def test_a_change_of_the_stiffness_on_a_ramp_makes_no_step_in_the_command() -> None:
    """From 6 to 6.6 N/mm at 50 N/s, on a rope that follows: the step was 0.8 mm/s, beside the limit of acceleration."""
    settings = changed(SETTINGS, {"tension.ramp_n_s": 50.0, "tension.acceleration_max_mm_s2": 1e6})
    gains = Gains(1.3, 0.15, 1.0)
    law, k_n_mm = TensionLaw(settings, gains), settings.plant.stiffness_n_mm
    law.start_ramp(200.0, 0.0)
    law.target_n = 300.0
    commands, ramps = [], []
    for tick in range(4000):
        speed_mm_s = law._slope_n_s / k_n_mm
        commands.append(law.compensating(Estimate(law.setpoint_n, speed_mm_s, 0.0, 50.0), 1.0))
        ramps.append(law._slope_n_s)
        if tick == 1000:
            assert law._slope_n_s == 50.0
            law.change_gains(gains, 1.1 * k_n_mm)
    steps = np.abs(np.diff(commands))
    assert steps[1000] < 0.01
    assert steps.max() < 0.1, "nor is there one at the ramp's end"
    assert ramps[-1] == 0.0
    assert law._stiffness == pytest.approx(1.1 * k_n_mm), "in use once the ramp has ended"
