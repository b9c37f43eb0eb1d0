"""A trip leaves a file with all data around it, which an independent reader decodes."""

from __future__ import annotations

import json
import math
import os
import pathlib
from collections import Counter
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from hil.faults import on_bus
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from hil.wire import FRAME
from rigctl.config.audit_section import AuditSettings
from rigctl.config.recording_section import RecordingSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.model.checks import Check
from rigctl.model.parts import Part
from rigctl.model.states import Mode
from rigctl.model.verbs import VALUES, Refusal, Setting, Verb
from rigctl.recorder import chain
from rigctl.recorder import recording as recordings
from rigctl.recorder.recorder_process import Recorder
from rigctl.replay.compare import first_difference
from rigctl.replay.play import play, spans
from tests.builders.durable import Disk
from tests.builders.loop_frames import nmt, stop_node
from tests.loop.test_causes import Shown

WALL_OFFSET_NS = 1_700_000_000_000_000_000
TICK_NS = 1_000_000


class Kept:
    """A recorder on a rig in lockstep: real loop, real rings, simulated time."""

    def __init__(self, rig: Lockstep, folder: pathlib.Path, **audit: Any) -> None:
        self.rig = rig
        own = AuditSettings(file=str(folder / "audit.jsonl"), trips=str(folder / "trips"), **audit)
        kept = RecordingSettings(folder=str(folder / "recordings"))
        self.settings = rig.settings.model_copy(update={"audit": own, "recording": kept})
        self.folder = folder / "trips"
        active = {"settings": self.settings.model_dump(mode="json"), "started_wall_ns": 7, "design": {"gains": {}}}
        rig.runtime.write_json(ACTIVE, active)
        self.recorder = self.start()

    def start(self) -> Recorder:
        now = self.rig.clock.now()
        self.recorder = Recorder(self.rig.runtime, self.settings, now, now + WALL_OFFSET_NS)
        return self.recorder

    def poll(self, *, final: bool = False) -> None:
        now = self.rig.clock.now()
        self.recorder.poll(now, now + WALL_OFFSET_NS, final=final)

    def files(self) -> list[pathlib.Path]:
        return sorted(self.folder.glob("*"))

    def log(self) -> list[chain.AuditEntry]:
        lines = self.settings.audit_log.read_bytes().splitlines(keepends=True)
        assert chain.verify(lines).good
        return [chain.read_line(line)[0] for line in lines]


@pytest.fixture
def kept(settings: RigSettings, gains: Gains, tmp_path: pathlib.Path) -> Iterator[Kept]:
    """COMPENSATING at 60 N, with every frame of the bus logged by the bus itself."""
    with lockstep(settings, gains, log=True, history_s=settings.telemetry.history_s) as rig:
        found = Kept(rig, tmp_path)
        rig.run(0.2)
        assert rig.command(Verb.TARGET, 60.0) is Refusal.NONE
        arm_and_tension(rig, limit_s=5.0)
        found.poll()
        yield found


def trip(rig: Lockstep) -> int:
    """Silence the cell; returns the time of the trip on the loop's clock."""
    stop_node(rig, rig.settings.tension_cell.node)
    rig.run_until(Mode.FAULT, 0.1)
    return rig.clock.now()


def test_a_dump_names_the_part_that_the_running_rig_names(kept: Kept) -> None:
    """Its fault alone is one of many names of a bus that is cut."""
    rig = kept.rig
    rig.run(0.5)
    on_bus.burst(math.inf)(Stand(rig, "cut"))
    rig.run(2.5)
    kept.poll()
    (file,) = kept.files()
    culprit = read(file)[2]["culprit"]
    state = Shown(rig).state()
    assert culprit["parts"] == Part.BUS == " or ".join(state["culprit"]["parts"])
    assert (culprit["text"], culprit["first"]) == (state["culprit"]["text"], state["culprit"]["first"])
    assert culprit["follows"].split() == state["culprit"]["follows"][: len(culprit["follows"].split())]


