"""Audit log and trip dumps of a real daemon, with a rig that fails and a full disk."""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import signal
import subprocess
from collections.abc import Iterator

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from rigctl.config import rig_file as config
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.recorder import chain
from tests.builders import daemons
from tests.builders.operators import ANNA, KIM
from tests.builders.waiting import patience_s, until
from tests.live.system.test_daemon import PATIENT, Running


def entries(file: pathlib.Path) -> list[chain.AuditEntry]:
    """Entries of a log, whose chain must hold."""
    lines = config.load(file).audit_log.read_bytes().splitlines(keepends=True)
    report = chain.verify(lines)
    assert report.good, report
    return [chain.read_line(line)[0] for line in lines]


def missing(found: list[chain.AuditEntry], runtime: Runtime) -> dict[str, int]:
    """Number of slots of each ring that are neither in the log, once, nor counted there as a repeat."""
    rings = {
        "events": runtime.events.reader(), "notes": runtime.notes.reader(), "replies": runtime.replies.reader(),
        "commands": runtime.commands.reader(), "desk": runtime.requests.reader(from_start=True),
        "supervision": runtime.supervision.reader(from_start=True),
    }  # fmt: skip
    repeats = [entry.details for entry in found if entry.what == "repeated"]
    return {
        name: ring.head
        - len({entry.seq for entry in found if entry.source == name})
        - sum(same["count"] for same in repeats if same["source"] == name)
        for name, ring in rings.items()
    }


def recorder_of(file: pathlib.Path) -> int:
    return daemons.process_with("rigctl.recorder", f"rigctl-{daemons.name_of(file)}")


@pytest.fixture
def slow(tmp_path: pathlib.Path) -> Iterator[Running]:
    file = daemons.slow_rig_file(tmp_path)
    log = tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log") as rig, daemons.daemon(file, log) as daemon:
        yield Running(file, daemon, rig, log)


@pytest.mark.smoke
def test_a_session_with_a_trip_is_on_record_and_the_recorders_death_changes_nothing(slow: Running) -> None:
    file, runtime = slow.file, Runtime.of(daemons.name_of(slow.file))
    slow.do("arm", "--operator", "anna")
    slow.do("target", "60", "--operator", "anna")
    slow.do("tension", "--wait", "--operator", "anna")
    assert f"{ANNA} holds the lease" in slow.refused("disarm", "--operator", "kim")
    os.kill(recorder_of(file), signal.SIGKILL)
    until(lambda: "recorder process killed by signal 9; comes back in 0.2 s; the loop is unaffected"
                     in slow.log.read_text(), log=slow.log)  # fmt: skip
    slow.rig.send_signal(signal.SIGSTOP)
    until(lambda: daemons.state(file).get("mode") == "FAULT", log=slow.log)
    slow.rig.send_signal(signal.SIGCONT)
    told = until(lambda: (s := daemons.state(file)).get("trip_dump") and s, log=slow.log)
    assert told["trip_dump"] == json.loads(slow.do("status", "--json"))["trip_dump"]
    assert "trip dump" in slow.do("status", "--all")
    head = told["audit"]["head"]
    answer = daemons.rigctl("audit", "verify", str(file), "--head", head)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert runtime.read_json(RECORDED)["failures"] == 0
    slow.daemon.send_signal(signal.SIGTERM)
    ended = slow.daemon.wait(patience_s())
    # A drive that is not heard for 0.2 s is left to its own supervision: then its brake is not seen to close.
    assert ended == ("the brake was not seen to close" in slow.log.read_text())

    found = entries(file)
    what = [entry.what for entry in found]
    assert what.count("daemon_started") == 1
    # The counts of repeated lines are written when the recorder ends, between the two.
    *_, stopped, ended_last = (entry for entry in found if entry.what != "repeated")
    assert (stopped.what, ended_last.what, what[-1]) == ("daemon_stopped", "recorder_stopped", "recorder_stopped")
    assert "brake" in stopped.text or "stopped in" in stopped.text
    (designed,) = [entry for entry in found if entry.what == "daemon_designed"]
    assert designed.details["ms_max"] < 1.6
    assert ("process_ended", "recorder") in [(entry.what, entry.details.get("process")) for entry in found]
    answers = [(entry.who, entry.details["verb"], entry.details["reason"]) for entry in found
               if entry.what in ("command_accepted", "command_refused")]  # fmt: skip
    for expected in ((ANNA, "arm", ""), (ANNA, "tension", ""), (KIM, "disarm", "lease_held")):
        assert expected in answers
    refused = [entry for entry in found if entry.what == "command_refused"]
    assert {entry.who for entry in refused} == {KIM}
    assert {entry.details["holder"] for entry in refused} == {ANNA}
    assert [entry.text for entry in found if entry.what == "mode"][:2] == [
        "DISARMED -> HOLD: drive enabled", "HOLD -> TENSIONING: tension commanded"
    ]  # fmt: skip
    assert "trip" in what
    killed_ns = next(entry.t_ns for entry in found if entry.details.get("process") == "recorder")
    for source in ("events", "desk", "supervision", "replies", "commands", "notes"):
        seen = [entry.seq for entry in found if entry.source == source]
        assert seen == sorted(set(seen)), source
        repeats = [entry.details for entry in found if entry.what == "repeated" and entry.details["source"] == source]
        last = max([seen[-1], *(same["up_to"] for same in repeats)])
        # A killed recorder takes along the counts of repeats that it has not written yet, and nothing else.
        by_then = max([entry.seq for entry in found if entry.source == source and entry.t_ns < killed_ns], default=0)
        counted_then = by_then - sum(seq <= by_then for seq in seen)
        missing = last - len(seen) - sum(same["count"] for same in repeats)
        assert 0 <= missing <= counted_then, source

    (dump,) = (file.parent / "trips").iterdir()
    assert dump.name == told["trip_dump"]
    with dump.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        records_kept = [item.decoded_message for item in reader.iter_decoded_messages(topics=["/records"])]
        sent = [flag for item in reader.iter_decoded_messages(topics=["/frames"]) for flag in item.decoded_message.sent]
        words = {item.name: item.metadata for item in reader.iter_metadata()}
    ticks = np.array([record.tick for record in records_kept])
    skipped = np.array([record.skipped for record in records_kept])
    assert np.all(np.diff(ticks) == 1 + np.diff(skipped))
    assert records_kept[0].t_ns < int(words["rigctl"]["t_ns"]) < records_kept[-1].t_ns
    assert 0 < sum(sent) < len(sent)
    assert words["audit"]["head"] in {entry.previous for entry in found}


