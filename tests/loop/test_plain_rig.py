"""The real loop on a rig whose sensors send plain frames: the same promises, and the same losses."""

from __future__ import annotations

import numpy as np
import pytest

from hil.lockstep import Lockstep, lockstep
from hil.nodes.plain_sensors import PlainSensor
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.devices.startup import Device, PlainDevice
from rigctl.metrics import tension_error as metrics
from rigctl.model.faults import Fault
from rigctl.model.samples import Quality
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.paths import ROOT

PLAIN = config.load(ROOT / "config/plain_rig.yaml")


@pytest.fixture
def rig_settings() -> RigSettings:
    """Its plant is the paper rig's, and so are the gains."""
    return PLAIN


def sensor(rig: Lockstep, device: str) -> PlainSensor:
    found = {"tension_cell": rig.rig.cell, "inclinometer": rig.rig.inclinometer}[device]
    assert isinstance(found, PlainSensor)
    return found


def test_start_up_reports_the_sensors_by_their_dbc_and_touches_only_the_drive(rig: Lockstep) -> None:
    drive, cell, slope = rig.report.devices
    assert isinstance(drive, Device) and drive.name == "cylinder drive"
    assert cell == PlainDevice("tension cell", "plain_sensors.dbc", "Tension", 0x110)
    assert slope == PlainDevice("inclinometer", "plain_sensors.dbc", "Inclination", 0x111)
    assert rig.report.as_json()["devices"][1]["message"] == "Tension"


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_it_tensions_and_holds_within_the_demo_limits_while_the_mechanism_moves(rig: Lockstep) -> None:
    rig.run(2.0)
    assert rig.rig.start_motion()
    truth, lost = [], 0
    for _ in range(60):
        lost = int(rig.run(0.1)["frames_lost"][-1])
        truth.append(rig.rig.truth.vertical_n)
    demo = rig.settings.demo
    assert demo is not None
    peak, rms = metrics.largest_and_rms_pct(np.array(truth), rig.settings.tension.target_n)
    assert peak <= demo.eta_max_pct
    assert rms <= demo.eta_rms_pct
    assert lost == 0
    assert rig.rig.truth.tangential_rad > 0.003


@pytest.mark.starts_in(Mode.HOLD)
def test_every_sample_is_used_and_none_is_refused(rig: Lockstep) -> None:
    records = rig.run(1.0)
    assert records["tension_age_ns"].max() == 0
    assert records["inclination_age_ns"].max() == 9_000_000
    assert set(records["tension_quality"]) == set(records["inclination_quality"]) == {0}
    assert records["frames_refused"][-1] == 0


@pytest.mark.parametrize(
    ("device", "fault"), [("tension_cell", Fault.CELL_STALE), ("inclinometer", Fault.INCLINATION_STALE)]
)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_frames_that_stop_trip_and_hold_the_stroke(rig: Lockstep, device: str, fault: Fault) -> None:
    sensor(rig, device).connected = False
    records = rig.run(0.5)
    safety = rig.settings.safety
    limit_ms = safety.stale_ms if device == "tension_cell" else safety.inclination_stale_ms
    tripped = int(np.argmax(records["mode"] == Mode.FAULT))
    assert 0 < tripped <= limit_ms + 1  # a plain frame of this tick is used in it
    assert set(records["fault"][tripped:]) == {fault}
    assert records["command_mm_s"][-1] == 0.0
    assert rig.command(Verb.RESET) is not Refusal.NONE
    sensor(rig, device).connected = True
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE


@pytest.mark.parametrize(
    ("device", "fault", "column"),
    [
        ("tension_cell", Fault.CELL_INVALID, "tension_quality"),
        ("inclinometer", Fault.INCLINATION_INVALID, "inclination_quality"),
    ],
)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_valid_0_trips_as_invalid(rig: Lockstep, device: str, fault: Fault, column: str) -> None:
    sensor(rig, device).able = False
    records = rig.run(0.1)
    assert records[column][-1] == Quality.INVALID
    assert (records["mode"][-1], records["fault"][-1]) == (Mode.FAULT, fault)
    assert records["command_mm_s"][-1] == 0.0
    assert np.isfinite(records["tension_n"]).all()


@pytest.mark.parametrize("device", ["tension_cell", "inclinometer"])
def test_a_rig_with_a_silent_sensor_does_not_arm(gains: Gains, device: str) -> None:
    with lockstep(PLAIN, gains) as rig:
        sensor(rig, device).connected = False
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
