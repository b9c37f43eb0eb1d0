"""The emergency stop and the other stops of the drive: seen at once, ended on the brake, the load carried."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hil.faults.in_controller import trip
from hil.lockstep import Lockstep, lockstep
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.watch.safety import STATUS_PERIODS
from rigctl.devices import objects
from rigctl.devices.objects import drive_state
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.signals import STATUS, WATCHED
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Setting, Verb
from tests.builders.loop_frames import latched
from tests.builders.rig_bench import SAME_CLOCKS, changed

ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)


def status_period_s(rig: Lockstep) -> float:
    return 1.0 / (rig.settings.cylinder.status_rate_hz or math.inf)


def braked(rig: Lockstep) -> bool:
    return rig.rig.drive.control.stage.phase is StagePhase.BRAKED


def carried(rig: Lockstep, seconds: float = 1.0) -> bool:
    """Whether the brake is closed and the stroke stays in place."""
    before = rig.rig.truth.stroke_mm
    rig.run(seconds)
    return braked(rig) and rig.rig.truth.stroke_mm == before


@pytest.mark.gate("4")
@pytest.mark.parametrize("mode", ARMED)
@pytest.mark.starts_in("mode")
def test_an_emergency_stop_is_seen_at_once_latched_and_ends_on_the_brake(rig: Lockstep, mode: Mode) -> None:
    before = rig.rig.truth.tension_n
    rig.rig.drive.press_e_stop(True)
    for _ in range(2):  # the emergency message comes long before the input's next status
        rig.loop.tick()
    assert latched(rig) == (Mode.FAULT, Fault.E_STOP, Action.QUICK_STOP)
    rig.run(0.5)
    assert carried(rig)
    if mode is not Mode.HOLD:
        assert rig.rig.truth.tension_n == pytest.approx(before, abs=5.0)  # 10 mm/s stopped at 500 mm/s2: 0.3 mm
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.E_STOP
    rig.rig.drive.press_e_stop(False)
    rig.run(2 * status_period_s(rig))
    assert rig.loop.machine.fault is Fault.E_STOP  # latched
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.2)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.DISARMED, Fault.NONE)
    assert rig.command(Verb.ARM) is Refusal.NONE


def test_an_emergency_stop_is_latched_while_disarmed_and_a_short_press_too(rig: Lockstep) -> None:
    rig.rig.drive.press_e_stop(True)
    rig.run(0.01)
    rig.rig.drive.press_e_stop(False)
    rig.run(0.2)
    assert rig.loop.machine.fault is Fault.E_STOP
    assert rig.command(Verb.ARM) is Refusal.WRONG_MODE
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.2)
    assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.starts_in(Mode.HOLD)
def test_without_its_message_the_input_alone_is_seen_with_the_next_status(rig: Lockstep) -> None:
    rig.rig.drive.e_stop_pressed = True  # a drive that mirrors the input and does not react
    rig.run(status_period_s(rig) + 0.002)
    assert rig.loop.machine.fault is Fault.E_STOP
    rig.run(0.3)
    assert carried(rig)  # by the loop's quick stop


def test_arming_is_refused_while_pressed_and_while_the_input_is_not_seen(rig: Lockstep) -> None:
    drive = rig.rig.drive
    assert drive.device is not None
    drive.device.sdo[objects.TPDO2_COMMUNICATION][1].raw = 1 << 31 | (objects.TPDO2_BASE + drive.id)
    rig.run((STATUS_PERIODS + 1) * status_period_s(rig))
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check.E_STOP_UNSEEN | Check.STATUS_STALE in Check(int(rig.reply["checks"]))
    assert math.isnan(rig.record["drive_current_a"])
    drive.press_e_stop(True)
    rig.loop.tick()
    assert Check.E_STOP in rig.view.failed_checks


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_current_and_temperature_are_the_drives(rig: Lockstep) -> None:
    record, truth = rig.record, rig.rig.truth
    simulation = rig.settings.simulation
    assert simulation is not None
    load_a, friction_a = (n / simulation.drive.force_n_a for n in (truth.tension_n, simulation.drive.friction_n))
    unit_a = (rig.settings.cylinder.rated_current_a or math.nan) * objects.PER_CURRENT_UNIT
    assert abs(record["drive_current_a"] - load_a) <= friction_a + unit_a
    assert simulation.drive.ambient_c <= record["drive_temperature_c"] < simulation.drive.ambient_c + 1.0


def test_a_drive_that_is_not_asked_for_its_status_has_no_emergency_stop(settings: RigSettings, gains: Gains) -> None:
    without = {"status_rate_hz": None, "rated_current_a": None, "e_stop_input": None}
    limits = [limit for limit in settings.limits if WATCHED[limit.signal].age != STATUS]
    cylinder = settings.cylinder.model_copy(update=without)
    plain = settings.model_copy(update={"cylinder": cylinder, "limits": limits})
    with lockstep(plain, gains, log=True) as rig:
        rig.run(0.3)
        rig.rig.drive.e_stop_pressed = True
        rig.run(0.3)
        assert not rig.view.e_stop
        assert math.isnan(rig.record["drive_temperature_c"])
        assert rig.command(Verb.ARM) is Refusal.NONE
        identifiers = {int.from_bytes(frame[:4], "little") for _, frame in rig.frames}
        assert objects.TPDO2_BASE + settings.cylinder.node not in identifiers


# -- quick stop and cut -----------------------------------------------------------------------------------------


def moving(rig: Lockstep) -> None:
    """Bring the rig to COMPENSATING, on its way to another target."""
    assert rig.command(Verb.TARGET, 250.0) is Refusal.NONE
    rig.run(0.5)
    assert abs(rig.rig.truth.speed_mm_s) > 5.0


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_quick_stop_at_speed_ends_with_the_brake_closed_and_the_tension_held(rig: Lockstep) -> None:
    moving(rig)
    before = rig.rig.truth
    trip(rig, Action.QUICK_STOP)
    words = set()
    for _ in range(400):
        rig.loop.tick()
        words.add(rig.record["controlword"])
    assert carried(rig)
    assert objects.Controlword.DISABLE_VOLTAGE not in words  # power is never cut at once on a drive that obeys
    assert abs(rig.rig.truth.stroke_mm - before.stroke_mm) < 0.4  # 8 mm/s: 0.06 mm of ramp, 0.2 mm of lag
    assert rig.rig.truth.tension_n == pytest.approx(before.tension_n, abs=2.5)
    assert drive_state(rig.loop.inbox.drive.statusword) in objects.OFF_STATES


@pytest.mark.parametrize("speed_mm_s", [10.0, -10.0])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_drive_that_runs_away_is_cut_and_its_brake_closes(rig: Lockstep, speed_mm_s: float) -> None:
    drive = rig.rig.drive
    drive.defect = lambda speed, closed: (speed_mm_s if drive.control.stage.powered else speed, closed)
    began_ns = rig.clock.now()
    while not braked(rig):
        rig.loop.tick()
        assert rig.clock.now() - began_ns < 300_000_000
        if rig.loop.machine.fault is Fault.NONE:
            tripped_ns = rig.clock.now()
    assert rig.view.action is Action.POWER_OFF
    assert rig.clock.now() - tripped_ns <= 150_000_000  # 60 ms to stop by itself, 50 ms for the brake
    assert carried(rig)


def test_the_drives_own_stop_is_set_and_read_back(rig: Lockstep) -> None:
    assert rig.report.supervised
    found = {setting.object: setting.found for setting in rig.report.supervision}
    assert (found["0x605A"], found["0x605B"], found["0x605C"], found["0x605E"], found["0x6007"]) == (2, 1, 1, 2, 3)
    assert found["0x60B1"] == 0
    assert found["0x1016:01"] == 1 << 16 | rig.settings.cylinder.heartbeat_timeout_ms
    assert found["0x1400:05"] == rig.settings.cylinder.command_deadline_ms


@pytest.mark.parametrize(
    ("index", "name", "kept"),
    [(objects.ABORT_CONNECTION_OPTION, "0x6007", 0), (objects.VELOCITY_OFFSET, "0x60B1", 400)],
)
def test_a_drive_that_keeps_a_stop_setting_of_its_own_cannot_be_armed(
    settings: RigSettings, gains: Gains, monkeypatch: pytest.MonkeyPatch, index: int, name: str, kept: int
) -> None:
    from hil.nodes import cylinder_drive

    made = cylinder_drive.CylinderDrive.__init__

    def stubborn(self: cylinder_drive.CylinderDrive, *arguments: object) -> None:
        made(self, *arguments)  # type: ignore[arg-type]
        self.readers[index, 0] = lambda: kept

    monkeypatch.setattr(cylinder_drive.CylinderDrive, "__init__", stubborn)
    with lockstep(settings, gains) as rig:
        rig.run(0.2)
        (wrong,) = [setting for setting in rig.report.supervision if not setting.ok]
        assert (wrong.object, wrong.found) == (name, kept)
        assert wrong.wanted != kept
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.DRIVE_SUPERVISION


def test_a_drive_that_has_started_anew_counts_as_unverified(rig: Lockstep) -> None:
    rig.rig.drive.reset_node()
    rig.run(0.1)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check.DRIVE_SUPERVISION in Check(int(rig.reply["checks"]))


@pytest.mark.study
def test_at_an_end_of_the_stroke_only_an_operator_who_says_so_arms(settings: RigSettings, gains: Gains) -> None:
    near = {"stroke_min_mm": -1.0}  # the rope is slack at 0
    with lockstep(settings.model_copy(update={"cylinder": settings.cylinder.model_copy(update=near)}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.STROKE_NEAR_END
        assert rig.command(Verb.ARM, 1.0) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE  # away from the limit
        rig.run_until(Mode.COMPENSATING, 15.0)
        assert rig.command(Verb.HOLD) is Refusal.NONE
        assert rig.command(Verb.DISARM) is Refusal.NONE
        rig.run(0.3)
        assert rig.command(Verb.ARM) is Refusal.NONE
    beyond = {"stroke_min_mm": 3.0}
    with lockstep(settings.model_copy(update={"cylinder": settings.cylinder.model_copy(update=beyond)}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM, 1.0) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.STROKE_RANGE


def test_a_refused_arm_near_the_end_hides_nothing_of_what_is_shown(settings: RigSettings, gains: Gains) -> None:
    near = {"stroke_min_mm": -1.0}
    with lockstep(settings.model_copy(update={"cylinder": settings.cylinder.model_copy(update=near)}), gains) as rig:
        assert rig.command(Setting.HOST_CHECKS, float(Check.DISK)) is Refusal.NONE
        rig.run(1.1)
        assert rig.command(Verb.ARM, 1.0) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.DISK
        assert set(rig.run(0.6)["checks"].tolist()) == {Check.DISK | Check.STROKE_NEAR_END}


def test_records_show_what_stands_against_arming_and_what_the_host_says_at_once(rig: Lockstep) -> None:
    assert rig.run(0.6)["checks"][-1] == 0
    rig.rig.drive.press_e_stop(True)
    assert Check.E_STOP in Check(int(rig.run(0.6)["checks"][-1]))
    rig.rig.drive.press_e_stop(False)
    rig.run(0.1)
    rig.command(Verb.RESET)
    rig.run(0.2)
    assert rig.command(Verb.ARM) is Refusal.NONE
    rig.command(Setting.HOST_CHECKS, float(Check.DISK))
    records = rig.run(0.01)
    assert records["checks"][-1] & int(HOST_CHECKS) == Check.DISK  # armed or not
    assert records["drive_temperature_c"][-1] == pytest.approx(25.0, abs=0.2)
    assert math.isfinite(records["drive_current_a"][-1])


def test_what_the_host_says_stands_against_arming_until_it_says_otherwise(rig: Lockstep) -> None:
    assert rig.command(Setting.HOST_CHECKS, float(Check.DISK | Check.TARE)) is Refusal.NONE
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.DISK | Check.TARE
    assert rig.command(Setting.HOST_CHECKS, float(Check.CELL_STALE)) is Refusal.OUT_OF_RANGE
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.HOST
    assert rig.command(Setting.HOST_CHECKS, 0.0) is Refusal.NONE
    assert rig.command(Verb.ARM) is Refusal.NONE


def words_of(
    rig: Lockstep, ticks: int, seen_as: Callable[[bytes], bytes] = lambda frame: frame
) -> list[tuple[int, int, float]]:
    """Time in ns, controlword and speed in mm/s of the drive's next commands; ``seen_as`` changes frames on the bus."""
    found: list[tuple[int, int, float]] = []
    command = objects.RPDO1_BASE + rig.settings.cylinder.node

    def tap(_port: object, frame: bytes) -> tuple[bytes, ...]:
        can_id, size, data = FRAME.unpack(frame)
        if can_id == command:
            word, speed = objects.DRIVE_RPDO.codec.unpack(data[:size])
            found.append((rig.clock.now(), word, speed / 1000))
        return (seen_as(frame),)

    rig.hub.tap = tap
    for _ in range(ticks):
        rig.loop.tick()
    rig.hub.tap = None
    return found


