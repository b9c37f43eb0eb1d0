"""The excitation of IDENTIFY on a stroke that follows at once."""

from __future__ import annotations

import itertools

import pytest

from rigctl.config import rig_file as config
from rigctl.control.excitation.trials import QUIET_S, REST_S, Excitation
from rigctl.control.snapshot import Snapshot
from rigctl.model.verbs import Refusal
from tests.unit.control.test_plain_inbox import CONFIG, Bench

RIG = config.load(CONFIG / "paper_rig.yaml")


def steps_of(skips: dict[int, int]) -> tuple[list[tuple[float, int]], float, float]:
    """Speed and ticks of each step, the stroke at the end in mm, and the time taken in s.

    ``skips``: ticks skipped before the tick of that number.
    """
    inbox, dt = Bench(RIG).inbox, 1.0 / RIG.loop.rate_hz
    inbox.cell.tension_n, inbox.drive.stroke_mm = 100.0, 50.0
    excitation, snapshot, speeds = Excitation(RIG, inbox), Snapshot(), list[float]()
    ended, number = None, 0
    while ended is None:
        passed = 1 + skips.get(number, 0)
        speeds += [excitation.wanted_mm_s] * (passed - 1)
        inbox.drive.stroke_mm += excitation.wanted_mm_s * (passed - 1) * dt
        snapshot.t_ns += passed * RIG.loop.period_ns
        ended = excitation.see(inbox, snapshot)
        speeds.append(excitation.wanted_mm_s)
        inbox.drive.stroke_mm += excitation.wanted_mm_s * dt
        inbox.cell.tension_n = 100.0 + RIG.plant.stiffness_n_mm * (inbox.drive.stroke_mm - 50.0)
        number += 1
    assert ended is Refusal.NONE
    steps = [(speed, len(list(ticks))) for speed, ticks in itertools.groupby(speeds) if speed]
    return steps, inbox.drive.stroke_mm, excitation.figures["duration_s"] * RIG.loop.rate_hz - len(speeds)


def test_every_step_up_is_followed_by_the_same_step_down_so_that_the_stroke_ends_where_it_began() -> None:
    steps, stroke_mm, _ = steps_of({})
    assert len(steps) % 2 == 0
    for (up, up_ticks), (down, down_ticks) in zip(steps[::2], steps[1::2], strict=True):
        assert up > 0.0
        assert (down, down_ticks) == (-up, up_ticks)
    assert stroke_mm == pytest.approx(50.0, abs=1e-9)


def test_skipped_ticks_count_and_a_step_that_they_made_too_long_is_taken_back() -> None:
    usual, _, _ = steps_of({})
    before = round(QUIET_S * RIG.loop.rate_hz)
    for speed, ticks in usual[:8]:  # four feelers up and down
        assert speed
        before += ticks + round(REST_S * RIG.loop.rate_hz)
    within, at_the_end = before + 100, before + usual[8][1] - 1
    steps, stroke_mm, extra = steps_of({within: 20})
    assert steps == usual
    assert extra == 0
    steps, stroke_mm, extra = steps_of({at_the_end: 10})
    assert steps[9][1] == steps[8][1] > usual[8][1]
    assert stroke_mm == pytest.approx(50.0, abs=1e-9)
    assert extra == 0
