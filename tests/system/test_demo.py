"""The demo, in simulated and in real time: its figures, its keys, its verdict."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import pytest

from rigctl.recorder import recording
from tests import daemons

KEYS = {
    "eta_true_max_pct", "eta_true_rms_pct", "eta_cell_max_pct", "skipped_ticks", "ticks", "lateness_us", "work_us",
    "frames", "telemetry", "duration_s", "passed",
}  # fmt: skip
SHORT: dict[str, Any] = {"angle_deg": 2.0}


def play(tmp_path: pathlib.Path, changes: dict[str, dict[str, Any]], *options: str) -> tuple[int, dict[str, Any], str]:
    figures = tmp_path / "demo.json"
    file = daemons.rig_file(tmp_path, changes)
    answer = daemons.rigctl("demo", str(file), "--json", str(figures), *options,
                            "--recordings", str(tmp_path / "recordings"))  # fmt: skip
    assert "Traceback" not in answer.stderr
    return answer.returncode, json.loads(figures.read_text()), answer.stdout


def replayed(file: str) -> tuple[int, bool]:
    """Ticks that a replay finds the same, and whether that is all of them."""
    answer = daemons.rigctl("replay", file, "--json")
    assert answer.returncode in (0, 1), answer.stderr
    found = json.loads(answer.stdout)
    return sum(row["same"] for row in found["loops"]), found["identical"] and answer.returncode == 0


@pytest.mark.simulated_time
def test_the_papers_move_in_lockstep_is_within_the_limits(tmp_path: pathlib.Path) -> None:
    code, figures, said = play(tmp_path, {"demo": {"angle_deg": 13.0}}, "--lockstep")
    assert code == 0
    assert set(figures) >= KEYS
    assert figures["passed"] is True
    assert 0.0 < figures["eta_true_max_pct"] <= 0.10
    assert 0.0 < figures["eta_true_rms_pct"] <= 0.03
    assert figures["frames"]["lost"] == 0
    assert figures["skipped_ticks"] == 0
    assert figures["telemetry"] is None
    kept = recording.read(figures["recording"])
    assert figures["recording"] in said
    assert (len(kept.records), kept.complete, kept.gaps) == (figures["ticks"], True, [])
    assert replayed(figures["recording"]) == (figures["ticks"], True)
    assert "passed" in said


@pytest.mark.simulated_time
def test_limits_that_are_not_met_fail_the_demo(tmp_path: pathlib.Path) -> None:
    code, figures, said = play(tmp_path, {"demo": {**SHORT, "eta_max_pct": 0.001}}, "--lockstep")
    assert code == 1
    assert figures["passed"] is False
    assert "NOT MET" in said


def test_in_real_time_every_part_runs_in_its_own_process(tmp_path: pathlib.Path) -> None:
    changes = {
        "demo": SHORT,
        "safety": {
            "stale_ms": 100,
            "bus_silent_ms": 100,
            "inclination_stale_ms": 500,
            "overrun_ticks": 900,
            "waiver": "a simulated rig on a busy machine",
        },
        "cylinder": {"command_deadline_ms": 150, "heartbeat_timeout_ms": 200},
        "telemetry": {"lease_s": 15},  # shorter than the time between two of its commands: it has to renew it
    }
    code, figures, said = play(tmp_path, changes)
    assert set(figures) >= KEYS
    assert figures["frames"]["lost"] == 0
    assert figures["frames"]["sent"] > 2 * figures["ticks"]
    assert figures["telemetry"]["produced"] > 20_000
    assert figures["telemetry"]["received"] == figures["telemetry"]["produced"]
    assert set(figures["lateness_us"]) == set(figures["work_us"]) == {"p50", "p99", "p999", "max"}
    assert figures["eta_true_max_pct"] <= 0.10
    assert (code, figures["passed"]) == (0, True), said
    kept = recording.read(*recording.parts_of(figures["recording"]))
    assert (kept.complete, kept.gaps) == (True, [])
    assert len(kept.records) >= figures["ticks"]
    assert replayed(figures["recording"]) == (len(kept.records), True)
