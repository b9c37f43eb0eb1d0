"""An end in order while the motor has a load that its brake does not hold, judged by the plant's truth."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from hil.faults import in_device, stand
from hil.faults.in_device import CELL, brake_slips, reads
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power.ending import TOGETHER_NS, WAITS_NS
from rigctl.model.events import Kind
from rigctl.model.states import EndStep, Event, Flag, Mode, Witness
from rigctl.model.verbs import Refusal, Verb
from rigctl.recorder.trips import triggers
from tests.builders.branches import Started
from tests.builders.loop_changes import LoopStep, failing

SINKS_MM = 0.2
"""Of a load that the motor holds, as in tests/studies/test_ways_out.py."""
WAITS_S = WAITS_NS * 1e-9
ENDS_S = 4.0
"""Of a loop whose end nothing delays: the stop, the brake, and the load seen at rest."""
LOWERS_S = 45.0


@pytest.fixture(scope="module")
def carried_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    """300 N on a brake that slips by 0.3 mm/s; the motor has taken the load."""
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.HOLD, 300.0)
        stand.enter(rig, Mode.HOLD)
        stand.park(rig)
        brake_slips(0.3)(Stand(rig, "ending"))
        rig.run(2.0)
        assert rig.command(Verb.CARRY, 600.0) is Refusal.NONE
        rig.run(1.0)
        rig.events.read()
        yield Started.now(rig)


@pytest.fixture
def carried(request: pytest.FixtureRequest, carried_once: Started) -> Lockstep:
    return carried_once.go_on(request)


def put_in(rig: Lockstep, fault: Injector) -> None:
    fault(Stand(rig, "ending"))


def steps(rig: Lockstep) -> list[EndStep]:
    return [EndStep(int(event["a"])) for event in rig.events.read() if event["kind"] == Kind.ENDING]


def changes(events: npt.NDArray[np.void]) -> list[Event]:
    return [Event(int(event["value"])) for event in events if event["kind"] == Kind.MODE]


def run_until_finished(rig: Lockstep, limit_s: float) -> float:
    """Run until the loop has ended; returns after how long, s."""
    began_ns = rig.clock.now()
    while not rig.loop.finished:
        rig.tick()
        assert rig.clock.now() - began_ns < limit_s * 1e9, (rig.loop.machine.mode.name, steps(rig))
    return (rig.clock.now() - began_ns) * 1e-9


class Watched:
    """How the load has moved while the motor had to hold it, and the tension as the motor let it go."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig, self._from_mm = rig, rig.rig.truth.stroke_mm
        self.off_mm, self.let_go_n, self._on = 0.0, math.nan, True
        rig.on_advance = self._look

    def _look(self) -> None:
        on, truth = self._rig.rig.drive.control.enabled, self._rig.rig.truth
        if self._rig.loop.machine.mode is not Mode.RELEASING and math.isnan(self.let_go_n) and not self._lowered:
            self.off_mm = max(self.off_mm, abs(truth.stroke_mm - self._from_mm))
        if self._on and not on:
            self.let_go_n = truth.tension_n
        self._on = on

    @property
    def _lowered(self) -> bool:
        return self._rig.rig.truth.tension_n < self._rig.settings.tension.slack_n


def test_the_load_is_held_for_ten_seconds_and_lowered_before_the_end(carried: Lockstep) -> None:
    load = Watched(carried)
    carried.loop.stop_requested = True
    records = carried.run(WAITS_S - 0.1)
    assert load.off_mm <= SINKS_MM
    assert set(records["mode"]) == {Mode.FAULT}
    assert records["end_s"][0] == pytest.approx(WAITS_S, abs=0.01)
    assert records["end_s"][-1] == pytest.approx(0.1, abs=0.01)
    assert steps(carried) == [EndStep.WAITS]
    run_until_finished(carried, LOWERS_S)
    assert load.off_mm <= SINKS_MM
    assert load.let_go_n < carried.settings.tension.slack_n
    assert carried.rig.drive.control.stage.braked
    events = carried.events.read()
    assert [int(event["a"]) for event in events if event["kind"] == Kind.ENDING] == [EndStep.LOWERS, EndStep.LOWERED]
    assert changes(events) == [Event.LOWER, Event.RAMP_ENDS]
    assert triggers(events) == []  # a lowering that has come to its end is no trip, so it makes no dump


def test_a_second_request_leaves_the_load_at_once(carried: Lockstep) -> None:
    carried.loop.stop_requested = True
    carried.run(3.0)
    carried.loop.repeated_stops += 1
    run_until_finished(carried, ENDS_S)
    assert carried.rig.truth.tension_n > 250.0
    assert steps(carried) == [EndStep.WAITS, EndStep.LEFT]


def test_a_second_request_also_stops_the_lowering(carried: Lockstep) -> None:
    assert carried.command(Verb.LOWER) is Refusal.NONE
    carried.loop.stop_requested = True
    carried.run(2.0)
    carried.loop.repeated_stops += 1
    run_until_finished(carried, ENDS_S)
    assert steps(carried) == [EndStep.LOWERS, EndStep.LEFT]


def test_signals_that_come_together_are_one_request(carried: Lockstep) -> None:
    """A terminal that closes sends SIGHUP twice, a session that ends SIGTERM and SIGHUP."""
    carried.loop.stop_requested = True
    carried.run(0.5 * TOGETHER_NS * 1e-9)
    carried.loop.repeated_stops += 1
    carried.run(TOGETHER_NS * 1e-9)
    assert not carried.record["flags"] & Flag.STOPPING
    assert steps(carried) == [EndStep.WAITS]


