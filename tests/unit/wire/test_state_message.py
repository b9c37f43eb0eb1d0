"""The state message, the events and the gateway's memory."""

from __future__ import annotations

import math
import pathlib
import re
import types
from datetime import UTC, datetime, timedelta
from time import time_ns
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.gateway import published_position
from rigctl.gateway.active import ActiveConfiguration
from rigctl.gateway.gateway_process import StateView
from rigctl.gateway.published_position import SENT_NS, Cursor
from rigctl.gateway.streams import BLOCK_RECORDS, blocks_of
from rigctl.ipc import wall_clock
from rigctl.ipc.ledger import Standing
from rigctl.ipc.record import EVENT, RECORD
from rigctl.ipc.ring import RingReader, create
from rigctl.ipc.runtime_folder import Runtime
from rigctl.metrics.tension_error import percentiles_us
from rigctl.model.device_states import DriveState
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.samples import Quality
from rigctl.model.states import Flag, HeldBy, Mode
from rigctl.operations.preflight import PreflightVerdict
from rigctl.wire.event_message import event_message
from rigctl.wire.record_names import ALIVE_NS, quality_words
from rigctl.wire.state_message import Recent, TripEvents, state_of, warnings_of
from tests.builders.paths import ROOT

NOW, WALL = 10_000_000_000, 1_700_000_000_000_000_000


def record(**values: Any) -> np.void:
    slots = np.zeros(1, RECORD.dtype)
    for name, value in ({"t_ns": NOW - 1_000_000} | values).items():
        slots[name] = value
    return slots[0]  # type: ignore[no-any-return]


def event(kind: int, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0, text: bytes = b"") -> np.void:
    return np.array([(1, NOW, kind, a, b, value, limit, text)], EVENT.dtype)[0]  # type: ignore[no-any-return]


def state(found: np.void | None, trip: TripEvents | None = None) -> dict[str, Any]:
    made = state_of(found, trip or TripEvents(), Recent(), NOW, WALL)
    return dict(msgspec.json.decode(msgspec.json.encode(made)))


def test_error_is_given_only_while_compensating() -> None:
    for mode in Mode:
        found = state(record(mode=mode, target_n=300.0, vertical_n=298.5))
        if mode is Mode.COMPENSATING:
            assert (found["error_n"], found["error_pct"]) == (-1.5, pytest.approx(0.5))
        else:
            assert (found["error_n"], found["error_pct"]) == (None, None)
        assert found["mode"] == mode.name


def test_every_field_of_the_record_is_there_by_its_name() -> None:
    found = state(record(tangential_rad=math.pi / 2, normal_rad=math.nan, flags=Flag.ARMING | Flag.DRIVE_ENABLED))
    assert {field.name for field in RECORD.fields} <= found.keys()
    assert found["tangential_deg"] == pytest.approx(90.0)
    assert found["normal_deg"] is None
    assert found["flag_names"] == ["arming", "drive_enabled"]
    assert found["wall_ns"] == WALL - 1_000_000


@pytest.mark.parametrize(("age_ns", "alive"), [(0, True), (ALIVE_NS - 1, True), (ALIVE_NS, False)])
def test_a_loop_is_alive_while_its_records_are_new(age_ns: int, alive: bool) -> None:
    found = state(record(t_ns=NOW - age_ns))
    assert found["loop_alive"] is alive
    assert found["age_ms"] == pytest.approx(age_ns / 1e6)


def test_a_record_made_meanwhile_has_no_negative_age() -> None:
    assert state(record(t_ns=NOW + 1_400_000))["age_ms"] == 0.0


def test_a_signal_that_never_came_has_no_age() -> None:
    found = state(record(tension_age_ns=(1 << 61) + 5, drive_age_ns=7))
    assert (found["tension_age_ns"], found["drive_age_ns"]) == (None, 7)


@pytest.mark.parametrize("held_by", HeldBy)
@pytest.mark.parametrize("drive", DriveState)
def test_a_drive_is_off_once_the_loop_has_seen_it_off_whatever_carries_the_load(
    drive: DriveState, held_by: HeldBy
) -> None:
    found = state(record(statusword=0x1200 | drive, held_by=held_by))
    assert found["drive_state"] == drive.name
    powered = drive in (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED) or held_by is HeldBy.TAKING
    assert found["drive_power"] == ("NOT_OFF" if powered else "STOPPING")
    off = state(record(statusword=0x1200 | drive, held_by=held_by, flags=Flag.DRIVE_OFF))
    assert off["drive_power"] == "OFF"


