"""What proves that a rope is slack, and what does not."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.control.modes import Mode
from rigctl.control.slack_zero import LONGEST_REST_S, PROOF_AGE_S, PROOF_MM, SlackWatch, SlackZero
from tests.builders.paths import ROOT

RIG = config.load(ROOT / "config/paper_rig.yaml")
K_N_MM = RIG.plant.stiffness_n_mm
MS = 1_000_000


class Rope:
    """A cell with a zero error on a rope that is tight above ``tight_mm`` of stroke; time and stroke by the test."""

    def __init__(self, zero_n: float = 0.1, tight_mm: float = 2.0, mode: Mode = Mode.HOLD) -> None:
        self.watch, self.zero_n, self.tight_mm, self.mode = SlackWatch(RIG), zero_n, tight_mm, mode
        self.inbox: Any = SimpleNamespace(
            stroke_mm=0.0, speed_mm_s=0.0, drive_t_ns=0, cell_n=0.0, cell_quality=0, cell_fresh=True
        )
        self.t_ns = 0
        self._draw = random.Random(3).gauss

    def go(self, seconds: float, speed_mm_s: float = 0.0) -> list[SlackZero]:
        found = []
        for _ in range(round(1000 * seconds)):
            self.t_ns += MS
            inbox = self.inbox
            inbox.drive_t_ns, inbox.speed_mm_s = self.t_ns, speed_mm_s
            inbox.stroke_mm += speed_mm_s * 1e-3
            pull_n = max(0.0, K_N_MM * (inbox.stroke_mm - self.tight_mm))
            inbox.cell_n = pull_n + self.zero_n + self._draw(0.0, 0.03)
            if (zero := self.watch.look(inbox, self.mode, self.t_ns)) is not None:
                found.append(zero)
        return found


def test_a_rest_alone_proves_nothing() -> None:
    assert Rope().go(60.0) == []


@pytest.mark.parametrize("speed_mm_s", [8.0, 1.0, -3.0])
def test_a_motion_that_the_reading_does_not_follow_proves_the_rest_before_it(speed_mm_s: float) -> None:
    rope = Rope()
    rope.go(1.5)
    (found,) = rope.go(PROOF_MM / abs(speed_mm_s) + 0.01, speed_mm_s)
    assert found.tension_n == pytest.approx(0.1, abs=0.004)
    assert found.samples >= 1000


def test_a_motion_before_the_rest_proves_it_too() -> None:
    rope = Rope()
    rope.inbox.stroke_mm = 5.0
    assert rope.go(5.0 / 8.0, -8.0) == []
    (found,) = rope.go(3.0)
    assert found.tension_n == pytest.approx(0.1, abs=0.004)
    assert rope.go(20.0) == []  # once for each proof


def test_a_tight_rope_is_never_taken_for_a_slack_one() -> None:
    """Also below tension.slack_n, where it counts as slack for the law."""
    rope = Rope(tight_mm=-0.3)
    for _ in range(4):
        assert rope.go(2.0) == []
        assert rope.go(0.06, 8.0) == []
        assert rope.go(2.0) == []
        assert rope.go(0.06, -8.0) == []


def test_a_motion_that_ends_tight_within_the_proof_proves_nothing() -> None:
    rope = Rope(tight_mm=0.3)  # 0.3 mm of slack, then 1.2 N within the half millimetre
    rope.go(1.5)
    assert rope.go(0.5 / 8.0, 8.0) == []


def test_a_short_rest_is_no_mean() -> None:
    rope = Rope()
    rope.go(0.7)
    assert rope.go(0.1, 8.0) == []


def test_a_proof_holds_for_half_a_minute() -> None:
    """Whoever moves the mechanism meanwhile pulls at the rope."""
    rope = Rope()
    rope.go(0.1, 8.0)  # proven, and no rest before it
    rope.inbox.cell_fresh = False
    rope.t_ns += round(1e9 * PROOF_AGE_S)
    rope.inbox.cell_fresh = True
    assert rope.go(2.0) == []


@pytest.mark.parametrize("what", ["mode", "quality", "drive", "rise"])
def test_what_comes_between_ends_the_stretch(what: str) -> None:
    rope = Rope()
    rope.go(1.5)
    if what == "mode":
        rope.mode = Mode.FAULT
    elif what == "quality":
        rope.inbox.cell_quality = 1
    elif what == "rise":
        rope.zero_n = 0.8
    else:
        rope.t_ns += 10**9
        rope.watch.look(rope.inbox, rope.mode, rope.t_ns)
    rope.go(0.05)
    rope.mode, rope.inbox.cell_quality, rope.zero_n = Mode.HOLD, 0, 0.1
    assert rope.go(0.1, 8.0) == []


def test_a_long_rest_counts_by_its_last_whole_stretch() -> None:
    rope = Rope()
    rope.go(LONGEST_REST_S + 0.5)
    (found,) = rope.go(0.1, 8.0)
    assert found.samples == round(LONGEST_REST_S * RIG.loop.rate_hz)
