"""A recording holds the content of the rings: read by mcap's own reader, by ours, whole, and cut off anywhere."""

from __future__ import annotations

import hashlib
import json
import os
import pathlib
import random
import struct
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from rigctl.ipc.record import COMMAND, FRAME, RECORD
from rigctl.recorder import frame_block, recording
from rigctl.recorder.audit_log import AuditLog, Item
from rigctl.recorder.recording import RecordingError
from tests.builders.durable import Disk
from tests.builders.tape import OFFSET_NS, Tape, as_recorded, same
from tests.builders.waiting import patience_s


@pytest.fixture
def tape(tmp_path: pathlib.Path) -> Tape:
    return Tape(tmp_path)


def decoded(path: pathlib.Path, topic: str) -> list[tuple[Any, Any]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(found.message, found.decoded_message) for found in reader.iter_decoded_messages(topics=[topic])]


def test_the_standard_decoders_read_every_slot_of_the_rings(tape: Tape) -> None:
    tape.run(2000)
    tape.close()
    records, frames, commands = tape.held()
    (path,) = tape.files()
    kept = as_recorded(records)
    found = decoded(path, "/records")
    assert len(found) == 2000
    for (message, record), slot in zip(found, kept, strict=True):
        assert message.log_time == slot["t_ns"] + OFFSET_NS
        for field in RECORD.fields:
            value = getattr(record, field.name)
            assert value == slot[field.name] or (np.isnan(value) and np.isnan(slot[field.name])), field.name
    assert len(commands) > 5
    for (_, command), slot in zip(decoded(path, "/commands"), commands, strict=True):
        for name in ("seq", *(field.name for field in COMMAND.fields)):
            value = getattr(command, name)
            assert value == slot[name] or (np.isnan(value) and np.isnan(slot[name])), name
    at = 0
    for _, block in decoded(path, "/frames"):
        part = frames[at : at + len(block.can_id)]
        assert block.seq == part["seq"][0]
        assert list(block.t_ns + np.cumsum(block.later_ns, dtype=np.int64)) == part["t_ns"].tolist()
        assert list(block.can_id) == part["can_id"].tolist()
        assert (list(block.sent), list(block.dlc)) == (part["sent"].tolist(), part["dlc"].tolist())
        assert block.data == part["data"].tobytes()
        at += len(part)
    assert at == len(frames) == 8000


def test_our_reader_gives_the_rings_slots_back(tape: Tape) -> None:
    tape.run(2000)
    tape.close()
    records, frames, commands = tape.held()
    (path,) = tape.files()
    found = recording.read(path)
    assert same(found.records, as_recorded(records))
    assert same(found.frames, frames)
    assert same(found.commands, commands)
    assert [event.seq for event in found.events] == list(range(1, len(found.events) + 1))
    assert found.events[0].details["b"] == 2
    assert found.complete
    assert found.gaps == []
    assert found.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (found.rig, found.wall_offset_ns) == ("paper_rig", OFFSET_NS)
    assert json.loads(found.attachments["schema.json"])["rig"] == "paper_rig"
    assert found.metadata["versions"]["numpy"] == np.__version__
    without = recording.read(path, frames=False)
    assert (len(without.frames), len(without.records), without.gaps) == (0, 2000, [])


def test_a_file_cut_off_anywhere_reads_up_to_its_last_whole_chunk(tape: Tape, tmp_path: pathlib.Path) -> None:
    tape.run(4000)
    tape.close()
    records, frames, _ = tape.held()
    (path,) = tape.files()
    raw = path.read_bytes()
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in summary.chunk_indexes]
    chance, cut = random.Random(3), tmp_path / "cut.mcap"
    first = ends[0] + 1
    for size in [*(chance.randrange(first, len(raw)) for _ in range(60)), first, len(raw) - 1]:
        cut.write_bytes(raw[:size])
        found = recording.read(cut)
        whole = sum(1 for end in ends if end <= size)
        assert len(found.records) >= 4000 * (whole - 1) / len(ends)
        assert same(found.records, as_recorded(records[: len(found.records)]))
        assert same(found.frames, frames[: len(found.frames)])
        assert not found.complete
        assert "cut off" in found.files[0].note
        assert theirs(cut) == len(found.records)