def test_the_state_of_a_drive_that_is_not_heard_is_not_shown() -> None:
    found = state(record(statusword=DriveState.FAULT, held_by=HeldBy.BRAKE, drive_quality=Quality.STALE))
    assert (found["drive_state"], found["drive_power"]) == (None, None)


def test_no_record_is_a_state_too() -> None:
    found = state(None)
    assert found["loop_alive"] is False
    assert found["mode"] is None


def test_numbers_from_another_version_are_shown_not_raised() -> None:
    found = state(record(mode=77, fault=999, tension_quality=64))
    assert (found["mode"], found["fault"]) == ("UNKNOWN_77", "UNKNOWN_999")
    assert found["fault_text"] == "unknown fault 999"


def test_the_trip_is_worded_with_its_figures() -> None:
    trip = TripEvents()
    trip.note(np.array([event(Kind.STARTED), event(Kind.TRIP, Fault.CELL_STALE, 0, 2e7, 1.5e7)]))
    assert trip.text(Fault.CELL_STALE) == "no tension sample for 20 ms (limit 15 ms)"
    assert trip.text(Fault.TENSION_HIGH) == "tension high"  # its event is overwritten
    assert trip.text(Fault.NONE) == ""


def test_a_state_with_a_fault_says_why_however_the_trip_falls_between_what_is_read(tmp_path: pathlib.Path) -> None:
    settings, runtime = config.load(ROOT / "config/paper_rig.yaml"), Runtime(tmp_path)
    runtime.make_rings(settings)
    records, events = runtime.records.writer(), runtime.events.writer()
    nothing = dict.fromkeys((field.name for field in RECORD.fields), 0)
    records.write(*nothing.values())

    class Tripping(RingReader):
        """The loop trips right after a read."""

        def read(self, limit: int | None = None) -> npt.NDArray[Any]:
            found = super().read(limit)
            events.write(NOW, int(Kind.TRIP), Fault.TENSION_HIGH, Action.HOLD, 412.0, 400.0, b"")
            records.write(*(nothing | {"fault": int(Fault.TENSION_HIGH)}).values())
            return found

    for torn in ("_events", "_records"):
        view = StateView(runtime, settings, ActiveConfiguration(runtime), {})
        ring = runtime.events if torn == "_events" else runtime.records
        setattr(view, torn, Tripping(ring.path, ring.slot.dtype, from_start=True))
        cursor = Cursor(tmp_path / "cursor", runtime.records.path, 0)
        for _ in range(2):
            made = msgspec.json.decode(view.make(NOW, 0, Standing(), None, PreflightVerdict(), cursor))
            assert made["fault"] is None or made["fault_text"] == "tension 412.0 N above 400.0 N", torn
        assert made["fault"] == "TENSION_HIGH"


def test_a_wrong_clock_or_a_date_after_it_is_a_warning_of_the_state(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, runtime = config.load(ROOT / "config/paper_rig.yaml"), Runtime(tmp_path)
    runtime.make_rings(settings)
    later = datetime.now(UTC) + timedelta(days=3)
    cursor = Cursor(tmp_path / "cursor", runtime.records.path, 0)

    def warnings(standing: Standing, **dates: datetime) -> list[str]:
        view = StateView(runtime, settings, ActiveConfiguration(runtime), dates)
        made = msgspec.json.decode(view.make(NOW, 0, standing, None, PreflightVerdict(), cursor))
        return list(made["warnings"])

    assert warnings(Standing()) == []
    for found in (warnings(Standing(tared=f"{later:%Y-%m-%dT%H:%M:%SZ}")), warnings(Standing(), certificate=later)):
        assert len(found) == 1
        assert re.match(rf"the computer's clock reads .*, which is before .* \({later:%Y-%m-%d}\): ", found[0])
    monkeypatch.setattr(wall_clock, "RELEASED", later)
    assert "which is before the release of rigctl" in warnings(Standing())[0]


def test_quality_in_words() -> None:
    assert quality_words(0) == "good"
    assert quality_words(Quality.STALE | Quality.NEVER) == "stale+never"


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=3000))
def test_percentiles_are_samples_in_order(values: list[int]) -> None:
    found = percentiles_us(np.array(values))
    ranked = [found[name] for name in ("p50", "p99", "p999", "max")]
    assert ranked == sorted(ranked)
    assert found["max"] == round(max(values) / 1000, 1)


