"""Whether the load is at rest, and by which measurement: shown for what the simulated plant's truth is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.faults import stand
from hil.faults.in_device import SPEED, STROKE, both, brake_slips, reads, stuck
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.load.load_at_rest import REST_NS
from rigctl.model.events import Kind
from rigctl.model.states import HeldBy, LoadAtRest, Mode
from tests.builders.branches import Started
from tests.builders.loop_frames import stop_node, texts

ENCODER_STUCK = both(stuck(STROKE), reads(SPEED, times=0.0))
REST_S = REST_NS * 1e-9
RESTS_MM = 0.05
"""Motion in `REST_S` of a load that is called at rest: half of what is stated, which is of stretch."""


@pytest.fixture(scope="module")
def parked_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.HOLD, 300.0)
        stand.enter(rig, Mode.HOLD)
        rig.run(2.0 + REST_S)
        yield Started.now(rig)


@pytest.fixture
def parked(request: pytest.FixtureRequest, parked_once: Started) -> Lockstep:
    """HOLD with 300 N on the closed brake, at rest."""
    return parked_once.go_on(request)


def shown(rig: Lockstep) -> LoadAtRest:
    return LoadAtRest(int(rig.run(0.01)["load_at_rest"][-1]))


def test_a_parked_load_rests_by_tension_and_stroke(parked: Lockstep) -> None:
    assert shown(parked) is LoadAtRest.BOTH
    assert parked.record["held_by"] == HeldBy.BRAKE
    assert texts(parked, Kind.LOAD_AT_REST) == []


@pytest.mark.parametrize(
    ("silent", "by"),
    [(["tension_cell"], LoadAtRest.STROKE), (["cylinder"], LoadAtRest.TENSION),
     (["tension_cell", "cylinder"], LoadAtRest.UNKNOWN)],
)  # fmt: skip
def test_a_device_that_is_silent_shows_nothing(parked: Lockstep, silent: list[str], by: LoadAtRest) -> None:
    for section in silent:
        stop_node(parked, getattr(parked.settings, section).node)
    parked.run(0.1 + REST_S)
    assert shown(parked) is by


def test_on_a_slack_rope_the_stroke_shows_it(rig: Lockstep) -> None:
    rig.run(0.1 + REST_S)
    assert rig.view.slack
    assert shown(rig) is LoadAtRest.STROKE


@pytest.mark.starts_in(Mode.TENSIONING)
def test_a_load_that_is_moved_does_not_rest(rig: Lockstep) -> None:
    assert shown(rig) is LoadAtRest.MOVES


@pytest.mark.gate("0.3-False")
@pytest.mark.parametrize("encoder_stuck", [False, True])
@pytest.mark.parametrize("speed_mm_s", [0.06, 0.3])
def test_a_brake_that_slips_is_no_rest_within_the_time_stated(
    parked: Lockstep, speed_mm_s: float, encoder_stuck: bool
) -> None:
    at = Stand(parked, "load at rest")
    brake_slips(speed_mm_s)(at)
    if encoder_stuck:
        ENCODER_STUCK(at)
    parked.events.read()
    before_mm = parked.rig.truth.stroke_mm
    called = parked.run(2.0 * REST_S)["load_at_rest"]
    assert abs(parked.rig.truth.stroke_mm - before_mm) > RESTS_MM
    assert (called[round(REST_S * parked.settings.loop.rate_hz) :] == LoadAtRest.MOVES).all()
    assert "load at rest on the brake: no" in texts(parked, Kind.LOAD_AT_REST)[0]
    parked.rig.drive.brake.slip_mm_s = 0.0
    parked.run(10.0)
    assert shown(parked) in (LoadAtRest.STROKE, LoadAtRest.BOTH, LoadAtRest.TENSION)
    assert "yes, by" in texts(parked, Kind.LOAD_AT_REST)[-1]
