"""The emergency stop at an I/O node: pressed or silent, in every mode, and the node's start-up."""

from __future__ import annotations

import pytest

from hil.faults import on_bus
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from hil.nodes import io_node
from hil.nodes.io_node import IoNode
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.config.io_section import IoSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.devices import objects, startup
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.signals import STATUS, WATCHED
from rigctl.model.states import EStop, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import latched

IO = IoSettings(e_stop_input=9)
ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)


def fitted(settings: RigSettings, **changes: object) -> RigSettings:
    return settings.model_copy(update={"io": IO.model_copy(update=changes)})


@pytest.fixture
def rig_settings(settings: RigSettings) -> RigSettings:
    """The paper's, with an I/O node."""
    return fitted(settings)


def node(rig: Lockstep) -> IoNode:
    assert rig.rig.io is not None
    return rig.rig.io


def silence(rig: Lockstep) -> None:
    """Drop the frames of the node's inputs from now on."""
    on_bus.silent(on_bus.io)(Stand(rig, "silent"))


def ticks_until_fault(rig: Lockstep, most: int) -> int:
    for tick in range(1, most + 1):
        rig.loop.tick()
        if rig.loop.machine.fault is not Fault.NONE:
            return tick
    raise AssertionError(f"no fault within {most} ticks")


def trip_value(rig: Lockstep) -> float:
    (trip,) = [event for event in rig.events.read() if event["kind"] == Kind.TRIP]
    return float(trip["value"])


@pytest.mark.gate("1", "3")
@pytest.mark.parametrize("mode", ARMED)
@pytest.mark.starts_in("mode")
def test_pressed_at_the_io_node_alone_the_loop_stops_the_drive_and_latches(rig: Lockstep, mode: Mode) -> None:
    rig.events.read()
    before = rig.rig.truth
    node(rig).press_e_stop(True)
    assert ticks_until_fault(rig, 7) <= IO.inhibit_ms + 2
    assert latched(rig) == (Mode.FAULT, Fault.E_STOP, Action.QUICK_STOP)
    assert trip_value(rig) == EStop.IO_NODE
    assert not rig.loop.inbox.drive_status.e_stop  # the drive's own input, which is not open
    assert rig.rig.drive.errors == ()
    rig.run(0.5)
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED
    stands = rig.rig.truth
    rig.run(1.0)
    assert rig.rig.truth.stroke_mm == stands.stroke_mm
    assert abs(stands.stroke_mm - before.stroke_mm) < 0.4  # 10 mm/s: 0.1 mm of ramp, 0.2 mm of lag
    if mode is not Mode.HOLD:
        assert stands.tension_n == pytest.approx(before.tension_n, abs=5.0)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.E_STOP
    node(rig).press_e_stop(False)
    rig.run(0.1)
    assert rig.loop.machine.fault is Fault.E_STOP  # latched
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.2)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.DISARMED, Fault.NONE)
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED, "a reset switches nothing on"
    assert rig.command(Verb.ARM) is Refusal.NONE


def test_while_disarmed_it_is_latched_too_and_nobody_arms(rig: Lockstep) -> None:
    node(rig).press_e_stop(True)
    ticks_until_fault(rig, IO.inhibit_ms + 2)
    assert rig.loop.machine.fault is Fault.E_STOP
    assert rig.command(Verb.ARM) is Refusal.WRONG_MODE
    assert Check(int(rig.run(0.6)["checks"][-1])) == Check.E_STOP_IO
    node(rig).press_e_stop(False)
    rig.run(0.6)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.2)
    assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_in_fault_under_power_a_press_still_takes_the_drive_to_its_brake(rig: Lockstep) -> None:
    on_bus.silent(on_bus.cell)(Stand(rig, "silent"))
    rig.run(0.05)
    rig.hub.tap = None
    rig.run(0.2)
    assert rig.loop.machine.fault is Fault.CELL_STALE
    assert rig.rig.drive.control.enabled
    node(rig).press_e_stop(True)
    rig.run(0.5)
    assert (rig.loop.machine.fault, rig.view.action) == (Fault.CELL_STALE, Action.QUICK_STOP)
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.E_STOP


