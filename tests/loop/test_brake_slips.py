"""A brake that slips: reported with its speed, no reset while the load sinks, carry and lower are the way out."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from hil.faults import in_device, on_bus, stand
from hil.faults.in_controller import trip
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.cli import status
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power.stage import KEPT_NS
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.page.operator_panel import answers, devices
from rigctl.wire.alarms import as_message
from tests.builders.branches import Started
from tests.loop.test_causes import Shown

SLIP_MM_S = 0.3


def slip(rig: Lockstep, speed_mm_s: float = SLIP_MM_S) -> None:
    """The closed brake lets a tight rope out; the open one, and the motor, are sound."""
    rig.rig.plant.parameters["dead_band"] = 0.0

    def defect(wanted_mm_s: float, braked: bool) -> tuple[float, bool]:
        slips = braked and rig.rig.truth.tension_n > 1.0
        return (-speed_mm_s, False) if slips else (wanted_mm_s, braked)

    rig.rig.drive.defect = defect


@pytest.fixture(scope="module", params=[Mode.DISARMED, pytest.param(Mode.HOLD, marks=pytest.mark.study)])
def slipping_once(request: pytest.FixtureRequest, settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(settings, gains) as rig:
        stand.start(rig, request.param, None if request.param is Mode.HOLD else 300.0)
        stand.enter(rig, request.param)
        rig.run(3.0)
        rig.events.read()
        slip(rig)
        rig.run(1.0)
        yield Started.now(rig)


@pytest.fixture
def slipping(request: pytest.FixtureRequest, slipping_once: Started) -> Lockstep:
    """A rig whose brake has let the load sink by 0.3 mm/s for a second, 300 N on the rope."""
    return slipping_once.go_on(request)


def lines(rig: Lockstep) -> list[str]:
    return [
        worded(
            int(e["kind"]), int(e["a"]), int(e["b"]), float(e["value"]), float(e["limit"]),
            bytes(e["text"]).rstrip(b"\0").decode(),
        ).text
        for e in rig.events.read()
    ]  # fmt: skip


def test_a_slip_is_reported_with_its_speed_and_the_time_until_the_rope_is_slack(slipping: Lockstep) -> None:
    assert slipping.loop.machine.fault is Fault.STROKE_MOVES
    (trip,) = [line for line in lines(slipping) if line.startswith("trip STROKE_MOVES")]
    assert "(0.30 mm/s), the rope is slack in about 16" in trip, "295 N at 6 N/mm are 49.5 mm, 165 s at 0.3 mm/s"
    record = slipping.run(1.0)[-1]
    assert record["sink_mm_s"] == pytest.approx(-SLIP_MM_S, rel=0.05)
    left_s = (slipping.rig.truth.tension_n - 5.0) / 5.96 / SLIP_MM_S
    assert record["slack_s"] == pytest.approx(left_s, rel=0.05)


def test_page_and_status_show_one_time_until_the_rope_is_slack_and_count_it_down(slipping: Lockstep) -> None:
    """99 s, 98 s and 76 s were on one page: the texts of trip and cause had kept the figure of their own time."""
    shown, left_s = Shown(slipping), list[float]()
    for _ in range(3):
        slipping.run(5.0)
        state = shown.state()
        alarms, now_ns = shown.alarms(state)
        log = shown.events(now_ns)
        assert any("is slack in about 16" in event["text"] for event in log), "as of its time"
        page = [answers(state, alarms), devices(state, {}), [as_message(row, now_ns, state) for row in alarms]]
        printed = [*status.rows(state | {"warnings": []}, alarms, now_ns), page, state["fault_text"], state["causes"]]
        figures = {float(found) for found in re.findall(r"slack in (?:about )?(\d+) s", repr(printed))}
        assert figures == {float(f"{state['slack_s']:.0f}")}
        left_s += figures
    assert left_s == sorted(left_s, reverse=True)
    assert left_s[0] - left_s[-1] == pytest.approx(10.0, abs=2.0)  # of the speed's noise


@pytest.mark.parametrize("speed_mm_s", [0.03, *(pytest.param(mm_s, marks=pytest.mark.long) for mm_s in (0.1, 0.19))])
def test_a_slip_too_slow_for_the_reported_speed_is_found_too(
    settings: RigSettings, gains: Gains, speed_mm_s: float
) -> None:
    """0.9 mm of STROKE_NOT_HELD would come after 30 s at 0.03 mm/s."""
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.DISARMED, 300.0)
        rig.run(3.0)
        before_mm = rig.rig.truth.stroke_mm
        slip(rig, speed_mm_s)
        rig.run(8.0)
        assert rig.loop.machine.fault is Fault.STROKE_MOVES
        assert abs(rig.rig.truth.stroke_mm - before_mm) > 0.2
        assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT


def test_no_reset_is_accepted_while_the_load_sinks(slipping: Lockstep) -> None:
    """It was accepted, and 300 N fell to 225 N in 40 s without a line."""
    for _ in range(5):
        assert slipping.command(Verb.RESET) is Refusal.CAUSE_PRESENT
        slipping.run(2.0)
    assert slipping.loop.machine.mode is Mode.FAULT


def test_a_brake_that_holds_again_can_be_reset(slipping: Lockstep) -> None:
    slipping.rig.drive.defect = None
    slipping.run(6.0)
    armed = slipping.view.armed
    assert slipping.command(Verb.RESET) is Refusal.NONE
    assert slipping.loop.machine.mode is (Mode.HOLD if armed else Mode.DISARMED)
    assert slipping.run(1.0)["held_by"][-1] == HeldBy.BRAKE


# -- carry ------------------------------------------------------------
def test_the_motor_carries_the_load_for_as_long_as_stated(slipping: Lockstep) -> None:
    assert slipping.command(Verb.CARRY, 10.0) is Refusal.NONE
    assert slipping.loop.machine.mode is Mode.FAULT
    slipping.run(1.0)
    carried_n, carried_mm = slipping.rig.truth.tension_n, slipping.rig.truth.stroke_mm
    records = slipping.run(8.0)
    assert set(records["held_by"]) == {HeldBy.MOTOR}
    assert slipping.rig.truth.tension_n == pytest.approx(carried_n, abs=0.5)
    assert slipping.rig.truth.stroke_mm == pytest.approx(carried_mm, abs=0.05)
    assert slipping.command(Verb.RESET) is Refusal.CARRIED, "the brake would have to hold"


@pytest.mark.study
def test_a_carry_that_is_over_lowers_the_load_and_never_parks_it_on_the_slipping_brake(slipping: Lockstep) -> None:
    assert slipping.command(Verb.CARRY, 2.0) is Refusal.NONE
    slipping.run(1.5)
    records = slipping.run(11.0)
    tight = records["tension_n"] > 20.0
    assert HeldBy.BRAKE not in records["held_by"][tight]
    assert slipping.rig.truth.tension_n < slipping.settings.tension.slack_n
    slipping.run(8.0)
    assert slipping.loop.machine.mode is Mode.FAULT
    assert slipping.rig.drive.control.stage.braked
    assert slipping.command(Verb.RESET) is Refusal.NONE


def test_a_load_carried_five_seconds_after_the_fault_stays_within_a_fifth_of_a_millimetre(slipping: Lockstep) -> None:
    slipping.run(5.0)
    before_mm, off = slipping.rig.truth.stroke_mm, [0.0]
    assert slipping.command(Verb.CARRY, 10.0) is Refusal.NONE
    assert before_mm - slipping.rig.truth.stroke_mm < 0.2, "until it has it"
    carried_mm = slipping.rig.truth.stroke_mm
    slipping.on_advance = lambda: off.append(abs(slipping.rig.truth.stroke_mm - carried_mm))
    slipping.run(5.0)
    assert max(off) < 0.2


def test_a_carried_load_may_be_released_and_no_other(slipping: Lockstep) -> None:
    assert slipping.command(Verb.RELEASE) is Refusal.WRONG_MODE
    assert slipping.command(Verb.CARRY, 60.0) is Refusal.NONE
    assert slipping.command(Verb.RELEASE) is Refusal.NONE
    assert slipping.loop.machine.mode is Mode.RELEASING
    slipping.run(10.0)
    assert slipping.rig.truth.tension_n < slipping.settings.tension.slack_n
    assert (slipping.loop.machine.mode, slipping.loop.machine.fault) == (Mode.FAULT, Fault.STROKE_MOVES)


def test_the_emergency_stop_bars_a_carry_and_ends_it(slipping: Lockstep) -> None:
    slipping.rig.drive.press_e_stop(True)
    slipping.run(0.2)
    assert slipping.command(Verb.CARRY, 60.0) is Refusal.CAUSE_PRESENT
    slipping.rig.drive.press_e_stop(False)
    slipping.run(2.5)
    assert not slipping.rig.drive.control.enabled


def test_no_carry_after_the_last_resort(slipping: Lockstep) -> None:
    trip(slipping, Action.SILENCE)
    slipping.run(0.5)
    assert slipping.command(Verb.CARRY, 60.0) is Refusal.WRONG_MODE


def test_a_carry_is_prolonged_by_another(slipping: Lockstep) -> None:
    assert slipping.command(Verb.CARRY, 2.0) is Refusal.NONE
    slipping.run(1.5)
    assert slipping.command(Verb.CARRY, 20.0) is Refusal.NONE
    records = slipping.run(4.0)
    assert set(records["held_by"]) == {HeldBy.MOTOR}


@pytest.mark.parametrize("seconds", [0.0, 0.5, 3601.0, float("nan")])
def test_a_carry_without_a_time_in_bounds_is_refused(slipping: Lockstep, seconds: float) -> None:
    assert slipping.command(Verb.CARRY, seconds) is Refusal.OUT_OF_RANGE


def test_a_carry_needs_encoder_and_tension_to_agree(slipping: Lockstep) -> None:
    """A cell that shows the load at rest while the encoder shows it sinking, or the other way: one of them is wrong."""
    true_n = slipping.rig.truth.tension_n
    in_device.reads(in_device.CELL, freezes=True, noise=0.03)(Stand(slipping, "cell"))
    slipping.run(4.0)
    assert slipping.rig.truth.tension_n < true_n - 5.0
    assert slipping.command(Verb.CARRY, 10.0) is Refusal.DISAGREE
    assert slipping.rig.drive.control.stage.phase.name == "BRAKED"


def test_a_carry_goes_on_when_a_measurement_is_lost(slipping: Lockstep) -> None:
    assert slipping.command(Verb.CARRY, 60.0) is Refusal.NONE
    slipping.run(1.0)
    on_bus.silent(on_bus.cell)(Stand(slipping, "silent"))
    before_mm = slipping.rig.truth.stroke_mm
    slipping.run(2.0)
    assert slipping.rig.drive.control.enabled
    assert slipping.rig.truth.stroke_mm == pytest.approx(before_mm, abs=0.05)


def test_disarming_puts_the_carried_load_on_the_brake_to_try_it(slipping: Lockstep) -> None:
    assert slipping.command(Verb.CARRY, 60.0) is Refusal.NONE
    slipping.rig.drive.defect = None  # repaired meanwhile
    slipping.run(1.0)
    assert slipping.command(Verb.DISARM) is Refusal.NONE
    slipping.run(6.0)
    assert slipping.rig.drive.control.stage.braked
    assert slipping.command(Verb.RESET) is Refusal.NONE
    assert slipping.loop.machine.mode is Mode.DISARMED


# -- lower ------------------------------------------------------------
def test_the_motor_lowers_the_load_until_the_rope_is_slack(slipping: Lockstep) -> None:
    assert slipping.command(Verb.LOWER) is Refusal.NONE
    assert slipping.loop.machine.mode is Mode.RELEASING
    records = slipping.run(10.0)
    rate = (records["tension_n"][0] - records["tension_n"][2000]) / 2.0
    assert 0.0 < rate <= 1.1 * slipping.settings.tension.ramp_n_s, "bounded, as a release"
    assert slipping.rig.truth.tension_n < slipping.settings.tension.slack_n
    assert (slipping.loop.machine.mode, slipping.loop.machine.fault) == (Mode.FAULT, Fault.STROKE_MOVES)
    slipping.run(6.0)
    assert slipping.rig.drive.control.stage.braked
    assert slipping.command(Verb.LOWER) is Refusal.ALREADY
    assert slipping.command(Verb.RESET) is Refusal.NONE


def test_a_hold_stops_the_lowering_and_the_motor_carries(slipping: Lockstep) -> None:
    assert slipping.command(Verb.LOWER) is Refusal.NONE
    slipping.run(1.0)
    assert slipping.hold() is Refusal.NONE
    slipping.run(1.0)
    held_n = slipping.rig.truth.tension_n
    assert set(slipping.run(5.0)["held_by"]) == {HeldBy.MOTOR}
    assert slipping.rig.truth.tension_n == pytest.approx(held_n, abs=0.5)
    left_ns = slipping.view.carry_until_ns - slipping.clock.now()
    assert 0 < left_ns < KEPT_NS


# -- a motor that cannot ------------------------------------------------------------
def test_a_drive_that_does_not_come_on_ends_with_its_power_off(
    slipping: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slipping.rig.drive.control, "_enable", lambda _t_ns: None)
    assert slipping.command(Verb.CARRY, 10.0) is Refusal.DRIVE_TIMEOUT
    slipping.run(0.5)
    assert slipping.view.action is Action.POWER_OFF
    assert slipping.rig.drive.control.stage.phase.name == "BRAKED"


@pytest.mark.parametrize("verb", [Verb.CARRY, Verb.LOWER])
def test_neither_is_a_command_without_a_fault(rig: Lockstep, verb: Verb) -> None:
    assert rig.command(verb, 10.0) is Refusal.WRONG_MODE
    assert not any(int(event["kind"]) == Kind.TRIP for event in rig.events.read())
