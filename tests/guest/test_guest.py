"""Boots a guest kernel with real SocketCAN and runs the tests of ``inside/`` there."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import pytest

from tests.builders.waiting import FACTOR

HERE = pathlib.Path(__file__).parent
CACHE = pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache"))
HOME = pathlib.Path(os.environ.get("GUEST_HOME", CACHE / "rigctl/guest"))


@pytest.mark.guest
@pytest.mark.parametrize(
    "tests",
    [
        pytest.param(("socketcan",), marks=pytest.mark.smoke),
        ("interface",),
        pytest.param(("operation",), marks=pytest.mark.machine),
        pytest.param(("bus_faults",), marks=pytest.mark.machine),
    ],
    ids="-".join,
)
def test_the_daemon_and_the_simulated_rig_on_a_real_kernels_socketcan(tests: tuple[str, ...]) -> None:
    files = [str(HERE / f"inside/{name}.py") for name in tests]
    inside = [sys.executable, "-m", "pytest", "-v", "--durations=0", "--timeout=0", *files]
    result = subprocess.run(
        [str(HERE / "guest-run"), "-t", "900", *inside],
        env={**os.environ, "GUEST_HOME": str(HOME), "OPENBLAS_NUM_THREADS": "1", FACTOR: "10"},
        capture_output=True,
        text=True,
        check=False,
    )
    sys.stdout.write(result.stdout)
    assert result.returncode == 0, result.stdout + result.stderr
    assert " passed" in result.stdout
