"""The latch and the position loop of a held stroke, against a drive with a lag and an offset."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.snapshot import Snapshot
from rigctl.control.stroke_hold import AUTHORITY_MM_S, CREEP_MM_S, DEAD_ZONE_MM, SAID_MM, StrokeHold
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
MS = 1_000_000
K_N_MM = SETTINGS.plant.stiffness_n_mm


class Rig:
    """A drive with its lag, an offset, and an encoder whose position drifts; the load hangs on the spring."""

    def __init__(
        self, *, offset: float = 0.0, drift: float = 0.0, speed: float = 0.0, tension_n: float = 300.0
    ) -> None:
        self.hold = StrokeHold(SETTINGS)
        self.snapshot = Snapshot(
            stroke_mm=50.0, speed_mm_s=speed, tension_n=tension_n, drive_age_ns=MS, drive_enabled=True
        )
        self.offset, self.drift, self.speed = offset, drift, speed
        self.true_mm, self.said_mm, self.command, self.t_ns = 50.0, 50.0, 0.0, 0
        self.tension_n = tension_n
        self.left = self.creeps = 0

    def run(self, seconds: float, *, honest_speed: bool = True, powered: bool = True) -> None:
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
            self.snapshot.speed_mm_s = self.speed + (0.0 if honest_speed else self.drift)
            self.snapshot.tension_n = self.tension_n + (self.true_mm - 50.0) * K_N_MM


def test_what_stands_is_latched_at_once_and_gets_no_correction() -> None:
    rig = Rig()
    rig.run(0.002)
    assert rig.hold.reference_mm == 50.0
    rig.run(1.0)
    assert (rig.command, rig.hold.error_mm) == (0.0, 0.0)


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
    assert rig.hold.error_mm > 2.0


@pytest.mark.parametrize("offset", [0.02, -0.1, 0.45])
def test_an_offset_is_corrected_to_the_dead_zone(offset: float) -> None:
    rig = Rig(offset=offset)
    rig.run(20.0)
    assert abs(rig.true_mm - 50.0) < 2.0 * DEAD_ZONE_MM
    assert rig.hold.creep_mm_s == pytest.approx(offset, abs=0.1 * abs(offset) + 0.01)
    assert rig.creeps == (abs(offset) > CREEP_MM_S)
    assert (rig.left, rig.hold.doubt_mm) == (0, 0.0)


def test_the_correction_never_exceeds_its_authority_and_does_not_wind_up() -> None:
    rig = Rig(offset=0.8)
    rig.run(3.0)
    assert rig.command == -AUTHORITY_MM_S
    assert rig.hold.error_mm > SAID_MM
    rig.offset = 0.0
    rig.run(10.0)
    assert abs(rig.hold.error_mm) < 2.0 * DEAD_ZONE_MM
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
@pytest.mark.parametrize("honest_speed", [True, False])
def test_a_position_that_drifts_is_found_out_by_load_or_speed(drift: float, honest_speed: bool) -> None:
    rig = Rig(drift=drift)
    rig.run(0.8 / abs(drift), honest_speed=honest_speed)
    assert abs(rig.hold.doubt_mm) > 0.5
    assert abs(rig.true_mm - 50.0) < 0.75
    moved = rig.true_mm
    rig.run(1.0, honest_speed=honest_speed)
    assert rig.true_mm == pytest.approx(moved, abs=0.02), "no more is corrected after it"


def test_without_load_a_drift_of_both_cannot_be_told_from_a_creep() -> None:
    rig = Rig(drift=0.2, tension_n=-50.0)
    rig.run(6.0, honest_speed=False)
    assert rig.hold.doubt_mm == 0.0


def test_a_position_that_contradicts_its_speed_or_is_old_is_not_followed() -> None:
    rig = Rig(offset=0.3)
    rig.run(1.0)
    assert rig.command < 0.0
    rig.snapshot.drive_age_ns = 100 * MS
    rig.run(0.01)
    assert rig.command == 0.0
    rig.snapshot.drive_age_ns = MS
    rig.run(0.01)
    assert rig.command < 0.0
    rig.snapshot.contradiction_mm = 0.31
    rig.run(0.01)
    rig.snapshot.contradiction_mm = 0.0
    rig.run(0.01)
    assert rig.command == 0.0
    rig.hold.follow()
    rig.run(1.0)
    assert rig.command < 0.0
