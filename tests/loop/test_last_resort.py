"""A command without effect is followed by silence, so that the drive stops by itself; judged by the plant's truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator

import pytest

from hil.faults import on_bus
from hil.faults.rows.arming_phases import PHASES, arm_until
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep, lockstep
from hil.nodes.power_stage import StagePhase
from hil.operated_rig import arm_and_tension
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.control.bus.outbox import CUTS, NMT_STOPS
from rigctl.control.law.tension import Gains
from rigctl.control.watch.escalation import ANSWER_NS, BLIND_MM
from rigctl.devices import objects as od
from rigctl.model.device_states import NmtState
from rigctl.model.events import worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.branches import Started
from tests.builders.loop_frames import latched
from tests.builders.rig_bench import changed

Inject = Callable[[Lockstep], None]
RAMPS = (Mode.TENSIONING, Mode.RELEASING)  # the catalogue plays them too
ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
DEAD_TICKS = 1500


def can_id(frame: bytes) -> int:
    return int(FRAME.unpack(frame)[0])


def injected(fault: Injector) -> Inject:
    def inject(rig: Lockstep) -> None:
        fault(Stand(rig, "command path"))

    return inject


sync_lost = injected(on_bus.sync_lost())


def command_late(ticks: int) -> Inject:
    """The drive's commands arrive so many ticks late; the first one repeats until then."""

    def inject(rig: Lockstep) -> None:
        ours, waiting = command_id(rig), deque[bytes]()

        def tap(_: object, frame: bytes) -> Iterable[bytes]:
            if can_id(frame) != ours:
                return (frame,)
            waiting.append(frame)
            return (waiting.popleft() if len(waiting) > ticks else waiting[0],)

        rig.hub.tap = tap

    return inject


def command_id(rig: Lockstep) -> int:
    return od.DRIVE_RPDO.cob_base + rig.settings.cylinder.node


FAULTS: dict[str, Inject] = {
    "sync lost": sync_lost,
    "sync doubled": injected(on_bus.sync_twice()),
    "commands frozen": injected(on_bus.frozen(on_bus.drive, od.DRIVE_RPDO.cob_base)),
    "commands 100 ms late": command_late(100),
    "commands 1 s late": command_late(1000),
    "samples frozen": injected(on_bus.frozen(on_bus.drive)),
    "samples lost": injected(on_bus.silent(on_bus.drive)),
}


def said(rig: Lockstep) -> list[str]:
    found = []
    for event in rig.events.read():
        kind, a, b, value, limit, text = (event[n].item() for n in ("kind", "a", "b", "value", "limit", "text"))
        found.append(worded(kind, a, b, value, limit, text.decode()).text)
    return found


def braked(rig: Lockstep) -> bool:
    return rig.rig.drive.control.stage.phase is StagePhase.BRAKED


def kill_and_see_mm(rig: Lockstep) -> float:
    """Motion of the stroke after the loop has died: what stops only now was not under control."""
    before_mm = rig.rig.truth.stroke_mm
    for _ in range(DEAD_TICKS):
        rig.clock.skip = 1
        rig.clock.next_tick()
    return abs(rig.rig.truth.stroke_mm - before_mm)


@pytest.fixture(scope="module")
def loaded_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(changed(settings, cylinder={"brake_test": True}), gains) as rig:
        rig.run(0.2)
        arm_and_tension(rig, target_n=100.0, limit_s=5.0)
        assert rig.command(Verb.HOLD) is Refusal.NONE
        rig.run(0.3)
        assert rig.command(Verb.DISARM) is Refusal.NONE
        rig.run(1.0)
        rig.events.read()
        yield Started.now(rig)


@pytest.fixture
def loaded(request: pytest.FixtureRequest, loaded_once: Started) -> Lockstep:
    """DISARMED with 100 N on the brake, whose test is part of arming."""
    return loaded_once.go_on(request)