@pytest.mark.parametrize("lag_s", [0.02, 0.05])
def test_a_drive_keeps_its_power_for_the_time_it_needs_to_stop(
    settings: RigSettings, gains: Gains, lag_s: float
) -> None:
    """From top speed at its own deceleration, with two of its lags to spare; then the power is cut."""
    slow = changed(settings, plant={"cylinder_lag_s": lag_s}, simulation=SAME_CLOCKS)
    with lockstep(slow, gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        creeps_mm_s = 2.0  # a drive whose speed grows beyond any command is cut at once
        rig.rig.drive.defect = lambda speed, closed: (
            creeps_mm_s if rig.rig.drive.control.stage.powered else speed, closed,
        )  # fmt: skip
        words = [(t_ns, word) for t_ns, word, _ in words_of(rig, 1000)]
        asked = next(t_ns for t_ns, word in words if word == objects.Controlword.QUICK_STOP)
        cut = next(t_ns for t_ns, word in words if word == objects.Controlword.DISABLE_VOLTAGE)
        tension, cylinder = slow.tension, slow.cylinder
        needs_s = tension.speed_max_mm_s / cylinder.stop_deceleration_mm_s2 + 2 * lag_s
        assert (cut - asked) * 1e-9 == pytest.approx(needs_s, abs=2e-3)


@pytest.mark.parametrize("before", [Mode.TENSIONING, Mode.HOLD])
@pytest.mark.starts_in("before")
def test_ten_commands_of_no_speed_precede_the_end_of_the_drives_power(rig: Lockstep, before: Mode) -> None:
    """Also where nothing moves: a held stroke is commanded against a drive that creeps, until the end begins."""
    if before is Mode.HOLD:
        rig.rig.drive.defect = lambda speed, closed: (speed + 0.07, closed)
        rig.run(1.0)
    assert rig.run(0.01)["command_mm_s"][-1] != 0.0
    rig.give(Verb.HOLD)
    rig.give(Verb.DISARM)
    words = words_of(rig, 400)
    off = next(i for i, (_, word, _) in enumerate(words) if word != objects.Controlword.ENABLE_OPERATION)
    last = max((i for i, (_, _, speed) in enumerate(words[:off]) if speed != 0.0), default=-1)
    assert off - last - 1 >= 10, "the brake must not stop a load that moves"


@pytest.mark.parametrize("end", ["disarm", "stop"])
@pytest.mark.starts_in(Mode.HOLD)
def test_a_stroke_that_never_reads_as_at_rest_delays_the_end_by_two_seconds_at_most(rig: Lockstep, end: str) -> None:
    rig.run(0.5)
    status = objects.TPDO1_BASE + rig.settings.cylinder.node

    def offset(frame: bytes) -> bytes:
        can_id, size, data = FRAME.unpack(frame)
        if can_id != status:
            return frame
        word, stroke, speed = objects.DRIVE_TPDO.codec.unpack(data[:size])
        return bytes(FRAME.pack(can_id, size, objects.DRIVE_TPDO.codec.pack(word, stroke, speed + 80)))

    words_of(rig, 20, seen_as=offset)
    began_ns = rig.clock.now()
    if end == "disarm":
        rig.give(Verb.DISARM)
        words = words_of(rig, 2200, seen_as=offset)
        over_ns = next(t_ns for t_ns, word, _ in words if word != objects.Controlword.ENABLE_OPERATION)
    else:
        rig.loop.stop_requested = True
        while not rig.loop.finished:
            words_of(rig, 1, seen_as=offset)
        over_ns = rig.clock.now()
    assert rig.loop.machine.fault is Fault.NONE
    assert (over_ns - began_ns) * 1e-9 == pytest.approx(2.0, abs=0.1)


def test_a_drive_that_is_off_is_commanded_no_speed_and_a_slack_rope_shows_no_disturbance(rig: Lockstep) -> None:
    assert {speed for _, _, speed in words_of(rig, 100)} == {0.0}
    records = rig.read_records()
    assert not records["run_out_mm_s"].any()
    assert not records["disturbance_mm_s"].any()