@pytest.mark.starts_in(Mode.HOLD)
def test_the_button_itself_opens_both_and_either_alone_keeps_the_reset_away(rig: Lockstep) -> None:
    rig.rig.drive.press_e_stop(True)
    node(rig).press_e_stop(True)
    rig.run(0.5)
    assert rig.view.e_stop == EStop.DRIVE | EStop.IO_NODE
    assert Check(int(rig.run(0.6)["checks"][-1])) & (Check.E_STOP | Check.E_STOP_IO) == Check.E_STOP | Check.E_STOP_IO
    rig.rig.drive.press_e_stop(False)
    rig.run(0.2)
    assert rig.view.e_stop == EStop.IO_NODE
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    node(rig).press_e_stop(False)
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE


@pytest.mark.gate("2", "4")
@pytest.mark.parametrize("mode", ARMED)
@pytest.mark.starts_in("mode")
def test_a_silent_node_ends_with_the_stroke_held_until_it_is_heard_again(rig: Lockstep, mode: Mode) -> None:
    before = rig.rig.truth
    silence(rig)
    ticks = ticks_until_fault(rig, IO.stale_ms + 2)
    assert ticks > IO.stale_ms - IO.event_ms - 2  # the last sample may be as old as the event timer
    assert latched(rig) == (Mode.FAULT, Fault.E_STOP_UNSEEN, Action.HOLD)
    tripped = rig.rig.truth
    rig.run(0.5)
    assert rig.view.action is Action.HOLD  # stopped by the motor: the stop is not known to be pressed
    assert rig.rig.truth.stroke_mm == pytest.approx(tripped.stroke_mm, abs=0.3)
    if mode in (Mode.HOLD, Mode.COMPENSATING):
        assert rig.rig.truth.tension_n == pytest.approx(before.tension_n, abs=1.0)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.E_STOP_UNSEEN
    rig.hub.tap = None
    rig.run(0.1)
    assert rig.loop.machine.fault is Fault.E_STOP_UNSEEN  # latched
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert rig.loop.machine.mode is Mode.HOLD


def test_arming_is_refused_while_its_input_is_not_seen(rig: Lockstep) -> None:
    silence(rig)
    rig.run(0.2)
    assert rig.loop.machine.mode is Mode.DISARMED
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.E_STOP_IO_UNSEEN
    rig.hub.tap = None
    rig.run(0.05)
    assert rig.command(Verb.ARM) is Refusal.NONE


def test_pressed_and_then_silent_it_stays_pressed(rig: Lockstep) -> None:
    node(rig).press_e_stop(True)
    rig.run(0.02)
    silence(rig)
    node(rig).press_e_stop(False)  # the message does not get through
    rig.run(0.6)
    assert rig.view.e_stop == EStop.IO_NODE
    checks = Check(int(rig.run(0.6)["checks"][-1]))
    assert checks == Check.E_STOP_IO | Check.E_STOP_IO_UNSEEN
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_node_that_starts_anew_has_lost_its_settings_and_the_daemon_is_to_be_started_anew(rig: Lockstep) -> None:
    node(rig).reset_node()
    rig.run(0.01)
    assert rig.loop.machine.fault is Fault.DEVICE_RESTARTED
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT


@pytest.mark.starts_in(Mode.HOLD)
def test_lost_frames_are_ridden_through(rig: Lockstep) -> None:
    inputs, came = objects.TPDO1_BASE + IO.node, [0]

    def tap(_: object, frame: bytes) -> tuple[bytes, ...]:
        if FRAME.unpack(frame)[0] != inputs:
            return (frame,)
        came[0] += 1
        return (frame,) if came[0] % 4 == 0 else ()  # three of four are lost

    rig.hub.tap = tap
    rig.run(3.0)
    assert rig.loop.machine.mode is Mode.HOLD