# -- in every mode -------------------------------------------------------------------------------------------------
@pytest.mark.gate("sync doubled-3", "samples frozen-1", "samples lost-1")
@pytest.mark.parametrize(
    "mode", [pytest.param(mode, marks=pytest.mark.long) if mode in RAMPS else mode for mode in ARMED]
)
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.starts_in("mode")
def test_no_fault_of_the_command_path_moves_the_load(rig: Lockstep, mode: Mode, fault: str) -> None:
    """From the trip on the load moves 1 mm at most, and then it does not need the loop's death to stand still."""
    FAULTS[fault](rig)
    tripped_mm = None
    for _ in range(4000):
        rig.tick()
        if rig.loop.machine.fault is not Fault.NONE and tripped_mm is None:
            tripped_mm = rig.rig.truth.stroke_mm
    end_mm = rig.rig.truth.stroke_mm
    if tripped_mm is not None:
        assert end_mm == pytest.approx(tripped_mm, abs=1.0)
        assert braked(rig) or rig.view.action is Action.HOLD
    if tripped_mm is not None or mode is Mode.HOLD:  # a motion that goes on is ridden through, and ends with the loop
        assert kill_and_see_mm(rig) < 0.1


@pytest.mark.gate("2", "4")
@pytest.mark.parametrize("rig", ARMED, indirect=["rig"])
def test_without_sync_the_drive_is_stopped_from_its_last_speed(rig: Lockstep) -> None:
    """From the last SYNC on: the drive repeats its last speed, and neither samples nor commands are exchanged."""
    before_mm = rig.rig.truth.stroke_mm
    sync_lost(rig)
    rig.run(3.0)
    assert latched(rig) == (Mode.FAULT, Fault.SYNC_LOST, Action.SILENCE)
    assert braked(rig)
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=1.0)
    assert kill_and_see_mm(rig) == 0.0


@pytest.mark.gate("2")
@pytest.mark.parametrize("mode", ARMED)
@pytest.mark.starts_in("mode")
def test_a_drive_that_ignores_its_commands_is_left_to_its_own_supervision(rig: Lockstep, mode: Mode) -> None:
    """Heartbeat and commands keep arriving, so only their end on purpose makes the drive stop."""
    said(rig)
    FAULTS["commands frozen"](rig)
    if mode is Mode.HOLD:
        rig.give(Verb.TENSION)
    for _ in range(4000):
        rig.tick()
        if rig.view.action is Action.SILENCE:
            break
    silent_mm = rig.rig.truth.stroke_mm
    rig.run(1.0)
    assert braked(rig)
    assert rig.rig.truth.stroke_mm == pytest.approx(silent_mm, abs=0.5)
    told = said(rig)
    assert any("own supervision" in text for text in told)
    assert not any("power off, brake closed" in text or "can do no more" in text for text in told)


@pytest.mark.parametrize("fault", ["commands lost", "samples frozen"])
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_motor_that_creeps_under_its_own_stop_loses_its_power_by_sdo(rig: Lockstep, fault: str) -> None:
    """The drive's ramp ends at standstill, which a motor that creeps never reaches: it would turn for ever."""
    drive = rig.rig.drive
    if fault == "commands lost":
        drive.rpdo_defect = lambda _: None
    else:
        FAULTS[fault](rig)
    drive.defect = lambda speed_mm_s, braked: (speed_mm_s if braked else speed_mm_s - 5.0, braked)
    while rig.view.action is not Action.SILENCE:
        rig.tick()
    silent_mm = rig.rig.truth.stroke_mm
    rig.run(2.0)
    assert braked(rig)
    assert rig.rig.truth.stroke_mm == pytest.approx(silent_mm, abs=1.0)
    assert rig.view.master_age_ns > 1e9, "the drive's answer is to us"


