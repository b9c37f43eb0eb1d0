"""Arming, the emergency stop and `rigctl doctor` with real processes."""

from __future__ import annotations

import contextlib
import json
import pathlib
from collections.abc import Iterator
from typing import Any

import pytest

from tests.builders import daemons
from tests.builders.waiting import until
from tests.live.system.test_daemon import PATIENT, Running


@contextlib.contextmanager
def running(folder: pathlib.Path, changes: dict[str, dict[str, Any]]) -> Iterator[Running]:
    file = daemons.rig_file(folder, {**PATIENT, **changes})
    log = folder / "daemon.log"
    with daemons.simulated_rig(file, folder / "rig.log") as rig, daemons.daemon(file, log) as daemon:
        yield Running(file, daemon, rig, log)


def doctor(rig: Running) -> tuple[int, dict[str, dict[str, Any]]]:
    """Exit code, and findings by name."""
    answer = daemons.rigctl("doctor", str(rig.file), "--json")
    return answer.returncode, {row["name"]: row for row in json.loads(answer.stdout)}


def test_arming_is_refused_with_everything_that_stands_against_it_and_doctor_says_the_same(
    tmp_path: pathlib.Path,
) -> None:
    strict: dict[str, dict[str, Any]] = {
        "loop": {"cpu": 1023, "realtime_waiver": None},
        "calibration": {"waiver": None},
        "preflight": {"disk_free_mib": 2**30},
        "cylinder": {**PATIENT["cylinder"], "stroke_min_mm": -1.0},
    }
    with running(tmp_path, strict) as rig:
        said = rig.refused("arm")
        words = (
            "no calibration check has passed: rigctl calibrate", "no tare on record: rigctl tare",
            "cpu 1023 is not available", "loop.realtime_waiver", "MiB free: make room", "rigctl arm --near-end",
        )  # fmt: skip
        assert [word for word in words if word not in said] == []
        answer = json.loads(daemons.rigctl("arm", "--json", file=rig.file).stdout)
        assert (answer["reason"], len(answer["checks"])) == ("preflight", 5)
        assert len(json.loads(daemons.rigctl("arm", "--near-end", "--json", file=rig.file).stdout)["checks"]) == 4
        code, found = doctor(rig)
        assert code == 1
        failing = {name for name, row in found.items() if row["severity"] == "fails"}
        assert failing >= {
            "calibration: in force", "tare: in force", "real time: granted", "disk: room to write",
            "stroke: away from its ends",
        }  # fmt: skip
        assert found["rig file"]["ok"]
        assert "rigctl tare" in found["tare: in force"]["fix"]
        rig.do("tare")  # tare removes one finding and leaves the others
        said = until(lambda: (text := rig.refused("arm")) and "tare" not in text and text, log=rig.log)
        assert "no calibration" in said


def test_a_brake_is_tested_in_hold_and_a_slack_rope_is_paid_out(tmp_path: pathlib.Path) -> None:
    """Each command as it is typed, with its line and its exit code."""
    with running(tmp_path, {}) as rig:
        unsupported = daemons.rigctl("brake-test", file=rig.file)
        assert (unsupported.returncode, unsupported.stdout) == (2, "")
        assert "support the payload from below first" in unsupported.stderr
        rig.do("arm")
        assert "the rope is slack" in rig.refused("brake-test", "--supported")
        rig.do("target", "100")
        rig.do("tension", "--wait")
        assert "a length is paid out in HOLD" in rig.refused("release", "20")
        assert daemons.mode(rig.file) == "COMPENSATING"
        rig.do("hold")
        assert "the rope is tight: release without a length" in rig.refused("release", "20")
        held: list[str] = []

        def tested() -> bool:  # UNSTEADY until the stroke has stood still
            answer = daemons.rigctl("brake-test", "--supported", file=rig.file)
            held.append(answer.stdout + answer.stderr)
            return answer.returncode == 0

        until(tested, log=rig.log)
        assert "the brake has held 100 N for 10 s, the motor has it, HOLD" in held[-1]
        assert rig.truth()[0] == pytest.approx(100.0, abs=3.0)
        rig.do("release", "--wait")
        assert "rope is slack already" in rig.refused("release")
        assert "expected a length of rope above 0 mm" in rig.refused("release", "0")
        assert "leave the cylinder inside its stroke" in rig.refused("release", "999")
