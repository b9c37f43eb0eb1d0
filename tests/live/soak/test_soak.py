"""A minute of the soak: the same program, with the promises that a minute can show."""

from __future__ import annotations

import json
import pathlib
import subprocess
import sys

import pytest

from tests.builders.paths import ROOT


@pytest.mark.real_time
@pytest.mark.machine
def test_a_minute_in_service_keeps_every_promise(tmp_path: pathlib.Path) -> None:
    file, plot = tmp_path / "soak.json", tmp_path / "soak.png"
    answer = subprocess.run(
        [sys.executable, "-m", "tests.soak", "--for", "60s", "--seed", "13", "--json", str(file), "--plot", str(plot)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stdout + answer.stderr
    results = json.loads(file.read_text())
    assert results["broken"] == []
    assert set(results["lost"].values()) == {0}
    assert results["commands"]["accepted"] > 0
    assert results["clients_came"] > 0
    assert results["page"]["frames"] > 0
    assert len(results["strikes"]) >= 3
    assert all(results["lateness"][kind]["ticks"] > 0 for kind in ("alone", "busy"))
    assert plot.read_bytes().startswith(b"\x89PNG")