@pytest.mark.starts_in(Mode.HOLD)
def test_silence_is_power_off_by_sdo_and_nmt_stop_then_sync_alone(rig: Lockstep) -> None:
    heard: list[bytes] = []
    rig.hub.attach(heard.append)
    sync_lost(rig)
    while rig.view.action is not Action.SILENCE:
        rig.tick()
    before = len(heard)
    rig.run(1.0)
    ids = [can_id(frame) for frame in heard[before:]]
    assert ids.count(od.NMT_COB) == NMT_STOPS
    writes = od.SDO_RX_BASE + rig.settings.cylinder.node
    assert ids.count(writes) == CUTS - 1  # the first went out in the tick of the trip
    assert max(i for i, ident in enumerate(ids) if ident == writes) < ids.index(od.NMT_COB), "no SDO after NMT stop"
    controller = od.HEARTBEAT_BASE + rig.settings.can.controller_node
    assert not {controller, command_id(rig)} & set(ids)
    assert {i for i in ids if od.SDO_RX_BASE <= i < od.SDO_RX_BASE + 0x80} == {writes}
    stop = next(frame for frame in heard if can_id(frame) == od.NMT_COB)
    assert FRAME.unpack(stop)[2][:2] == bytes([od.NMT_STOP, rig.settings.cylinder.node])


@pytest.mark.starts_in(Mode.TENSIONING)
def test_a_drive_that_misses_the_nmt_stop_too_stops_by_its_deadline(rig: Lockstep) -> None:
    lost = {od.SYNC_COB, od.NMT_COB}
    before_mm = rig.rig.truth.stroke_mm
    rig.hub.tap = lambda _, frame: () if can_id(frame) in lost else (frame,)
    rig.run(1.0)
    assert braked(rig)
    deadline_s = rig.settings.cylinder.command_deadline_ms * 1e-3
    assert rig.rig.truth.stroke_mm == pytest.approx(
        before_mm, abs=1.0 + rig.settings.tension.speed_max_mm_s * deadline_s
    )


# -- in every phase of arming --------------------------------------------------------------------------------------
@pytest.mark.gate("opening-sync lost")
@pytest.mark.parametrize(
    ("phase", "fault"),
    [
        pytest.param(phase, fault, marks=() if phase == "opening" or fault == "sync lost" else pytest.mark.long)
        for phase in PHASES
        for fault in FAULTS
    ],
)
def test_a_fault_of_the_command_path_while_arming_leaves_the_load_where_it_was(
    loaded: Lockstep, phase: str, fault: str
) -> None:
    """Either the rig arms and holds, or the drive ends off with its brake closed: never on without being commanded."""
    rig = loaded
    before = rig.rig.truth
    arm_until(rig, phase)
    FAULTS[fault](rig)
    rig.run(7.0 if "1 s" in fault else 4.5)  # read-back, brake test, time-out of the drive, off
    assert rig.rig.truth.stroke_mm == pytest.approx(before.stroke_mm, abs=1.0)
    assert rig.rig.truth.tension_n == pytest.approx(before.tension_n, rel=0.03)
    if rig.loop.machine.mode is not Mode.HOLD:
        assert braked(rig), latched(rig)
        assert not rig.rig.drive.control.enabled
    assert kill_and_see_mm(rig) < 0.1


def test_sync_lost_while_the_brake_opens_is_a_fault_at_once(loaded: Lockstep) -> None:
    rig = loaded
    arm_until(rig, "opening")
    sync_lost(rig)
    rig.run(0.05)
    assert rig.loop.machine.mode is Mode.FAULT
    assert rig.loop.machine.fault in (Fault.SYNC_LOST, Fault.BUS_SILENT)  # nothing else is read back then
    rig.run(1.0)
    assert rig.view.action is Action.SILENCE
    assert braked(rig)


@pytest.mark.starts_in(Mode.HOLD)
def test_a_drive_that_does_not_go_off_after_disarm_is_left_to_its_own_supervision(rig: Lockstep) -> None:
    FAULTS["commands frozen"](rig)
    rig.run(0.01)
    id_ = rig.give(Verb.DISARM)
    rig.run(5.0)
    assert braked(rig)
    assert (rig.loop.machine.fault, rig.view.action) == (Fault.DRIVE_UNASKED, Action.SILENCE)
    assert rig.answer(id_) in (Refusal.NONE, Refusal.OFF_UNSEEN), "never before the drive was seen off"


