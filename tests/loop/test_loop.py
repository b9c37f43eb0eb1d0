"""The loop's behaviour, seen through its frames, its records and the plant's truth."""

from __future__ import annotations

import math
from collections.abc import Callable

import can
import numpy as np
import pytest

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.devices import objects as od
from rigctl.metrics import tension_error as metrics
from rigctl.model.checks import Check
from rigctl.model.device_states import DriveState
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Setting, Verb
from tests.builders.loop_changes import LoopStep, failing, leave_unexplained
from tests.builders.loop_frames import assert_held, events, stop_node

Enter = Callable[[Mode], None]


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_it_tensions_holds_releases_and_ends_slack(rig: Lockstep) -> None:
    rig.run(2.0)
    truth = [rig.rig.truth.vertical_n for _ in rig.run(1.0)]
    assert max(metrics.largest_and_rms_pct(np.array(truth), 300.0)) < 0.05
    assert rig.command(Verb.RELEASE) is Refusal.NONE
    rig.run_until(Mode.HOLD, 10.0)
    assert rig.rig.truth.tension_n == 0.0
    assert rig.command(Verb.DISARM) is Refusal.NONE
    rig.run(0.3)
    records = rig.run(0.1)
    assert od.drive_state(int(records["statusword"][-1])) is not DriveState.OPERATION_ENABLED


def test_a_slack_rope_shows_no_run_out_no_stretch_and_good_samples(rig: Lockstep) -> None:
    records = rig.run(0.2)
    assert not records["run_out_mm_s"].any()
    assert np.abs(records["stretch_mm_s"]).max() < 1e-9
    assert not records["tension_quality"].any()
    assert not records["inclination_quality"].any()
    assert rig.view.lateness_ns == records["lateness_ns"][-1] == 0
    assert rig.run(0.5)["checks"][-1] == 0  # the preflight for display is half a second old at most


def test_a_loop_that_no_gateway_has_told_its_checks_arms_nothing(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains, host_checks=Check.HOST) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.command(Setting.HOST_CHECKS, 0.0) is Refusal.NONE
        assert not int(rig.reply["checks"])
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert not int(rig.reply["checks"])


@pytest.mark.starts_in(Mode.TENSIONING)
def test_tensioning_never_overshoots_by_more_than_a_newton(rig: Lockstep) -> None:
    records = rig.run(6.0)
    assert records["mode"][-1] == Mode.COMPENSATING
    assert records["tension_n"].max() < 301.0
    ramp = np.diff(records["tension_n"][:2000:100]) / 0.1
    assert np.abs(ramp).max() < 1.5 * rig.settings.tension.ramp_n_s


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_new_target_is_reached_on_the_ramp(rig: Lockstep) -> None:
    assert rig.command(Verb.TARGET, 280.0) is Refusal.NONE
    rig.run(2.0)
    assert rig.rig.truth.vertical_n == pytest.approx(280.0, abs=0.2)
    assert rig.command(Verb.TARGET, 351.0) is Refusal.OUT_OF_RANGE
    rig.run(0.5)
    assert rig.rig.truth.vertical_n == pytest.approx(280.0, abs=0.2)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_gains_change_in_the_closed_loop_without_a_bump(rig: Lockstep, gains: Gains) -> None:
    assert rig.command(Verb.TARGET, 290.0) is Refusal.NONE
    before = rig.run(0.5)  # in the middle of the ramp, where the errors are largest
    rig.events.read()
    softer = Gains(0.5 * gains.k_tension, 0.7 * gains.k_speed, 0.5 * gains.k_integral)
    assert rig.command(Setting.LAW_GAINS, *softer.in_order) is Refusal.NONE
    after = rig.run(0.5)
    assert rig.loop.law._gains == softer
    assert events(rig).count(Kind.GAINS) == 1
    steps = [np.abs(np.diff(records["command_mm_s"])).max() for records in (before[-200:], after[:200])]
    assert steps[1] < 2.0 * steps[0]
    rig.run(3.0)
    assert rig.rig.truth.vertical_n == pytest.approx(290.0, abs=0.2)


@pytest.mark.parametrize("values", [(math.nan, 0.5, 1.0), (1.0, -0.1, 1.0), (1.0, 0.5, math.inf)])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_gains_that_are_none_are_refused_and_change_nothing(
    rig: Lockstep, gains: Gains, values: tuple[float, float, float]
) -> None:
    assert rig.command(Setting.LAW_GAINS, *values) is Refusal.OUT_OF_RANGE
    assert rig.loop.law._gains == gains


def test_a_part_of_the_gains_changes_nothing(rig: Lockstep, gains: Gains) -> None:
    assert rig.command(Setting.LAW_GAINS, 1.0, 0.5) is Refusal.OUT_OF_RANGE
    assert rig.loop.law._gains == gains


