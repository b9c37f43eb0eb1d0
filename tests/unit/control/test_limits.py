"""Limits of the rig file: each bound is a row, and each signal is the snapshot's field of that name."""

from __future__ import annotations

import math
from typing import Any, get_args

import pytest
from pydantic import ValidationError

from rigctl.config import rig_file as config
from rigctl.config.limits_section import LimitSettings, SignalName
from rigctl.control.findings import DriveStatusSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch import limits
from rigctl.control.watch.safety import Row
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.signals import WATCHED
from rigctl.model.states import Mode
from tests.builders.outcomes import WatchLog
from tests.builders.paths import ROOT
from tests.builders.snapshots import changed

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
MS = 1_000_000
SEEN: dict[str, tuple[dict[str, Any], float]] = {
    "tension_n": ({"tension_n": 290.0}, 290.0),
    "tension_rate_n_s": ({"plausibility.tension_rate_n_s": -50.0}, 50.0),
    "vertical_error_n": ({"vertical_error_n": -2.0}, 2.0),
    "tangential_deg": ({"tangential_rad": math.radians(-3.0)}, -3.0),
    "normal_deg": ({"normal_rad": math.radians(4.0)}, 4.0),
    "stroke_mm": ({"stroke_mm": 55.0}, 55.0),
    "travel_mm": ({"travel_mm": -11.0}, 11.0),
    "speed_mm_s": ({"speed_mm_s": -1.5}, -1.5),
    "disturbance_mm_s": ({"disturbance_mm_s": -2.5}, 2.5),
    "drive_temperature_c": ({"drive_status.temperature_c": 41.0}, 41.0),
    "drive_current_a": ({"drive_status.current_a": -3.0}, 3.0),
    "drive_warning": ({"drive_warning": True}, 1.0),
    "cell_age_ms": ({"cell_age_ns": 3 * MS}, 3.0),
    "inclination_age_ms": ({"inclination_age_ns": 12 * MS}, 12.0),
    "drive_age_ms": ({"drive_age_ns": 4 * MS}, 4.0),
    "rejects": ({"rejects": 7}, 7.0),
    "cell_nis": ({"cell_nis": 1.25}, 1.25),
    "lateness_us": ({"lateness_ns": 250_000}, 250.0),
    "skipped_ticks": ({"skipped_in_window": 9}, 9.0),
    "error_frames": ({"error_frames": 11}, 11.0),
    "sensitivity_peak": ({"least_peak": 1.4}, 1.4),
    "command_age_s": ({"command_age_ns": 90_000_000_000}, 90.0),
}


def rows(**limit: Any) -> tuple[Row, ...]:
    found = LimitSettings.model_validate({"action": "hold", "modes": ["HOLD"], **limit})
    return limits.rows(SETTINGS.model_copy(update={"limits": [found]}))[:-1]  # the last is of every rig


def test_every_signal_has_a_name_a_meaning_and_a_way_to_read_it() -> None:
    assert set(WATCHED) == set(SEEN) == set(get_args(SignalName))


@pytest.mark.parametrize("signal", WATCHED)
def test_a_signal_is_what_its_name_says(signal: str) -> None:
    seen, value = SEEN[signal]
    assert limits.value_of(WATCHED[signal])(changed(Snapshot(), seen)) == pytest.approx(value)


def test_each_bound_is_a_row_of_its_own_that_shows_value_and_limit_as_they_are() -> None:
    high, low = rows(signal="stroke_mm", low=-5.0, high=5.0, persistence_ms=7, action="power_off")
    for row, inside, outside, words, bound in ((high, 5.0, 5.1, "above", 5.0), (low, -5.0, -5.1, "below", -5.0)):
        assert row.text == f"stroke_mm {words}"
        assert (row.fault, row.action, row.persistence_ns) == (Fault.LIMIT, Action.POWER_OFF, 7 * MS)
        assert not row.value(Snapshot(stroke_mm=inside)) > row.limit
        assert row.value(Snapshot(stroke_mm=outside)) > row.limit
        assert row.sign * row.limit == bound
        assert row.sign * row.value(Snapshot(stroke_mm=outside)) == outside


def test_what_is_not_known_passes_no_limit() -> None:
    row, _ = rows(signal="drive_temperature_c", high=70.0)
    assert not row.value(Snapshot()) > row.limit


@pytest.mark.parametrize("action", ["power_off", "ramp_down"])
def test_a_limit_on_a_signal_that_does_not_come_is_a_fault_of_its_own(action: str) -> None:
    _, unseen = rows(signal="drive_temperature_c", high=70.0, action=action)
    assert (unseen.fault, unseen.action, unseen.persistence_ns) == (Fault.LIMIT_UNSEEN, Action.HOLD, 0)
    assert unseen.text == "drive temperature (drive_temperature_c)"
    five_periods = DriveStatusSeen(age_ns=250 * MS)
    assert not unseen.value(Snapshot(drive_status=five_periods)) > unseen.limit
    assert unseen.value(Snapshot(drive_status=DriveStatusSeen(age_ns=251 * MS))) > unseen.limit
    worded = fault_text(unseen.fault, 251 * MS, unseen.limit, unseen.text)
    assert worded == (
        "drive temperature (drive_temperature_c) is limited by the rig file and does not come: no sample for 251 ms "
        "(limit 250 ms)"
    )


