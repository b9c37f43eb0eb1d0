"""What the shell gets at the Tab key, from the program as it is installed."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import pytest


def completed(typed: str, folder: pathlib.Path) -> list[str]:
    environment = {
        **os.environ, "_RIGCTL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" ")),
        "RIGCTL_CONNECT": "tcp/127.0.0.1:1",
    }  # fmt: skip
    program = pathlib.Path(sys.executable).with_name("rigctl")
    done = subprocess.run([program], cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize("command", ["run", "check", "tune", "bench", "doctor", "install", "bridge foxglove"])
def test_rig_files_are_completed(command: str, tmp_path: pathlib.Path) -> None:
    for name in ("bench_two.yaml", "bench_two.json", "best.yml", "other.yaml"):
        (tmp_path / name).write_text("")
    assert completed(f"rigctl {command} be", tmp_path) == ["bench_two.yaml", "best.yml"]


def test_folders_are_left_to_the_shell(tmp_path: pathlib.Path) -> None:
    (tmp_path / "config").mkdir()
    assert completed("rigctl check con", tmp_path) == []


def test_without_a_daemon_no_cause_is_completed(tmp_path: pathlib.Path) -> None:
    assert completed("rigctl alarms acknowledge ", tmp_path) == []