def test_a_rope_that_is_loaded_while_the_drive_is_off_is_believed_at_once(rig: Lockstep, gains: Gains) -> None:
    with lockstep(rig.settings, gains) as loaded:
        loaded.rig.plant.preload(300.0)
        loaded.run(0.1)
        arm_and_tension(loaded, limit_s=5.0)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_mode_changes_are_bumpless(rig: Lockstep) -> None:
    rig.run(2.0)
    for verb in (Verb.HOLD, Verb.TENSION):
        assert rig.command(verb) is Refusal.NONE
        records = rig.run(1.0)
        assert np.abs(records["tension_n"] - 300.0).max() < 0.6
        steps = np.abs(np.diff(records["command_mm_s"]))
        assert steps.max() <= rig.settings.tension.acceleration_max_mm_s2 * 1e-3 * (1 + 1e-9)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_the_error_stays_within_the_demo_limits_while_the_mechanism_moves(rig: Lockstep) -> None:
    rig.run(2.0)
    assert rig.rig.start_motion()
    truth = []
    for _ in range(100):
        rig.run(0.1)
        truth.append(rig.rig.truth.vertical_n)
    assert rig.rig.truth.tangential_rad > math.radians(0.45)
    demo = rig.settings.demo
    assert demo is not None
    peak, rms = metrics.largest_and_rms_pct(np.array(truth), 300.0)
    assert peak <= demo.eta_max_pct
    assert rms <= demo.eta_rms_pct


def test_two_runs_give_byte_identical_frames(settings: RigSettings, gains: Gains) -> None:
    def play() -> list[tuple[int, bytes]]:
        with lockstep(settings, gains, log=True) as rig:
            rig.run(0.2)
            rig.command(Verb.ARM)
            rig.command(Verb.TENSION)
            rig.rig.start_motion()
            rig.run(2.0)
            rig.command(Verb.HOLD)
            rig.run(0.2)
            return list(rig.frames)

    first, second = play(), play()
    assert len(first) > 9000
    assert first == second


@pytest.mark.starts_in(Mode.TENSIONING)
def test_disarming_stops_the_stroke_before_the_power_goes(rig: Lockstep) -> None:
    rig.command(Verb.HOLD)
    assert rig.rig.truth.speed_mm_s > 1.0
    assert rig.command(Verb.DISARM) is Refusal.NONE
    records = rig.run(0.5)
    off = records["controlword"] != od.Controlword.ENABLE_OPERATION
    assert off[-1]
    assert abs(float(records["speed_mm_s"][np.argmax(off)])) < 0.1


@pytest.mark.parametrize(
    "step",
    [LoopStep.RECEIVE, LoopStep.ESTIMATE, LoopStep.DECIDE, LoopStep.SPEED, LoopStep.SEND, LoopStep.RECORD],
)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_an_exception_anywhere_in_the_tick_stops_the_stroke_and_is_latched(rig: Lockstep, step: LoopStep) -> None:
    before = rig.rig.truth
    rig.events.read()
    with failing(rig, step):
        rig.run(0.02)
    records = rig.run(0.002)
    assert records["mode"][-1] == Mode.FAULT
    assert records["fault"][-1] == Fault.LOOP_EXCEPTION
    assert records["command_mm_s"][-1] == 0.0
    assert events(rig).count(Kind.EXCEPTION) == 1
    rig.run(0.3)
    assert_held(rig, before.tension_n, before.stroke_mm)
    assert rig.command(Verb.RESET) is Refusal.NONE
    if step is LoopStep.DECIDE:
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run_until(Mode.COMPENSATING, 5.0)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_what_a_tick_found_is_reported_though_its_record_fails(rig: Lockstep) -> None:
    """A trip, its change of mode, a further cause and an emergency of a device in the very tick without a record."""
    rig.run(0.02)
    rig.events.read()
    with failing(rig, LoopStep.WRITE_RECORD):
        rig.loop.inbox.drive_status.e_stop = rig.loop.inbox.network.restarted = True
        rig.loop.inbox.network._notices.emergencies.append((2, 0x8110, b""))
        rig.run(0.001)
    rig.run(0.002)
    found = rig.events.read()
    kinds = found["kind"].tolist()
    assert {Kind.TRIP, Kind.MODE, Kind.EXCEPTION, Kind.CAUSE, Kind.EMERGENCY} <= set(kinds)
    causes = {Fault(int(a)) for a in found["a"][found["kind"] == Kind.CAUSE]}
    assert Fault.DEVICE_RESTARTED in causes


