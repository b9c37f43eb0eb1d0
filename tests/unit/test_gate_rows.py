"""Of a test of many rows the gate plays those that its mark names; a row that is not there is an error."""

from __future__ import annotations

import pathlib
import subprocess
import sys

import pytest

from tests.builders.paths import ROOT

CONFTEST = "from tests.conftest import _leave_rows_to_the_studies as pytest_collection_modifyitems  # noqa: F401\n"
TEST = """import pytest

@pytest.mark.gate({rows})
@pytest.mark.parametrize("row", ["low", "middle", "high"])
def test_rows(row): pass

@pytest.mark.gate
@pytest.mark.parametrize("row", ["low", "high"])
def test_all(row): pass
"""


def collected(folder: pathlib.Path, rows: str) -> subprocess.CompletedProcess[str]:
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "test_rows.py").write_text(TEST.format(rows=rows))
    command = [sys.executable, "-m", "pytest", "-c", "/dev/null", f"--rootdir={folder}", "-q", "-m", "not study",
               "--collect-only", "-p", "no:cacheprovider", str(folder)]  # fmt: skip
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("rows", "left"), [("'low', 'high'", {"low", "high"}), ("", {"low", "middle", "high"})])
def test_the_gate_plays_the_rows_that_are_named(tmp_path: pathlib.Path, rows: str, left: set[str]) -> None:
    lines = collected(tmp_path, rows).stdout.splitlines()
    assert {line.partition("[")[2].rstrip("]") for line in lines if "test_rows[" in line} == left
    assert sum("test_all[" in line for line in lines) == 2


def test_a_row_that_is_not_there_is_an_error(tmp_path: pathlib.Path) -> None:
    found = collected(tmp_path, "'lowest'")
    assert found.returncode == 4
    assert "not every row that its mark `gate` names is there" in found.stdout + found.stderr