@pytest.mark.skipif(os.getuid() != 0 or shutil.which("mount") is None, reason="needs root, to mount a small disk")
def test_a_full_disk_is_told_and_the_daemon_goes_on(tmp_path: pathlib.Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(disk)], check=True)
    try:
        kept = {"file": str(disk / "audit.jsonl"), "trips": str(disk / "trips")}
        file = daemons.rig_file(tmp_path, {**PATIENT, "preflight": {"disk_free_mib": 1}, "audit": kept})
        log = tmp_path / "daemon.log"
        with daemons.simulated_rig(file, tmp_path / "rig.log") as rig, daemons.daemon(file, log) as daemon:
            running = Running(file, daemon, rig, log)
            runtime = Runtime.of(daemons.name_of(file))
            until(lambda: runtime.read_json(RECORDED).get("entries"), log=log)
            running.compensate(60)
            filler = disk / "filler"
            with filler.open("wb", buffering=0) as out_, pytest.raises(OSError, match="No space left"):
                while True:
                    out_.write(b"x" * 512)
            running.do("hold")
            until(lambda: runtime.read_json(RECORDED)["failures"] > 1, log=log)
            assert "No space left" in running.do("status", "--all")
            assert daemons.mode(file) == "HOLD"
            rig.send_signal(signal.SIGSTOP)
            until(lambda: daemons.mode(file) == "FAULT", log=log)
            rig.send_signal(signal.SIGCONT)
            until(lambda: "trip dump cannot be written" in log.read_text(), log=log)
            assert "-> FAULT" in log.read_text()
            filler.unlink()
            until(lambda: "audit log is written again" in log.read_text(), log=log)
            until(lambda: not runtime.read_json(RECORDED)["warnings"]
                             or "audit" not in runtime.read_json(RECORDED)["warnings"][0], log=log)  # fmt: skip
            until(lambda: not any(missing(entries(file), runtime).values()), log=log)
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(patience_s()) == 0
        what = [entry.what for entry in entries(file)]
        assert "written_again" in what
        assert "lost" not in what
        assert "command_accepted" in what
        assert "trip_dump" in what
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)