# -- supervision found off -----------------------------------------------------------------------------------------
@pytest.mark.gate("4118-1-1", "24583-0-3")
@pytest.mark.parametrize("rig", ARMED, indirect=["rig"])
@pytest.mark.parametrize(("index", "sub"), [(od.CONSUMER_HEARTBEAT, 1), (od.ABORT_CONNECTION_OPTION, 0)])
def test_a_drive_whose_supervision_is_found_off_is_parked(rig: Lockstep, index: int, sub: int) -> None:
    entry = rig.rig.drive.device.sdo[index]
    (entry[sub] if sub else entry).raw = 0  # by the drive's own port: no frame on the bus
    while rig.loop.machine.fault is Fault.NONE:
        rig.tick()
    before_mm = rig.rig.truth.stroke_mm
    rig.run(0.5)
    assert (rig.loop.machine.fault, rig.view.action) == (Fault.SUPERVISION_LOST, Action.QUICK_STOP)
    assert braked(rig)
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=1.0)
    assert kill_and_see_mm(rig) == 0.0


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_foreign_write_that_ends_the_supervision_leaves_no_motor_on(rig: Lockstep) -> None:
    """The fault is the second master's; the motor holds for no longer than its stop takes."""
    before_mm = rig.rig.truth.stroke_mm
    on_bus.sdo_write(od.CONSUMER_HEARTBEAT, 1, 4)(Stand(rig, "foreign"))
    rig.run(1.0)
    assert rig.loop.machine.fault is Fault.RIVAL
    assert braked(rig)
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=1.0)
    assert kill_and_see_mm(rig) == 0.0


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_load_whose_drive_stays_silent_after_reset_is_a_fault_again(rig: Lockstep) -> None:
    """The start-up finds every device by SDO, and no sample of the load comes: that is no acknowledged fault."""
    sync_lost(rig)
    rig.run(3.0)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(1.5)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.DRIVE_STALE)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    rig.hub.tap = None
    rig.run(0.5)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.5)
    assert rig.loop.machine.mode is Mode.DISARMED


# -- the way back --------------------------------------------------------------------------------------------------
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_reset_brings_all_devices_up_again_and_the_rig_works(rig: Lockstep) -> None:
    sync_lost(rig)
    while rig.view.action is not Action.SILENCE:
        rig.tick()
    assert rig.command(Verb.RESET) is Refusal.STOP_RUNNING, "the drive's supervision has had no time yet"
    rig.run(2.1)
    assert rig.command(Verb.ARM) is Refusal.WRONG_MODE
    rig.hub.tap = None
    said(rig)
    silent = rig.loop
    assert silent.machine.fault is Fault.SYNC_LOST
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert any("fault SYNC_LOST reset" in text for text in said(rig))
    rig.run(0.5)
    assert rig.loop is not silent
    assert silent.finished
    assert rig.loop.machine.mode is Mode.DISARMED
    assert braked(rig)
    assert rig.rig.drive.nmt_state is NmtState.OPERATIONAL
    assert rig.command(Verb.RESET) is Refusal.NONE, "the drive's own fault is cleared"
    rig.run(0.5)
    arm_and_tension(rig, limit_s=5.0)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_cause_that_is_still_there_after_the_reset_is_found_again(rig: Lockstep) -> None:
    sync_lost(rig)
    rig.run(4.0)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.7)
    assert rig.loop.machine.mode is Mode.DISARMED
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert braked(rig)


def test_the_times_stated_bound_the_motion() -> None:
    """At top speed: unseen distance, one answer, NMT stop, lag and ramp of the paper's rig stay below 1 mm."""
    speed_mm_s, lag_s, deceleration = 10.0, 0.02, 500.0
    assert BLIND_MM + speed_mm_s * (ANSWER_NS * 1e-9 + 0.002 + lag_s) + speed_mm_s**2 / (2 * deceleration) < 1.0