def theirs(path: pathlib.Path) -> int:
    """Number of records that mcap's own reader gets out of a file without an end, before it fails."""
    count, topics = 0, {}
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                count += isinstance(record, Message) and topics[record.channel_id] == "/records"
        except (EndOfFile, struct.error):
            pass
    return count


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "empty file"),
        (b"\x89MCAP", "cut off within its first bytes"),
        (b"rig: paper_rig\n" * 9, "not an MCAP file"),
        (b"\x89MCAP0\r\n", "not a recording of rigctl: cut off"),
        (b"\x89MCAP0\r\n" + b"\xff" * 300, "not a recording of rigctl: damaged at byte 8"),
    ],
)
def test_what_is_no_recording_is_one_line(tmp_path: pathlib.Path, content: bytes, said: str) -> None:
    file = tmp_path / "other.mcap"
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=said) as refused:
        recording.read(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_chunk_with_a_bit_turned_is_left_out_and_said(tape: Tape) -> None:
    tape.run(2000)
    tape.close()
    (path,) = tape.files()
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[2]
    raw = bytearray(path.read_bytes())
    raw[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 4
    path.write_bytes(raw)
    found = recording.read(path)
    assert not found.complete
    assert f"at byte {chunk.chunk_start_offset}" in found.files[0].note
    assert {gap.ring for gap in found.gaps} & {"records", "frames"}
    missing = {gap.ring: gap.count for gap in found.gaps}
    assert len(found.records) + missing.get("records", 0) == 2000
    assert len(found.frames) + missing.get("frames", 0) == 8000


def test_a_recorder_that_was_killed_is_followed_without_a_gap(tape: Tape) -> None:
    tape.run(1200)
    assert tape.recording._part is not None
    tape.recording._part.disk.end()
    tape.recording._part.disk.join(patience_s())  # a kill leaves this: whole chunks, no index
    tape.tick(700)
    tape.start()
    tape.run(900)
    tape.close()
    records, frames, commands = tape.held()
    first, second = tape.files()
    assert (first.name[-9:], second.name[-9:]) == ("0001.mcap", "0002.mcap")
    found = recording.read(second, first)
    assert [file.complete for file in found.files] == [False, True]
    assert found.gaps == []
    assert same(found.records, as_recorded(records))
    assert same(found.frames, frames)
    assert same(found.commands, commands)
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (first, second)]
    assert found.sha256 == hashlib.sha256("\n".join(digests).encode()).hexdigest()
    assert recording.parts_of(first) == (first, second)


def test_what_the_rings_no_longer_held_is_a_gap(tape: Tape) -> None:
    tape.run(400)
    held = tape.settings.telemetry.history_s * 1000
    tape.tick(held + 500)
    tape.poll()
    tape.close()
    found = recording.read(*tape.files())
    (gap,) = [gap for gap in found.gaps if gap.ring == "records"]
    assert (gap.after, gap.count) == (400, 501)
    (seen,) = recording._gaps("records", found.records["seq"], found.records["t_ns"])
    assert (seen.after, seen.upto) == (400, 901)  # one slot less than the ring holds is safe to read
    assert tape.recording.as_dict()["records_lost"] == 501


def test_parts_of_another_run_are_refused(tape: Tape, tmp_path: pathlib.Path) -> None:
    tape.run(400)
    tape.close()
    other_folder = tmp_path / "other"
    other_folder.mkdir()
    other = Tape(other_folder)
    other.start(run=OFFSET_NS + 10**9)
    other.run(400)
    other.close()
    with pytest.raises(RecordingError, match="another run"):
        recording.read(*tape.files(), *other.files())


def test_documents_that_change_are_attached_anew_and_found_by_time(tape: Tape) -> None:
    tape.runtime.write_json("control.json", {"pid": 1})
    tape.run(800)
    tape.runtime.write_json("control.json", {"pid": 2})
    tape.run(800)
    tape.close()
    (path,) = tape.files()
    found = recording.read(path)
    first, second = [item for item in found.generations if item.name == "control.json"]
    assert (json.loads(first.data), json.loads(second.data)) == ({"pid": 1}, {"pid": 2})
    assert found.in_force("control.json", second.t_ns - 1) == first.data
    assert found.in_force("control.json", second.t_ns) == second.data
    assert found.in_force("control.json", 0) == first.data
    assert found.in_force("nothing", 0) is None
    assert "lease.json" not in found.attachments


@pytest.mark.parametrize("dated_s", [12, 4_070_908_800], ids=["1970", "2099"])
def test_a_document_is_in_force_since_it_was_found_changed_whatever_date_its_file_has(tape: Tape, dated_s: int) -> None:
    """The clock was set between the writing of the second one and the recorder's next look."""
    seen = []
    for pid in (1, 2, 2, 3):
        tape.runtime.write_json("control.json", {"pid": pid})
        if pid == 2:
            os.utime(tape.runtime.directory / "control.json", (dated_s, dated_s))
        tape.run(1600)
        seen.append((tape.now_ns - 1, pid))
        if len(seen) == 2:  # the part that comes begins with a copy
            tape.close()
            tape.start()
    tape.close()
    found = recording.read(*tape.files())
    assert [json.loads(item.data) for item in found.generations if item.name == "control.json"] == [
        {"pid": pid} for pid in (1, 2, 3)
    ]
    assert [(t_ns, json.loads(found.in_force("control.json", t_ns) or b"")["pid"]) for t_ns, _ in seen] == seen


def test_the_audit_logs_lines_are_in_it_and_made_up_for_after_a_kill(tape: Tape) -> None:
    log = AuditLog(tape.settings.audit_log, "paper_rig")

    def enter(number: int) -> list[bytes]:
        return log.append([Item(tape.now_ns, OFFSET_NS, "command", f"number {number}", "anna")], [{"events": number}])

    tape.recording.audit(enter(1))
    tape.run(400)
    assert tape.recording._part is not None
    tape.recording._part.disk.end()
    tape.recording._part.disk.join(patience_s())
    enter(2)  # in the log, but the recorder was killed before recording it
    tape.start().audit(enter(3))
    tape.run(400)
    tape.close()
    found = recording.read(*tape.files())
    assert [(entry.seq, entry.text, entry.who) for entry in found.audit] == [
        (1, "number 1", "anna"), (2, "number 2", "anna"), (3, "number 3", "anna"),
    ]  # fmt: skip


@pytest.mark.parametrize("count", [0, 1, 2, 4096, 4097, 9000])
def test_blocks_of_frames_give_the_frames_back(count: int) -> None:
    chance = np.random.default_rng(count)
    frames = np.zeros(count, FRAME.dtype)
    frames["seq"] = np.arange(10, 10 + count)
    frames["t_ns"] = np.cumsum(chance.integers(-1000, 3_000_000_000, count))  # some are too far apart for one block
    frames["can_id"] = chance.integers(0, 2**32, count)
    frames["data"] = [bytes(row) for row in chance.integers(0, 256, (count, 8), np.uint8)]
    frames["seq"][count // 2 :] += 5  # frames lost between
    messages = [message for _, _, message in frame_block.encode(frames)]
    again = frame_block.decode(messages) if messages else np.empty(0, FRAME.dtype)
    assert again.tobytes() == frames.tobytes()


@pytest.mark.parametrize(
    ("metadata", "found"),
    [({"format": "1", "version": "0.1.0"}, "found format 1, expected format 2: it was made by rigctl 0.1.0 with"),
     ({"version": "0.1.0"}, "found no format, expected format 2: it was made by rigctl 0.1.0 with"),
     ({"format": "3"}, "found format 3, expected format 2: it was made by a rigctl that it does not name with"),
     ({"format": "1\n2"}, r"found format 1\\n2, expected")],
    ids=["recording", "dump", "unnamed", "two lines"],
)  # fmt: skip
def test_a_file_with_other_bits_for_the_causes_is_refused_and_names_the_release(
    tmp_path: pathlib.Path, metadata: dict[str, str], found: str
) -> None:
    path = tmp_path / "former.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="rigctl")
        writer.add_metadata("rigctl", {"rig": "paper_rig", "run": "7", **metadata})
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(RecordingError, match=found) as refused:
        recording.read(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_all_of_a_recording_that_has_ended_is_on_the_disk(tape: Tape, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    tape.run(2000)
    tape.close()
    (path,) = tape.files()
    assert disk.holds(path)
