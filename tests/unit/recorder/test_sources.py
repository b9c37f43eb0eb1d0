"""Slots of the rings as entries and as protobuf; no content of a ring stops the recorder."""

from __future__ import annotations

import math
import subprocess
import sys
from enum import IntEnum

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.readback import Readback
from rigctl.ipc.notes import Note, RequestLog
from rigctl.ipc.record import RECORD, FrameFlag, Slot
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.ipc.supervision import Doing, Supervision
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.samples import Quality, Verdict
from rigctl.model.states import Event, Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.recorder import chain, protobuf
from rigctl.recorder.protobuf import Decoding, Encoding
from rigctl.recorder.recorder_process import Recorder
from rigctl.recorder.sources import SOURCES, AuditedRings
from rigctl.wire.state_message import RECORDER_SILENT_NS, recorder_of


def entries(settings: RigSettings) -> list[chain.AuditEntry]:
    lines = settings.audit_log.read_bytes().splitlines(keepends=True)
    assert chain.verify(lines).good
    return [chain.read_line(line)[0] for line in lines]


def decoded(slot: Slot, slots: np.ndarray) -> list[object]:
    """The messages as any protobuf reader decodes them, by the descriptor alone."""
    encoding = Encoding(slot)
    files = descriptor_pb2.FileDescriptorSet.FromString(encoding.descriptor())
    pool = descriptor_pool.DescriptorPool()
    pool.Add(files.file[0])
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(encoding.name))
    return [kind.FromString(data) for data in encoding.encode(slots)]


@given(st.binary(min_size=RECORD.dtype.itemsize * 3, max_size=RECORD.dtype.itemsize * 3))
def test_a_record_of_any_bits_is_decoded_to_the_same_values(raw: bytes) -> None:
    slots = np.frombuffer(raw, RECORD.dtype)
    for slot, message in zip(slots, decoded(RECORD, slots), strict=True):
        for name in RECORD.dtype.names or ():
            found, value = getattr(message, name), slot[name].item()
            assert found == value or (math.isnan(found) and math.isnan(value)), name


def test_enumerations_have_their_names_in_the_file() -> None:
    slots = np.zeros(1, RECORD.dtype)
    slots["mode"], slots["fault"], slots["tension_quality"] = Mode.FAULT, Fault.TENSION_HIGH, 9
    slots["speed_verdict"] = 1
    (message,) = decoded(RECORD, slots)
    fields = message.DESCRIPTOR.fields_by_name  # type: ignore[attr-defined]

    def name(field: str) -> str:
        return str(fields[field].enum_type.values_by_number[getattr(message, field)].name)

    assert name("mode") == "MODE_FAULT"
    assert name("fault") == "FAULT_TENSION_HIGH"
    assert name("tension_quality") == "QUALITY_STALE_NEVER"
    assert name("speed_verdict") == "VERDICT_USED"


def test_a_recording_from_before_there_were_enumerations_is_read_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    slots = np.zeros(5, RECORD.dtype)
    slots["mode"], slots["fault"], slots["rail_quality"] = [0, 1, 2, 3, 5], [0, 1, 300, 65535, 2], [0, 8, 255, 1, 128]
    new = Encoding(RECORD)
    monkeypatch.setattr(protobuf, "enum_of", lambda _slot, _field: None)
    for encoding in (new, Encoding(RECORD)):
        messages = encoding.encode(slots)
        found = Decoding(encoding.descriptor(), encoding.name, RECORD).decode(messages)
        assert found.dtype == RECORD.dtype
        assert np.array_equal(found, slots)