def test_a_load_that_the_operator_lowers_meanwhile_ends_the_wait(carried: Lockstep) -> None:
    load = Watched(carried)
    carried.loop.stop_requested = True
    carried.run(2.0)
    assert carried.command(Verb.LOWER) is Refusal.NONE
    assert run_until_finished(carried, LOWERS_S) < WAITS_S + 3.0, "300 N at 50 N/s, and the brake"
    assert load.let_go_n < carried.settings.tension.slack_n
    assert steps(carried) == [EndStep.WAITS, EndStep.LOWERS, EndStep.LOWERED]


def test_a_lowering_under_way_goes_on_to_its_end(carried: Lockstep) -> None:
    assert carried.command(Verb.LOWER) is Refusal.NONE
    carried.run(1.0)
    load = Watched(carried)
    carried.loop.stop_requested = True
    run_until_finished(carried, LOWERS_S)
    assert load.let_go_n < carried.settings.tension.slack_n
    assert steps(carried) == [EndStep.LOWERS, EndStep.LOWERED]


@pytest.mark.study
def test_a_hold_stops_the_lowering_for_another_ten_seconds(carried: Lockstep) -> None:
    carried.loop.stop_requested = True
    carried.run(WAITS_S + 1.0)
    assert carried.hold() is Refusal.NONE
    carried.run(0.5)  # until it is at rest
    load = Watched(carried)
    carried.run(WAITS_S - 1.0)
    assert carried.rig.drive.control.enabled
    assert load.off_mm <= SINKS_MM
    run_until_finished(carried, LOWERS_S)
    assert load.let_go_n < carried.settings.tension.slack_n
    assert steps(carried) == [EndStep.WAITS, EndStep.LOWERS, EndStep.WAITS, EndStep.LOWERS, EndStep.LOWERED]


def test_another_carry_does_not_put_the_end_off(carried: Lockstep) -> None:
    carried.loop.stop_requested = True
    carried.run(5.0)
    assert carried.command(Verb.CARRY, 3600.0) is Refusal.NONE
    carried.run(WAITS_S - 4.5)
    assert carried.loop.machine.mode is Mode.RELEASING


def press_e_stop(at: Stand) -> None:
    at.drive.press_e_stop(True)


@pytest.mark.parametrize(
    "stops", [press_e_stop, in_device.trips(0x2310)], ids=["emergency stop", "power stage in a fault"]
)
def test_what_stops_the_motor_lets_the_end_go_on_with_what_is_left(carried: Lockstep, stops: Injector) -> None:
    """LOWER is barred by either."""
    carried.loop.stop_requested = True
    carried.run(2.0)
    put_in(carried, stops)
    run_until_finished(carried, ENDS_S)
    assert carried.rig.drive.control.stage.braked
    (waits, gone) = [event for event in carried.events.read() if event["kind"] == Kind.ENDING]
    assert (int(waits["a"]), int(gone["a"])) == (EndStep.WAITS, EndStep.GONE)
    assert gone["limit"] == pytest.approx(carried.rig.truth.tension_n, abs=5.0)


def test_the_witness_that_is_in_force_shows_the_load_to_its_end(carried: Lockstep) -> None:
    put_in(carried, reads(CELL, freezes=True, noise=0.03))
    assert carried.command(Verb.CARRY, 600.0, Witness.ENCODER) is Refusal.NONE
    load = Watched(carried)
    carried.loop.stop_requested = True
    run_until_finished(carried, LOWERS_S)
    assert load.off_mm <= SINKS_MM
    assert load.let_go_n == 0.0
    assert steps(carried) == [EndStep.WAITS, EndStep.LOWERS, EndStep.LOWERED]


@pytest.mark.gate("HOLD")
@pytest.mark.parametrize(
    "rig", [Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING], indirect=True, ids=lambda mode: mode.name
)
def test_a_load_on_the_motor_above_a_brake_known_not_to_hold_is_lowered_too(rig: Lockstep) -> None:
    if rig.loop.machine.mode is Mode.HOLD:
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(3.0)
        assert rig.hold() is Refusal.NONE
        rig.run(0.5)
    rig.events.read()
    rig.loop.brake.set("a test")
    rig.run(0.01)
    brake_slips(0.3)(Stand(rig, "ending"))
    load = Watched(rig)
    rig.loop.stop_requested = True
    run_until_finished(rig, LOWERS_S)
    assert load.let_go_n < rig.settings.tension.slack_n


@pytest.mark.parametrize(
    "rig", [Mode.DISARMED, Mode.HOLD, Mode.COMPENSATING], indirect=True, ids=lambda mode: mode.name
)
def test_nothing_delays_an_end_that_no_load_is_in_the_way_of(rig: Lockstep) -> None:
    rig.events.read()
    rig.loop.stop_requested = True
    records = rig.run(0.001)
    assert records["flags"][-1] & Flag.STOPPING
    assert math.isnan(records["end_s"][-1])
    run_until_finished(rig, ENDS_S)
    assert steps(rig) == []


def test_a_failing_tick_does_not_end_a_loop_that_has_a_load_to_lower(
    carried: Lockstep,
) -> None:
    carried.loop.stop_requested = True
    carried.run(1.0)
    with failing(carried, LoopStep.WATCH):
        carried.run(0.005)
    load = Watched(carried)
    run_until_finished(carried, WAITS_S + LOWERS_S)
    assert load.let_go_n < carried.settings.tension.slack_n


def test_the_record_shows_that_an_end_would_be_delayed(carried: Lockstep) -> None:
    assert carried.run(0.001)["flags"][-1] & Flag.CARRIES
    assert carried.command(Verb.LOWER) is Refusal.NONE
    assert carried.run(0.001)["flags"][-1] & Flag.CARRIES
    carried.run(8.0)  # 300 N at 50 N/s, and 1 mm more
    assert not carried.run(0.001)["flags"][-1] & Flag.CARRIES, "the rope is slack"