@pytest.mark.parametrize("step", [LoopStep.SPEED, LoopStep.SEND, LoopStep.RECORD])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_stretch_tolerated_in_motion_is_no_cause_once_an_exception_holds_the_stroke(
    rig: Lockstep, step: LoopStep
) -> None:
    leave_unexplained(rig, 8.0)  # below the limit of a mode that moves, above the limit at rest
    with failing(rig, step):
        rig.run(0.001)
    records = rig.run(1.0)
    assert set(records["fault"]) == {Fault.LOOP_EXCEPTION}
    assert not any(
        event["a"] == Fault.STRETCH_UNEXPLAINED for event in rig.events.read() if event["kind"] == Kind.CAUSE
    )
    assert rig.view.action is Action.HOLD


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_burst_of_overruns_trips(rig: Lockstep, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = rig.clock.next_tick
    limit = rig.settings.safety.overrun_ticks
    monkeypatch.setattr(rig.clock, "next_tick", lambda: (plain()[0], 10))
    records = rig.run((limit // 10 + 1) * 1e-3)
    assert records["fault"][-1] == Fault.OVERRUN
    assert records["fault"][limit // 10 - 2] == Fault.NONE
    assert records["skipped"][-1] == 10 * len(records)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_stopping_in_the_closed_loop_ends_in_hold_with_the_brake_closed(rig: Lockstep) -> None:
    before = rig.rig.truth
    rig.loop.stop_requested = True
    for _ in range(2500):
        rig.loop.tick()
        if rig.loop.finished:
            break
    assert rig.loop.finished
    assert rig.loop.machine.mode == Mode.HOLD
    assert od.drive_state(rig.loop.inbox.drive.statusword) is not DriveState.OPERATION_ENABLED
    for _ in range(500):
        rig.clock.next_tick()
    assert rig.rig.truth.stroke_mm == pytest.approx(before.stroke_mm, abs=0.1)
    assert rig.rig.truth.tension_n == pytest.approx(before.tension_n, abs=1.0)


def test_old_and_unknown_commands_are_not_carried_out(rig: Lockstep) -> None:
    assert rig.command(Verb.ARM, age_ns=2_000_000_000) is Refusal.EXPIRED
    assert rig.command(99) is Refusal.UNKNOWN  # type: ignore[arg-type]
    assert rig.loop.machine.mode == Mode.DISARMED


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_foreign_and_malformed_frames_are_counted_and_change_nothing(rig: Lockstep) -> None:
    rig.run(0.5)
    refused = rig.loop.inbox.refused
    for can_id, data in ((0x7FF, b"12345678"), (0x182, b"123"), (0x184, b""), (0x183, b"12345678"), (0x84, b"1")):
        rig.inject(can_id.to_bytes(4, "little") + bytes([len(data), 0, 0, 0]) + data.ljust(8, b"\0"))
    rig.run(0.5)
    assert rig.loop.inbox.refused == refused + 4
    assert rig.loop.machine.mode == Mode.COMPENSATING


def test_error_frames_are_seen_and_counted(rig: Lockstep) -> None:
    frame = (0x20000000 | 0x004).to_bytes(4, "little") + bytes([8, 0, 0, 0]) + b"\0\x20" + bytes(6)
    for recent, total in ((1, 1), (2, 3)):  # a second apart: a limit of the rig file counts those of the last second
        for _ in range(recent):
            rig.inject(frame)
            records = rig.run(0.01)
        assert (records["error_frames"][-1], rig.view.error_frames) == (total, recent)
        rig.run(1.1)
        assert rig.view.error_frames == 0


def test_a_loop_that_can_tell_nobody_of_an_exception_counts_it(rig: Lockstep) -> None:
    with failing(rig, LoopStep.DECIDE, LoopStep.NOTICE):
        rig.run(0.003)
    assert rig.loop.exceptions_unreported == 3
    assert rig.run(0.001)["fault"][-1] == Fault.LOOP_EXCEPTION


def test_a_babbling_bus_and_a_deaf_one_are_told_once_a_second(rig: Lockstep, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.events.read()

    def deaf(*_: object) -> None:
        raise can.CanOperationError("send buffer full", 105)

    error = (0x20000000 | 0x004).to_bytes(4, "little") + bytes([8, 0, 0, 0]) + b"\0\x20" + bytes(6)
    with monkeypatch.context() as patch:
        patch.setattr(rig.bus, "send", deaf)
        for _ in range(1500):
            rig.inject(error)
            rig.loop.tick()
    told = events(rig)
    assert told.count(Kind.BUS_ERROR) == 2
    assert told.count(Kind.SEND_FAILED) == 2
    records = rig.run(0.01)
    assert records["send_failures"][-1] >= 3000
    assert records["error_frames"][-1] == 1500


def test_a_late_or_lost_answer_is_counted_as_missing(rig: Lockstep) -> None:
    rig.run(0.1)
    assert rig.run(0.05)["frames_lost"][-1] == 0
    stop_node(rig, rig.settings.tension_cell.node)
    records = rig.run(0.05)
    assert records["frames_lost"][-1] == 49  # the last SYNC's samples are not due yet


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_after_an_exception_the_drive_starts_from_rest_and_the_filter_knows_it(
    rig: Lockstep,
) -> None:
    assert rig.command(Verb.TARGET, 250.0) is Refusal.NONE
    before = rig.run(0.4)
    assert abs(before["command_mm_s"][-1]) > 5.0
    with failing(rig, LoopStep.ESTIMATE):
        rig.loop.tick()
    assert rig.read_records()["command_mm_s"][-1] == 0.0
    after = rig.run(0.1)
    step = rig.settings.tension.acceleration_max_mm_s2 * rig.settings.loop.period_ns * 1e-9
    assert abs(after["command_mm_s"][0]) <= step, "it does not go on from the speed before"
    usual = np.abs(before["speed_innovation_mm_s"][-200:]).max()
    sooner = after["speed_innovation_mm_s"] * -np.sign(before["command_mm_s"][-1])
    assert sooner.max() < 2.0 * usual, "the filter expects the drive to brake, no later than it does"