def test_without_the_drives_input_the_io_node_is_the_only_eye(settings: RigSettings, gains: Gains) -> None:
    without = {"status_rate_hz": None, "rated_current_a": None, "e_stop_input": None}
    limits = [limit for limit in settings.limits if WATCHED[limit.signal].age != STATUS]
    cylinder = settings.cylinder.model_copy(update=without)
    blind = settings.model_copy(update={"cylinder": cylinder, "limits": limits})
    with lockstep(fitted(blind), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        node(rig).press_e_stop(True)
        ticks_until_fault(rig, IO.inhibit_ms + 2)
        assert rig.loop.machine.fault is Fault.E_STOP


def test_start_up_sets_the_node_to_send_by_itself_and_reads_it_back(rig: Lockstep) -> None:
    (found,) = [device for device in rig.report.devices if device.name == "I/O node"]
    assert isinstance(found, startup.Device)
    assert (found.node, found.device_type) == (IO.node, objects.DEVICE_TYPE_401)
    sdo = node(rig).device.sdo
    communication, mapping = sdo[objects.TPDO1_COMMUNICATION], sdo[objects.TPDO1_MAPPING]
    assert [communication[sub].raw for sub in (1, 2, 3, 5)] == [0x186, 255, 50, 20]  # 5 ms, 20 ms
    assert [mapping[sub].raw for sub in (0, 1)] == [1, 0x60000208]  # input 9: the second block alone
    assert sdo[objects.PRODUCER_HEARTBEAT].raw == startup.DEVICE_HEARTBEAT_MS


@pytest.mark.parametrize(
    ("index", "sub", "value", "words"),
    [
        (objects.DEVICE_TYPE, 0, 0x00020191, "found 0x20191, expected one with digital inputs"),
        (objects.DEVICE_TYPE, 0, 0x00020194, "found CiA profile 404, expected 401"),
        (objects.INPUTS_8, 0, 1, "found 8 inputs, expected more than io.e_stop_input (9)"),
        (objects.INPUT_POLARITY_8, 2, 2, "object 0x6002:02: found 0x2, expected 0x0"),
        (objects.INPUT_EVENT_MASK_8, 2, 0, "object 0x6006:02: found 0x0, expected 0xff"),
        (objects.TPDO1_COMMUNICATION, 5, 0, "object 0x1800:05: found 0x0, expected 0x14"),
    ],
)
def test_a_node_that_is_another_or_keeps_settings_of_its_own_ends_the_start(
    settings: RigSettings, gains: Gains, monkeypatch: pytest.MonkeyPatch, index: int, sub: int, value: int, words: str
) -> None:
    made = io_node.IoNode.__init__

    def odd(self: IoNode, *arguments: object) -> None:
        made(self, *arguments)  # type: ignore[arg-type]
        self.readers[index, sub] = lambda: value

    monkeypatch.setattr(io_node.IoNode, "__init__", odd)
    with pytest.raises(startup.StartupError) as error, lockstep(fitted(settings), gains):
        pass
    said = str(error.value)
    assert said.startswith("I/O node (node 6)")
    assert words in said
    assert "\n" not in said


def test_an_input_that_the_node_has_not_got_ends_the_start(settings: RigSettings, gains: Gains) -> None:
    with (
        pytest.raises(startup.StartupError, match=r"io_node\.eds: io\.eds: found no object 0x6000:03, expected it"),
        lockstep(fitted(settings, e_stop_input=16), gains),
    ):
        pass


def test_a_node_that_is_not_there_ends_the_start_with_its_name(settings: RigSettings, gains: Gains) -> None:
    with (
        pytest.raises(startup.StartupError, match=r"I/O node \(node 7\) does not answer"),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("hil.nodes.io_node.IoNode._on_sdo", lambda *_: None)
        with lockstep(fitted(settings, node=7), gains):
            pass
