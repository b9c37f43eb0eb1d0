"""Devices that go silent, boot, fail or say what cannot be: the loop holds the load, latched where it must be."""

from __future__ import annotations

import numpy as np
import pytest

from hil.lockstep import Lockstep
from rigctl.devices import objects as od
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.samples import Quality
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import assert_held, events, frame, nmt, stop_node

ACTIVE = [Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING]


@pytest.mark.gate("tension_cell-3-1", "tension_cell-3-2", "inclinometer-5-3", "cylinder-7-4", "cylinder-7-2")
@pytest.mark.parametrize("rig", ACTIVE, indirect=["rig"])
@pytest.mark.parametrize(
    ("device", "fault"),
    [("tension_cell", Fault.CELL_STALE), ("inclinometer", Fault.INCLINATION_STALE), ("cylinder", Fault.DRIVE_STALE)],
)
def test_a_device_that_goes_silent_ends_in_hold_latched(rig: Lockstep, device: str, fault: Fault) -> None:
    stop_node(rig, getattr(rig.settings, device).node)
    limit = rig.settings.safety.inclination_stale_ms if device == "inclinometer" else rig.settings.safety.stale_ms
    records = rig.run((limit + 25) * 1e-3)
    assert records["mode"][-1] == Mode.FAULT
    stopped = Fault.NODE_NOT_OPERATIONAL  # the heartbeat may report it before the samples are too old
    assert records["fault"][-1] in (fault, stopped)
    tripped = int(np.argmax(records["mode"] == Mode.FAULT))
    assert tripped <= limit + (11 if device == "inclinometer" else 2)
    assert_held(rig, float(records["tension_n"][tripped]), float(records["stroke_mm"][tripped]))
    if device != "cylinder":  # a silent drive is left to its own supervision, and a reset starts it up again
        assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.command(Verb.TENSION) is Refusal.WRONG_MODE


@pytest.mark.starts_in(Mode.HOLD)
def test_a_drive_that_stays_silent_is_left_to_its_own_supervision(rig: Lockstep) -> None:
    rig.events.read()
    stop_node(rig, rig.settings.cylinder.node)
    rig.run(0.05)
    assert rig.view.action is Action.HOLD  # a burst of lost frames is over by then
    rig.run(0.4)
    assert rig.view.action is Action.SILENCE
    assert events(rig).count(Kind.ESCALATION) == 2  # quick stop, then silence


def test_a_sample_that_does_not_come_grows_older_by_a_tick_each_tick(rig: Lockstep) -> None:
    stop_node(rig, rig.settings.tension_cell.node)
    ages = rig.run(0.05)["tension_age_ns"][5:]
    assert np.array_equal(ages - ages[0], np.arange(len(ages)) * rig.settings.loop.period_ns)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_fault_is_left_by_a_reset_once_its_cause_is_gone(rig: Lockstep) -> None:
    stop_node(rig, rig.settings.tension_cell.node)
    rig.run(0.1)
    assert rig.loop.machine.mode == Mode.FAULT
    rig.rig.receive(nmt(1, rig.settings.tension_cell.node))
    rig.run(0.5)
    assert rig.loop.machine.mode == Mode.FAULT
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert rig.loop.machine.mode == Mode.HOLD
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run_until(Mode.COMPENSATING, 5.0)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_drive_fault_is_latched_and_reset_clears_both(rig: Lockstep) -> None:
    before = rig.rig.truth
    stop_node(rig, rig.settings.cylinder.node)
    rig.rig.receive(nmt(1, rig.settings.cylinder.node))
    rig.run(0.2)
    assert rig.loop.machine.mode == Mode.FAULT
    assert_held(rig, before.tension_n, before.stroke_mm)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.2)
    assert rig.loop.machine.mode == Mode.DISARMED
    assert_held(rig, before.tension_n, before.stroke_mm)
    assert rig.command(Verb.ARM) is Refusal.NONE
    assert rig.loop.machine.mode == Mode.HOLD


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_overload_of_the_cell_trips_and_keeps_the_fault_until_it_is_over(rig: Lockstep) -> None:
    before = rig.rig.truth
    cell = rig.settings.tension_cell.node
    stop_node(rig, cell)
    data = od.CELL_TPDO.codec.pack(500_000, od.AiStatus.POSITIVE_OVERLOAD)
    overload = (od.TPDO1_BASE + cell).to_bytes(4, "little") + bytes([5, 0, 0, 0]) + data + bytes(3)
    rig.inject(overload)
    rig.loop.tick()
    assert rig.loop.machine.fault is Fault.CELL_INVALID
    assert rig.loop.inbox.cell.quality == Quality.SATURATED
    assert_held(rig, before.tension_n, before.stroke_mm)
    rig.inject(overload)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    rig.rig.receive(nmt(1, cell))
    rig.run(1.0)  # the heartbeat reports it operational again, and its settings are read back
    assert rig.command(Verb.RESET) is Refusal.NONE


