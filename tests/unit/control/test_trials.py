"""The excitation of IDENTIFY on a stroke that follows at once."""

from __future__ import annotations

import itertools

import pytest

from rigctl.config import rig_file as config
from rigctl.control.modes import Refusal
from rigctl.control.snapshot import Snapshot
from rigctl.control.trials import Excitation
from tests.unit.control.test_plain_inbox import CONFIG, Bench

RIG = config.load(CONFIG / "paper_rig.yaml")


def test_every_step_up_is_followed_by_the_same_step_down_so_that_the_stroke_ends_where_it_began() -> None:
    inbox, dt = Bench(RIG).inbox, 1.0 / RIG.loop.rate_hz
    inbox.tension_n, inbox.stroke_mm = 100.0, 50.0
    excitation, speeds = Excitation(RIG, inbox), []
    ended = None
    while ended is None:
        ended = excitation.see(inbox, Snapshot())
        speeds.append(excitation.wanted_mm_s)
        inbox.stroke_mm += excitation.wanted_mm_s * dt
        inbox.tension_n = 100.0 + RIG.plant.stiffness_n_mm * (inbox.stroke_mm - 50.0)
    assert ended is Refusal.NONE
    steps = [(speed, len(list(ticks))) for speed, ticks in itertools.groupby(speeds) if speed]
    assert len(steps) % 2 == 0
    for (up, up_ticks), (down, down_ticks) in zip(steps[::2], steps[1::2], strict=True):
        assert up > 0.0
        assert (down, down_ticks) == (-up, up_ticks)
    assert inbox.stroke_mm == pytest.approx(50.0, abs=1e-9)