def test_a_limit_that_is_only_logged_says_that_its_signal_does_not_come() -> None:
    _, unseen = rows(signal="drive_temperature_c", high=70.0, action="log")
    assert (unseen.fault, unseen.action, unseen.limit) == (Fault.LIMIT, Action.LOG, 250.0)
    assert unseen.text == "age in ms of drive temperature (drive_temperature_c) above"
    assert unseen.value(Snapshot(drive_status=DriveStatusSeen(age_ns=251 * MS))) == 251.0


def test_in_the_armed_modes_the_built_in_rows_watch_the_others_and_in_disarmed_this_one() -> None:
    assert len(rows(signal="tangential_deg", high=5.0)) == 1
    _, unseen = rows(signal="tangential_deg", high=5.0, modes=["DISARMED", "HOLD"])
    assert (unseen.modes, unseen.limit, unseen.persistence_ns) == ({Mode.DISARMED}, 100 * MS, 100 * MS)
    assert unseen.value(Snapshot(inclination_age_ns=101 * MS)) > unseen.limit


def test_two_limits_on_a_signal_miss_it_once() -> None:
    found = [LimitSettings(signal="drive_temperature_c", high=high, action="hold") for high in (70.0, 85.0)]
    *table, _ = limits.rows(SETTINGS.model_copy(update={"limits": found}))
    assert [row.fault for row in table] == [Fault.LIMIT, Fault.LIMIT, Fault.LIMIT_UNSEEN]


@pytest.mark.parametrize("slope", [40.0, -40.0])
def test_a_rate_is_the_slope_of_the_signal_whatever_its_sign(slope: float) -> None:
    (row,) = rows(signal="tension_n", rate=1.0)
    found = [row.value(Snapshot(t_ns=t * MS, tension_n=300.0 + slope * t * 1e-3)) for t in range(400)]
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(abs(slope), rel=0.03)
    assert max(found) <= 1.03 * abs(slope)


def test_a_rate_starts_anew_after_a_pause_and_knows_nothing_of_what_is_not_a_number() -> None:
    (row,) = rows(signal="tension_n", rate=1.0)
    row.value(Snapshot(t_ns=0, tension_n=0.0))
    assert row.value(Snapshot(t_ns=500 * MS, tension_n=300.0)) == 0.0
    assert math.isnan(row.value(Snapshot(t_ns=501 * MS, tension_n=math.nan)))
    assert row.value(Snapshot(t_ns=502 * MS, tension_n=300.0)) == 0.0


def test_a_limit_trips_with_its_own_action_and_words() -> None:
    watch = WatchLog(SETTINGS, rows(signal="drive_temperature_c", high=85.0, action="ramp_down"))
    good = Snapshot(tension_n=300.0, stroke_mm=50.0, cell_age_ns=0, inclination_age_ns=0, drive_age_ns=0, bus_age_ns=0,
        drive_status=DriveStatusSeen(age_ns=0))  # fmt: skip
    assert watch.trips(changed(good, {"drive_status.temperature_c": 85.0}), Mode.HOLD, 0) is None
    trip = watch.trips(changed(good, {"drive_status.temperature_c": 86.0}), Mode.HOLD, MS)
    assert trip is not None
    assert (trip.fault, trip.action, trip.text) == (Fault.LIMIT, Action.RAMP_DOWN, "drive_temperature_c above")
    assert (trip.value, trip.limit) == (86.0, 85.0)
    assert watch.trips(changed(good, {"drive_status.temperature_c": 86.0}), Mode.COMPENSATING, 2 * MS) is None


@pytest.mark.parametrize(
    "limit",
    [
        {"signal": "tension_n"},
        {"signal": "tension_n", "low": 5.0, "high": 5.0},
        {"signal": "tension_n", "rate": 0.0},
        {"signal": "tension", "high": 5.0},
        {"signal": "tension_n", "high": 5.0, "modes": []},
        {"signal": "tension_n", "high": 5.0, "modes": ["hold"]},
        {"signal": "tension_n", "high": 5.0, "action": "explode"},
        {"signal": "tension_n", "high": math.inf},
    ],
)
def test_a_limit_that_is_none_is_refused(limit: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        LimitSettings.model_validate({"action": "hold", **limit})


def test_the_papers_rig_watches_all_but_what_it_has_no_bound_for() -> None:
    watched = {limit.signal for limit in SETTINGS.limits}
    assert set(WATCHED) - watched <= {"drive_current_a", "sensitivity_peak"}
    assert {limit.action for limit in SETTINGS.limits} >= {"log", "hold", "ramp_down"}