def test_the_inbox_keeps_every_frame_with_its_flags(runtime: Runtime, settings: RigSettings) -> None:
    import can

    bus = can.Bus(interface="virtual", channel="kept")
    other = can.Bus(interface="virtual", channel="kept", receive_own_messages=False)
    sent = [
        can.Message(arbitration_id=0x555, data=b"\1\0", is_extended_id=False),
        can.Message(arbitration_id=0x1ABCDEF0, data=b"\1\2\3\4\5\6\7\x08", is_extended_id=True),
        can.Message(arbitration_id=0x7, is_remote_frame=True, dlc=3, is_extended_id=False),
        can.Message(arbitration_id=0x40, is_error_frame=True, data=b"\0" * 8, is_extended_id=False),
    ]
    try:
        for message in sent:
            other.send(message)
        Inbox(bus, settings, runtime.frames.writer(), Readback((), settings, 0)).drain(77, 0)
    finally:
        bus.shutdown()
        other.shutdown()
    slots = runtime.frames.reader(from_start=True).read()
    assert slots["can_id"].tolist() == [0x555, 0x9ABCDEF0, 0x40000007, 0x20000040]
    assert slots["dlc"].tolist() == [2, 8, 3, 8]
    assert [bytes(data) for data in slots["data"]][1] == b"\1\2\3\4\5\6\7\x08"
    assert set(slots["t_ns"]) == {77}
    assert set(slots["sent"]) == {0}


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
@given(data=st.data())
def test_a_slot_of_any_bits_makes_an_entry(source: object, data: st.DataObject) -> None:
    from rigctl.ipc import record
    from rigctl.recorder.sources import AuditedRing

    assert isinstance(source, AuditedRing)
    dtype = {
        "events": record.EVENT, "commands": record.COMMAND, "replies": record.REPLY, "notes": record.NOTE,
        "desk": record.REQUEST, "holds": record.HOLD, "supervision": record.NOTE,
    }[source.name].dtype  # fmt: skip
    raw = data.draw(st.binary(min_size=dtype.itemsize, max_size=dtype.itemsize))
    slot = np.frombuffer(raw, dtype)[0].copy()
    slot["t_ns"] = data.draw(st.integers(0, 2**60))
    if "kind" in (dtype.names or ()):
        slot["kind"] = data.draw(st.integers(0, 40))
    item = source.item(slot, 0)
    entry = chain.AuditEntry(
        1, "rig", "", item.t_ns, item.what, item.who, item.text, item.details, item.source, item.seq, {}, chain.ORIGIN
    )
    assert chain.verify([chain.line_of(entry)[0]]).good


def test_what_was_overwritten_before_it_was_read_is_said(runtime: Runtime) -> None:
    events = runtime.events.writer()
    rings = AuditedRings(runtime, {})
    for number in range(6000):
        events.write(number, 9, 0, 0, 0.0, 0.0, b"")
    items = rings.take_all(0)
    (lost,) = [item for item in items if item.what == "lost"]
    held = [item.seq for item in items if item.seq]
    assert held == list(range(held[0], 6001))
    assert (lost.details["ring"], lost.details["after"], lost.details["up_to"]) == ("events", 0, held[0] - 1)
    assert lost.details["count"] == held[0] - 1


def test_a_recorder_goes_on_from_the_log_and_a_new_daemon_begins_its_rings_anew(
    runtime: Runtime, settings: RigSettings
) -> None:
    events, desk = runtime.events.writer(), RequestLog(runtime.requests.writer())
    supervision = Supervision(runtime.supervision.writer())
    supervision.note(1, Doing.DAEMON_STARTED, reason="rigctl 1")
    recorder = Recorder(runtime, settings, 1, 1)
    for number in range(5):
        events.write(number, 9, 0, 0, 0.0, 0.0, b"")
    recorder.poll(2, 2)
    events.write(6, 9, 0, 0, 0.0, 0.0, b"")
    desk.given(7, 99, "arm", "kim", "", math.nan, "process 7 of anna")
    desk.answered(
        8, 99, "kim", {"accepted": False, "verb": "arm", "operator": "kim", "reason": "no", "text": "ARM: no"}
    )
    recorder = Recorder(runtime, settings, 3, 3)  # the previous recorder was killed
    recorder.poll(4, 4)
    found = entries(settings)
    assert [entry.seq for entry in found if entry.source == "events"] == [1, 2, 3, 4, 5, 6]
    (started,) = [entry for entry in found if entry.what == "daemon_started"]
    assert started.details["version"] == "1"
    assert len(started.details["settings_sha256"]) == 64
    assert started.details["calibration_waiver"] == "simulated cell: there is no weight to hang on it"
    asked = [
        (entry.what, entry.who, entry.details["id"], entry.details.get("giver"))
        for entry in found if entry.source == "desk"
    ]  # fmt: skip
    assert asked == [("command_given", "kim", 99, "process 7 of anna"), ("command_refused", "kim", 99, None)]
    runtime.make_rings(settings)
    runtime.write_json(ACTIVE, {**runtime.read_json(ACTIVE), "started_wall_ns": 6})
    runtime.events.writer().write(6, 9, 0, 0, 0.0, 0.0, b"")
    Recorder(runtime, settings, 5, 5).poll(6, 6)
    assert [entry.seq for entry in entries(settings) if entry.source == "events"][-2:] == [6, 1]


