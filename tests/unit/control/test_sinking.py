"""A load that sinks on the closed brake: speed, disagreement with the tension, and the way to a slack rope."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rigctl.config import rig_file as config
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.load.sinking import AGREES_MM, AGREES_SHARE, Sinking
from rigctl.control.power.power_seen import PowerSeen
from rigctl.control.snapshot import Snapshot
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
K = SETTINGS.plant.slow_stiffness_n_mm
MS = 1_000_000
CLOSED = PowerSeen(stopped_and_closed=True)
Path = Callable[[float], float]


def after(seconds: float, stroke_mm: Path, tension_n: Path) -> Sinking:
    """What is found after so long on the closed brake; both paths are functions of the time in s."""
    found = Sinking(SETTINGS, RopeMemory(SETTINGS))
    for tick in range(round(1000 * seconds) + 1):
        t = 1e-3 * tick
        found.look(tick * MS, Snapshot(stroke_mm=stroke_mm(t), tension_n=tension_n(t), power=CLOSED))
    return found


def sinks(speed_mm_s: float, from_s: float = 0.0) -> tuple[Path, Path]:
    """Stroke and the tension that follows it by the stiffness."""

    def moved_mm(t: float) -> float:
        return speed_mm_s * max(0.0, t - from_s)

    return lambda t: 50.0 + moved_mm(t), lambda t: 300.0 + K * moved_mm(t)


@pytest.mark.parametrize("speed_mm_s", [-0.3, -3.0, 0.3])
def test_the_speed_is_that_of_the_stroke_and_agrees_with_the_tension(speed_mm_s: float) -> None:
    for seconds in (0.5, 1.2, 8.0):
        found = after(seconds, *sinks(speed_mm_s))
        assert found.seen.speed_mm_s == pytest.approx(speed_mm_s, rel=1e-6)
        assert found.seen.apart_mm == 0.0


def test_the_speed_is_of_the_last_second() -> None:
    assert after(6.0, *sinks(-0.3, from_s=4.5)).seen.speed_mm_s == pytest.approx(-0.3, rel=1e-6)
    assert after(6.0, lambda t: 50.0 - 0.3 * min(t, 3.0), lambda _: 300.0).seen.speed_mm_s > -0.15, "it has stopped"


def test_a_motion_too_slow_for_one_second_shows_in_five() -> None:
    assert after(2.0, *sinks(-0.008)).seen.speed_mm_s == 0.0
    assert after(6.0, *sinks(-0.008)).seen.speed_mm_s == pytest.approx(-0.008, rel=1e-6)
    assert after(60.0, *sinks(-0.003)).seen.speed_mm_s == 0.0, "nothing that the encoder's noise could make"


@pytest.mark.parametrize("speed_mm_s", [-0.3, 0.3])
def test_a_stroke_that_the_tension_does_not_follow_is_apart_by_its_motion_of_five_seconds(speed_mm_s: float) -> None:
    apart_mm = after(9.0, sinks(speed_mm_s)[0], lambda _: 300.0).seen.apart_mm
    assert apart_mm == pytest.approx((1.0 - AGREES_SHARE) * 5.0 * abs(speed_mm_s) - AGREES_MM, rel=0.02)


def test_a_tension_that_changes_on_a_stroke_at_rest_is_apart_by_its_stretch() -> None:
    apart_mm = after(9.0, lambda _: 50.0, lambda t: 300.0 - 0.2 * K * t).seen.apart_mm
    assert apart_mm == pytest.approx(5.0 * 0.2 - AGREES_MM, rel=0.02)


def test_the_rope_is_slack_after_the_stretch_above_that_limit() -> None:
    assert after(0.1, lambda _: 50.0, lambda _: 300.0).seen.left_mm == (300.0 - SETTINGS.tension.slack_n) / K
    assert after(0.1, lambda _: 50.0, lambda _: 1.0).seen.left_mm == 0.0


def test_a_motor_that_may_hold_and_a_position_that_jumps_begin_anew() -> None:
    found = Sinking(SETTINGS, RopeMemory(SETTINGS))
    for tick in range(2000):
        found.look(tick * MS, Snapshot(stroke_mm=50.0 - 3e-4 * tick, tension_n=300.0, power=CLOSED))
    assert found.seen.speed_mm_s == pytest.approx(-0.3, rel=1e-6)
    found.look(2000 * MS, Snapshot(stroke_mm=48.0, tension_n=300.0, power=CLOSED))
    assert found.seen.speed_mm_s == 0.0
    for tick in range(2001, 4000):
        found.look(tick * MS, Snapshot(stroke_mm=48.0 - 3e-4 * tick, tension_n=300.0, power=PowerSeen()))
    assert (found.seen.speed_mm_s, found.seen.apart_mm) == (0.0, 0.0)