def read(file: pathlib.Path) -> tuple[dict[str, list[tuple[int, Any]]], dict[str, bytes], dict[str, dict[str, str]]]:
    """Messages by topic with their time on the loop's clock, attachments, metadata, read with mcap's own reader."""
    topics: dict[str, list[tuple[int, Any]]] = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            topics.setdefault(channel.topic, []).append((message.log_time - WALL_OFFSET_NS, (schema, message.data)))
        for topic in ("/records", "/frames", "/commands"):
            decoded = [found.decoded_message for found in reader.iter_decoded_messages(topics=[topic])]
            topics[topic] = [(t_ns, item) for (t_ns, _), item in zip(topics.get(topic, []), decoded, strict=True)]
        attached = {found.name: found.data for found in reader.iter_attachments()}
        words = {found.name: dict(found.metadata) for found in reader.iter_metadata()}
    return topics, attached, words


def test_a_dump_holds_every_record_and_frame_from_10_s_before_to_2_s_after(kept: Kept) -> None:
    rig = kept.rig
    rig.run(9.0)
    tripped_ns = trip(rig)
    kept.poll()
    rig.run(1.9)
    kept.poll()
    assert kept.files() == []  # the dump's time is not over
    rig.run(0.5)
    kept.poll()
    (file,) = kept.files()
    assert file.name.startswith("paper_rig-000001-20231114T2213")
    assert file.name.endswith("Z-CELL_STALE.mcap")
    topics, attached, words = read(file)

    records = [record for _, record in topics["/records"]]
    ticks = np.array([record.tick for record in records])
    assert len(records) == 12_001
    assert np.all(np.diff(ticks) == 1)
    first, last = topics["/records"][0][0], topics["/records"][-1][0]
    assert (tripped_ns - first, last - tripped_ns) == (
        pytest.approx(10e9, abs=2 * TICK_NS),
        pytest.approx(2e9, abs=2 * TICK_NS),
    )
    assert records[0].t_ns == first
    ring = rig.runtime.records.reader(from_start=True).read()
    of_ring = {int(slot["tick"]): slot for slot in ring}
    for record in records[::997]:
        slot = of_ring[record.tick]
        for field in RECORD.fields:
            assert getattr(record, field.name) == slot[field.name] or np.isnan(slot[field.name]), field.name

    blocks = [block for _, block in topics["/frames"]]
    assert {sent for block in blocks for sent in block.sent} == {0, 1}
    on_bus: Counter[tuple[int, bytes]] = Counter()
    inside = (first + 5 * TICK_NS, last - 5 * TICK_NS)
    for t_ns, raw in rig.frames:
        if inside[0] <= t_ns <= inside[1]:
            can_id, dlc, data = FRAME.unpack(raw)
            on_bus[can_id, data[:dlc]] += 1
    in_file = Counter(
        (can_id, block.data[8 * at : 8 * at + dlc])
        for block in blocks
        for at, (can_id, dlc) in enumerate(zip(block.can_id, block.dlc, strict=True))
    )
    assert sum(on_bus.values()) > 45_000
    assert not on_bus - in_file  # every frame of the bus is in the file
    assert not {key[0] for key in in_file} - {key[0] for key in on_bus}
    ends = [block.seq + len(block.can_id) for block in blocks]
    assert [block.seq for block in blocks[1:]] == ends[:-1]
    assert np.array_equal(recordings.read(file).frames["seq"], np.arange(blocks[0].seq, ends[-1]))

    said = [json.loads(data) for _, (schema, data) in topics["/events"]]
    assert {schema.encoding for _, (schema, _) in topics["/events"]} == {"jsonschema"}
    names = [item["what"] for item in said if item["what"] != "held"]
    assert names[names.index("trip") + 1] == "mode"
    assert "CELL_STALE" in said[names.index("trip")]["text"]
    assert json.loads(attached[ACTIVE])["settings"]["rig"] == "paper_rig"
    assert json.loads(attached["schema.json"])["enums"]["modes"]["FAULT"] == Mode.FAULT
    assert words["rigctl"]["fault"] == "CELL_STALE"
    heads = [entry.previous for entry in kept.log()]
    assert words["audit"]["head"] in heads
    (entry,) = [entry for entry in kept.log() if entry.what == "trip_dump"]
    assert entry.details["file"] == file.name
    kept.poll()
    assert len(kept.files()) == 1


