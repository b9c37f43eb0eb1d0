"""What is judged of a process by its progress: a stalled or busy computer does not make its processes hang."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys

import pytest

from rigctl.ipc.progress import HUNG_S, REPORTED_S, Progress, Stall, StallChange, Thread, main_thread, progress_of
from rigctl.ipc.runtime_folder import Runtime

TURN_S = 0.1
STOPPED = Thread("T", 100, 7)


def looked(stall: Stall, seconds: float, thread: Thread | None, *, at: float = 0.0, count: int | None = 7,
           turn_s: float = TURN_S) -> list[tuple[float, StallChange]]:  # fmt: skip
    """What is found, and when, in a time without progress."""
    stall.look(at, count, thread)
    turns = (at + turn_s * number for number in range(1, round(seconds / turn_s) + 1))
    return [(round(now - at, 6), found) for now in turns if (found := stall.look(now, count, thread)) is not None]


def test_a_process_without_progress_is_reported_after_1_s_and_hangs_after_5_s() -> None:
    found = looked(Stall(), 5.4, STOPPED)
    assert [what for _, what in found][:2] == [StallChange.STALLED, StallChange.HUNG]
    (reported, _), (hung, _) = found[:2]
    assert REPORTED_S <= reported <= REPORTED_S + 2 * TURN_S
    assert HUNG_S <= hung <= HUNG_S + 2 * TURN_S


@pytest.mark.parametrize("state", ["R", "D"])
def test_one_that_waits_for_a_processor_or_a_disk_does_not_hang(state: str) -> None:
    assert [what for _, what in looked(Stall(), 60.0, Thread(state, 100, 7))] == [StallChange.STALLED]


@pytest.mark.parametrize(
    ("ran_s", "waited_s", "state"),
    [(0.04, 0.06, "R"), (0.04, 0.0, "S"), (0.0, 0.1, "S"), (0.001, 0.0, "S"), (0.09, 0.0, "D")],
)
def test_one_that_takes_or_waits_for_a_processor_or_a_disk_does_not_hang(
    ran_s: float, waited_s: float, state: str
) -> None:
    stall = Stall()
    found = [
        stall.look(TURN_S * turn, 7, Thread(state, round(turn * ran_s * 1e9), round(turn * waited_s * 1e9)))
        for turn in range(600)
    ]
    assert [what for what in found if what is not None] == [StallChange.STALLED]


@pytest.mark.parametrize("state", ["R", "S"])
def test_one_that_spins_without_progress_hangs_after_5_s(state: str) -> None:
    stall = Stall()
    found = [stall.look(TURN_S * turn, 7, Thread(state, round(turn * 0.06e9), 0)) for turn in range(60)]
    assert [what for what in found if what is not None][:2] == [StallChange.STALLED, StallChange.HUNG]
    assert HUNG_S <= TURN_S * found.index(StallChange.HUNG) <= HUNG_S + 2 * TURN_S


def test_one_that_may_not_be_seen_is_reported_only() -> None:
    assert [what for _, what in looked(Stall(), 60.0, None)] == [StallChange.STALLED]


def test_a_time_in_which_the_observer_was_stalled_itself_does_not_count() -> None:
    """The computer may have been asleep: nothing is known of the process until it could have taken a turn."""
    stall = Stall()
    stall.look(0.0, 7, STOPPED)
    assert stall.look(3600.0, 7, STOPPED) is None
    assert stall.look(3600.1, 8, STOPPED) is None


def test_progress_ends_it_and_says_how_long_it_lasted() -> None:
    stall = Stall()
    assert [what for _, what in looked(stall, 2.0, STOPPED)] == [StallChange.STALLED]
    assert stall.look(2.1, 8, STOPPED) is StallChange.RESUMED
    assert stall.lasted_s == pytest.approx(2.0, abs=0.11)
    assert [what for _, what in looked(stall, 2.0, STOPPED, at=2.1, count=8)] == [StallChange.STALLED]


def test_until_its_first_progress_a_process_may_take_its_grace() -> None:
    found = looked(Stall(grace_s=20.0), 26.0, STOPPED, count=None)
    assert [what for _, what in found][:2] == [StallChange.STALLED, StallChange.HUNG]
    assert found[0][0] >= 20.0 + REPORTED_S - TURN_S


def test_a_count_of_the_process_before_ends_no_grace() -> None:
    stall = Stall(grace_s=20.0)
    assert looked(stall, 15.0, STOPPED) == []


def test_the_count_is_in_the_folder_and_a_new_process_begins_anew(tmp_path: pathlib.Path) -> None:
    runtime = Runtime(tmp_path)
    assert progress_of(runtime, "recorder") is None
    progress = Progress(runtime, "recorder")
    assert progress_of(runtime, "recorder") is None
    progress.step()
    progress.step()
    assert progress_of(runtime, "recorder") == 2
    Progress(runtime, "recorder").step()
    assert progress_of(runtime, "recorder") == 1
    (tmp_path / "gateway.progress").write_bytes(b"abc")  # damaged
    assert progress_of(runtime, "gateway") is None


def test_a_stopped_process_is_seen_as_stopped_and_takes_no_processor_time() -> None:
    process = subprocess.Popen([sys.executable, "-c", "print(1, flush=True)\nwhile True: pass"], stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        os.kill(process.pid, signal.SIGSTOP)
        os.waitpid(process.pid, os.WUNTRACED)
        first, second = main_thread(process.pid), main_thread(process.pid)
        assert first is not None
        assert first.state == "T"
        assert first == second
    finally:
        process.kill()
        process.wait()
    assert main_thread(process.pid) is None