def test_a_log_that_cannot_be_written_is_told_once_and_made_up_for(
    runtime: Runtime, settings: RigSettings, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = settings.audit_log.parent
    folder.write_text("a file in its place")
    recorder = Recorder(runtime, settings, 0, 0)
    events = runtime.events.writer()
    for second in range(1, 5):
        events.write(second, 9, 0, 0, 0.0, 0.0, b"")
        recorder.poll(second * 1_000_000_000, second * 1_000_000_000)
    told = runtime.read_json("recorder.json")
    assert told["failures"] >= 4
    assert "cannot be written: " in told["warnings"][0]
    assert capfd.readouterr().err.count("WARNING") == 1
    folder.unlink()
    recorder.poll(9_000_000_000, 9_000_000_000)
    recorder.poll(9_100_000_000, 9_100_000_000)
    found = entries(settings)
    assert [entry.seq for entry in found if entry.source == "events"] == [1, 2, 3, 4]
    assert (found[-1].what, found[-1].details["for_s"]) == ("written_again", 9.0)
    assert runtime.read_json("recorder.json")["warnings"] == []


def test_the_state_says_what_is_kept_and_whether_the_recorder_runs() -> None:
    told = {
        "entries": 3,
        "head": "ab",
        "failures": 1,
        "trip_dump": "x.mcap",
        "recording": {"file": "y.mcap"},
        "warnings": ["disk"],
        "t_ns": 10,
    }
    shown, warnings = recorder_of(told, 20)
    assert shown == {
        "audit": {"entries": 3, "head": "ab", "failures": 1},
        "trip_dump": "x.mcap",
        "recording": {"file": "y.mcap"},
    }
    assert warnings == ["disk"]
    assert "does not run" in recorder_of(told, 10 + RECORDER_SILENT_NS + 1)[1][-1]
    assert recorder_of({}, 20) == ({"audit": None, "trip_dump": None, "recording": None}, [])


def test_the_recorder_needs_no_network_and_the_loop_no_recorder() -> None:
    unwanted = {
        "rigctl.recorder": ("zenoh", "control", "hil"),
        "rigctl.control.control_process": ("rigctl.recorder", "mcap"),
    }
    for module, others in unwanted.items():
        name = f"{module}.recorder_process" if module == "rigctl.recorder" else module
        code = f"import sys, {name}; print([m for m in {others!r} if m in sys.modules])"
        answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert answer.stdout.strip() == "[]", name


@pytest.mark.parametrize(("arguments", "code"), [((), 2), (("/nowhere",), 1)])
def test_the_process_without_a_daemon_is_one_line(arguments: tuple[str, ...], code: int) -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "rigctl.recorder", *arguments], capture_output=True, text=True, check=False
    )
    assert (answer.returncode, answer.stderr.count("\n")) == (code, 1)


@pytest.mark.parametrize("kind", [Mode, Event, Verb, Refusal, Fault, Action, Kind, Note, Quality, Verdict, FrameFlag])
def test_no_number_in_a_file_has_two_names(kind: type[IntEnum]) -> None:
    assert len(kind.__members__) == len(set(kind.__members__.values()))


def test_every_mode_and_fault_fits_its_field_of_the_record() -> None:
    slots = np.zeros(1, RECORD.dtype)
    for name, kind in (("mode", Mode), ("fault", Fault)):
        for member in kind:
            slots[name] = member
            assert slots[name][0] == member
