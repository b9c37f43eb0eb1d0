"""Moves marked by an operator: the error that repeats is learnt, in the whole loop against the simulated rig."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hil.lockstep import lockstep
from hil.operated_rig import arm_and_tension
from hil.plant.layout import MECHANISM
from hil.scenario import disturbances, kinds
from hil.scenario.layered_rig import with_set
from hil.scenario.play import play
from hil.studies.moves.repeated_moves import LEARNING
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design.margins import design_and_check
from rigctl.model.verbs import Refusal, Verb
from tests.builders.paths import ROOT
from tests.builders.rig_bench import changed


def learns(settings: RigSettings) -> RigSettings:
    return settings.model_copy(update={"learning": LEARNING})


def test_the_shipped_set_learns_from_short_moves_and_plays_it() -> None:
    stiff = changed(
        with_set(ROOT / "config/paper_rig.yaml", ROOT / "config/sets/learned_moves.yaml"), plant={"spring_n_mm": 34.0}
    )
    move = kinds.OutAndBack(
        kind="out_and_back", angle_deg=3.0, speed_deg_s=3.0, acceleration_deg_s2=6.0, start_s=0.5, dwell_s=1.0,
        repeats=4,
    )  # fmt: skip
    one_s = 5.0
    starts = [move.start_s + i * one_s for i in range(move.repeats)]
    run = play(
        stiff, {MECHANISM: disturbances.rotation(move)}, seconds=starts[-1] + one_s, controller="loop", target_n=300.0,
        marks=[mark for start in starts for mark in ((start, 1), (start + 4.5, 0))],
    )  # fmt: skip
    assert not run.ended.tripped
    index = ((run.t_s - move.start_s) // one_s).astype(int)
    spread = [float(np.std(run.truth["vertical_n"][index == i])) for i in range(move.repeats)]
    assert run.records is not None and run.records_t_s is not None
    assert run.records["learned_mm_s"][run.records_t_s > starts[-1]].any()
    assert spread[3] < 0.7 * spread[1]  # 0.73 without the set; `python -m hil moves` judges by longer moves


@pytest.mark.study
def test_what_repeats_from_move_to_move_is_taken_away(settings: RigSettings) -> None:
    stiff = changed(settings, plant={"spring_n_mm": 34.0})
    gains = design_and_check(stiff).gains
    move = kinds.OutAndBack(
        kind="out_and_back", angle_deg=6.0, speed_deg_s=2.0, acceleration_deg_s2=4.0, start_s=0.5, dwell_s=1.75,
        repeats=5,
    )  # fmt: skip
    tracks = {MECHANISM: disturbances.rotation(move)}
    one_s = (tracks[MECHANISM].end + move.dwell_s - move.start_s) / move.repeats
    starts = [move.start_s + i * one_s for i in range(move.repeats)]

    def spread_by_move(rig: RigSettings, marks: list[tuple[float, int]]) -> list[float]:
        run = play(rig, tracks, seconds=starts[-1] + one_s, controller="loop", target_n=300.0, gains=gains, marks=marks)
        assert not run.ended.tripped
        index = ((run.t_s - move.start_s) // one_s).astype(int)
        return [float(np.std(run.truth["vertical_n"][index == i])) for i in range(move.repeats)]

    without = spread_by_move(stiff, [])
    learning = spread_by_move(learns(stiff), [(start, 1) for start in starts])
    # The first move begins with the rope plumb, the others where friction has left it: the second is learnt from anew.
    assert learning[:2] == pytest.approx(without[:2], rel=1e-9)
    assert learning[4] < 0.5 * without[4]


def test_a_move_is_refused_without_the_section_and_outside_compensating(settings: RigSettings, gains: Gains) -> None:
    def answers(rig_settings: RigSettings) -> list[Refusal]:
        with lockstep(rig_settings, gains) as rig:
            rig.run(0.2)
            found = [rig.command(Verb.MOVE, 1.0)]
            arm_and_tension(rig, limit_s=10.0)
            found += [rig.command(Verb.MOVE, number) for number in (1.0, 0.0, 1.5, 3.0, -1.0)]
            return found

    unknown = [Refusal.OUT_OF_RANGE] * 3
    assert answers(settings) == [Refusal.WRONG_MODE] + [Refusal.NO_LEARNING] * 5
    assert answers(learns(settings)) == [Refusal.WRONG_MODE, Refusal.NONE, Refusal.NONE, *unknown]


def test_the_record_shows_the_move_and_its_speed(settings: RigSettings, gains: Gains) -> None:
    with lockstep(learns(settings), gains) as rig:
        rig.run(0.2)
        arm_and_tension(rig, limit_s=10.0)
        learning: Any = rig.loop.learning
        table = learning._tables[1]
        table.taught, table.length, table.target_n, table.gains = 1, 900, 300.0, gains
        for i in range(900):
            table.speeds[i] = 0.01
        assert rig.command(Verb.MOVE, 2.0) is Refusal.NONE
        records = rig.run(1.0)
        assert (records["move"] == 2).all()
        assert records["learned_mm_s"][100:] == pytest.approx(0.01)
        assert rig.hold() is Refusal.NONE
        records = rig.run(0.1)
        assert not records["move"].any()
        assert not records["learned_mm_s"].any()
