"""The tension latched with a held stroke, tick by tick on synthetic signals, over minutes and hours."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.load.held_tension import (
    FALLEN_NS,
    GROWS_MM,
    GROWS_NS,
    LASTS_S,
    SINKS_MM_S,
    SINKS_NS,
    STRETCH_NS,
    UNLOADED_MM_S,
    HeldTension,
    cell_n,
    fall_limit_n,
    in_words,
    smallest_creep_mm_s,
    stretch_limit_mm,
)
from rigctl.control.snapshot import Snapshot
from tests.builders import snapshots
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
K = SETTINGS.plant.stiffness_n_mm
TICKS = 10  # at once: what is watched is slow
S = 1e-9
Signal = Callable[[float], float]


def of_spring(n_mm: float) -> RigSettings:
    return changed(SETTINGS, {"plant.spring_n_mm": n_mm, "safety.waiver": "a study of a stiff spring, no load on it"})


class Held:
    """Feeds tension and stroke, and trips as the safety table does: beyond its limit for its persistence."""

    def __init__(self, settings: RigSettings = SETTINGS, *, motor: bool) -> None:
        self.subject, self.settings = HeldTension(settings), settings
        self.snapshot = Snapshot(drive_enabled=motor, drive_off=not motor, cell_heard=True)
        fall_n = fall_limit_n(settings)
        self.rows = {
            "stretched_mm": (stretch_limit_mm(settings), STRETCH_NS),
            "growing_mm": (stretch_limit_mm(settings, GROWS_MM), GROWS_NS),
            "sinks_n": (fall_n, SINKS_NS),
            "fallen_n": (fall_n, FALLEN_NS),
        }
        self.beyond_s, self.trips, self.largest = dict.fromkeys(self.rows, 0.0), set[str](), 0.0

    def run(self, seconds: float, tension: Signal, stroke: Signal = lambda _: 50.0) -> Held:
        dt = TICKS / self.settings.loop.rate_hz
        for n in range(round(seconds / dt)):
            self.snapshot.tension_n, self.snapshot.stroke_mm = tension(n * dt), stroke(n * dt)
            self.subject.watch(self.snapshot, TICKS, latched=True)
            for name, (limit, persistence_ns) in self.rows.items():
                value = abs(getattr(self.subject.seen, name))
                self.largest = max(self.largest, value)
                self.beyond_s[name] = self.beyond_s[name] + dt if value > limit else 0.0
                if self.beyond_s[name] > persistence_ns * S:
                    self.trips.add(name)
        return self


# -- the motor holds ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("spring", [6.0, 35.2])
@pytest.mark.parametrize("load_n", [50.0, 350.0])
@pytest.mark.parametrize("speed", [0.025, -0.05, 0.5, -5.0])
def test_stretch_that_the_stroke_does_not_show_is_seen_within_the_promise(
    speed: float, load_n: float, spring: float
) -> None:
    """At any speed, however slow; what a fast one moves in the 15 ms to the trip is left out."""
    settings = of_spring(spring)
    k = settings.plant.stiffness_n_mm
    held = Held(settings, motor=True).run(1.0, lambda _t: load_n)
    allowed_mm = max(0.9, 0.9 * 0.03 * load_n / k) + 0.03 * abs(speed)
    held.run(allowed_mm / abs(speed), lambda t: load_n + k * speed * t)
    assert held.trips


@pytest.mark.parametrize("speed", [0.025, -0.3])
def test_stroke_that_the_tension_does_not_show_adds_up_and_both_together_agree(speed: float) -> None:
    drifts = Held(motor=True).run(1.0 / abs(speed), lambda _t: 300.0, lambda t: 50.0 + speed * t)
    assert "growing_mm" in drifts.trips
    agrees = Held(motor=True).run(100.0, lambda t: 300.0 + K * 0.01 * t, lambda t: 50.0 + 0.01 * t)
    assert agrees.largest < 1e-9


def test_the_stiffness_found_by_the_sign_check_counts() -> None:
    held = Held(motor=True)
    held.subject.found_stiffness(2.0 * K)
    assert held.run(100.0, lambda t: 300.0 + 2.0 * K * 0.02 * t, lambda t: 50.0 + 0.02 * t).largest < 1e-9


def test_a_bump_is_ridden_through_and_one_beyond_the_promise_is_not() -> None:
    def bump(mm: float) -> Signal:
        return lambda t: 300.0 + K * mm * min(1.0, max(0.0, (t - 1.0) / 0.1))

    for mm in (1.0, -1.0):
        assert not Held(motor=True).run(10.0, bump(mm)).trips
    for mm in (1.45, -1.45):
        assert Held(motor=True).run(10.0, bump(mm)).trips == {"stretched_mm"}


def test_a_flexible_mechanism_gives_way_with_the_stroke_and_its_bounce_after_a_stop_is_no_disagreement() -> None:
    soft = changed(SETTINGS, {"plant.mechanism_n_mm": 6.0})
    share = soft.plant.slow_stiffness_n_mm
    follows = Held(soft, motor=True).run(60.0, lambda t: 300.0 + share * 0.03 * t, lambda t: 50.0 + 0.03 * t)
    assert not follows.trips
    omega = math.sqrt(1e3 * (6.0 + K) / soft.plant.payload_kg)
    amplitude_mm = soft.tension.speed_max_mm_s / omega
    assert not Held(soft, motor=True).run(5.0, lambda t: 300.0 + K * amplitude_mm * math.cos(omega * t)).trips


@pytest.mark.parametrize("lost", [{"cell_heard": False}, {"cell_quality": 1}, {"plausibility.cell_repeats": 100}])
@pytest.mark.parametrize("motor", [True, False])
def test_an_unknown_cell_says_nothing_and_is_compared_with_the_latch_once_it_is_back(
    lost: dict[str, int], motor: bool
) -> None:
    held = Held(motor=motor).run(2.0, lambda _t: 300.0)
    known = held.snapshot
    held.snapshot = snapshots.changed(known, lost)
    held.run(5.0, lambda _t: 0.0)
    assert held.largest == 0.0
    held.snapshot = known
    assert held.run(20.0, lambda _t: 290.0).trips


def test_a_slack_rope_is_latched_once_it_is_tight() -> None:
    held = Held(motor=True).run(10.0, lambda t: min(4.0, 0.4 * t), lambda t: 50.0 + t)
    assert held.largest == 0.0
    assert held.run(1.0, lambda t: 4.0 + 20.0 * t, lambda _t: 60.0).trips, "tension without stroke: it lifts the load"


# -- on the brake -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("spring", [6.0, 35.2])
@pytest.mark.parametrize("speed", [0.02, 0.05, 0.5, 3.0])
def test_a_load_that_sinks_is_seen_within_the_promise(speed: float, spring: float) -> None:
    settings = of_spring(spring)
    k = settings.plant.stiffness_n_mm
    held = Held(settings, motor=False).run(5.0, lambda _t: 300.0)
    allowed_mm = max(1.0, 0.03 * 300.0 / k, 2.2 * speed)  # what goes on does so for 2 s
    assert held.run(allowed_mm / speed, lambda t: 300.0 - k * speed * t).trips


@pytest.mark.parametrize(
    ("speed", "sinks"),
    [(0.9 * SINKS_MM_S, False), (1.1 * SINKS_MM_S, True), (0.9 * UNLOADED_MM_S, True), (1.1 * UNLOADED_MM_S, False)],
)
def test_between_two_speeds_a_fall_is_that_of_a_load_that_sinks(speed: float, sinks: bool) -> None:
    held = Held(motor=False).run(5.0, lambda _t: 300.0)
    held.run(2.0, lambda t: 300.0 - K * speed * t)
    assert (held.subject.seen.sinks_n > 0.0) == sinks


def test_what_slips_in_jerks_is_seen_too() -> None:
    held = Held(motor=False).run(5.0, lambda _t: 300.0)
    held.run(80.0, lambda t: 300.0 - 0.1 * K * math.floor(t / 3.0))
    assert held.trips == {"fallen_n", "sinks_n"}


def test_the_reference_of_the_motor_goes_on_as_that_of_the_brake() -> None:
    held = Held(motor=True).run(1.0, lambda _t: 300.0)
    held.snapshot.drive_enabled = False
    assert held.run(12.0, lambda _t: 290.0).trips
    held.subject.follow()
    assert held.run(20.0, lambda _t: 290.0).subject.seen.fallen_n == 0.0, "acknowledged"


def test_a_load_that_was_added_is_the_reference_once_it_has_lasted() -> None:
    held = Held(motor=False).run(5.0, lambda _t: 100.0)
    assert not held.run(2.0 * LASTS_S, lambda _t: 300.0).trips
    assert held.run(5.0, lambda t: 300.0 - 3.0 * t).trips


@pytest.mark.parametrize(
    ("what", "seconds", "tension"),
    [
        ("a load lifted off", 30.0, lambda t: max(0.0, 300.0 - 150.0 * t)),
        ("a bump", 60.0, lambda t: 300.0 - (6.0 if t > 5.0 else 0.0)),
        ("a hand that pushes slowly", 60.0, lambda t: 300.0 - 20.0 * min(1.0, max(0.0, 2.0 * (t - 5.0))) * (t < 9.0)),
        ("a load hung on", 30.0, lambda t: min(300.0, 150.0 * t)),
        ("a hand for 3 s", 60.0, lambda t: 300.0 - (20.0 if 5.0 < t < 8.0 else 0.0)),
        ("a hand that pulls for 3 s", 60.0, lambda t: 300.0 + (40.0 if 5.0 < t < 8.0 else 0.0)),
        ("a payload that bounces", 60.0, lambda t: 300.0 + 20.0 * math.sin(2.0 * math.pi * 2.2 * t)),
        ("a payload that swings", 60.0, lambda t: 300.0 + 2.0 * math.sin(2.0 * math.pi * 0.4 * t)),
        ("a slack rope", 30.0, lambda t: 2.0 * math.sin(t)),
    ],
)  # fmt: skip
def test_what_is_done_to_a_rig_at_rest_is_no_fault(what: str, seconds: float, tension: Signal) -> None:
    assert not Held(motor=False).run(seconds, tension).trips, what


@pytest.mark.parametrize("motor", [True, False])
def test_a_rope_that_carried_and_is_slack_has_lost_its_load_however_fast(motor: bool) -> None:
    held = Held(motor=motor).run(10.0, lambda _t: 2.0)
    assert not held.subject.lost, "it has not carried one"
    assert not held.run(5.0, lambda _t: 300.0).subject.lost
    assert held.run(0.01, lambda _t: 0.0).run(60.0, lambda _t: 0.0).subject.lost
    held.subject.follow()
    assert not held.run(5.0, lambda _t: 0.0).subject.lost, "acknowledged"
    assert not held.run(5.0, lambda _t: 300.0).subject.lost
    held.run(1.0, lambda _t: 0.0)
    assert not held.run(0.2, lambda _t: 300.0).subject.lost, "the load is back"


@pytest.mark.parametrize("spring", [1.0, 6.0, 35.2])
def test_a_cell_of_class_c3_may_drift_and_creep_for_a_shift(spring: float) -> None:
    """As the paper rig's simulated cell does, at its largest load; ten minutes here pass as a day."""
    settings = of_spring(spring)
    drift_n_h, creep_n = 0.01, 2.45e-4 * 350.0
    held = Held(settings, motor=False).run(
        600.0, lambda t: 350.0 - drift_n_h * t * 144.0 / 3600.0 - creep_n * (1.0 - math.exp(-t / 4.0))
    )
    assert not any(held.beyond_s.values())
    assert not held.trips
    assert cell_n(settings) >= drift_n_h * 24.0 + creep_n


