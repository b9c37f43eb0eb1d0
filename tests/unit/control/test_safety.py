"""Every row of the safety table trips, in its modes, after its persistence, and not before."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.config.io_section import IoSettings
from rigctl.config.limits_section import LimitSettings
from rigctl.control.findings import DriveStatusSeen
from rigctl.control.snapshot import FieldValue, Snapshot
from rigctl.control.watch import limits
from rigctl.control.watch.safety import Row, preflight, table
from rigctl.model.checks import Check
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from tests.builders.outcomes import WatchLog
from tests.builders.paths import ROOT
from tests.builders.snapshots import changed

PAPER = config.load(ROOT / "config/paper_rig.yaml")
SETTINGS = PAPER.model_copy(update={"io": IoSettings(e_stop_input=0, drive_enable_output=0, drive_off_input=1)})
ROWS = table(SETTINGS)
MS = 1_000_000

GOOD = Snapshot(
    tension_n=300.0,
    cell_age_ns=MS,
    cell_heard=True,
    inclination_age_ns=9 * MS,
    stroke_mm=50.0,
    drive_age_ns=MS,
    drive_heard=True,
    drive_enabled=True,
    bus_age_ns=MS,
    drive_wanted=True,
    io_age_ns=MS,
    drive_status=DriveStatusSeen(age_ns=50 * MS, temperature_c=40.0),
)

NODES = {"tension cell": 2, "inclinometer": 3, "I/O node": 6, "cylinder drive": 4}
BAD: dict[tuple[Fault, str], dict[str, object]] = {
    (Fault.SYNC_LOST, "ns of a load"): {"sync_age_ns": 16 * MS},
    (Fault.DRIVE_STALE, "ns of a load"): {"drive_age_ns": 16 * MS},
    (Fault.DRIVE_NOT_FOLLOWING, ""): {"drive_enabled": False},
    (Fault.DRIVE_NOT_FOLLOWING, "mm/s moves though off"): {"speed_mm_s": 0.51, "drive_off": True},
    (Fault.STROKE_MOVES, "mm/s"): {"speed_mm_s": -0.51, "drive_off": True, "drive_wanted": False},
    (Fault.STROKE_MOVES, "mm/s slowly"): {"sinking.speed_mm_s": -0.021, "sinking.left_mm": 40.0},
    (Fault.DRIVE_UNASKED, "mm/s the stroke moves under power"): {"speed_mm_s": 0.3, "drive_powered": True},
    **{
        (Fault.NODE_NOT_OPERATIONAL, f"ns {name} (node {node})"): {"heartbeats_t_ns": {node: -501 * MS}}
        for name, node in NODES.items()
    },
    **{
        (Fault.NODE_NOT_OPERATIONAL, f"NMT state {name} (node {node})"): {"node_states": {node: 127}}
        for name, node in NODES.items()
    },
    (Fault.RIVAL, ""): {"master_age_ns": 10 * MS},
    (Fault.TENSION_HIGH, "N"): {"tension_n": 400.1},
    (Fault.TENSION_LOW, "N of a load"): {"tension_n": 4.9, "rope_lost": True},
}
"""Where a row's value is more than one field."""


def named(row: Row) -> tuple[Fault, str]:
    return row.fault, f"{row.unit} {row.text}".strip()


def bad_for(row: Row) -> Snapshot:
    if named(row) in BAD:
        return changed(GOOD, BAD[named(row)])
    assert isinstance(row.value, FieldValue)
    (least, most), beyond = row.value.good_range(row.limit), 0.1 + 1e-6 * abs(row.limit)
    return changed(GOOD, {row.value.field: most + beyond if math.isfinite(most) else least - beyond})


def test_the_table_covers_every_fault_a_tick_can_see() -> None:
    assert set(BAD) <= {named(row) for row in ROWS}
    assert {row.fault for row in ROWS} == set(Fault) - {
        Fault.NONE, Fault.LOOP_EXCEPTION, Fault.LIMIT, Fault.LIMIT_UNSEEN, Fault.BRAKE_SLIPS,
        Fault.FORCES_DISAGREE,  # of a rig with a second path, see tests/loop/test_second_force.py
    }  # fmt: skip


@pytest.mark.parametrize("mode", Mode)
def test_a_good_rig_never_trips(mode: Mode) -> None:
    watch = WatchLog(SETTINGS)
    assert all(watch.trips(GOOD, mode, t * MS) is None for t in range(500))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.fault.name)
@pytest.mark.parametrize("mode", Mode)
def test_a_row_trips_in_its_modes_after_its_persistence(row: Row, mode: Mode) -> None:
    snapshot = bad_for(row)
    watch = WatchLog(SETTINGS)
    if mode not in row.modes:
        trips = [watch.trips(snapshot, mode, t * MS) for t in range(500)]
        assert all(trip is None or replace(trip, value=0.0) != replace(row.trip(0.0), value=0.0) for trip in trips)
        return
    tripped = next(t for t in range(11_000) if watch.trips(snapshot, mode, t * MS) is not None)
    assert tripped * MS == row.persistence_ns
    trip = watch.trips(snapshot, mode, 12_000 * MS)
    assert trip is not None
    assert trip.fault is row.fault
    assert (trip.value - trip.limit) * row.sign > 0.0
    assert trip.action is row.action


