"""The drive as its controller sees it: enabling, following, stopping, and stopping by itself."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import pytest

from hil.nodes.dictionary import Abort
from hil.nodes.node import ERROR_FIELD
from rigctl.devices import objects
from rigctl.devices.objects import Controlword, EmcyCode
from rigctl.model.device_states import DriveState
from tests.builders.rig_bench import MS, SETTINGS, SETTINGS_BRAKE_MS, RigBench

DRIVE = SETTINGS.cylinder.node
ENABLE = Controlword.ENABLE_OPERATION
START, STOP, PRE_OPERATIONAL, RESET_NODE = 0x01, 0x02, 0x80, 0x81
OFF, READY, ON = DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON
QUICK_MM, SLOW_MM = 0.1, 0.25  # from 10 mm/s at 500 and at 200 mm/s2
assert SETTINGS.simulation is not None
SETTINGS_DRIVE = SETTINGS.simulation.drive
STANDSTILL_MS = 400  # ramp from 10 mm/s at 500 mm/s2 or more, the lag of 20 ms down to 0.05 mm/s, the brake


@pytest.fixture
def bench() -> RigBench:
    bench = RigBench()
    bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, objects.ABORT_CONNECTION_QUICK_STOP, 2)
    bench.write(DRIVE, objects.QUICK_STOP_DECELERATION, 0, 500_000, 4)
    bench.enable()
    return bench


def rests(bench: RigBench) -> bool:
    """Whether the stroke stays exactly in place, on the brake."""
    before = bench.rig.truth.stroke_mm
    bench.wait(500)
    return bench.rig.truth.stroke_mm == before and bench.rig.drive.control.stage.braked


def report(bench: RigBench) -> tuple[int, int, int]:
    status, position, velocity = objects.DRIVE_TPDO.codec.unpack(bench.sent(objects.TPDO1_BASE + DRIVE)[-1])
    return int(status), int(position), int(velocity)


def test_operation_is_reported_only_once_the_brake_is_open() -> None:
    bench = RigBench()
    bench.write(DRIVE, objects.MODE_OF_OPERATION, 0, 9, 1)
    bench.nmt(START)
    bench.wait(1)
    bench.drive(1, Controlword.SHUTDOWN)
    bench.drive(1, Controlword.SWITCH_ON)
    bench.drive(SETTINGS_BRAKE_MS - 1, ENABLE, 5.0)
    assert bench.state() is DriveState.SWITCHED_ON
    assert bench.rig.truth.stroke_mm == 0.0
    bench.drive(2, ENABLE, 5.0)
    assert bench.state() is DriveState.OPERATION_ENABLED
    bench.drive(100, ENABLE, 5.0)
    assert bench.rig.truth.stroke_mm > 0.0


def test_calling_off_while_the_brake_opens_closes_it_again() -> None:
    bench = RigBench()
    bench.nmt(START)
    bench.wait(1)
    bench.drive(1, Controlword.SHUTDOWN)
    bench.drive(1, Controlword.SWITCH_ON)
    bench.drive(10, ENABLE)
    bench.drive(200, Controlword.SWITCH_ON)
    assert bench.state() is DriveState.SWITCHED_ON
    assert rests(bench)


def test_it_follows_the_target_and_reports_micrometres(bench: RigBench) -> None:
    bench.drive(1000, ENABLE, 10.0)
    status, position, velocity = report(bench)
    truth = bench.rig.truth
    assert truth.speed_mm_s == pytest.approx(10.0)
    assert velocity == 1000  # 10 um/s
    assert position == pytest.approx(truth.stroke_mm * 1000, abs=13.5)  # one tick older, rounded, 3 um of ripple
    assert status & 0x1237 == 0x1237  # following, remote, voltage, operation enabled
    assert bench.read(DRIVE, objects.VELOCITY_ACTUAL) == pytest.approx(10_000, abs=5)  # an encoder step a millisecond


@pytest.mark.parametrize("speed", [5.0, -5.0])
def test_the_16_bit_velocity_has_its_sign_and_own_unit(bench: RigBench, speed: float) -> None:
    bench.drive(400, ENABLE, 5.0)  # away from the end of the stroke
    bench.drive(400, ENABLE, speed)
    (found,) = struct.unpack("<h", struct.pack("<H", bench.read(DRIVE, objects.VELOCITY_ACTUAL_16) & 0xFFFF))
    assert found * 0.01 == pytest.approx(speed, abs=0.02)  # 0x2044 counts in 0.01 mm/s


def test_a_velocity_offset_is_added_to_the_target_velocity(bench: RigBench) -> None:
    bench.write(DRIVE, objects.VELOCITY_OFFSET, 0, -1_500 & 0xFFFFFFFF, 4)
    bench.drive(500, ENABLE, 10.0)
    assert bench.rig.truth.speed_mm_s == pytest.approx(8.5)
    bench.drive(500, ENABLE, 0.0)
    assert bench.rig.truth.speed_mm_s == pytest.approx(-1.5)
    bench.nmt(RESET_NODE)
    bench.wait(10)
    assert bench.read(DRIVE, objects.VELOCITY_OFFSET) == 0


def test_a_command_waits_for_its_sync(bench: RigBench) -> None:
    for _ in range(20):
        bench.send(objects.HEARTBEAT_BASE + 1, b"\x05")
        bench.command(ENABLE, 10.0)
        bench.wait(1)
    assert bench.rig.truth.stroke_mm == 0.0
    bench.send(objects.SYNC_COB)
    bench.wait(10)
    assert bench.rig.truth.stroke_mm > 0.0


def test_without_mode_9_it_does_not_move() -> None:
    bench = RigBench()
    bench.enable()
    assert bench.write(DRIVE, objects.MODE_OF_OPERATION, 0, 8, 1) == Abort.VALUE_RANGE
    bench.write(DRIVE, objects.MODE_OF_OPERATION, 0, 0, 1)
    assert bench.read(DRIVE, objects.MODE_DISPLAY) == 0
    bench.drive(200, ENABLE, 10.0)
    assert bench.rig.truth.stroke_mm == 0.0


def test_the_stroke_end_is_reported(bench: RigBench) -> None:
    bench.drive(2800, ENABLE, -10.0)
    assert report(bench)[0] & objects.STATUS_INTERNAL_LIMIT
    bench.drive(500, ENABLE, 10.0)
    assert not report(bench)[0] & objects.STATUS_INTERNAL_LIMIT


@pytest.mark.parametrize(
    ("controlword", "option", "at_once", "at_rest", "ramp_mm"),
    [
        (Controlword.QUICK_STOP, (objects.QUICK_STOP_OPTION, 2), DriveState.QUICK_STOP_ACTIVE, OFF, QUICK_MM),
        (Controlword.QUICK_STOP, (objects.QUICK_STOP_OPTION, 1), DriveState.QUICK_STOP_ACTIVE, OFF, SLOW_MM),
        (Controlword.QUICK_STOP, (objects.QUICK_STOP_OPTION, 0), DriveState.QUICK_STOP_ACTIVE, OFF, 0.0),
        (Controlword.DISABLE_VOLTAGE, (objects.QUICK_STOP_OPTION, 2), OFF, OFF, 0.0),
        (Controlword.SHUTDOWN, (objects.SHUTDOWN_OPTION, 0), READY, READY, 0.0),
        (Controlword.SHUTDOWN, (objects.SHUTDOWN_OPTION, 1), READY, READY, SLOW_MM),
        (Controlword.SWITCH_ON, (objects.DISABLE_OPERATION_OPTION, 0), ON, ON, 0.0),
        (Controlword.SWITCH_ON, (objects.DISABLE_OPERATION_OPTION, 1), ON, ON, SLOW_MM),
    ],
)
def test_every_way_out_of_operation_ends_on_the_brake(
    bench: RigBench,
    controlword: Controlword,
    option: tuple[int, int],
    at_once: DriveState,
    at_rest: DriveState,
    ramp_mm: float,
) -> None:
    assert bench.write(DRIVE, option[0], 0, option[1], 2) == 0
    bench.drive(500, ENABLE, 10.0)
    before = bench.rig.truth.stroke_mm
    bench.drive(1, controlword, 10.0)
    assert bench.state() is at_once
    bench.drive(STANDSTILL_MS, controlword, 10.0)
    assert bench.state() is at_rest
    # v^2 / 2a on the ramp, v (tau + Td) = 0.22 mm behind it
    assert bench.rig.truth.stroke_mm - before == pytest.approx(ramp_mm + 0.22, abs=0.02)
    assert rests(bench)


def test_disable_voltage_closes_the_brake_on_a_motor_that_runs_away(bench: RigBench) -> None:
    drive = bench.rig.drive
    drive.defect = lambda speed, braked: (10.0 if drive.control.stage.powered else speed, braked)
    assert bench.write(DRIVE, objects.SHUTDOWN_OPTION, 0, 1, 2) == 0
    bench.drive(500, ENABLE)
    bench.drive(1, Controlword.SHUTDOWN)
    bench.drive(500, Controlword.SHUTDOWN)
    assert not drive.control.stage.braked  # the drive waits for a standstill that never comes
    bench.drive(SETTINGS_BRAKE_MS + 2, Controlword.DISABLE_VOLTAGE)
    assert rests(bench)


def test_a_motor_without_power_gives_way_under_load_until_the_brake_has_closed(bench: RigBench) -> None:
    bench.drive(6000, ENABLE, 8.0)
    bench.drive(500, ENABLE)
    before = bench.rig.truth
    assert before.tension_n > 200.0
    bench.drive(500, Controlword.DISABLE_VOLTAGE)
    creep_mm = before.tension_n / SETTINGS_DRIVE.creep_n_s_mm * SETTINGS_BRAKE_MS * 1e-3
    # the motor's speed rises with its lag until the brake stops it
    assert 0.2 * creep_mm < before.stroke_mm - bench.rig.truth.stroke_mm < creep_mm


# -- emergency stop ---------------------------------------------------------------------------------------------


def inputs(bench: RigBench) -> int:
    return bench.read(DRIVE, objects.DIGITAL_INPUTS)


def press(bench: RigBench, pressed: bool) -> None:
    """Press or release the emergency stop through the simulator node."""
    assert bench.write(objects.SIMULATOR_NODE, objects.SIM_E_STOP, 0, int(pressed), 1) == 0


def test_an_emergency_stop_ramps_down_closes_the_brake_and_keeps_the_drive_off_until_released(bench: RigBench) -> None:
    bench.drive(500, ENABLE, 10.0)
    before = bench.rig.truth.stroke_mm
    others = inputs(bench) & 0xFFFF
    assert inputs(bench) >> 16 & 1
    press(bench, True)
    assert inputs(bench) & 0xFFFF == others
    assert bench.emergencies(DRIVE) == [EmcyCode.EXTERNAL]
    assert bench.state() is DriveState.FAULT_REACTION_ACTIVE
    assert not inputs(bench) >> 16 & 1
    bench.drive(STANDSTILL_MS, ENABLE, 10.0)
    assert bench.rig.truth.stroke_mm - before == pytest.approx(QUICK_MM + 0.22, abs=0.02)
    assert rests_while_driven(bench)
    bench.drive(3, Controlword.DISABLE_VOLTAGE)
    bench.drive(3, Controlword.FAULT_RESET)
    assert bench.state() is DriveState.FAULT
    press(bench, False)
    bench.drive(3, Controlword.DISABLE_VOLTAGE)
    bench.drive(3, Controlword.FAULT_RESET)
    assert bench.state() is DriveState.SWITCH_ON_DISABLED
    assert bench.emergencies(DRIVE) == [EmcyCode.EXTERNAL, EmcyCode.NO_ERROR]


def rests_while_driven(bench: RigBench) -> bool:
    """Whether the stroke stays in place whatever the controller commands."""
    before = bench.rig.truth.stroke_mm
    for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON, ENABLE):
        bench.drive(100, word, 10.0)
    return bench.rig.truth.stroke_mm == before and bench.state() is DriveState.FAULT


def test_a_drive_that_restarts_with_its_emergency_stop_pressed_stays_off(bench: RigBench) -> None:
    press(bench, True)
    bench.nmt(RESET_NODE, DRIVE)
    bench.wait(STANDSTILL_MS)
    assert bench.state() is DriveState.FAULT
    assert bench.read(DRIVE, objects.ERROR_CODE) == EmcyCode.EXTERNAL


# -- second TPDO ------------------------------------------------------------------------------------------------


def test_the_second_tpdo_comes_with_every_nth_sync_once_it_is_switched_on(bench: RigBench) -> None:
    bench.drive(200, ENABLE)
    assert bench.sent(objects.TPDO2_BASE + DRIVE) == []
    assert bench.write(DRIVE, objects.TPDO2_COMMUNICATION, 2, 50, 1) == 0
    assert bench.write(DRIVE, objects.TPDO2_COMMUNICATION, 1, objects.TPDO2_BASE + DRIVE, 4) == 0
    first = len(bench.sent(objects.TPDO1_BASE + DRIVE))
    bench.drive(200, ENABLE)
    assert len(bench.sent(objects.TPDO1_BASE + DRIVE)) - first == 200
    frames = bench.sent(objects.TPDO2_BASE + DRIVE)
    assert len(frames) == 4
    current, temperature, bits = objects.DRIVE_TPDO2.codec.unpack(frames[-1])
    assert (current, bits) == (0, 1 << 16 | 1 << 2)  # a slack rope at stroke 0
    assert temperature == SETTINGS_DRIVE.ambient_c * 10


def test_the_motors_current_is_the_load_it_carries_and_warms_it(bench: RigBench) -> None:
    bench.drive(6000, ENABLE, 8.0)
    raised = bench.read(DRIVE, objects.CURRENT_ACTUAL)
    load_n = bench.rig.truth.tension_n
    rated_a = bench.read(DRIVE, objects.MOTOR_RATED_CURRENT) / 1000
    expected = (load_n + SETTINGS_DRIVE.friction_n) / SETTINGS_DRIVE.force_n_a / rated_a * 1000
    assert raised == pytest.approx(expected, abs=1.0)
    assert raised > 100
    bench.drive(100, ENABLE)
    held = bench.read(DRIVE, objects.CURRENT_ACTUAL)
    assert 0 < held < raised  # no friction at rest
    warm = bench.read(DRIVE, objects.DRIVE_TEMPERATURE)
    bench.drive(20_000, ENABLE)
    share = 1.0 - math.exp(-20.0 / SETTINGS_DRIVE.thermal_s)
    final_c = SETTINGS_DRIVE.ambient_c + SETTINGS_DRIVE.heating_c_a2 * (held * rated_a / 1000) ** 2
    assert (bench.read(DRIVE, objects.DRIVE_TEMPERATURE) - warm) / 10 == pytest.approx(
        (final_c - warm / 10) * share, abs=0.1
    )
    bench.drive(200, Controlword.SHUTDOWN)
    assert bench.read(DRIVE, objects.CURRENT_ACTUAL) == 0


@pytest.mark.parametrize(("speed", "bit"), [(-10.0, 0), (10.0, 1)])
def test_limit_switches_are_inputs(bench: RigBench, speed: float, bit: int) -> None:
    bench.rig.plant.parameters[0]["stroke_high"] = 5.0
    bench.rig.plant.parameters[0]["stroke_low"] = -5.0
    bench.drive(300, ENABLE, speed)
    assert inputs(bench) & 0b111 == 0
    bench.drive(700, ENABLE, speed)
    assert inputs(bench) & 0b111 == 1 << bit


@pytest.mark.parametrize(("option", "stays"), [(2, False), (6, True)])
def test_quick_stop_option_says_whether_it_stays(bench: RigBench, option: int, stays: bool) -> None:
    assert bench.write(DRIVE, objects.QUICK_STOP_OPTION, 0, option, 2) == 0
    bench.drive(STANDSTILL_MS, Controlword.QUICK_STOP)
    assert (bench.state() is DriveState.QUICK_STOP_ACTIVE) == stays
    bench.drive(SETTINGS_BRAKE_MS + 3, ENABLE)
    assert (bench.state() is DriveState.OPERATION_ENABLED) == stays


def test_impossible_options_are_refused(bench: RigBench) -> None:
    assert bench.write(DRIVE, objects.QUICK_STOP_OPTION, 0, 3, 2) == Abort.VALUE_RANGE
    assert bench.write(DRIVE, objects.FAULT_REACTION_OPTION, 0, 3, 2) == Abort.VALUE_TOO_HIGH
    assert bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, -1, 2) == Abort.VALUE_TOO_LOW


# -- stopping by itself -----------------------------------------------------------------------------------------


def commands_without_heartbeat(bench: RigBench) -> None:
    for _ in range(STANDSTILL_MS + 100):
        bench.command(ENABLE, 10.0)
        bench.send(objects.SYNC_COB)
        bench.wait(1)


def heartbeat_without_commands(bench: RigBench) -> None:
    for _ in range(STANDSTILL_MS + 100):
        bench.send(objects.HEARTBEAT_BASE + 1, b"\x05")
        bench.send(objects.SYNC_COB)
        bench.wait(1)


def nmt_stop_and_start(bench: RigBench) -> None:
    bench.nmt(PRE_OPERATIONAL, DRIVE)
    bench.nmt(START, DRIVE)
    bench.drive(STANDSTILL_MS, ENABLE, 10.0)


LOSSES = [
    (commands_without_heartbeat, EmcyCode.HEARTBEAT_LOST, 60),
    (heartbeat_without_commands, EmcyCode.RPDO_TIMEOUT, 30),
    (nmt_stop_and_start, EmcyCode.COMMUNICATION, 0),
]


@pytest.mark.parametrize(("lose", "code", "silence_ms"), LOSSES)
def test_a_lost_controller_ends_in_fault_on_the_brake(
    bench: RigBench, lose: Callable[[RigBench], None], code: EmcyCode, silence_ms: int
) -> None:
    bench.drive(500, ENABLE, 10.0)
    before = bench.rig.truth.stroke_mm
    lose(bench)
    assert bench.state() is DriveState.FAULT
    assert bench.emergencies(DRIVE)[0] == code
    assert bench.read(DRIVE, objects.ERROR_CODE) == code
    assert bench.read(DRIVE, objects.ERROR_REGISTER) == 0x11
    assert bench.read(DRIVE, ERROR_FIELD, 1) == code
    travelled = bench.rig.truth.stroke_mm - before
    assert travelled == pytest.approx(10.0 * silence_ms / 1000 + 0.32, abs=0.04)
    assert rests(bench)


@pytest.mark.parametrize("code", [EmcyCode.HEARTBEAT_LOST, EmcyCode.RPDO_TIMEOUT])
def test_a_fault_is_reset_only_once_the_controller_is_back(bench: RigBench, code: EmcyCode) -> None:
    (commands_without_heartbeat if code is EmcyCode.HEARTBEAT_LOST else heartbeat_without_commands)(bench)
    bench.write(DRIVE, objects.CONTROLWORD, 0, 0, 2)
    bench.write(DRIVE, objects.CONTROLWORD, 0, Controlword.FAULT_RESET, 2)
    assert bench.state() is DriveState.FAULT
    bench.drive(3, 0)
    assert bench.state() is DriveState.FAULT  # coming back is not enough: a reset needs the rising edge
    bench.drive(3, Controlword.FAULT_RESET)
    assert bench.state() is DriveState.SWITCH_ON_DISABLED
    assert bench.emergencies(DRIVE)[-1] == EmcyCode.NO_ERROR
    assert bench.read(DRIVE, objects.ERROR_CODE) == bench.read(DRIVE, objects.ERROR_REGISTER) == 0
    for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON):
        bench.drive(2, word)
    bench.drive(SETTINGS_BRAKE_MS + 3, ENABLE)
    assert bench.state() is DriveState.OPERATION_ENABLED


def test_a_held_reset_bit_does_not_reset_the_next_fault(bench: RigBench) -> None:
    bench.wait(200)
    assert bench.state() is DriveState.FAULT
    bench.drive(3, 0)
    bench.drive(3, Controlword.FAULT_RESET)
    bench.wait(200)
    assert bench.state() is DriveState.FAULT
    bench.drive(3, Controlword.FAULT_RESET)
    assert bench.state() is DriveState.FAULT


def test_nobody_is_missed_before_being_heard() -> None:
    bench = RigBench()
    bench.write(DRIVE, objects.CONSUMER_HEARTBEAT, 1, 1 << 16 | 60, 4)
    bench.write(DRIVE, objects.RPDO1_COMMUNICATION, 5, 30, 2)
    bench.nmt(START)
    bench.wait(1000)
    assert bench.emergencies(DRIVE) == []
    bench.send(objects.HEARTBEAT_BASE + 1, b"\x00")  # boot-up is no heartbeat
    bench.send(objects.HEARTBEAT_BASE + 9, b"\x05")  # another node's
    bench.wait(1000)
    assert bench.emergencies(DRIVE) == []
    bench.send(objects.HEARTBEAT_BASE + 1, b"\x05")
    bench.wait(1000)
    assert bench.emergencies(DRIVE) == [EmcyCode.HEARTBEAT_LOST]


def test_heartbeats_just_in_time_are_in_time(bench: RigBench) -> None:
    for _ in range(10):
        bench.send(objects.HEARTBEAT_BASE + 1, b"\x05")
        for _ in range(59):
            bench.command(ENABLE)
            bench.wait(1)
    assert bench.state() is DriveState.OPERATION_ENABLED


def test_a_pause_of_this_process_is_not_the_controllers_silence() -> None:
    bench = RigBench(longest_silence_ns=5 * MS)
    bench.enable()
    bench.t_ns += 10_000 * MS
    bench.rig.advance(bench.t_ns)
    bench.rig.supervise(bench.t_ns)
    assert bench.emergencies(DRIVE) == []
    bench.wait(100)
    assert bench.emergencies(DRIVE)[0] == EmcyCode.RPDO_TIMEOUT


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, DriveState.OPERATION_ENABLED),
        (1, DriveState.FAULT),
        (2, DriveState.SWITCH_ON_DISABLED),
        (3, DriveState.FAULT),
    ],
)
def test_the_abort_connection_option_is_obeyed(bench: RigBench, option: int, state: DriveState) -> None:
    bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, option, 2)
    bench.drive(100, ENABLE, 10.0)
    commands_without_heartbeat(bench)
    assert bench.emergencies(DRIVE) == [EmcyCode.HEARTBEAT_LOST]
    assert bench.state() is state
    if option:
        assert rests(bench)


def test_a_second_loss_does_not_lead_out_of_fault(bench: RigBench) -> None:
    heartbeat_without_commands(bench)
    bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, 2, 2)
    bench.wait(200)
    assert bench.emergencies(DRIVE) == [EmcyCode.RPDO_TIMEOUT, EmcyCode.HEARTBEAT_LOST]
    assert bench.state() is DriveState.FAULT


def test_an_error_without_a_fault_goes_with_its_cause(bench: RigBench) -> None:
    bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, 0, 2)
    commands_without_heartbeat(bench)
    bench.drive(2, ENABLE)
    assert bench.emergencies(DRIVE) == [EmcyCode.HEARTBEAT_LOST, EmcyCode.NO_ERROR]
    assert bench.state() is DriveState.OPERATION_ENABLED


@pytest.mark.parametrize(("reaction", "travel_mm"), [(0, 0.22), (1, 0.25 + 0.22), (2, 0.1 + 0.22)])
def test_the_fault_reaction_option_chooses_the_ramp(bench: RigBench, reaction: int, travel_mm: float) -> None:
    """0x605E: at once, slow down ramp (0x6084, 200 mm/s2), quick stop ramp (0x6085, 500 mm/s2)."""
    bench.write(DRIVE, objects.ABORT_CONNECTION_OPTION, 0, 1, 2)
    bench.write(DRIVE, objects.FAULT_REACTION_OPTION, 0, reaction, 2)
    bench.drive(500, ENABLE, 10.0)
    before = bench.rig.truth.stroke_mm
    bench.nmt(PRE_OPERATIONAL, DRIVE)
    bench.wait(STANDSTILL_MS)
    assert bench.state() is DriveState.FAULT
    assert bench.rig.truth.stroke_mm - before == pytest.approx(travel_mm, abs=0.02)


def test_a_node_reset_stops_the_motor_and_starts_anew(bench: RigBench) -> None:
    bench.drive(500, ENABLE, 10.0)
    bench.nmt(RESET_NODE, DRIVE)
    assert bench.state() is DriveState.NOT_READY
    bench.wait(STANDSTILL_MS)
    assert bench.state() is DriveState.SWITCH_ON_DISABLED
    assert bench.read(DRIVE, objects.CONSUMER_HEARTBEAT, 1) == 0
    assert bench.read(DRIVE, objects.MODE_DISPLAY) == 0
    assert rests(bench)


def test_a_stopped_node_stops_the_motor(bench: RigBench) -> None:
    bench.drive(500, ENABLE, 10.0)
    bench.nmt(STOP, DRIVE)
    bench.wait(STANDSTILL_MS)
    assert rests(bench)
    bench.nmt(PRE_OPERATIONAL, DRIVE)
    assert bench.state() is DriveState.FAULT


def test_it_is_not_enabled_outside_operational() -> None:
    bench = RigBench()
    bench.wait(1)
    for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON, ENABLE):
        bench.write(DRIVE, objects.CONTROLWORD, 0, word, 2)
    bench.wait(200)
    assert bench.state() is DriveState.SWITCHED_ON
    assert bench.rig.drive.control.stage.braked


def test_short_commands_are_no_commands(bench: RigBench) -> None:
    for _ in range(100):
        bench.send(objects.HEARTBEAT_BASE + 1, b"\x05")
        bench.send(objects.RPDO1_BASE + DRIVE, b"\x0f\x00\x00")
        bench.send(objects.SYNC_COB)
        bench.wait(1)
    assert bench.emergencies(DRIVE)[0] == EmcyCode.RPDO_TIMEOUT


def test_an_rpdo_may_be_moved_and_mapped_anew() -> None:
    bench = RigBench()
    for index, subindex, value, size in (
        (objects.RPDO1_COMMUNICATION, 1, 0x80000204, 4),
        (objects.RPDO1_MAPPING, 0, 0, 1),
        (objects.RPDO1_MAPPING, 1, 0x00050008, 4),  # a dummy byte before the controlword
        (objects.RPDO1_MAPPING, 2, 0x60400010, 4),
        (objects.RPDO1_MAPPING, 0, 2, 1),
        (objects.RPDO1_COMMUNICATION, 1, 0x304, 4),
    ):
        assert bench.write(DRIVE, index, subindex, value, size) == 0
    bench.nmt(START)
    bench.wait(1)
    bench.command(Controlword.SHUTDOWN)
    bench.send(objects.SYNC_COB)
    assert bench.state() is DriveState.SWITCH_ON_DISABLED
    bench.send(0x304, b"\xff\x06\x00")
    bench.send(objects.SYNC_COB)
    assert bench.state() is DriveState.READY_TO_SWITCH_ON
