"""The recorder is killed at random instants while the rings fill: the chain holds, without gap or repetition."""

from __future__ import annotations

import itertools
import pathlib
import random
import signal
import time
from collections.abc import Iterator

import pytest

from rigctl.config.audit_section import AuditSettings
from rigctl.config.recording_section import RecordingSettings
from rigctl.ipc.runtime_folder import ACTIVE, RECORDED
from rigctl.ipc.supervision import Doing, Supervision
from rigctl.model.events import Kind
from rigctl.recorder import chain
from tests.builders.miniature import Daemon
from tests.builders.waiting import patience_s, until

KILLS = 10


@pytest.fixture
def daemon(tmp_path: pathlib.Path) -> Iterator[Daemon]:
    """Rings without a loop: the test is the writer."""
    found = Daemon()
    own = AuditSettings(file=str(tmp_path / "audit.jsonl"), trips=str(tmp_path / "trips"))
    kept = RecordingSettings(folder=str(tmp_path / "recordings"))
    found.settings = found.settings.model_copy(update={"audit": own, "recording": kept})
    found.runtime.write_json(ACTIVE, {"settings": found.settings.model_dump(mode="json"), "started_wall_ns": 5})
    try:
        yield found
    finally:
        found.close()


def test_ten_kills_lose_nothing(daemon: Daemon) -> None:
    log = daemon.settings.audit_log
    events = daemon.runtime.events.writer()
    choose = random.Random(20)
    numbers = itertools.count(1)

    def write_for(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            events.write(time.monotonic_ns(), int(Kind.SIGNS), next(numbers), 5, 0.0, 0.0, b"")
            time.sleep(0.001)

    def entries() -> int:
        return int(daemon.runtime.read_json(RECORDED).get("entries", 0))

    for _ in range(KILLS):
        before = entries()
        recorder = daemon.spawn("-m", "rigctl.recorder", str(daemon.runtime.directory))
        while entries() <= before:
            assert recorder.poll() is None
            write_for(0.001)  # few while it starts, however long that takes: the ring must hold them
            time.sleep(0.02)
        write_for(choose.uniform(0.0, 0.2))
        recorder.send_signal(signal.SIGKILL)
        recorder.wait()
        write_for(0.02)
    before = entries()
    last = daemon.spawn("-m", "rigctl.recorder", str(daemon.runtime.directory))
    until(lambda: entries() > before, "the last recorder to write")
    Supervision(daemon.runtime.supervision.writer()).note(time.monotonic_ns(), Doing.DAEMON_STOPPED, reason="done")
    last.terminate()
    assert last.wait(patience_s()) == 0

    lines = log.read_bytes().splitlines(keepends=True)
    report = chain.verify(lines)
    assert report.good, report
    assert report.head == daemon.runtime.read_json(RECORDED)["head"]
    found = [chain.read_line(line)[0] for line in lines]
    assert [entry.seq for entry in found if entry.source == "events"] == list(range(1, events.head + 1))
    assert [entry.what for entry in found].count("recorder_started") == KILLS + 1
    assert [entry.what for entry in found][-2:] == ["daemon_stopped", "recorder_stopped"]
    assert not {entry.what for entry in found} & {"lost", "tampered", "unworded"}