def test_commands_and_answers_are_in_the_dump(kept: Kept) -> None:
    assert kept.rig.command(Verb.TARGET, 1000.0) is Refusal.OUT_OF_RANGE
    trip(kept.rig)
    kept.poll(final=True)
    topics, _, _ = read(kept.files()[0])
    orders = [
        (order.verb, *(getattr(order, name) for name in VALUES.get(order.verb, ()))) for _, order in topics["/commands"]
    ]
    replies = [json.loads(data)["text"] for _, (_, data) in topics["/replies"]]
    assert orders == [(Verb.TARGET, 60.0), (Verb.ARM, 0.0), (Verb.TENSION,), (Verb.TARGET, 1000.0)]
    assert replies[-1] == "not carried out: OUT_OF_RANGE, COMPENSATING"


@pytest.mark.study
def test_a_dump_of_a_young_loop_comes_out_bit_identical(
    settings: RigSettings, gains: Gains, tmp_path: pathlib.Path
) -> None:
    history_s, begins = settings.telemetry.history_s, int(Check.HOST)  # as the control process does
    with lockstep(settings, gains, history_s=history_s, host_checks=begins) as rig:
        kept = Kept(rig, tmp_path)
        active = rig.runtime.read_json(ACTIVE)
        rig.runtime.write_json(ACTIVE, {**active, "design": {"gains": msgspec.to_builtins(gains)}})
        rig.runtime.write_json("control.json", {**rig.report.as_json(), "host_checks": int(Check.HOST)})
        rig.run(0.3)
        rig.command(Setting.HOST_CHECKS, 0.0)  # as the gateway does
        assert rig.command(Verb.TARGET, 60.0) is Refusal.NONE
        arm_and_tension(rig, limit_s=5.0)
        trip(rig)
        rig.run(2.1)
        kept.poll()
        (file,) = kept.files()
    assert file.stat().st_mode & 0o777 == 0o640 & ~umask()
    recording = recordings.read(*recordings.parts_of(file))
    (span,) = spans(recording)
    assert Mode.FAULT in span.records["mode"]
    assert first_difference(play(recording, span), lambda _done, _doing: None) == (len(span.records), None)


def umask() -> int:
    found = os.umask(0o022)
    os.umask(found)
    return found


@pytest.mark.study
def test_two_trips_within_seconds_are_both_covered(kept: Kept) -> None:
    rig = kept.rig
    first_ns = trip(rig)
    rig.rig.receive(nmt(1, rig.settings.tension_cell.node))
    rig.run(1.0)  # the device's settings are read back by then
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.3)
    second_ns = trip(rig)
    assert second_ns - first_ns < 2_000_000_000
    rig.run(2.1)
    kept.poll()
    (file,) = kept.files()
    topics, _, words = read(file)
    first, second = words["rigctl"]["trips"].split()
    assert first == "CELL_STALE"
    assert second in ("CELL_STALE", "NODE_NOT_OPERATIONAL")  # the heartbeat may report first that the node has stopped
    times = [t_ns for t_ns, _ in topics["/records"]]
    assert times[-1] - second_ns == pytest.approx(2e9, abs=2 * TICK_NS)
    rig.rig.receive(nmt(1, rig.settings.tension_cell.node))
    rig.run(1.0)  # the device's settings are read back by then
    assert rig.command(Verb.RESET) is Refusal.NONE
    trip(rig)
    rig.run(2.1)
    kept.poll()
    assert len(kept.files()) == 2
    assert [entry.what for entry in kept.log()].count("trip_dump") == 2


