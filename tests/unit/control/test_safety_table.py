"""Every row of the safety table: the bound beyond which it acts, how, after how long and in which modes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from operator import attrgetter

import pytest

from rigctl.config import rig_file as config
from rigctl.config.io_section import IoSettings
from rigctl.config.limits_section import LimitSettings
from rigctl.control.findings import DriveStatusSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch import limits
from rigctl.control.watch.safety import Row, Trip, preflight, table
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode
from tests.builders.outcomes import WatchLog
from tests.builders.paths import ROOT
from tests.builders.snapshots import changed

MS = 1_000_000
IO = IoSettings(e_stop_input=0, drive_enable_output=0, drive_off_input=1)
SETTINGS = config.load(ROOT / "config/paper_rig.yaml").model_copy(update={"io": IO})
ALIVE = "HOLD TENSIONING COMPENSATING RELEASING"
ARMED = f"{ALIVE} FAULT"
MOVING = "TENSIONING COMPENSATING RELEASING"
EVERY = f"DISARMED {ARMED}"
FALL_N = 0.2 * SETTINGS.plant.stiffness_n_mm
REST = "HOLD FAULT"
GOOD = Snapshot(
    tension_n=300.0, cell_age_ns=MS, cell_heard=True, inclination_age_ns=9 * MS, stroke_mm=50.0,
    drive_age_ns=MS, drive_heard=True, drive_enabled=True,
    bus_age_ns=MS, drive_wanted=True, io_age_ns=MS, drive_status=DriveStatusSeen(age_ns=50 * MS),
)  # fmt: skip

# fault, unit: the snapshot's signal, its highest value without a trip, the action, after how many ms, in which modes
ROWS: dict[tuple[str, str], tuple[str, float, str, int, str]] = {
    ("E_STOP", ""): ("e_stop", 0, "QUICK_STOP", 0, EVERY),
    ("BUS_SILENT", "ns"): ("bus_age_ns", 15e6, "HOLD", 0, ARMED),
    ("SUPERVISION_LOST", ""): ("readback.lost", 0, "HOLD", 0, ARMED),
    ("SUPERVISION_LOST", "commands"): ("readback.disobeys", 0, "POWER_OFF", 0, ARMED),
    ("SUPERVISION_LOST", "drive"): ("readback.unsupervised", 0, "QUICK_STOP", 0, ARMED),
    ("SYNC_LOST", "ns"): ("sync_age_ns", 15e6, "HOLD", 0, ARMED),
    ("SYNC_LOST", "ns of a load"): ("sync_age_ns", 15e6, "HOLD", 1000, "DISARMED"),
    ("DRIVE_STALE", "ns of a load"): ("drive_age_ns", 15e6, "HOLD", 1000, "DISARMED"),
    ("STROKE_JUMPED", "mm"): ("stroke_jump_mm", 0.5, "POWER_OFF", 0, ARMED),
    ("DRIVE_STALE", "ns"): ("drive_age_ns", 15e6, "HOLD", 0, ARMED),
    ("CELL_STALE", "ns"): ("cell_age_ns", 15e6, "HOLD", 0, ARMED),
    ("INCLINATION_STALE", "ns"): ("inclination_age_ns", 100e6, "HOLD", 0, ARMED),
    ("E_STOP_UNSEEN", "ns"): ("io_age_ns", 100e6, "HOLD", 0, ARMED),
    ("ENABLE_IGNORED", ""): ("enable_ignored", 0, "HOLD", 500, ARMED),
    ("DRIVE_REFUSES", "it takes no commands from the bus (statusword bit 9, remote, is off)"): (
        "drive_local",
        0,
        "HOLD",
        20,
        ARMED,
    ),
    ("DRIVE_REFUSES", "a limit of its own is active (statusword bit 11)"): ("drive_limited", 0, "HOLD", 100, ARMED),
    ("DRIVE_REFUSES", "it does not follow the commanded speed (statusword bit 12 is off)"): (
        "drive_ignores",
        0,
        "POWER_OFF",
        20,
        ARMED,
    ),
    ("DRIVE_UNASKED", "the drive has been enabled by somebody else"): (
        "drive_not_requested",
        0,
        "POWER_OFF",
        20,
        "DISARMED HOLD FAULT",
    ),
    ("DRIVE_UNASKED", "the drive does not show that it has gone off though it is commanded to"): (
        "drive_off_pending",
        0,
        "POWER_OFF",
        1000,
        "DISARMED HOLD FAULT",
    ),
    ("STATUS_STALE", "ns"): ("drive_status.age_ns", 250e6, "HOLD", 0, ARMED),  # five of 50 ms
    ("DRIVE_FAULT", ""): ("drive_faulted", 0, "HOLD", 0, ARMED),
    ("SIGN_DRIVE", ""): ("signs.drive_reversed", 0, "HOLD", 0, "TENSIONING"),
    ("SIGN_CELL", ""): ("signs.cell_reversed", 0, "HOLD", 0, "TENSIONING"),
    ("CELL_INVALID", ""): ("cell_quality", 0, "HOLD", 0, ARMED),
    ("INCLINATION_INVALID", ""): ("inclination_quality", 0, "HOLD", 0, ARMED),
    ("TENSION_HIGH", "N"): ("tension_n", 400, "HOLD", 20, EVERY),
    ("CELL_STUCK", "samples"): ("plausibility.cell_repeats", 19, "HOLD", 0, ARMED),
    ("CELL_NOISY", "N"): ("plausibility.cell_unrest_n", 0.9, "HOLD", 5, ARMED),
    ("SENSOR_EMERGENCY", ""): ("sensor_emergency", 0, "HOLD", 0, ARMED),
    ("DRIVE_EMERGENCY", ""): ("drive_emergency", 0, "HOLD", 0, ARMED),
    ("DRIVE_NOT_FOLLOWING", "mm/s speed"): ("plausibility.speed_error_mm_s", 2.5, "POWER_OFF", 15, ARMED),
    ("DRIVE_NOT_FOLLOWING", "mm position"): ("plausibility.stroke_error_mm", 0.5, "POWER_OFF", 0, ARMED),
    ("STROKE_NOT_HELD", "mm"): ("stroke_hold.excursion_mm", 0.9, "POWER_OFF", 2, f"{REST} DISARMED"),
    ("POSITION_DRIFTS", "mm"): ("stroke_hold.corrected_mm", 0.8, "POWER_OFF", 0, REST),
    ("STRETCH_UNEXPLAINED", "mm at rest"): ("held_tension.stretched_mm", 0.8, "POWER_OFF", 15, REST),
    ("STRETCH_UNEXPLAINED", "mm growing"): ("held_tension.growing_mm", 0.5, "POWER_OFF", 600, REST),
    ("LOAD_SINKS", "N is falling"): ("held_tension.sinks_n", FALL_N, "HOLD", 1500, f"{REST} DISARMED"),
    ("LOAD_SINKS", "N has fallen"): ("held_tension.fallen_n", FALL_N, "HOLD", 10_000, f"{REST} DISARMED"),
    ("DRIVE_CONTRADICTS", "mm"): ("plausibility.contradiction_mm", 0.3, "HOLD", 0, ARMED),
    ("INNOVATION", "samples"): ("rejects", 19, "HOLD", 0, MOVING),
    ("INNOVATION", "N at once"): ("plausibility.cell_step_n", 0, "HOLD", 0, MOVING),
    ("INNOVATION", "slopes"): ("slope_rejects", 49, "HOLD", 0, MOVING),
    ("CELL_FROZEN", ""): ("probe.cell_frozen", 0, "HOLD", 0, "COMPENSATING"),
    ("ENCODER_STUCK", ""): ("probe.encoder_stuck", 0, "QUICK_STOP", 0, "COMPENSATING"),
    ("DRIVE_MOTIONLESS", ""): ("probe.drive_motionless", 0, "POWER_OFF", 0, "COMPENSATING"),
    ("ROPE_CHANGED", ""): ("probe.rope_changed", 0, "HOLD", 0, "COMPENSATING"),
    ("LOAD_UNSEEN", "N"): ("probe.travel.excess_n", 0, "HOLD", 25, "TENSIONING COMPENSATING"),
    ("LOAD_UNSEEN", "N by current"): ("take_up.excess_n", 0, "HOLD", 0, "TENSIONING"),
    ("STRETCH_UNEXPLAINED", "mm"): ("plausibility.unexplained_mm", 12, "HOLD", 15, MOVING),
    ("STROKE_END", ""): ("stroke_limited", 0, "HOLD", 200, MOVING),
    ("DEVICE_RESTARTED", ""): ("device_restarted", 0, "HOLD", 0, ARMED),
    ("OVERRUN", "ticks"): ("skipped_in_window", 49, "HOLD", 0, ARMED),
}


def modes(names: str) -> set[Mode]:
    return {Mode[name] for name in names.split()}


def row_of(fault: str, unit: str) -> Row:
    (found,) = [row for row in table(SETTINGS) if (row.fault.name, f"{row.unit} {row.text}".strip()) == (fault, unit)]
    return found


@pytest.mark.parametrize("name", ROWS, ids="-".join)
def test_a_row_is_what_it_is_written_down_to_be(name: tuple[str, str]) -> None:
    signal, highest, action, persistence_ms, where = ROWS[name]
    row = row_of(*name)
    assert row.modes == modes(where)
    assert (row.action.name, row.persistence_ns, row.sign) == (action, persistence_ms * MS, 1.0)
    assert row.limit == pytest.approx(highest)
    at = changed(GOOD, {signal: row.limit})
    assert not row.value(at) > row.limit, "at the bound is not beyond it"
    assert row.value(changed(GOOD, {signal: highest * 1.01 + 0.01})) > row.limit


def test_rows_that_watch_more_than_one_signal_or_a_lower_bound() -> None:
    low, negative = row_of("TENSION_LOW", "N"), row_of("CELL_NEGATIVE", "N")
    assert (low.limit, low.sign, low.persistence_ns, low.modes) == (-20.0, -1.0, 20 * MS, modes("COMPENSATING"))
    assert low.value(replace(GOOD, tension_n=19.0)) == -19.0
    lost = row_of("TENSION_LOW", "N of a load")
    assert (lost.limit, lost.sign, lost.persistence_ns, lost.action) == (-5.0, -1.0, 20 * MS, Action.HOLD)
    assert lost.modes == modes("TENSIONING HOLD FAULT")
    assert lost.value(replace(GOOD, tension_n=4.9)) < lost.limit, "a slack rope that has not carried a load"
    assert lost.value(replace(GOOD, tension_n=4.9, rope_lost=True)) > lost.limit
    assert (negative.limit, negative.sign, negative.persistence_ns) == (15.0, -1.0, 10 * MS)  # slack 5, tare 10
    assert negative.modes == modes(ARMED)
    dropped = row_of("DRIVE_NOT_FOLLOWING", "")
    assert (dropped.persistence_ns, dropped.modes, dropped.limit) == (20 * MS, modes(ALIVE), 0)
    seen = {
        (wanted, enabled): bool(dropped.value(replace(GOOD, drive_wanted=wanted, drive_enabled=enabled)))
        for wanted in (False, True)
        for enabled in (False, True)
    }
    assert [key for key, bad in seen.items() if bad] == [(True, False)]
    slips = row_of("STROKE_MOVES", "mm/s")
    assert (slips.limit, slips.persistence_ns, slips.modes) == (0.2, 200 * MS, modes("DISARMED HOLD FAULT"))
    sinks = row_of("STROKE_MOVES", "mm/s slowly")
    assert (sinks.limit, sinks.persistence_ns, sinks.modes) == (0.02, 1000 * MS, modes("DISARMED HOLD FAULT"))
    assert sinks.value(changed(GOOD, {"sinking.speed_mm_s": -0.1, "sinking.left_mm": 40.0})) == pytest.approx(0.1)
    assert sinks.value(changed(GOOD, {"sinking.speed_mm_s": -0.1})) == 0.0, "no load hangs on a slack rope"
    assert sinks.blocks_reset
    assert not slips.blocks_reset, "the other row bars the reset while a load sinks"
    assert slips.value(replace(GOOD, speed_mm_s=-0.3, drive_off=True)) == pytest.approx(0.3)
    assert slips.value(replace(GOOD, speed_mm_s=-0.3)) == 0.0
    assert slips.value(replace(GOOD, speed_mm_s=-0.3, drive_faulted=True)) == pytest.approx(0.3)
    mute = replace(GOOD, speed_mm_s=-0.3, drive_age_ns=SETTINGS.safety.stale_ms * MS + 1)
    assert slips.value(replace(mute, drive_off=True)) == 0.0, "the last speed of a silent drive is no motion"
    moved = row_of("DRIVE_UNASKED", "mm/s the stroke moves under power")
    assert (moved.limit, moved.persistence_ns, moved.modes) == (0.2, 200 * MS, modes("DISARMED HOLD"))
    assert moved.value(replace(GOOD, speed_mm_s=-0.3, drive_powered=True)) == pytest.approx(0.3)
    assert moved.value(replace(GOOD, speed_mm_s=-0.3)) == 0.0
    assert moved.value(replace(mute, drive_powered=True)) == 0.0
    silent = row_of("NODE_NOT_OPERATIONAL", "ns cylinder drive (node 4)")
    assert (silent.limit, silent.persistence_ns, silent.action, silent.modes) == (500 * MS, 0, Action.HOLD,
                                                                                 modes(ARMED))  # fmt: skip
    assert silent.value(replace(GOOD, t_ns=7 * MS, heartbeats_t_ns={4: 2 * MS, 3: 0})) == 5 * MS
    state = row_of("NODE_NOT_OPERATIONAL", "NMT state I/O node (node 6)")
    assert (state.limit, state.persistence_ns, state.action, state.modes) == (0, 0, Action.HOLD, modes(ARMED))
    assert [state.value(replace(GOOD, node_states={6: told})) for told in (5, 127, 4, 0)] == [0, 127, 4, 0]


def test_bounds_that_follow_from_the_rig_file() -> None:
    """The bound follows the noise where that is coarse, else the payload; a count of 0 switches the row off."""

    def limit(fault: str, unit: str, section: str, **change: object) -> float:
        changed = SETTINGS.model_copy(update={section: getattr(SETTINGS, section).model_copy(update=change)})
        (row,) = [row for row in table(changed) if (row.fault.name, row.unit) == (fault, unit)]
        return row.limit

    fast = SETTINGS.plant.stiffness_n_mm * 80.0 / 1000
    assert limit("CELL_NOISY", "N", "tension_cell", noise_n=0.001) == pytest.approx(fast)
    assert limit("CELL_NOISY", "N", "tension_cell", noise_n=0.1) == pytest.approx(3.0)
    assert limit("CELL_STUCK", "samples", "safety", stuck_samples=0) == float("inf")
    assert limit("OVERRUN", "ticks", "safety", overrun_ticks=3) == 2
    assert limit("INNOVATION", "samples", "estimator", reject_limit=7) == 6


def test_a_logged_limit_is_told_with_what_it_found_and_hides_nothing_behind_it() -> None:
    rows = [LimitSettings(signal="lateness_us", high=500.0, action="log", modes=["HOLD"]),
            LimitSettings(signal="drive_current_a", high=5.0, action="ramp_down", modes=["HOLD"])]  # fmt: skip
    watch = WatchLog(SETTINGS, limits.rows(SETTINGS.model_copy(update={"limits": rows})))
    both = changed(GOOD, {"lateness_ns": 600_000, "drive_status.current_a": 6.0})
    trip = watch.trips(both, Mode.HOLD, 0)
    assert trip is not None
    assert trip.action is Action.RAMP_DOWN
    assert watch.limits == [(Trip(Fault.LIMIT, 600.0, 500.0, Action.LOG, "lateness_us above"), True)]
    watch.limits.clear()
    watch.trips(both, Mode.HOLD, MS)
    assert watch.limits == []
    watch.trips(both, Mode.TENSIONING, 2 * MS)
    assert [begins for _, begins in watch.limits] == [False], "in a mode that does not watch it, it is over"


@pytest.mark.parametrize(
    ("bad", "fault"),
    [
        ({"bus_age_ns": 16 * MS}, "BUS_SILENT"), ({"drive_age_ns": 16 * MS}, "DRIVE_STALE"),
        ({"cell_age_ns": 16 * MS}, "CELL_STALE"), ({"cell_quality": 1}, "CELL_INVALID"),
        ({"inclination_age_ns": 101 * MS}, "INCLINATION_STALE"), ({"inclination_quality": 1}, "INCLINATION_INVALID"),
        ({"tension_n": 401.0}, "TENSION_HIGH"), ({"skipped_in_window": 50}, "OVERRUN"),
        ({"device_restarted": True}, "DEVICE_RESTARTED"), ({"plausibility.cell_repeats": 20}, "CELL_STUCK"),
        ({"io_age_ns": 101 * MS}, "E_STOP_UNSEEN"), ({"io_age_ns": 100 * MS}, "NONE"), ({"e_stop": 2}, "E_STOP"),
        ({"drive_status.age_ns": 251 * MS}, "STATUS_STALE"), ({"drive_status.age_ns": 250 * MS}, "NONE"),
        ({"drive_local": True}, "DRIVE_REFUSES"), ({"drive_not_requested": True}, "DRIVE_UNASKED"),
        ({"heartbeats_t_ns": {2: -501 * MS}}, "NODE_NOT_OPERATIONAL"),
        ({"node_states": {2: 127}}, "NODE_NOT_OPERATIONAL"), ({"node_states": {2: 5}}, "NONE"),
        ({"e_stop": True}, "E_STOP"), ({"plausibility.cell_unrest_n": 1.0}, "CELL_NOISY"),
        ({"tension_n": -16.0}, "CELL_NEGATIVE"),
        ({"sensor_emergency": True}, "SENSOR_EMERGENCY"), ({"drive_emergency": True}, "NONE"),
        ({"drive_faulted": True}, "NONE"), ({"drive_enabled": False}, "NONE"),
        ({"plausibility.speed_error_mm_s": 9.0}, "NONE"),
        ({"plausibility.stroke_error_mm": 9.0}, "NONE"), ({"plausibility.contradiction_mm": 9.0}, "NONE"),
        ({"rejects": 99}, "NONE"),
        ({"plausibility.unexplained_mm": 99.0}, "NONE"), ({"stroke_limited": True}, "NONE"),
        ({"rope_lost": True}, "NONE"),
        ({"readback.lost": 1}, "SUPERVISION_LOST"), ({"stroke_jump_mm": 0.51}, "STROKE_JUMPED"),
        ({"sync_age_ns": 16 * MS}, "SYNC_LOST"), ({"sync_age_ns": 15 * MS}, "NONE"),
        ({"signs.drive_reversed": True}, "NONE"), ({"signs.cell_reversed": True}, "NONE"),
        ({"slope_rejects": 99}, "NONE"),
        ({"tension_n": 1.0}, "NONE"), ({"cell_age_ns": 15 * MS}, "NONE"),
        ({"master_age_ns": 10 * MS}, "RIVAL"), ({}, "NONE"),
    ],
)  # fmt: skip
def test_what_keeps_a_fault_from_being_reset(bad: dict[str, object], fault: str) -> None:
    assert WatchLog(SETTINGS).present(changed(GOOD, bad)).name == fault


@pytest.mark.parametrize(
    ("seen", "near_end", "failing"),
    [
        ({"stroke_mm": -18.0}, False, ""), ({"stroke_mm": 118.0}, False, ""),
        ({"stroke_mm": -18.1}, False, "STROKE_NEAR_END"), ({"stroke_mm": 118.1}, False, "STROKE_NEAR_END"),
        ({"stroke_mm": -22.0}, False, "STROKE_NEAR_END"), ({"stroke_mm": 122.0}, False, "STROKE_NEAR_END"),
        ({"stroke_mm": -22.0}, True, ""), ({"stroke_mm": 122.0}, True, ""),
        ({"stroke_mm": -22.1}, True, "STROKE_RANGE"), ({"stroke_mm": 122.1}, False, "STROKE_RANGE"),
        ({"cell_age_ns": 15 * MS}, False, ""), ({"drive_age_ns": 15 * MS}, False, ""),
        ({"inclination_age_ns": 100 * MS}, False, ""), ({"tension_n": 400.0}, False, ""),
        ({"e_stop": 1}, False, "E_STOP"), ({"e_stop": 2}, False, "E_STOP_IO"),
        ({"e_stop": 3}, False, "E_STOP E_STOP_IO"),
        ({"drive_status.e_stop_unseen": True}, False, "E_STOP_UNSEEN"),
        ({"stroke_unconfirmed": True}, False, "STROKE_UNCONFIRMED"),
        ({"stroke_mm": 123.0}, False, "STROKE_RANGE"), ({"stroke_mm": math.nan}, False, "STROKE_RANGE"),
        ({"cell_heard": False}, False, "CELL_STALE"), ({"cell_quality": 1}, False, "CELL_INVALID"),
        ({"inclination_age_ns": 101 * MS}, False, "INCLINATION_STALE"),
        ({"inclination_quality": 1}, False, "INCLINATION_INVALID"),
        ({"drive_heard": False}, False, "DRIVE_STALE"), ({"drive_faulted": True}, False, "DRIVE_FAULT"),
        ({"tension_n": 401.0}, False, "TENSION_HIGH"), ({"reading_n": 401.0}, False, "TENSION_HIGH"),
        ({"tension_n": math.nan}, False, "TENSION_HIGH"),
    ],
)  # fmt: skip
def test_preflight_at_its_bounds(seen: dict[str, object], near_end: bool, failing: str) -> None:
    """With the checks that others have found, too."""
    snapshot, known = changed(GOOD, seen), Check.DRIVE_SUPERVISION | Check.CALIBRATION | Check.DISK | Check.TARE
    found = preflight(snapshot, SETTINGS, set(), Check(0), near_end=near_end)
    assert {check.name for check in found} == set(failing.split())
    assert preflight(snapshot, SETTINGS, set(), known, near_end=near_end) == found | known


def test_nothing_has_been_seen_at_first() -> None:
    unseen = preflight(Snapshot(), SETTINGS, set(), Check(0))
    assert Check.CELL_STALE | Check.DRIVE_STALE | Check.INCLINATION_STALE | Check.STROKE_RANGE in unseen


def test_what_no_gateway_has_told_stands_against_arming() -> None:
    assert {check.name for check in HOST_CHECKS} == {"TARE", "MARGINS", "REALTIME", "DISK", "HOST"}
    assert not preflight(GOOD, SETTINGS, {Fault.DRIVE_STALE}, Check(0))


def leaves(value: object) -> Iterator[object]:
    """The value itself, or those of a group of findings, but its age."""
    if is_dataclass(value):
        for one in fields(value):
            if one.name != "age_ns":
                yield from leaves(getattr(value, one.name))
    else:
        yield value


def test_nothing_seen_is_nothing_known() -> None:
    never, snapshot = 1 << 62, Snapshot()
    assert [snapshot.cell_age_ns, snapshot.inclination_age_ns, snapshot.drive_age_ns, snapshot.bus_age_ns] == [
        never
    ] * 4
    assert [snapshot.io_age_ns, snapshot.drive_status.age_ns, snapshot.rail_age_ns] == [never] * 3
    for name in ("tension_n", "reading_n", "stroke_mm", "drive_status.temperature_c", "drive_status.current_a"):
        assert math.isnan(attrgetter(name)(snapshot)), name
    others = [value for name in Snapshot.__slots__
              if not name.endswith("_age_ns") and name not in ("held_by", "power")
              for value in leaves(getattr(snapshot, name)) if str(value) != "nan"]  # fmt: skip
    assert not any(others)
    assert snapshot.held_by is HeldBy.UNKNOWN


@pytest.mark.parametrize("value", [Trip(Fault.LIMIT, 1.0, 0.0), table(SETTINGS)[0]], ids=lambda x: type(x).__name__)
def test_a_trip_and_a_row_are_not_changed_afterwards(value: object) -> None:
    with pytest.raises(FrozenInstanceError):
        value.limit = 0.0  # type: ignore[attr-defined]


def test_a_row_that_names_no_action_holds_the_stroke() -> None:
    assert Trip(Fault.LIMIT, 1.0, 0.0).action is Action.HOLD
    assert Row(Fault.LIMIT, lambda _: 0.0, 0, 0, frozenset(), "").action is Action.HOLD


@pytest.mark.parametrize(
    ("unit", "value", "words"),
    [
        ("", 1.0, "drive does not do as commanded: it is not enabled"),
        ("mm/s speed", 2.6, "drive does not do as commanded: its speed is off by 2.60 mm/s (limit 2.5 mm/s)"),
        ("mm position", -0.6, "drive does not do as commanded: its position is off by -0.60 mm (limit 0.5 mm)"),
    ],
)
def test_a_drive_that_does_not_follow_says_what_it_misses_and_by_how_much(unit: str, value: float, words: str) -> None:
    row = row_of("DRIVE_NOT_FOLLOWING", unit)
    trip = row.trip(value)
    assert fault_text(trip.fault, trip.value, trip.limit, trip.text) == words
    assert fault_text(trip.fault, 2.6, 2.5) == "drive does not do as commanded: its speed or position is off"
