"""The pieces of a study on several processors: results as they come, and an end where one is asked for."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from hil.runs import runner
from hil.runs.runner import Work
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

PIECES = 40
FEW = 20  # more than the processors have at hand, with time to spare; without an end all would begin


def noted(folder: pathlib.Path, number: int, seconds: float) -> int:
    """A piece of work that leaves a file when it begins."""
    (folder / str(number)).touch()
    time.sleep(seconds)
    return number * number


def main(folder: str) -> None:
    """A study that is interrupted, as `python -m hil` takes SIGTERM."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    pieces = {number: Work(noted, (pathlib.Path(folder), number, 0.5), str(number)) for number in range(PIECES)}
    runner.play(pieces, lambda _cost, _title: None)


def test_each_result_is_kept_as_it_comes_and_told_of(tmp_path: pathlib.Path) -> None:
    kept, titles = dict[int, int](), list[str]()
    pieces = {number: Work(noted, (tmp_path, number, 0.0), str(number)) for number in range(6)}
    found = runner.play(
        pieces, lambda _cost, title: titles.append(title), keep=lambda key, result: kept.update({key: result})
    )
    assert list(found.items()) == [(number, number * number) for number in range(6)]
    assert kept == found
    assert sorted(titles) == [str(number) for number in range(6)]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one processor plays the pieces in the process itself")
def test_a_study_that_is_told_to_end_begins_no_further_piece(tmp_path: pathlib.Path) -> None:
    """It went on to its end: the pool forgot that what had not begun was cancelled."""
    words = [sys.executable, "-c", f"from tests.unit.hil.test_study_runner import main; main({str(tmp_path)!r})"]
    with subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True) as study:
        until(lambda: len(list(tmp_path.iterdir())) >= 1)
        study.send_signal(signal.SIGTERM)
        _, said = study.communicate(timeout=patience_s())
    assert "KeyboardInterrupt" in said
    assert len(list(tmp_path.iterdir())) <= FEW
