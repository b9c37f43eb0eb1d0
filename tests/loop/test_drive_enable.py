"""The hard-wired enable at an I/O node: set to drive, dropped as the last resort and with the node; by the truth."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hil.lockstep import Lockstep, lockstep
from hil.nodes import io_node
from hil.nodes.power_stage import StagePhase
from rigctl.config.io_section import IoSettings
from rigctl.config.settings import RigSettings
from rigctl.control.clock import SimulatedClock
from rigctl.control.law.tension import Gains
from rigctl.devices import objects, startup
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.rig_bench import changed

IO = IoSettings(e_stop_input=9, drive_enable_output=0, drive_off_input=10)
MOVING = (Mode.TENSIONING, Mode.RELEASING)
ARMED = (Mode.HOLD, *MOVING, Mode.COMPENSATING)
Enter = Callable[[Mode], None]


def wired(settings: RigSettings) -> RigSettings:
    return changed(settings.model_copy(update={"io": IO}), hold={"park_s": 0.5})


@pytest.fixture
def rig_settings(settings: RigSettings) -> RigSettings:
    """The paper's, with the output wired."""
    return wired(settings)


def enables(rig: Lockstep) -> bool:
    assert rig.rig.io is not None
    return rig.rig.io.enables


def braked(rig: Lockstep) -> bool:
    return rig.rig.drive.control.stage.phase is StagePhase.BRAKED


def test_the_output_is_set_to_drive_and_dropped_only_once_the_brake_has_closed(rig: Lockstep, enter: Enter) -> None:
    assert not enables(rig)
    enter(Mode.HOLD)
    assert enables(rig)
    before = rig.rig.truth
    while enables(rig):
        rig.tick()
        assert enables(rig) or (rig.rig.drive.brake.closed and braked(rig))
    assert rig.rig.truth.stroke_mm == pytest.approx(before.stroke_mm, abs=0.01)
    assert rig.command(Verb.TENSION) is Refusal.NONE, "the load is taken back"
    assert enables(rig)
    rig.run(1.0)
    assert rig.loop.machine.fault is Fault.NONE


@pytest.mark.gate("2")
@pytest.mark.parametrize("rig", MOVING, indirect=["rig"])
def test_a_drive_that_reacts_to_nothing_is_stopped_by_the_output(rig: Lockstep) -> None:
    rig.rig.drive.hung = True
    while rig.loop.machine.fault is Fault.NONE:
        rig.tick()
    before_mm = rig.rig.truth.stroke_mm
    rig.run(0.5)
    assert rig.view.action is Action.SILENCE
    assert not enables(rig)
    assert braked(rig)
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=1.5)


@pytest.mark.study
def test_without_the_output_such_a_drive_runs_on(settings: RigSettings, gains: Gains) -> None:
    """The control: what the test above shows is the output's doing."""
    with lockstep(settings, gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(0.5)
        rig.rig.drive.hung = True
        rig.run(2.0)
        assert rig.view.action is Action.SILENCE
        assert not braked(rig)


@pytest.mark.gate("2")
@pytest.mark.parametrize("rig", ARMED, indirect=["rig"])
def test_a_node_that_dies_takes_the_drives_torque_with_it(rig: Lockstep) -> None:
    assert rig.rig.io is not None
    before_mm = rig.rig.truth.stroke_mm
    rig.rig.io.switch_off()
    rig.run(0.3)
    assert braked(rig)
    assert rig.loop.machine.mode is Mode.FAULT
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=1.0)


@pytest.mark.starts_in(Mode.TENSIONING)
def test_the_node_drops_the_output_when_our_heartbeat_ends(rig: Lockstep) -> None:
    """Even for a drive that does not watch the heartbeat itself: the loop is dead, nothing is sent."""
    rig.rig.drive.hung = True
    for _ in range(rig.settings.cylinder.heartbeat_timeout_ms + 300):
        SimulatedClock.next_tick(rig.clock)
    assert not enables(rig)
    assert braked(rig)


@pytest.mark.study
@pytest.mark.starts_in(Mode.HOLD)
def test_a_relay_that_does_not_open_is_found_and_bars_the_way_on(rig: Lockstep) -> None:
    assert rig.rig.io is not None
    rig.rig.io.welded = True
    rig.run(2.5)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.ENABLE_IGNORED)
    assert braked(rig)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    rig.rig.io.welded = False
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE


def test_a_rig_whose_output_is_bridged_does_not_arm(rig: Lockstep) -> None:
    assert rig.rig.io is not None
    rig.rig.io.readers[objects.INPUTS_8, 2] = lambda: 0b010  # e-stop closed, the drive has torque
    rig.rig.io._tpdos.clear()
    rig.run(0.6)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.ENABLE_IGNORED


def test_a_feedback_that_shows_no_torque_ends_the_arming(rig: Lockstep) -> None:
    assert rig.rig.io is not None
    rig.rig.io.readers[objects.INPUTS_8, 2] = lambda: 0b110
    rig.rig.io._tpdos.clear()
    rig.run(0.1)
    rig.command(Verb.ARM)
    rig.run(1.0)
    assert rig.loop.machine.fault is Fault.ENABLE_IGNORED
    assert braked(rig)


def test_the_daemons_start_leaves_the_output_off_and_has_the_node_watch_us(rig: Lockstep) -> None:
    assert rig.rig.io is not None
    device = rig.rig.io.device
    assert device.sdo[objects.CONSUMER_HEARTBEAT][1].raw == startup.consumer_heartbeat(rig.settings)
    assert device.sdo[objects.OUTPUT_ERROR_VALUE_8][1].raw == 0
    assert {(item.node, item.index) for item in rig.report.watched} >= {(IO.node, objects.CONSUMER_HEARTBEAT)}
    assert not enables(rig)


def test_a_node_whose_file_has_no_such_output_is_refused_by_the_objects(settings: RigSettings, gains: Gains) -> None:
    io = IO.model_copy(update={"drive_enable_output": 8})
    refused = pytest.raises(
        startup.StartupError, match=r"io_node\.eds: io\.eds: found no objects 0x6200:02, 0x6206:02, "
    )
    with refused, lockstep(settings.model_copy(update={"io": io}), gains):
        pass


def test_a_node_without_outputs_is_refused_by_name(
    settings: RigSettings, gains: Gains, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = io_node.IoNode.__init__

    def without(self: io_node.IoNode, *arguments: object) -> None:
        made(self, *arguments)  # type: ignore[arg-type]
        self.readers[objects.OUTPUTS_8, 0] = lambda: 0

    monkeypatch.setattr(io_node.IoNode, "__init__", without)
    words = rf"found 0 outputs, .* io.drive_enable_output \({IO.drive_enable_output}\)"
    refused = pytest.raises(startup.StartupError, match=words)
    with refused, lockstep(settings.model_copy(update={"io": IO}), gains):
        pass
