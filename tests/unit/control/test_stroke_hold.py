"""The latch and the position loop of a held stroke, against a drive with a lag and an offset."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.load.stroke_hold import AUTHORITY_MM_S, CREEP_MM_S, DEAD_ZONE_MM, SHOWN_MM, StrokeHold
from rigctl.control.snapshot import Snapshot
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
MS = 1_000_000


class Rig:
    """A drive with its lag, an offset, and an encoder whose position drifts."""

    def __init__(self, *, offset: float = 0.0, drift: float = 0.0, speed: float = 0.0) -> None:
        self.hold = StrokeHold(SETTINGS)
        self.snapshot = Snapshot(
            stroke_mm=50.0, speed_mm_s=speed, drive_age_ns=MS, drive_heard=True, drive_enabled=True
        )
        self.offset, self.drift, self.speed = offset, drift, speed
        self.true_mm, self.said_mm, self.command, self.t_ns = 50.0, 50.0, 0.0, 0
        self.left = self.creeps = 0

    def run(self, seconds: float, *, powered: bool = True) -> None:
        lag_s = SETTINGS.plant.cylinder_lag_s
        for _ in range(round(seconds * 1000)):
            self.t_ns += MS
            self.hold.watch(self.t_ns, self.snapshot, self.command)
            self.command = self.hold.correct(self.snapshot, 1, powered=powered)
            self.left += self.hold.left
            self.creeps += self.hold.creeps
            self.speed += (self.command + self.offset - self.speed) * 1e-3 / lag_s
            self.true_mm += self.speed * 1e-3
            self.said_mm += (self.speed + self.drift) * 1e-3
            self.snapshot.stroke_mm = self.said_mm
            self.snapshot.speed_mm_s = self.speed + self.drift


def test_what_stands_is_latched_at_once_and_gets_no_correction() -> None:
    rig = Rig()
    rig.run(0.002)
    assert rig.hold.reference_mm == 50.0
    rig.run(1.0)
    assert (rig.command, rig.hold.seen.excursion_mm) == (0.0, 0.0)


@pytest.mark.parametrize("speed", [10.0, -10.0, 0.5])
def test_what_moves_is_latched_where_it_comes_to_rest(speed: float) -> None:
    rig = Rig(speed=speed)
    rig.run(2.0)
    assert rig.hold.reference_mm == pytest.approx(rig.true_mm, abs=DEAD_ZONE_MM)
    assert rig.hold.reference_mm == pytest.approx(50.0 + speed * SETTINGS.plant.cylinder_lag_s, abs=DEAD_ZONE_MM)
    assert rig.command == 0.0


def test_a_first_sample_with_an_impossible_speed_puts_the_latch_off_by_no_more_than_a_stop() -> None:
    rig = Rig()
    rig.snapshot.speed_mm_s = 52_000.0
    rig.run(0.001)
    rig.run(0.3)
    assert rig.hold.reference_mm == pytest.approx(50.0)


def test_a_drive_that_does_not_stop_does_not_take_the_latch_along() -> None:
    rig = Rig(offset=8.0, speed=8.0)
    rig.run(0.5)
    assert rig.hold.reference_mm < 50.0 + 8.0 * 0.1
    assert rig.hold.seen.excursion_mm > 2.0


@pytest.mark.parametrize("offset", [0.02, -0.1, 0.45])
def test_an_offset_is_corrected_to_the_dead_zone(offset: float) -> None:
    rig = Rig(offset=offset)
    rig.run(20.0)
    assert abs(rig.true_mm - 50.0) < 2.0 * DEAD_ZONE_MM
    assert rig.hold.creep_mm_s == pytest.approx(offset, abs=0.1 * abs(offset) + 0.01)
    assert rig.creeps == (abs(offset) > CREEP_MM_S)
    assert rig.left == 0
    assert rig.hold.seen.corrected_mm == pytest.approx(-20.0 * offset, rel=0.1, abs=0.05)


def test_the_correction_never_exceeds_its_authority_and_does_not_wind_up() -> None:
    rig = Rig(offset=0.8)
    rig.run(3.0)
    assert rig.command == -AUTHORITY_MM_S
    assert rig.hold.seen.excursion_mm > SHOWN_MM
    rig.offset = 0.0
    rig.run(10.0)
    assert abs(rig.hold.seen.excursion_mm) < 2.0 * DEAD_ZONE_MM
    assert rig.said_mm > rig.hold.reference_mm - 0.1, "no overshoot worth speaking of"


def test_an_excursion_is_told_once() -> None:
    rig = Rig(offset=0.2)
    rig.run(3.0, powered=False)
    assert rig.left == 1
    rig.offset = 0.0
    rig.run(5.0)
    rig.offset = 0.2
    rig.run(3.0, powered=False)
    assert rig.left == 2


@pytest.mark.parametrize("drift", [0.02, 0.1, -0.45])
def test_the_sum_of_the_correction_is_what_a_drifting_position_has_moved_the_load_by(drift: float) -> None:
    rig = Rig(drift=drift)
    rig.run(0.8 / abs(drift))
    assert rig.hold.seen.corrected_mm == pytest.approx(rig.true_mm - 50.0, abs=0.02)
    assert abs(rig.hold.seen.corrected_mm) > 0.6
    rig.hold.follow()
    assert rig.hold.seen.corrected_mm == 0.0


def test_a_position_that_contradicts_its_speed_or_is_old_is_not_followed() -> None:
    rig = Rig(offset=0.3)
    rig.run(1.0)
    assert rig.command < 0.0
    rig.snapshot.drive_heard = False
    rig.run(0.01)
    assert rig.command == 0.0
    rig.snapshot.drive_heard = True
    rig.run(0.01)
    assert rig.command < 0.0
    rig.snapshot.plausibility.contradiction_mm = 0.31
    rig.run(0.01)
    rig.snapshot.plausibility.contradiction_mm = 0.0
    rig.run(0.01)
    assert rig.command == 0.0
    rig.hold.follow()
    rig.run(1.0)
    assert rig.command < 0.0
