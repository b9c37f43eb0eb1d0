"""Tests of a disk with too little room leave no bytecode that is cut short, which would fail every later import."""

from __future__ import annotations

import importlib
import pathlib
import subprocess
import sys

import pytest

from tests.builders.full_disk import files_of_at_most, rigctl_with_files_of_at_most
from tests.builders.paths import ROOT

OWN = ("builders/full_disk.py", "unit/test_full_disk.py")


def test_the_limit_of_a_files_length_is_set_in_one_place_only() -> None:
    tests = ROOT / "tests"
    found = {file.relative_to(tests).as_posix() for file in tests.rglob("*.py") if "RLIMIT_FSIZE" in file.read_text()}
    assert found == set(OWN)


def test_a_module_that_is_imported_under_the_limit_leaves_no_bytecode(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "imported_on_a_full_disk.py").write_text(f"WORDS = {['word'] * 1000}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    with files_of_at_most(100):
        importlib.import_module("imported_on_a_full_disk")
    assert not (tmp_path / "__pycache__").exists()
    assert not sys.dont_write_bytecode


def test_a_command_under_the_limit_leaves_none_either(tmp_path: pathlib.Path) -> None:
    copy = tmp_path / "rigctl"
    copy.mkdir()
    command = rigctl_with_files_of_at_most(100, [])
    (copy / "__init__.py").write_text("")
    (copy / "cli").mkdir()
    (copy / "cli/__init__.py").write_text("")
    (copy / "cli/app.py").write_text(f"WORDS = {['word'] * 1000}\ndef main(): print('run')\n")
    answer = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert answer.stdout == "run\n"
    assert not list(tmp_path.rglob("__pycache__"))
