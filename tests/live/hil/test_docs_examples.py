"""The Python blocks of the documentation that need a rig or a recording, unchanged."""

from __future__ import annotations

import os
import pathlib
import re
import subprocess
import sys

import pytest

from tests.builders.paths import ROOT
from tests.builders.tape import Tape
from tests.builders.waiting import patience_s

CHANNEL = "/tmp/rigctl-paper_rig.sock"


def blocks(kind: str) -> list[str]:
    pages = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
    return [
        block
        for page in pages
        for block in re.findall(rf"^```python {kind}\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    ]


def python(*words: object, folder: pathlib.Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip


def test_the_tests_shown_pass(tmp_path: pathlib.Path) -> None:
    shown = blocks("test")
    assert len(shown) >= 3
    files = [tmp_path / f"test_shown_{number}.py" for number in range(len(shown))]
    for file, text in zip(files, shown, strict=True):
        file.write_text(text)
    done = python("-m", "pytest", "-q", "-p", "no:cacheprovider", *files, folder=tmp_path)  # in any folder
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_catalogue_is_played_on_the_papers_rig_from_any_folder(tmp_path: pathlib.Path) -> None:
    rows = tmp_path / "rows.json"
    done = python("-m", "hil", "faults", "--only", "cell_silent", "--mode", "HOLD", "--json", rows, folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert rows.is_file()


def test_a_recording_is_read_as_shown(tmp_path: pathlib.Path) -> None:
    (shown,) = blocks("recording")
    tape = Tape(tmp_path)
    tape.tick(500)
    tape.close()
    (part,) = tape.files()
    part.rename(tmp_path / "recording.mcap")
    done = python("-c", shown, folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "500 ticks, 2000 frames, complete: True"
    assert lines[1].startswith("0.499 s, tension at the end ")
    assert lines[2].endswith("settings attached: True")


@pytest.mark.real_time
@pytest.mark.alone
def test_a_served_rig_is_met_as_shown(served: subprocess.Popen[str], channel: str, tmp_path: pathlib.Path) -> None:
    assert served.poll() is None
    (shown,) = blocks("serve")
    assert CHANNEL in shown
    script = tmp_path / "shown.py"
    script.write_text(shown.replace(CHANNEL, channel))
    done = python(script, folder=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["emergency stop pressed: 1", "true stroke: 0 um"]
