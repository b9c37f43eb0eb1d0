"""The recorder over a daemon's run: what it logs, what it publishes and when it ends."""

from __future__ import annotations

import os
import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rigctl.config.settings import RigSettings
from rigctl.ipc.record import REPLY
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.recorder.audit_log import moment
from rigctl.recorder.recorder_process import PUBLISH_NS, Recorder, _serve, main
from rigctl.recorder.recording import read
from tests.builders.waiting import patience_s, until
from tests.unit.recorder.test_sources import entries

S = 1_000_000_000


def test_an_undisturbed_run_is_logged_recorded_and_closed(runtime: Runtime, settings: RigSettings) -> None:
    recorder = Recorder(runtime, settings, 0, 0)
    events = runtime.events.writer()
    for second in range(1, 4):
        events.write(second * S, 9, 0, 0, 0.0, 0.0, b"")
        recorder.poll(second * S, second * S)
    recorder.close(4 * S, 4 * S)
    assert [entry.source for entry in entries(settings)] == ["recorder", "events", "events", "events", "recorder"]
    assert [entry.what for entry in entries(settings) if entry.source == "recorder"] == [
        "recorder_started", "recorder_stopped",
    ]  # fmt: skip
    assert read(*settings.file(settings.recording.folder).iterdir()).complete
    found = runtime.read_json(RECORDED)
    assert (found["entries"], found["failures"], found["warnings"]) == (5, 0, [])


def test_an_entry_has_one_moment_on_both_clocks_also_after_a_disk_that_failed(
    runtime: Runtime, settings: RigSettings
) -> None:
    folder = settings.audit_log.parent
    folder.write_text("a file in its place")
    recorder = Recorder(runtime, settings, 0, 0)
    events = runtime.events.writer()
    for second in range(1, 4):
        events.write(second * S, 9, 0, 0, 0.0, 0.0, b"")
        recorder.poll(second * S, second * S)
    folder.unlink()
    recorder.poll(9 * S, 9 * S)
    recorder.poll(10 * S, 10 * S)
    found = entries(settings)
    assert found[-1].what == "written_again"
    assert [(entry.t_ns, entry.wall) for entry in found] == [(t * S, moment(t * S)) for t in (0, 1, 2, 3, 9)]


def test_a_recording_that_fails_is_told_and_counted_once_for_each_try(runtime: Runtime, settings: RigSettings) -> None:
    folder = settings.file(settings.recording.folder)
    folder.write_text("a file in its place")
    recorder = Recorder(runtime, settings, 0, 0)
    for number in range(1, 11):
        recorder.poll(number * S // 10, number * S // 10)
    found = runtime.read_json(RECORDED)
    assert found["failures"] == 1
    assert str(folder) in found["warnings"][0]
    folder.unlink()
    for second in range(2, 5):
        recorder.poll(second * S, second * S)
    recorder.poll(5 * S, 5 * S)
    assert runtime.read_json(RECORDED)["warnings"] == []
    (again,) = [entry for entry in entries(settings) if entry.what == "written_again"]
    assert (again.details["what"], again.details["for_s"] > 0.0) == ("recording", True)


def test_figures_that_do_not_change_are_published_once_a_second(runtime: Runtime, settings: RigSettings) -> None:
    recorder = Recorder(runtime, settings, 0, 0)
    for t_ns in (S, 2 * S, 3 * S):  # log and recording have begun
        recorder.poll(t_ns, t_ns)
    base = runtime.read_json(RECORDED)["t_ns"]
    recording_alone = settings.model_copy(
        update={"recording": settings.recording.model_copy(update={"enabled": False})}
    )
    quiet = Recorder(runtime, recording_alone, base, base)
    quiet.poll(base + S, base + S)
    shown = []
    for part in range(1, 5):
        quiet.poll(base + S + part * PUBLISH_NS // 4, base + S)
        shown.append(runtime.read_json(RECORDED)["t_ns"] - base - S)
    assert shown == [0, 0, 0, PUBLISH_NS]


def test_what_the_loop_did_before_the_recorder_started_is_logged_too(runtime: Runtime, settings: RigSettings) -> None:
    values = REPLY.values(t_ns=1, id=99, accepted=1, reason=0, checks=0, mode=0, tension_n=4.5)
    runtime.replies.writer().write(*values)
    runtime.events.writer().write(2, 9, 0, 0, 0.0, 0.0, b"")
    recorder = Recorder(runtime, settings, 3, 3)
    recorder.poll(4, 4)
    found = {entry.source: entry for entry in entries(settings)}
    assert (found["replies"].seq, found["events"].seq) == (1, 1)
    details = found["replies"].details
    assert (details["value"], details["spread"]) == (4.5, 0.0)


@pytest.mark.parametrize("cut", [True, False])
def test_a_log_that_is_renamed_or_cut_is_found_without_another_entry_and_said_once(
    runtime: Runtime, settings: RigSettings, capsys: pytest.CaptureFixture[str], cut: bool
) -> None:
    recorder, log = Recorder(runtime, settings, 0, 0), settings.audit_log
    recorder.poll(S, S)
    recorder.poll(2 * S, 2 * S)  # the recording's own entry is written too
    size = log.stat().st_size
    if cut:
        os.truncate(log, 0)
    else:
        log.rename(log.with_name("away.jsonl"))
    for second in range(3, 9):
        recorder.poll(second * S, second * S)
    (entry,) = entries(settings)
    how = f"was cut from {size} to 0 bytes" if cut else "was renamed or deleted"
    assert (entry.what, entry.text, entry.t_ns) == ("tampered", f"the log {how} while the daemon ran", 3 * S)
    assert [line for line in capsys.readouterr().err.splitlines() if "WARNING" in line] == [
        f"recorder: WARNING: the audit log {log} {how} while the daemon ran; it goes on in a file of its name"
    ]
    found = runtime.read_json(RECORDED)
    assert (found["changes"], found["changed"]) == (1, how)
    again = Recorder(runtime, settings, 9 * S, 9 * S)
    again.poll(10 * S, 10 * S)
    assert runtime.read_json(RECORDED)["changes"] == 1


@pytest.mark.parametrize("over", [True, False])
def test_it_ends_with_the_supervisors_last_entry_and_not_before_it_is_told_to(over: bool) -> None:
    polls: list[int] = []
    recorder = SimpleNamespace(over=over, poll=lambda *_: polls.append(1))
    stop = SimpleNamespace(requested=False)
    serving = threading.Thread(
        target=_serve, args=(cast("Any", recorder), cast("Any", stop), lambda: False, lambda: None), daemon=True
    )
    serving.start()
    until(lambda: len(polls) >= 2)
    assert serving.is_alive()
    stop.requested, recorder.over = True, True
    serving.join(patience_s())
    assert not serving.is_alive()


def test_without_a_folder_it_says_how_it_is_started(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([], cast("Any", SimpleNamespace(requested=True))) == 2
    assert capsys.readouterr().err == "usage: python -m rigctl.recorder [--service] RUNTIME_DIR\n"
