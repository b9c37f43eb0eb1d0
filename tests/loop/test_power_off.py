"""A power off is reported as confirmed only where something other than the command shows it; judged by the truth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hil.faults import in_device
from hil.faults.in_controller import trip
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from hil.nodes.power_stage import StagePhase
from rigctl.config.io_section import IoSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power.drive_status import CURRENT_NS
from rigctl.control.power.power_off import WAIT_NS
from rigctl.devices.objects import OFF_STATES, Controlword, drive_state
from rigctl.model.device_states import DriveState
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Flag, HeldBy, LoadAtRest, Mode, PowerOff
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import stop_node, texts

WAIT_S = WAIT_NS * 1e-9


def cut(rig: Lockstep, fault: Fault = Fault.DRIVE_NOT_FOLLOWING, action: Action = Action.POWER_OFF) -> None:
    trip(rig, action, fault)


def shown(rig: Lockstep) -> PowerOff:
    return PowerOff(int(rig.record["power_off"]))


def moves_mm(rig: Lockstep, seconds: float = 2.0) -> float:
    before_mm = rig.rig.truth.stroke_mm
    rig.run(seconds)
    return abs(rig.rig.truth.stroke_mm - before_mm)


def without_power(rig: Lockstep) -> bool:
    return rig.rig.drive.control.stage.phase is StagePhase.BRAKED


@pytest.fixture
def fitted(settings: RigSettings, gains: Gains) -> Iterator[Lockstep]:
    """TENSIONING, on a rig with the drive's STO feedback at its I/O node."""
    io = IoSettings(e_stop_input=9, drive_enable_output=0, drive_off_input=10)
    with lockstep(settings.model_copy(update={"io": io}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(0.7)
        rig.events.read()
        yield rig


@pytest.mark.gate("3")
@pytest.mark.parametrize("rig", [Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING], indirect=["rig"])
def test_a_tension_at_rest_confirms_it(rig: Lockstep) -> None:
    rig.events.read()
    cut(rig)
    rig.run(1.0)
    assert shown(rig) is PowerOff.AWAITED
    rig.run(WAIT_S)
    assert shown(rig) is PowerOff.TENSION
    assert without_power(rig)
    assert moves_mm(rig) < 0.01
    (line,) = texts(rig, Kind.POWER_OFF)
    assert "confirmed by the drive's state and a tension at rest" in line


def test_on_a_slack_rope_the_drives_own_state_and_stroke_confirm_it(rig: Lockstep) -> None:
    assert rig.command(Verb.ARM) is Refusal.NONE
    assert rig.view.slack
    cut(rig)
    rig.run(WAIT_S - 1.0)
    assert shown(rig) is PowerOff.STROKE
    assert without_power(rig)


@pytest.mark.starts_in(Mode.TENSIONING)
def test_a_drive_that_goes_on_is_not_confirmed_whatever_it_reports(rig: Lockstep) -> None:
    """Its firmware has failed: the motor turns at its last speed, its state is as it was."""
    rig.events.read()
    rig.rig.drive.hung = True
    rig.run(1.0 + WAIT_S)
    assert rig.view.action >= Action.POWER_OFF
    assert not without_power(rig)
    assert shown(rig) is PowerOff.UNCONFIRMED
    (line,) = texts(rig, Kind.POWER_OFF)
    assert "UNCONFIRMED" in line
    assert "emergency stop" in line


@pytest.mark.gate("True-3")
@pytest.mark.parametrize("rig", [Mode.COMPENSATING], indirect=["rig"])
@pytest.mark.parametrize("silent", [False, True])
def test_a_load_at_rest_is_no_power_off_while_the_motor_may_carry_it(rig: Lockstep, silent: bool) -> None:
    """The firmware has failed with the motor at rest: it reports OPERATION ENABLED, or is not heard after NMT stop."""
    assert rig.command(Verb.HOLD) is Refusal.NONE
    rig.run(0.2)
    rig.rig.drive.hung = True
    trip(rig, Action.SILENCE if silent else Action.POWER_OFF, Fault.DRIVE_NOT_FOLLOWING)
    for _ in range(round((WAIT_S + 1.0) * rig.settings.loop.rate_hz)):
        rig.tick()
        assert not shown(rig).confirmed
    assert rig.rig.drive.control.stage.powered
    assert shown(rig) is PowerOff.UNCONFIRMED


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_motor_that_carries_is_on_whatever_its_drive_reports(rig: Lockstep) -> None:
    """It was held by the brake with the drive off, and the DISARM was confirmed."""
    assert rig.command(Verb.HOLD) is Refusal.NONE
    rig.run(0.2)
    in_device.lies_off()(Stand(rig, "lies off"))
    disarmed = rig.give(Verb.DISARM)
    records = rig.run(CURRENT_NS * 1e-9)
    assert drive_state(int(records["statusword"][-1])) in OFF_STATES  # by its own report
    assert HeldBy.BRAKE not in records["held_by"]
    assert rig.reply_to(disarmed) is None
    rig.run(1.5)
    assert rig.loop.machine.fault is Fault.DRIVE_UNASKED


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_cell_in_doubt_confirms_nothing(rig: Lockstep) -> None:
    rig.events.read()
    cut(rig, Fault.LOAD_UNSEEN)
    rig.run(WAIT_S + 0.5)
    assert shown(rig) is PowerOff.UNCONFIRMED


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_load_that_moves_again_with_the_motor_withdraws_it(rig: Lockstep) -> None:
    cut(rig)
    rig.run(WAIT_S)
    assert shown(rig) is PowerOff.TENSION
    rig.events.read()
    rig.rig.drive.defect = lambda _speed, _held: (-0.5, False)
    rig.run(1.0)
    assert shown(rig) is PowerOff.UNCONFIRMED
    assert len(texts(rig, Kind.POWER_OFF)) == 1


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_load_that_creeps_withdraws_it_for_good(rig: Lockstep) -> None:
    """At 0.03 mm/s the tension stays within what counts as rest for longer than a rest has to last."""
    cut(rig)
    rig.run(WAIT_S)
    assert shown(rig) is PowerOff.TENSION
    rig.events.read()
    in_device.brake_slips(0.03)(Stand(rig, "creeps"))
    rig.run(1.0)
    for _ in range(round(8.0 * rig.settings.loop.rate_hz)):
        rig.tick()
        assert shown(rig) is PowerOff.UNCONFIRMED
    assert len(texts(rig, Kind.POWER_OFF)) == 1


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_cell_that_sticks_behind_another_cause_confirms_nothing(rig: Lockstep) -> None:
    """The load goes on, and the latched fault is another than the cell's."""
    at = Stand(rig, "stuck behind")
    in_device.stuck(in_device.CELL)(at)
    rig.rig.drive.defect = lambda _speed, _held: (-0.5, False)
    cut(rig)
    for _ in range(round((WAIT_S + 1.0) * rig.settings.loop.rate_hz)):
        rig.tick()
        assert not shown(rig).confirmed
        assert rig.record["load_at_rest"] not in (LoadAtRest.TENSION, LoadAtRest.BOTH)
    assert rig.loop.machine.fault is Fault.DRIVE_NOT_FOLLOWING


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_drive_that_is_not_shown_to_be_off_keeps_its_supervision(rig: Lockstep) -> None:
    """What `rigctl.control.control_process` asks before it ends the supervision at the end of a loop."""
    rig.rig.drive.hung = True
    cut(rig)
    rig.run(WAIT_S + 0.5)
    assert shown(rig) is PowerOff.UNCONFIRMED
    rig.loop.stop_requested = True
    while not rig.loop.finished:
        rig.tick()
    assert not rig.loop.drive_off


def test_one_that_is_not_heard_keeps_it_too(rig: Lockstep) -> None:
    rig.run(1.0)
    assert rig.loop.drive_off
    stop_node(rig, rig.settings.cylinder.node)
    rig.run(0.1)
    assert not rig.loop.drive_off


def test_the_drives_feedback_at_the_io_node_confirms_it_at_once(fitted: Lockstep) -> None:
    cut(fitted)
    fitted.run(0.6)
    assert shown(fitted) is PowerOff.INPUT
    assert without_power(fitted)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_stroke_that_goes_on_is_on_no_brake_before_its_power_is_cut(rig: Lockstep) -> None:
    """The drive reports READY TO SWITCH ON as soon as it stops; its ramp ends at standstill, which does not come."""
    cut(rig, Fault.CELL_STALE, Action.HOLD)
    rig.run(0.15)
    in_device.torque_lost(free=False)(Stand(rig, "shorted"))
    for _ in range(6500):  # what has sunk in the last 5 s is not at rest
        rig.tick()
        if rig.record["held_by"] == HeldBy.BRAKE:
            assert not rig.rig.drive.control.stage.powered
    assert rig.record["held_by"] == HeldBy.BRAKE


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_reset_ends_the_report(rig: Lockstep) -> None:
    cut(rig)
    rig.run(WAIT_S)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.1)
    assert shown(rig) is PowerOff.NONE


LEADS_TO_POWER = (Controlword.SWITCH_ON, Controlword.ENABLE_OPERATION)


def shows_off(records: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Ticks whose record states that the drive is without power, in any way."""
    confirmed = [int(power_off) for power_off in PowerOff if power_off.confirmed]
    shown = np.isin(records["power_off"], confirmed) | (records["held_by"] == HeldBy.BRAKE)
    off: npt.NDArray[np.bool_] = shown | (records["flags"] & Flag.DRIVE_OFF != 0)
    return off


def withdrawn_by(rig: Lockstep, verb: Verb, *values: float) -> None:
    """The drive is stated to be off until a command, and not in the tick that sends the first word that leads to power.

    Nor in any tick after it.
    """
    assert shows_off(rig.run(0.05)).all()
    assert rig.command(verb, *values) is Refusal.NONE
    records = rig.read_records()
    on = np.flatnonzero(np.isin(records["controlword"], LEADS_TO_POWER))
    assert len(on), "no such word was sent"
    assert not shows_off(records[on[0] :]).any()


@pytest.mark.starts_in(Mode.DISARMED)
def test_arming_withdraws_it_with_the_first_word_that_leads_to_power(rig: Lockstep) -> None:
    rig.run(0.5)
    withdrawn_by(rig, Verb.ARM)


@pytest.mark.starts_in(Mode.HOLD)
def test_taking_the_load_back_from_the_brake_withdraws_it(rig: Lockstep) -> None:
    rig.run(4.0)
    assert rig.record["held_by"] == HeldBy.BRAKE
    withdrawn_by(rig, Verb.TENSION)


def test_carrying_a_load_that_the_brake_does_not_hold_withdraws_a_power_off_that_was_confirmed(
    fitted: Lockstep,
) -> None:
    cut(fitted)
    fitted.run(0.6)
    assert shown(fitted) is PowerOff.INPUT
    fitted.rig.drive.brake.slip_mm_s = 0.3
    fitted.run(2.0)
    assert shown(fitted) is PowerOff.INPUT, "the load sinks on its brake, without power"
    withdrawn_by(fitted, Verb.CARRY, 5.0)


@pytest.mark.starts_in(Mode.DISARMED)
def test_it_is_not_made_again_before_the_brakes_time_after_the_last_such_word(rig: Lockstep) -> None:
    """The drive acts on its commands late: its state is still off when HOLD has ended the arming."""
    rig.run(0.5)
    rig.give(Verb.ARM)
    for _ in range(5_000):
        if rig.rig.drive.control.state is DriveState.READY_TO_SWITCH_ON:
            rig.rig.drive.rpdo_defect = lambda _command: None
        if rig.record["controlword"] in LEADS_TO_POWER:
            break
        rig.tick()
    assert rig.view.taking
    assert rig.command(Verb.HOLD) is Refusal.NONE
    brake_s = rig.settings.cylinder.brake_delay_ms * 1e-3
    assert not shows_off(rig.run(brake_s - 0.01)).any()
    assert shows_off(rig.run(0.02))[-1]