def test_recent_holds_a_second() -> None:
    recent = Recent()
    assert recent.figures() == {"lateness_us": None, "work_us": None}
    for start in range(0, 3000, 20):
        part = np.zeros(20, RECORD.dtype)
        part["t_ns"] = (start + np.arange(20)) * 1_000_000
        part["lateness_ns"] = 1_000_000 if start < 1500 else 5000
        recent.add(part)
    assert recent.figures()["lateness_us"] == {"p50": 5.0, "p99": 5.0, "p999": 5.0, "max": 5.0}


@pytest.mark.parametrize(
    ("control", "found"),
    [({}, []), ({"warnings": ["a", 1]}, ["a", "1"]), ({"warnings": "a"}, []), ({"warnings": None}, [])],
)
def test_warnings_whatever_the_file_holds(control: dict[str, Any], found: list[str]) -> None:
    assert warnings_of(control) == found


@given(
    kind=st.integers(0, 2**16 - 1) | st.integers(0, 12),
    a=st.integers(0, 2**32 - 1) | st.integers(0, 12),
    b=st.integers(0, 2**32 - 1) | st.integers(0, 12),
    value=st.floats(),
    text=st.binary(max_size=80),
)
def test_every_event_slot_becomes_a_message(kind: int, a: int, b: int, value: float, text: bytes) -> None:
    severity, message = event_message(event(kind, a, b, value, value, text), 5)
    assert severity in ("info", "warning", "error")
    assert message["text"]
    assert message["wall_ns"] == NOW + 5
    msgspec.json.encode(message)


@given(st.sets(st.integers(1, 2000), max_size=1500))
def test_blocks_hold_every_record_and_break_at_gaps(tmp_path_factory: pytest.TempPathFactory, seqs: set[int]) -> None:
    from rigctl.wire.block import decode

    path = tmp_path_factory.mktemp("ring") / "records"
    create(path, RECORD.dtype, 4)
    records = np.zeros(len(seqs), RECORD.dtype)
    records["seq"] = sorted(seqs)
    found = [decode(raw) for raw in blocks_of(records, RingReader(path, RECORD.dtype), 3, 4)]
    assert [n for part in found for n in range(part.first_seq, part.last_seq + 1)] == sorted(seqs)
    assert all(part.count <= BLOCK_RECORDS and part.lost == 3 and part.stream == 4 for part in found)


def test_an_event_is_published_until_it_has_surely_left_the_process(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What Zenoh has not sent yet is gone with a killed gateway."""
    ring, path, now = tmp_path / "records", tmp_path / "cursor", [SENT_NS]
    create(ring, RECORD.dtype, 8)
    monkeypatch.setattr(published_position, "time", types.SimpleNamespace(monotonic_ns=lambda: now[0], time_ns=time_ns))
    cursor = Cursor(path, ring, head=0)

    def after_a_kill(later_ns: int) -> tuple[int, int]:
        now[0] += later_ns
        cursor.save()
        found = Cursor(path, ring, head=0)
        return found.event_seq, found.note_seq

    cursor.event_seq, cursor.note_seq = 3, 1
    assert after_a_kill(1) == (0, 0)
    assert after_a_kill(SENT_NS) == (0, 0)
    cursor.event_seq = 4
    assert after_a_kill(SENT_NS - 1) == (0, 0)
    assert after_a_kill(1) == (3, 1)
    assert after_a_kill(SENT_NS) == (4, 1)


def test_cursor_is_remembered_for_the_same_ring_only(tmp_path: pathlib.Path) -> None:
    ring, path = tmp_path / "records", tmp_path / "cursor"
    create(ring, RECORD.dtype, 8)
    first = Cursor(path, ring, head=0)
    assert not first.resumed
    first.fast_seq, first.fast_lost, first.fast_listened = 10, 2, True
    first.save()
    first.close()

    again = Cursor(path, ring, head=12)
    assert again.resumed
    assert (again.fast_seq, again.fast_lost, again.stream) == (10, 2, first.stream)
    assert (again.fast_listened, again.events_listened) == (True, False)
    assert not Cursor(path, ring, head=9).resumed  # ahead of the ring: of another ring

    (tmp_path / "keep").hardlink_to(ring)  # so that the new ring is another inode
    create(ring, RECORD.dtype, 8)
    path.write_bytes(path.read_bytes()[:-1] + b"\x01")
    other = Cursor(path, ring, head=100)
    assert not other.resumed
    assert other.fast_seq == 0
    path.write_bytes(b"garbage")
    assert not Cursor(path, ring, head=100).resumed
