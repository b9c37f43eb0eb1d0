"""The sign check as a function of command, stroke and tension alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest

from rigctl.config import rig_file as config
from rigctl.config.plant_section import in_series
from rigctl.control.watch.signs import SignCheck
from rigctl.design.plant_family import family
from rigctl.model.faults import Fault
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
K = SETTINGS.plant.stiffness_n_mm
LOWEST = SETTINGS.cylinder.stroke_min_mm


@dataclass
class Rig:
    """A first-order drive and a spring, the right way round or not."""

    drive_sign: float = 1.0
    cell_factor: float = 1.0
    slack_mm: float = 2.0
    load_n_s: float = 0.0  # change of the tension by itself

    def run(self, check: SignCheck, seconds: float = 3.0, command_mm_s: float = 8.4) -> tuple[Fault, float, float]:
        """Fault, true stroke and true tension at detection, or at the end."""
        stroke = speed = true_n = 0.0
        check.begin(0.0, max(0.0, K * -self.slack_mm) * self.cell_factor)
        for tick in range(round(seconds * 1000)):
            speed += (self.drive_sign * command_mm_s - speed) * 0.05
            stroke += speed * 1e-3
            true_n = max(0.0, K * (stroke - self.slack_mm)) + self.load_n_s * tick * 1e-3
            fault = check.see(command_mm_s, stroke, true_n * self.cell_factor)
            if fault is not Fault.NONE or check.passed:
                return fault, stroke, true_n
        return Fault.NONE, stroke, true_n


@pytest.mark.parametrize("slack_mm", [0.0, 2.0, 20.0, -40.0])
def test_the_right_way_round_passes_with_its_stiffness(slack_mm: float) -> None:
    check = SignCheck(SETTINGS)
    fault, _, _ = Rig(slack_mm=slack_mm).run(check)
    assert fault is Fault.NONE
    assert check.passed
    assert check.slope_n_mm == pytest.approx(K, rel=1e-6)


def test_a_rope_that_is_hardly_tight_shows_no_stiffness_yet() -> None:
    """Up to twice the limit of slack its sag makes it softer."""
    check, soft_n = SignCheck(SETTINGS), 2.0 * SETTINGS.tension.slack_n
    check.begin(0.0, 0.0)
    for tick in range(3000):
        stroke_mm = 10.0e-3 * tick
        sagging_mm = soft_n / (0.1 * K)
        tension_n = min(0.1 * K * stroke_mm, soft_n) + K * max(0.0, stroke_mm - sagging_mm)
        assert check.see(10.0, stroke_mm, tension_n) is Fault.NONE
    assert check.passed
    assert check.slope_n_mm == pytest.approx(K, rel=0.02)


@pytest.mark.parametrize("slack_mm", [2.0, -40.0])
def test_each_wrong_way_round_is_found_early(slack_mm: float) -> None:
    fault, stroke, _ = Rig(drive_sign=-1.0, slack_mm=slack_mm).run(SignCheck(SETTINGS))
    assert fault is Fault.SIGN_DRIVE
    assert abs(stroke) < 0.3
    start_n = max(0.0, -K * slack_mm)
    fault, _, tension_n = Rig(cell_factor=-1.0, slack_mm=slack_mm).run(SignCheck(SETTINGS))
    assert fault is Fault.SIGN_CELL
    assert tension_n - start_n < SETTINGS.tension.slack_n + 1.0


@pytest.mark.parametrize(
    ("factor", "fault"),
    [
        (0.25, Fault.SIGN_CELL), (2.05 / K, Fault.SIGN_CELL), (0.4, Fault.NONE), (1.3, Fault.NONE),
        (1.45, Fault.SIGN_CELL), (4.0, Fault.SIGN_CELL),
    ],
)  # fmt: skip
@pytest.mark.parametrize("slack_mm", [2.0, -40.0])
def test_the_slope_must_be_one_of_the_assumed_family(factor: float, fault: Fault, slack_mm: float) -> None:
    check = SignCheck(SETTINGS)
    assert Rig(cell_factor=factor, slack_mm=slack_mm).run(check)[0] is fault
    assert check.passed == (fault is Fault.NONE)
    least, most = SETTINGS.plant.found_n_mm
    assert (least, most) == (pytest.approx(2.26, abs=0.01), pytest.approx(8.23, abs=0.01))
    words = f"{factor * K:.2f} N/mm found, {least:.2f} to {most:.2f} N/mm expected"
    assert check.seen.words == ("" if fault is Fault.NONE else words)
    assert len(check.seen.words) <= 80  # an event's text


def test_the_family_of_the_first_tensioning_is_that_of_the_design() -> None:
    slow = [k.k_scale * K if k.k_m is None else in_series(k.k_scale * K, k.k_m) for k in family(SETTINGS)]
    least, most = SETTINGS.plant.found_n_mm
    assert (least, most) == (pytest.approx(0.85 * min(slow)), pytest.approx(1.15 * max(slow)))


def test_a_payload_that_moves_for_a_moment_is_looked_at_again() -> None:
    check = SignCheck(SETTINGS)
    check.begin(0.0, 100.0)
    for tick in range(2000):
        stroke_mm = 8.0e-3 * tick
        moved_n = 0.6 * K * min(stroke_mm, 2.6)  # down, until the first look
        assert check.see(8.0, stroke_mm, 100.0 + K * stroke_mm + moved_n) is Fault.NONE
        if tick == 330:
            assert not check.passed and check.slope_n_mm > SETTINGS.plant.found_n_mm[1]
    assert check.passed


def test_a_drive_that_does_not_move_is_found() -> None:
    assert Rig(drive_sign=0.0).run(SignCheck(SETTINGS))[0] is Fault.SIGN_DRIVE


def test_too_short_a_tensioning_settles_nothing_and_the_next_is_watched_again() -> None:
    check = SignCheck(SETTINGS)
    assert Rig().run(check, seconds=0.2)[0] is Fault.NONE
    assert not check.passed
    assert math.isnan(check.slope_n_mm)
    assert Rig(drive_sign=-1.0).run(check)[0] is Fault.SIGN_DRIVE


def test_a_load_that_goes_off_the_rope_is_not_called_a_sign() -> None:
    check = SignCheck(SETTINGS)
    assert Rig(slack_mm=-40.0, load_n_s=-2000.0).run(check, seconds=0.03)[0] is Fault.NONE


@pytest.mark.parametrize(
    ("stroke_mm", "tension_n", "way"),
    [(50.0, 300.0, -1.0), (LOWEST + 1.0, 300.0, 1.0), (50.0, 20.0, 1.0), (50.0, 50.0, -1.0)],
)
def test_a_rope_on_target_is_felt_downwards_where_there_is_room(stroke_mm: float, tension_n: float, way: float) -> None:
    check = SignCheck(SETTINGS)
    assert check.probe_mm_s == 0.0
    check.feel(stroke_mm, tension_n)
    assert math.copysign(1.0, check.probe_mm_s) == way
    assert abs(check.probe_mm_s) < SETTINGS.tension.speed_max_mm_s
    for _ in range(1000):
        stroke_mm += check.probe_mm_s * 1e-3
        tension_n += K * check.probe_mm_s * 1e-3
        assert check.see(check.probe_mm_s, stroke_mm, tension_n) is Fault.NONE
    assert check.passed
    assert check.probe_mm_s == 0.0


def test_a_tensioning_that_begins_anew_does_not_go_on_feeling() -> None:
    check = SignCheck(SETTINGS)
    check.feel(50.0, 300.0)
    check.begin(50.0, 300.0)
    assert check.probe_mm_s == 0.0