def test_the_limits_follow_the_stiffness_and_the_cell_and_are_printed() -> None:
    assert (stretch_limit_mm(SETTINGS), fall_limit_n(SETTINGS)) == (0.8, pytest.approx(0.2 * K))
    stiff = of_spring(35.2)
    assert stretch_limit_mm(stiff) == 0.8
    assert fall_limit_n(stiff) == pytest.approx(0.2 * stiff.plant.stiffness_n_mm)
    rope_alone = changed(SETTINGS, {"plant.spring_n_mm": None, "safety.waiver": "a study without a spring, no load"})
    assert stretch_limit_mm(rope_alone) == 0.1
    coarse = changed(SETTINGS, {"tension_cell.noise_n": 0.5})
    assert fall_limit_n(coarse) == cell_n(coarse) > 5.0
    words = in_words(SETTINGS)
    assert "disagree by 0.5 mm (2.98 N) if that grows, else by 0.8 mm (4.77 N) or 2.6% of the load" in words
    assert "fall by 1.19 N (0.2 mm) if it goes on, else by 2.6% of the load for 10 s" in words


@pytest.mark.parametrize("park_s", [0.5, 2.0, 30.0])
@pytest.mark.parametrize("spring_n_mm", [6.0, 35.2])
def test_the_smallest_creep_that_is_printed_is_seen_before_the_parking_and_a_slower_one_is_not(
    park_s: float, spring_n_mm: float
) -> None:
    """A stuck encoder: the tension alone moves."""
    settings = changed(of_spring(spring_n_mm), {"hold.park_s": park_s})
    creep_mm_s, k = smallest_creep_mm_s(settings), settings.plant.stiffness_n_mm
    assert f"{creep_mm_s:.2g} mm/s" in in_words(settings)
    for share, seen in ((1.15, True), (0.85, False)):
        speed_n_s = k * share * creep_mm_s
        held = Held(settings, motor=True).run(park_s, functools.partial(_falling, speed_n_s))
        assert bool(held.trips) is seen


def _falling(speed_n_s: float, t_s: float) -> float:
    return 300.0 - speed_n_s * t_s