@pytest.mark.parametrize("device", ["tension_cell", "inclinometer", "cylinder"])
def test_arming_is_refused_while_a_device_is_silent(rig: Lockstep, device: str) -> None:
    stop_node(rig, getattr(rig.settings, device).node)
    rig.run(0.2)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.loop.machine.mode == Mode.DISARMED


@pytest.mark.parametrize("command", [0x81, 0x82])
def test_a_device_that_booted_has_lost_its_settings_and_cannot_be_armed(rig: Lockstep, command: int) -> None:
    drive = rig.settings.cylinder.node
    rig.rig.receive(nmt(command, drive))
    rig.rig.receive(nmt(1, drive))
    rig.run(0.2)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.loop.machine.mode is Mode.DISARMED


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_device_that_boots_while_compensating_trips(rig: Lockstep) -> None:
    before = rig.rig.truth
    cell = rig.settings.tension_cell.node
    rig.rig.receive(nmt(0x82, cell))
    rig.rig.receive(nmt(1, cell))
    records = rig.run(0.1)
    assert records["fault"][-1] == Fault.DEVICE_RESTARTED
    assert_held(rig, before.tension_n, before.stroke_mm)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT


@pytest.mark.parametrize("angle_deg", [31.0, 60.0, 120.0, -180.0])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_an_inclination_beyond_the_sensors_range_never_reaches_the_law(rig: Lockstep, angle_deg: float) -> None:
    before = rig.rig.truth
    slope = rig.settings.inclinometer.node
    stop_node(rig, slope)
    rig.inject(frame(od.TPDO1_BASE + slope, od.SLOPE_TPDO.codec.pack(round(angle_deg * 100), 0)))
    records = rig.run(0.01)
    assert records["fault"][-1] == Fault.INCLINATION_INVALID
    assert records["inclination_quality"][-1] == Quality.INVALID
    assert_held(rig, before.tension_n, before.stroke_mm)


@pytest.mark.parametrize("tension_n", [20_000.0, 2_147_000.0, -2_147_000.0])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_one_sample_beyond_the_cells_range_trips_and_moves_nothing(rig: Lockstep, tension_n: float) -> None:
    before = rig.rig.truth
    rig.inject(frame(od.TPDO1_BASE + rig.settings.tension_cell.node, od.CELL_TPDO.codec.pack(int(tension_n * 1e3), 0)))
    records = rig.run(0.01)
    assert records["fault"][-1] in (Fault.CELL_INVALID, Fault.NONE)  # a good sample in the same tick replaces it
    assert_held(rig, before.tension_n, before.stroke_mm)


@pytest.mark.starts_in(Mode.TENSIONING)
def test_a_tension_lost_while_tensioning_stops_the_cylinder(rig: Lockstep) -> None:
    cell = rig.settings.tension_cell.node
    stop_node(rig, cell)
    before = rig.rig.truth
    for n in range(60):
        rig.inject(frame(od.TPDO1_BASE + cell, od.CELL_TPDO.codec.pack(20 + n % 2, 0)))
        rig.loop.tick()
    assert rig.loop.machine.fault in (Fault.LIMIT, Fault.STRETCH_UNEXPLAINED)  # its rate, or that no stroke explains it
    assert rig.rig.truth.stroke_mm - before.stroke_mm < 1.0


@pytest.mark.starts_in(Mode.HOLD)
def test_a_drive_that_moves_by_somebody_elses_command_trips(rig: Lockstep) -> None:
    for _ in range(400):
        rig.inject(frame(od.RPDO1_BASE + rig.settings.cylinder.node, od.DRIVE_RPDO.codec.pack(0x0F, -5000)))
        rig.inject(frame(od.SYNC_COB, b""))
        rig.loop.tick()
    assert rig.loop.machine.fault is Fault.RIVAL
