"""A brake that slips in the first second after a parking gives the load back to the motor; later nothing does."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.faults import stand
from hil.faults.in_controller import trip
from hil.faults.in_device import STROKE, both, brake_slips, reads
from hil.faults.on_bus import cell, silent
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep, lockstep
from hil.studies.roll_back.study import SET
from rigctl.config import rig_file, strict_yaml
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.branches import Started
from tests.builders.loop_frames import latched

MOVED_MM = 1.0
"""The promise to whoever relies on a held load."""


def brake_open(at: Stand) -> None:
    """Its springs do not press the armature on."""
    at.drive.brake.stuck_open = True


def bring(rig: Lockstep) -> None:
    stand.start(rig, Mode.HOLD, 300.0)
    stand.enter(rig, Mode.HOLD)
    rig.events.read()


@pytest.fixture(scope="module")
def held_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(settings, gains) as rig:
        bring(rig)
        yield Started.now(rig)


@pytest.fixture
def held(request: pytest.FixtureRequest, held_once: Started) -> Lockstep:
    """HOLD with 300 N, held by the motor for another 1.8 s."""
    return held_once.go_on(request)


def put_in(rig: Lockstep, fault: Injector) -> None:
    fault(Stand(rig, "undone"))


def trips(rig: Lockstep) -> list[str]:
    return [
        worded(int(e["kind"]), int(e["a"]), int(e["b"]), float(e["value"]), float(e["limit"]),
               bytes(e["text"]).rstrip(b"\0").decode()).text
        for e in rig.events.read() if e["kind"] == Kind.TRIP
    ]  # fmt: skip


def parks(rig: Lockstep, seconds: float = 3.0) -> float:
    """Let HOLD park and go on; returns how far the load is from where it was, by truth, at most."""
    before_mm, moved = rig.rig.truth.stroke_mm, [0.0]
    rig.on_advance = lambda: moved.append(abs(rig.rig.truth.stroke_mm - before_mm))
    rig.run(seconds)
    rig.on_advance = None
    return max(moved)


@pytest.mark.gate("0.3 mm/s", "does not hold at all")
@pytest.mark.parametrize("slip", [brake_slips(0.15), brake_slips(0.3), brake_slips(1.5), brake_open],
                         ids=["0.15 mm/s", "0.3 mm/s", "1.5 mm/s", "does not hold at all"])  # fmt: skip
def test_a_brake_that_slips_at_once_gives_the_load_back_with_a_fault(held: Lockstep, slip: Injector) -> None:
    put_in(held, slip)
    assert parks(held) < MOVED_MM
    assert latched(held) == (Mode.FAULT, Fault.BRAKE_SLIPS, Action.HOLD)
    (text,) = trips(held)
    assert "on the closed brake (limit 0.04 mm) right after it had taken the load, the motor takes it back" in text
    before_mm = held.rig.truth.stroke_mm
    assert set(held.run(4.0)["held_by"]) == {HeldBy.MOTOR}
    assert held.rig.truth.stroke_mm == pytest.approx(before_mm, abs=0.05)
    assert held.command(Verb.RESET) is Refusal.CARRIED


def test_a_hold_while_the_motor_takes_the_load_back_does_not_leave_it_on_the_brake(held: Lockstep) -> None:
    put_in(held, brake_slips(1.5))
    before_mm = held.rig.truth.stroke_mm
    while not held.view.taking:
        held.run(0.002)
    assert held.command(Verb.HOLD) is Refusal.NONE
    assert held.run(1.0)["held_by"][-1] == HeldBy.MOTOR
    assert abs(held.rig.truth.stroke_mm - before_mm) < MOVED_MM


def drive_whose(settings: RigSettings, told_ms: int, *, waits_ms: int, closes_ms: int | None) -> RigSettings:
    """A rig file whose ``cylinder.brake_delay_ms`` is not what drive and brake need."""
    true = {"simulation.drive.brake_ms": waits_ms, "simulation.drive.brake_close_ms": closes_ms}
    return changed(settings, {"cylinder.brake_delay_ms": told_ms, **true})


@pytest.mark.gate("0.15-1000", "0.5-300")
@pytest.mark.parametrize("told_ms", [180, 300, 1000])
@pytest.mark.parametrize("slip_mm_s", [0.15, 0.5, 1.5])
def test_a_brake_delay_longer_than_it_is_does_not_leave_the_load_on_a_slipping_brake(
    settings: RigSettings, gains: Gains, slip_mm_s: float, told_ms: int
) -> None:
    """STROKE_MOVES took 0.2 s, the drive went off for good, and the motor had the load back only after the delay."""
    with lockstep(drive_whose(settings, told_ms, waits_ms=60, closes_ms=None), gains) as rig:
        bring(rig)
        put_in(rig, brake_slips(slip_mm_s))
        assert parks(rig, 6.0) < 0.1 + 0.25 * slip_mm_s
        assert rig.loop.machine.fault is Fault.BRAKE_SLIPS
        assert rig.record["held_by"] == HeldBy.MOTOR


@pytest.mark.gate("300-300", "60-300")
@pytest.mark.parametrize(("waits_ms", "closes_ms"), [(300, 300), (60, 300), (500, 500)])
def test_a_brake_delay_shorter_than_it_is_does_not_show_a_closed_brake(
    settings: RigSettings, gains: Gains, waits_ms: int, closes_ms: int
) -> None:
    with lockstep(drive_whose(settings, 60, waits_ms=waits_ms, closes_ms=closes_ms), gains) as rig:
        bring(rig)
        shown = []
        rig.on_advance = lambda: shown.append((HeldBy(int(rig.record["held_by"])), rig.rig.drive.brake.closed))
        rig.run(6.0)
        assert (HeldBy.CLOSING, False) in shown
        assert (HeldBy.BRAKE, False) not in shown


def test_a_motor_that_yields_takes_it_back_on_its_preload(settings: RigSettings, gains: Gains) -> None:
    given = strict_yaml.read(rig_file.shipped(SET)).data
    flat = {"cylinder.rated_force_n": given["cylinder"]["rated_force_n"]}
    flat |= {f"simulation.drive.{name}": value for name, value in given["simulation"]["drive"].items()}
    with lockstep(changed(settings, flat), gains) as rig:
        bring(rig)
        put_in(rig, brake_slips(0.5))
        assert parks(rig) < MOVED_MM
        assert rig.loop.machine.fault is Fault.BRAKE_SLIPS
        assert set(rig.run(1.0)["held_by"]) == {HeldBy.MOTOR}


def test_a_fault_whose_parking_slips_stays_latched_and_is_held_by_the_motor(held: Lockstep) -> None:
    trip(held, Action.HOLD)
    put_in(held, brake_slips(0.5))
    assert parks(held) < MOVED_MM
    assert held.loop.machine.fault is Fault.LIMIT
    assert [text.partition(":")[0] for text in trips(held)] == ["trip BRAKE_SLIPS"]
    assert set(held.run(1.0)["held_by"]) == {HeldBy.MOTOR}


def test_a_slip_after_the_first_second_switches_nothing_on(held: Lockstep) -> None:
    held.run(held.settings.hold.park_s + 1.4)
    assert held.rig.drive.control.stage.braked
    put_in(held, brake_slips(0.5))
    held.run(3.0)
    assert not held.rig.drive.control.enabled
    assert (held.loop.machine.mode, held.loop.machine.fault) == (Mode.FAULT, Fault.STROKE_MOVES)


@pytest.mark.parametrize(
    "fault", [both(silent(cell), brake_slips(0.5)), reads(STROKE, drift_s=-0.3)], ids=["no cell", "encoder drifts"]
)
def test_one_measurement_alone_switches_nothing_on(held: Lockstep, fault: Injector) -> None:
    held.run(held.settings.hold.park_s - 0.3)
    assert not held.rig.drive.control.stage.braked
    held.run(0.2)
    put_in(held, fault)
    states = held.run(3.0)["held_by"]
    assert not {HeldBy.MOTOR, HeldBy.TAKING} & set(states[200:])
    assert not held.rig.drive.control.enabled


def test_a_rig_that_is_disarmed_meanwhile_stays_off(held: Lockstep) -> None:
    held.run(held.settings.hold.park_s + 0.1)
    assert held.command(Verb.DISARM) is Refusal.NONE
    put_in(held, brake_slips(0.5))
    held.run(2.0)
    assert not held.rig.drive.control.enabled
    assert held.loop.machine.fault is Fault.STROKE_MOVES


def test_a_load_that_is_taken_back_in_the_first_second_leaves_nothing_behind(held: Lockstep) -> None:
    """The next time that the drive is off, the stroke is far below where it was."""
    held.run(held.settings.hold.park_s + 0.1)
    assert held.command(Verb.RELEASE) is Refusal.NONE
    held.run(2.0)
    assert held.hold() is Refusal.NONE
    held.run(6.0)
    assert (held.loop.machine.mode, held.loop.machine.fault) == (Mode.HOLD, Fault.NONE)
    assert held.rig.drive.control.stage.braked


def test_a_sound_brake_is_left_alone(held: Lockstep) -> None:
    assert parks(held, 6.0) < 0.02
    assert (held.loop.machine.mode, held.loop.machine.fault) == (Mode.HOLD, Fault.NONE)
    assert held.rig.drive.control.stage.braked


def test_the_motor_that_has_it_back_may_lower_it_by_release(held: Lockstep) -> None:
    put_in(held, brake_slips(0.5))
    parks(held)
    assert held.command(Verb.RELEASE) is Refusal.NONE
    assert held.loop.machine.mode is Mode.RELEASING
    held.run(10.0)
    assert held.rig.truth.tension_n < held.settings.tension.slack_n
    assert held.loop.machine.mode is Mode.FAULT


def test_a_drive_that_does_not_come_on_again_ends_with_its_power_off(
    held: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_in(held, brake_slips(0.3))
    monkeypatch.setattr(held.rig.drive.control, "_enable", lambda _t_ns: None)
    held.run(5.0)
    assert held.view.action is Action.POWER_OFF
    assert held.view.pending is None
    assert not held.rig.drive.control.enabled
