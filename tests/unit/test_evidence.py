"""The runs of `make test-live` are all made, and their table says what became of each test."""

from __future__ import annotations

import pathlib

import pytest

from tests import evidence
from tests.builders.paths import ROOT

CONFTEST = "from tests.builders.host_pause import pytest_runtest_makereport, pytest_runtest_protocol\n"
TESTS = """
import pathlib
import pytest

def test_good(): pass

def test_bad(): assert False

@pytest.mark.skip
def test_left(): pass

@pytest.mark.real_time
def test_paused(tmp_path):
    (tmp_path / "daemon.log").write_text("WARNING: 48 ticks skipped at once")
    runs = pathlib.Path(__file__).with_name("runs")
    again = runs.exists()
    runs.write_text("")
    assert again
"""


def test_a_run_that_fails_keeps_no_other_from_being_made(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "pytest.ini").write_text(f"[pytest]\nmarkers = real_time: live\npythonpath = {ROOT}\n")
    (tmp_path / "test_some.py").write_text(TESTS)
    own = ("-c", str(tmp_path / "pytest.ini"), "-p", "no:cacheprovider")
    first = (str(tmp_path), *own, "-m", "")
    runs = {"first": first, "broken": (*own, "--no-such-option"), "last": (*first[:-1], "real_time")}
    monkeypatch.setattr(evidence, "RUNS", runs)
    assert evidence.main([]) == 1
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["first", "1", "1", "1", "1"] in [line[:5] for line in lines]
    assert ["broken:", "not", "to", "its", "end"] in [line[:5] for line in lines]
    assert ["last", "1", "0", "0", "0"] in [line[:5] for line in lines]
    words = [" ".join(line) for line in lines]
    assert any(line.startswith("failed: ") and line.endswith("test_bad") for line in words)
    assert any("test_paused: the host paused its loop for 48 ms" in line for line in words)


def test_the_runs_have_every_test_that_is_neither_gate_nor_release() -> None:
    for name, words in evidence.RUNS.items():
        assert all((ROOT / path).exists() for path in words[: words.index("-m")]), name
