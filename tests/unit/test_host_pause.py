"""A real-time test is repeated for a pause that the loop has measured, once, and for nothing else."""

from __future__ import annotations

import pathlib
import signal
import subprocess
import sys
import time

import pytest

from tests.builders.host_pause import PAUSE_MS
from tests.builders.paths import ROOT

CONFTEST = "from tests.builders.host_pause import pytest_runtest_makereport, pytest_runtest_protocol\n"
TEST = """
import pathlib
import pytest

@pytest.mark.real_time
def test_live(tmp_path):
    runs = pathlib.Path({runs!r})
    runs.write_text(runs.read_text() + "x" if runs.exists() else "x")
    (tmp_path / "daemon.log").write_text("08:00:00 WARNING: {ticks} ticks skipped at once")
    assert len(runs.read_text()) > {fails}
"""
SMOKE_TEST = """
import pathlib
import pytest

@pytest.fixture(scope="module")
def made():
    made.count = getattr(made, "count", 0) + 1
    return made.count

@pytest.mark.smoke
def test_live(made):
    runs = pathlib.Path({runs!r})
    runs.write_text(runs.read_text() + f" {{made}}" if runs.exists() else f"{{made}}")
    assert len(runs.read_text().split()) > {fails}

def test_next(made):
    pass
"""


@pytest.mark.parametrize(
    ("ticks", "fails", "runs", "code"),
    [(48, 1, 2, 0), (48, 2, 2, 1), (5, 1, 1, 1), (48, 0, 1, 0)],
    ids=["repeated for a pause", "once", "no pause, no repeat", "passed at once"],
)
def test_only_a_measured_pause_repeats(tmp_path: pathlib.Path, ticks: int, fails: int, runs: int, code: int) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = real_time: live\n")
    counted = tmp_path / "runs"
    (tmp_path / "test_live.py").write_text(TEST.format(runs=str(counted), ticks=ticks, fails=fails))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_live.py"]
    done = subprocess.run(
        command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    assert len(counted.read_text()) == runs
    assert ("failed while the host paused the loop for 48 ms; once more" in done.stdout) is (runs == 2)


@pytest.mark.parametrize(("fails", "runs", "code"), [(0, 1, 0), (2, 3, 0), (3, 3, 1)])
def test_a_smoke_test_is_repeated_twice_and_named_in_the_run_after_it(
    tmp_path: pathlib.Path, fails: int, runs: int, code: int
) -> None:
    hooks = CONFTEST + "from tests.builders.smoke import pytest_terminal_summary\n"
    (tmp_path / "conftest.py").write_text(hooks)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n    smoke: first\n")
    counted = tmp_path / "runs"
    (tmp_path / "test_live.py").write_text(SMOKE_TEST.format(runs=str(counted), fails=fails))
    (tmp_path / "test_other.py").write_text("def test_other(): pass\n")
    where = {"PYTHONPATH": str(ROOT), "SMOKE_SUMMARY": str(tmp_path / "smoke.txt")}
    smoke, others = (
        subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, file],
            cwd=tmp_path, env=where, capture_output=True, text=True, check=False,
        )
        for file, options in (("test_live.py", ("--numprocesses", "2")), ("test_other.py", ()))
    )  # fmt: skip
    assert (smoke.returncode, others.returncode) == (code, 0), smoke.stdout + others.stdout
    made = counted.read_text().split()
    assert len(made) == runs
    assert len(set(made)) == runs, "each run has fixtures of its own"
    for output in (smoke.stdout, others.stdout):
        assert output.count("test_live.py::test_live: run") == min(fails, 3)
        assert ("run 3 failed, the last: AssertionError: assert 3 > 3" in output) is (code == 1)
    assert "1 passed" in others.stdout.splitlines()[-1]


def test_a_process_that_was_stopped_has_woken_up_late() -> None:
    program = (
        "import time; from tests.builders.host_pause import late_wake_ups\nwith late_wake_ups() as late:\n"
        " print(flush=True); time.sleep(1.0)\nprint(max(late))"
    )
    with subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, text=True) as watched:
        assert watched.stdout is not None
        watched.stdout.readline()
        time.sleep(0.1)
        watched.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        watched.send_signal(signal.SIGCONT)
        assert float(watched.stdout.read()) >= PAUSE_MS