def test_a_trip_whose_recorder_was_killed_is_dumped_by_the_next_and_only_once(kept: Kept) -> None:
    trip(kept.rig)
    kept.poll()
    kept.rig.run(2.1)
    kept.start()  # the previous recorder has written nothing
    (kept.folder).mkdir()
    (kept.folder / ".paper_rig-2023-BROKEN.mcap.part").touch()
    kept.start()
    kept.poll()
    assert [file.name.split("-")[-1] for file in kept.files()] == ["CELL_STALE.mcap"]
    kept.start()
    kept.poll()
    assert [entry.what for entry in kept.log()].count("trip_dump") == 1


def test_a_trip_as_the_daemon_stops_is_dumped(kept: Kept) -> None:
    trip(kept.rig)
    now = kept.rig.clock.now()
    kept.recorder.close(now, now + WALL_OFFSET_NS)
    (file,) = kept.files()
    assert len(read(file)[0]["/records"]) > 1000
    assert [entry.what for entry in kept.log()][-2:] == ["trip_dump", "recorder_stopped"]


def test_an_exception_in_the_loop_is_a_trip_too(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    law = kept.rig.loop.law

    def fail(*_: object) -> float:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(law, "compensating", fail)
        kept.rig.run(0.002)
    kept.poll(final=True)
    assert [file.name.split("-")[-1] for file in kept.files()] == ["LOOP_EXCEPTION.mcap"]


def test_the_newest_dumps_are_kept_and_what_is_deleted_is_on_record(kept: Kept) -> None:
    rig = kept.rig
    few = kept.settings.audit.model_copy(update={"trips_kept": 2})
    kept.settings = kept.settings.model_copy(update={"audit": few})
    kept.start()
    names = []
    for _ in range(3):
        trip(rig)
        kept.poll(final=True)
        names.append(kept.files()[-1].name)
        rig.rig.receive(nmt(1, rig.settings.tension_cell.node))
        rig.run(0.5)
        assert rig.command(Verb.RESET) is Refusal.NONE
    assert [file.name for file in kept.files()] == names[1:]
    (gone,) = [entry for entry in kept.log() if entry.what == "trip_dump_deleted"]
    assert gone.text == names[0]


@pytest.mark.study
def test_a_folder_that_takes_no_dump_is_told_and_tried_again_and_given_up_in_the_end(
    kept: Kept, capfd: pytest.CaptureFixture[str]
) -> None:
    rig = kept.rig
    kept.folder.write_text("a file in its place")
    trip(rig)
    rig.run(2.1)
    for _ in range(3):
        kept.poll()
        rig.run(1.1)
    assert kept.recorder.trouble.count == 3
    assert capfd.readouterr().err.count("WARNING: trip dump cannot be written") == 1
    kept.folder.unlink()
    kept.poll()
    assert len(kept.files()) == 1
    again = kept.log()[-1]
    assert (again.what, again.details["what"]) == ("written_again", "trip dump")
    rig.rig.receive(nmt(1, rig.settings.tension_cell.node))
    rig.run(1.0)  # the device's settings are read back by then
    assert rig.command(Verb.RESET) is Refusal.NONE
    trip(rig)
    rig.run(0.1)
    for file in kept.files():
        file.unlink()
    kept.folder.rmdir()
    kept.folder.write_text("again")
    rig.run(rig.settings.telemetry.history_s + 0.1)
    kept.poll()
    assert kept.log()[-1].what == "trip_dump_lost"
    assert kept.recorder.trouble.now


def test_a_dump_is_on_the_disk_before_it_has_its_name(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    trip(kept.rig)
    kept.poll(final=True)
    (file,) = kept.files()
    assert disk.replaced(file)
