"""The steps from a stop to the next power-on: standstill, the drive off, the brake closed, and the brake test."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hil.faults.in_controller import trip
from hil.lockstep import Lockstep, lockstep
from hil.nodes.power_stage import StagePhase
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power import arming, power_seen
from rigctl.devices.objects import OFF_STATES, Controlword
from rigctl.model.checks import Check
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

Enter = Callable[[Mode], None]
MS = 1_000_000
TICK_S = 0.001


def quick_stopped_at_speed(rig: Lockstep, enter: Enter) -> None:
    enter(Mode.COMPENSATING)
    assert rig.command(Verb.TARGET, 250.0) is Refusal.NONE
    rig.run(0.5)
    trip(rig, Action.QUICK_STOP)


def watched(rig: Lockstep, seconds: float) -> Iterator[tuple[StagePhase, int, bool]]:
    """StagePhase of the motor, controlword and whether the stroke moves, tick by tick."""
    for _ in range(round(seconds / TICK_S)):
        rig.loop.tick()
        moving = abs(rig.rig.truth.speed_mm_s) > power_seen.STILL_MM_S
        yield rig.rig.drive.control.stage.phase, rig.record["controlword"], moving


@pytest.mark.gate("60")
@pytest.mark.parametrize("ticks", [1, 10, 30, 60, 120, 180])
def test_reset_and_arm_during_a_quick_stop_cut_nothing_short(rig: Lockstep, enter: Enter, ticks: int) -> None:
    quick_stopped_at_speed(rig, enter)
    for _ in range(ticks):
        rig.loop.tick()
    rig.give(Verb.RESET)
    rig.give(Verb.ARM)
    phases = []
    for phase, word, moving in watched(rig, 0.6):
        assert not (moving and word == Controlword.DISABLE_VOLTAGE), "no power off for a drive that obeys"
        phases.append(phase)
    assert StagePhase.FALLING not in phases
    closing = phases.index(StagePhase.CLOSING) if StagePhase.CLOSING in phases else 0
    assert StagePhase.OPENING not in phases[closing : closing + 50], "the brake closes before it opens again"
    assert rig.loop.machine.mode is Mode.FAULT


def test_reset_is_refused_until_the_stop_has_ended_and_says_so(rig: Lockstep, enter: Enter) -> None:
    quick_stopped_at_speed(rig, enter)
    rig.loop.tick()
    assert rig.command(Verb.RESET) is Refusal.STOP_RUNNING
    assert abs(rig.reply["speed_mm_s"]) > 1.0
    until_ns = rig.clock.now() + 1_000 * MS
    while rig.command(Verb.RESET) is not Refusal.NONE:
        assert rig.clock.now() < until_ns
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED
    assert rig.view.off_ns >= rig.settings.cylinder.brake_delay_ms * MS
    assert rig.loop.machine.mode is Mode.DISARMED, "a quick stop takes the power off: a whole arming follows"
    assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_reset_cannot_take_back_the_power_off_of_a_drive_that_does_not_stop(rig: Lockstep) -> None:
    drive = rig.rig.drive
    drive.defect = lambda speed, closed: (-10.0 if drive.control.stage.powered else speed, closed)
    while rig.loop.machine.fault is Fault.NONE:
        rig.loop.tick()
    assert rig.view.action is Action.POWER_OFF
    assert rig.command(Verb.RESET) is Refusal.STOP_RUNNING
    rig.run(0.2)
    assert drive.control.stage.phase is StagePhase.BRAKED


@pytest.mark.starts_in(Mode.HOLD)
def test_arm_right_after_disarm_waits_for_the_brake_to_close(rig: Lockstep) -> None:
    assert rig.command(Verb.DISARM) is Refusal.NONE
    id_ = rig.give(Verb.ARM)
    phases = [phase for phase, _, _ in watched(rig, 0.6)]
    assert phases.index(StagePhase.BRAKED) < phases.index(StagePhase.OPENING), "closed before it opens again"
    assert [reply["reason"] for reply in rig._replies.read() if reply["id"] == id_] == [Refusal.NONE]
    assert rig.loop.machine.mode is Mode.HOLD


def test_a_drive_that_is_moved_by_something_else_is_not_switched_on(rig: Lockstep) -> None:
    rig.rig.drive.defect = lambda _speed, _closed: (0.15, False)  # below the trip limit of a slipping brake
    rig.run(0.4)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check(int(rig.reply["checks"])) == Check.NOT_AT_STANDSTILL
    assert rig.rig.drive.control.state in OFF_STATES
    rig.rig.drive.defect = None
    assert rig.command(Verb.ARM) is Refusal.NONE, "it waits until the stroke has stood still"


def test_an_arm_that_waits_is_refused_by_what_fails_meanwhile_and_ended_by_disarm(rig: Lockstep) -> None:
    rig.rig.drive.defect = lambda _speed, _closed: (0.15, False)
    rig.run(0.4)
    first = rig.give(Verb.ARM)
    rig.run(0.1)
    while rig.loop.readback.reading_all:  # the devices' settings are read first
        rig.loop.tick()
    assert rig.view.pending is Verb.ARM
    assert not any(rig.rig.drive.control.enabled for _ in watched(rig, 0.1))
    rig.rig.drive.press_e_stop(True)
    rig.run(0.1)
    assert rig.view.pending is not Verb.ARM
    (reply,) = [reply for reply in rig._replies.read() if reply["id"] == first]
    assert Check.E_STOP in Check(int(reply["checks"]))
    assert Check.NOT_AT_STANDSTILL not in Check(int(reply["checks"])), "what passes by itself is named alone only"


def test_one_toggling_count_of_a_coarse_encoder_is_standstill(settings: RigSettings) -> None:
    still = power_seen.Standstill(settings)
    count_mm, period_s = 0.005, 1.0 / settings.loop.rate_hz
    for i in range(400):
        stroke = 50.0 + count_mm * (i // 7 % 2)
        speed = count_mm / period_s / 7.0 * (1 if i % 14 == 7 else -1 if i % 14 == 0 else 0) * 0.2
        found = still.look(i * MS, stroke, speed, True)
    assert found >= power_seen.STILL_NS


@pytest.mark.gate("0.12")
@pytest.mark.parametrize("speed_mm_s", [0.12, -0.12, 8.0])
def test_a_stroke_that_creeps_is_not_at_standstill(settings: RigSettings, speed_mm_s: float) -> None:
    still = power_seen.Standstill(settings)
    found = [still.look(i * MS, 50.0 + speed_mm_s * i * 1e-3, 0.0, True) for i in range(1000)]  # its own speed is 0
    assert max(found) < power_seen.STILL_NS


@pytest.mark.parametrize(("stroke", "heard"), [(float("nan"), True), (50.0, False)])
def test_what_is_not_seen_does_not_stand_still(settings: RigSettings, stroke: float, heard: bool) -> None:
    still = power_seen.Standstill(settings)
    assert max(still.look(i * MS, stroke, 0.0, heard) for i in range(500)) < power_seen.STILL_NS


# -- brake test -------------------------------------------------------------------------------------------------


@pytest.fixture
def loaded(settings: RigSettings, gains: Gains) -> Iterator[Lockstep]:
    """A rig DISARMED, 300 N on the brake, with a brake test."""
    tested = settings.model_copy(update={"cylinder": settings.cylinder.model_copy(update={"brake_test": True})})
    with lockstep(tested, gains) as subject:
        subject.rig.plant.preload(300.0)
        subject.run(0.6)
        yield subject


def slips(rig: Lockstep, speed_mm_s: float) -> None:
    rig.rig.plant.parameters["dead_band"] = 0.0  # of the motor; the brake slips here
    rig.rig.drive.defect = lambda speed, braked: (-speed_mm_s, False) if braked else (speed, False)


def told(rig: Lockstep, kind: Kind) -> list[str]:
    names = ("kind", "a", "b", "value", "limit", "text")
    found = [[slot[name].item() for name in names] for slot in rig.events.read()]
    return [worded(k, a, b, value, limit, text.decode()).text for k, a, b, value, limit, text in found if k == kind]


def test_the_brake_is_tested_under_the_load_for_two_seconds_before_the_drive_has_power(loaded: Lockstep) -> None:
    began_ns = loaded.clock.now()
    assert loaded.command(Verb.ARM, limit_s=4.0) is Refusal.NONE
    assert loaded.clock.now() - began_ns >= arming.BRAKE_TEST_NS
    (line,) = told(loaded, Kind.BRAKE_TEST)
    assert line.startswith("brake test: held 300.")
    assert "0.000 mm" in line


def test_a_brake_that_gives_way_slowly_is_found_latched_and_said(loaded: Lockstep) -> None:
    began_ns = loaded.clock.now()

    def in_the_test() -> None:  # too slow for the standstill check, and before the limit of a sinking load
        if loaded.clock.now() - began_ns > 1_000 * MS:
            slips(loaded, 0.04)

    loaded.on_advance = in_the_test
    assert loaded.command(Verb.ARM, limit_s=4.0) is Refusal.BRAKE_SLIPPED
    assert abs(loaded.reply["moved_mm"]) == pytest.approx(arming.BRAKE_TEST_MM, abs=0.01)
    assert not loaded.rig.drive.control.enabled
    assert (loaded.loop.machine.mode, loaded.loop.machine.fault) == (Mode.FAULT, Fault.BRAKE_SLIPS)
    (line,) = told(loaded, Kind.TRIP)
    assert "moved by -0.05 mm on the closed brake (limit 0.05 mm)" in line


def test_a_load_that_sinks_already_bars_arming_and_the_motor_may_carry_it(loaded: Lockstep) -> None:
    slips(loaded, 0.04)
    assert loaded.command(Verb.ARM, limit_s=4.0) is not Refusal.NONE
    assert loaded.loop.machine.fault is Fault.STROKE_MOVES
    assert loaded.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert loaded.command(Verb.CARRY, 10.0) is Refusal.NONE
    assert 9.0 < float(loaded.reply["carried_s"]) <= 10.0, "less the time in which the motor took the load"
    before = loaded.rig.truth.stroke_mm
    loaded.run(0.5)
    assert loaded.rig.truth.stroke_mm == pytest.approx(before, abs=0.01)


def test_a_slack_rope_leaves_nothing_to_test_with(settings: RigSettings, gains: Gains) -> None:
    tested = settings.model_copy(update={"cylinder": settings.cylinder.model_copy(update={"brake_test": True})})
    with lockstep(tested, gains) as rig:
        rig.run(0.3)
        assert rig.command(Verb.ARM, limit_s=1.0) is Refusal.NONE
        assert told(rig, Kind.BRAKE_TEST) == ["brake test not possible: the rope is slack"]


@pytest.mark.parametrize("rig", [Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING], indirect=["rig"])
def test_the_daemon_ends_after_the_brake_has_had_its_time_and_may_release_the_drive(rig: Lockstep) -> None:
    """Else the drive would miss the commands after the end, and the next start would find it in a fault."""
    rig.loop.stop_requested = True
    while not rig.loop.finished:
        rig.loop.tick()
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED
    assert rig.loop.drive_off


def test_both_checks_are_said_in_words() -> None:
    for check in (Check.NOT_AT_STANDSTILL, Check.SEQUENCE_RUNNING):
        assert "wait" in check.words