@pytest.mark.parametrize("row", [row for row in ROWS if row.persistence_ns], ids=lambda row: row.fault.name)
def test_a_row_that_recovers_starts_again(row: Row) -> None:
    mode = min(row.modes)
    snapshot = bad_for(row)
    watch = WatchLog(SETTINGS)
    assert watch.trips(snapshot, mode, 0) is None
    assert watch.trips(GOOD, mode, row.persistence_ns // 2) is None
    assert watch.trips(snapshot, mode, row.persistence_ns) is None


@pytest.mark.parametrize("mode", Mode)
def test_no_correction_of_the_cell_puts_the_tension_limit_off(mode: Mode) -> None:
    watch = WatchLog(SETTINGS)
    snapshot = replace(GOOD, tension_n=395.0, reading_n=400.1)
    trips = [watch.trips(snapshot, mode, t * MS) for t in range(40)]
    assert trips[-1] is not None
    assert trips[-1].fault is Fault.TENSION_HIGH


@pytest.mark.parametrize(
    ("bad", "check"),
    [
        ({"plausibility.cell_repeats": 20}, Check.CELL_IMPLAUSIBLE),
        ({"plausibility.cell_unrest_n": 1.0}, Check.CELL_IMPLAUSIBLE),
        ({"tension_n": -15.1}, Check.CELL_IMPLAUSIBLE),
        ({"sensor_emergency": True}, Check.EMERGENCY),
        ({"master_age_ns": MS}, Check.RIVAL),
        ({"drive_emergency": True}, Check.EMERGENCY),
        ({"io_age_ns": 101 * MS}, Check.E_STOP_IO_UNSEEN),
        ({"enable_ignored": True}, Check.ENABLE_IGNORED),
        ({"drive_status.age_ns": 251 * MS}, Check.STATUS_STALE),
        ({"tangential_rad": 0.2}, Check.LIMIT),
        ({"tangential_rad": -0.2}, Check.LIMIT),
    ],
)
def test_nobody_arms_into_what_would_trip(bad: dict[str, object], check: Check) -> None:
    tilted = LimitSettings(signal="tangential_deg", low=-5.0, high=5.0, action="hold", modes=["HOLD"])
    watch = WatchLog(SETTINGS, limits.rows(SETTINGS.model_copy(update={"limits": [tilted]})))
    snapshot = changed(GOOD, bad)
    assert preflight(snapshot, SETTINGS, watch.beyond(snapshot, Mode.HOLD), Check(0)) == check
    assert preflight(GOOD, SETTINGS, watch.beyond(GOOD, Mode.HOLD), Check(0)) == Check(0)


def test_a_limit_that_is_only_logged_is_told_once_when_it_begins_and_once_when_it_is_over() -> None:
    late = LimitSettings(signal="lateness_us", high=500.0, persistence_ms=2, action="log", modes=["HOLD"])
    watch = WatchLog(SETTINGS, limits.rows(SETTINGS.model_copy(update={"limits": [late]})))
    bad = replace(GOOD, lateness_ns=600_000)
    for t, snapshot in enumerate([GOOD, bad, bad, bad, bad, GOOD, GOOD]):
        assert watch.trips(snapshot, Mode.HOLD, t * MS) is None
    told = [(trip.text, trip.value, trip.limit, begins) for trip, begins in watch.limits]
    assert told == [("lateness_us above", 600.0, 500.0, True), ("lateness_us above", 500.0, 500.0, False)]
    assert watch.beyond(bad, Mode.HOLD) == set()


def test_a_limit_that_comes_and_goes_is_told_at_most_once_a_second() -> None:
    late = LimitSettings(signal="lateness_us", high=500.0, action="log", modes=["HOLD"])
    watch = WatchLog(SETTINGS, limits.rows(SETTINGS.model_copy(update={"limits": [late]})))
    for t in range(3000):
        watch.trips(replace(GOOD, lateness_ns=600_000 * (t % 2)), Mode.HOLD, t * MS)
    assert [begins for _, begins in watch.limits] == [True, False] * 3


def test_of_several_rows_the_strongest_acts_and_among_equals_the_first() -> None:
    watch = WatchLog(SETTINGS)
    snapshot = replace(GOOD, cell_quality=1, inclination_quality=1)
    trip = watch.trips(snapshot, Mode.HOLD, 0)
    assert trip is not None
    assert (trip.fault, trip.action) == (Fault.CELL_INVALID, Action.HOLD)
    runaway = changed(snapshot, {"plausibility.stroke_error_mm": 1.0})
    trip = watch.trips(runaway, Mode.HOLD, MS)
    assert trip is not None
    assert (trip.fault, trip.action) == (Fault.DRIVE_NOT_FOLLOWING, Action.POWER_OFF)


def test_a_row_whose_persistence_runs_keeps_no_later_one_from_tripping() -> None:
    watch = WatchLog(SETTINGS)
    trip = watch.trips(replace(GOOD, tension_n=400.1, device_restarted=True), Mode.HOLD, 0)
    assert trip is not None
    assert trip.fault is Fault.DEVICE_RESTARTED


def test_a_row_begins_anew_in_a_mode_that_was_left() -> None:
    watch = WatchLog(SETTINGS)
    low = replace(GOOD, tension_n=19.9)
    assert all(watch.trips(low, Mode.COMPENSATING, t * MS) is None for t in range(15))
    assert watch.trips(low, Mode.HOLD, 15 * MS) is None
    assert all(watch.trips(low, Mode.COMPENSATING, t * MS) is None for t in range(16, 36))
    trip = watch.trips(low, Mode.COMPENSATING, 36 * MS)
    assert trip is not None
    assert trip.fault is Fault.TENSION_LOW


def test_a_logged_limit_whose_mode_is_left_is_over_only_once_it_is_seen_kept() -> None:
    late = LimitSettings(signal="lateness_us", high=500.0, action="log", modes=["HOLD"])
    watch = WatchLog(SETTINGS, limits.rows(SETTINGS.model_copy(update={"limits": [late]})))
    bad, second = replace(GOOD, lateness_ns=600_000), 1000 * MS
    for at, (mode, snapshot) in enumerate([
        (Mode.HOLD, bad), (Mode.TENSIONING, bad), (Mode.TENSIONING, GOOD), (Mode.HOLD, bad), (Mode.FAULT, GOOD),
        (Mode.HOLD, GOOD), (Mode.TENSIONING, GOOD), (Mode.HOLD, GOOD),
    ]):  # fmt: skip
        watch.trips(snapshot, mode, at * second)
    values = [trip.value for trip, _ in watch.limits]
    assert [begins for _, begins in watch.limits] == [True, False, True, False, False]
    assert values == [600.0, pytest.approx(math.nan, nan_ok=True), 600.0, pytest.approx(math.nan, nan_ok=True), 500.0]


def test_a_logged_limit_whose_signal_has_no_value_is_not_over() -> None:
    warm = LimitSettings(signal="drive_temperature_c", high=70.0, action="log", modes=["HOLD"])
    watch = WatchLog(SETTINGS, limits.rows(SETTINGS.model_copy(update={"limits": [warm]})))
    for at, found in enumerate([80.0, math.nan, math.nan, 80.0, math.nan, 60.0, 60.0]):
        watch.trips(changed(GOOD, {"drive_status.temperature_c": found}), Mode.HOLD, at * 1000 * MS)
    ends = [(begins, math.isnan(trip.value)) for trip, begins in watch.limits]
    assert ends == [(True, False), (False, True), (True, False), (False, True), (False, False)]


def test_a_weaker_row_never_takes_the_place_of_a_stronger_one_before_it() -> None:
    trip = WatchLog(SETTINGS).trips(replace(GOOD, e_stop=True, cell_quality=1), Mode.HOLD, 0)
    assert trip is not None
    assert (trip.fault, trip.action) == (Fault.E_STOP, Action.QUICK_STOP)


def test_a_rig_without_an_io_node_watches_for_none() -> None:
    watch = WatchLog(PAPER)
    never = replace(GOOD, io_age_ns=1 << 62)
    assert {row.fault for row in ROWS} - {row.fault for row in table(PAPER)} == {
        Fault.E_STOP_UNSEEN,
        Fault.ENABLE_IGNORED,
    }
    assert watch.trips(never, Mode.COMPENSATING, 0) is None
    assert watch.present(never) is Fault.NONE


def test_what_is_said_of_a_fault_has_its_numbers_in_the_unit_beside_them() -> None:
    """A row counts an age in nanoseconds; the operator reads milliseconds."""
    aged = [fault for fault in Fault if " ms" in worded(Kind.TRIP, fault, Action.HOLD, 50e6, 15e6, "x").text]
    assert Fault.CELL_STALE in aged
    for fault in aged:
        said = worded(Kind.TRIP, fault, Action.HOLD, 50e6, 15e6, "x").text
        assert "50 ms" in said and "15 ms" in said, said


FACTORS = (1.0, -1.0, 1e-3, 1e-6, -1e-6, math.degrees(1.0), -math.degrees(1.0))


@given(st.floats(-1e3, 1e3), st.sampled_from(FACTORS), st.booleans(), st.integers(-3, 3))
@example(tension_n=2.5e-323, factor=math.degrees(1.0), magnitude=False, ulps=-3)  # denormal: rounded more coarsely
@example(tension_n=1e-320, factor=1e-6, magnitude=True, ulps=-1)
def test_a_value_above_its_limit_lies_beyond_its_range(
    tension_n: float, factor: float, magnitude: bool, ulps: int
) -> None:
    read = FieldValue("tension_n", factor, magnitude=magnitude)
    value = read(Snapshot(tension_n=tension_n))
    limit = value
    for _ in range(abs(ulps)):
        limit = math.nextafter(limit, math.copysign(math.inf, ulps))
    least, greatest = read.good_range(limit)
    if value > limit:
        assert not least <= tension_n <= greatest
