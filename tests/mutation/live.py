"""Mutants in code that only real processes execute, against the tests that start these."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

from tests.builders.waiting import patience_s

_GATEWAY = ("test_gateway", "test_gateway_commands", "test_operator_commands", "test_lease_sessions")
LIVE = {
    "rigctl/control/realtime": ("tests/unit/control/test_realtime.py",),
    "rigctl/control/": ("tests/live/system/test_daemon.py",),
    "rigctl/gateway/": tuple(f"tests/live/telemetry/{name}.py" for name in _GATEWAY),
    "rigctl/recorder/": ("tests/live/system/test_recorder.py", "tests/live/system/test_recording_kept.py"),
}
"""Tests by the beginning of a module's name, the more exact first."""


def tests_of(file: str) -> tuple[str, ...]:
    """The live tests of a module's package."""
    return next((found for package, found in LIVE.items() if file.startswith(package)), ())


def first_failure(folder: pathlib.Path, file: str, source: str | None) -> tuple[str, int]:
    """The first test that fails with ``source`` in the place of ``file`` in the copy, and how many ran.

    A test that fails is run again, alone, with the mutant and without it: a busy machine may fail a real-time test too.
    """
    place = folder / file
    before = place.read_text()
    tests = list(tests_of(file))
    try:
        place.write_text(before if source is None else source)
        failed, ran = _run(folder, tests)
        if not failed or source is None:
            return failed, ran
        again, _ = _run(folder, [failed])
        place.write_text(before)
        without, _ = _run(folder, [failed])
        return (failed if again and not without else ""), ran
    finally:
        place.write_text(before)


def _run(folder: pathlib.Path, tests: list[str]) -> tuple[str, int]:
    command = [sys.executable, "-B", "-m", "pytest", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-rfE", *tests]
    own = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    environment = {name: value for name, value in os.environ.items() if name != "PYTEST_DISABLE_PLUGIN_AUTOLOAD"} | own
    try:
        ended = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=patience_s(600.0), check=False
        )
    except subprocess.TimeoutExpired:
        return "(took too long)", 0
    ran = sum(line.count(".") for line in ended.stdout.splitlines() if set(line.split(" ")[0]) <= set(".FEsx"))
    if ended.returncode == 0:
        return "", ran
    failed = [line.split(" ")[1] for line in ended.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return (failed[0] if failed else f"(pytest ended with {ended.returncode})"), ran
