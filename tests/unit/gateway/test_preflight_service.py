"""The host checks are judged again and again, and an old verdict is none."""

from __future__ import annotations

import pathlib
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.gateway.preflight_service import STALE_NS, PreflightService, look
from rigctl.ipc.ledger import Standing
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.checks import Check
from rigctl.operations.preflight import PreflightVerdict
from tests.builders.paths import ROOT
from tests.builders.waiting import until

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
STRICT = PAPER.model_copy(
    update={
        "calibration": PAPER.calibration.model_copy(update={"waiver": None}),
        "loop": PAPER.loop.model_copy(update={"realtime_waiver": None}),
    }
)
ACTIVE = {"design": {"accepted": True, "waiver": None, "verdict": "Ms 1.5"}}
CONTROL: dict[str, Any] = {
    "realtime": [{"name": "scheduler", "in_force": "SCHED_FIFO 80", "ok": True, "warning": ""}],
    "supervision": [],
}


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    least = PAPER.preflight.model_copy(update={"disk_free_mib": 1})
    return STRICT.model_copy(update={"directory": str(tmp_path), "preflight": least})


def test_it_looks_by_itself_and_sees_what_changes(settings: RigSettings, tmp_path: pathlib.Path) -> None:
    runtime = Runtime(tmp_path)
    now = datetime.now(UTC)
    standing = [Standing(due=f"{now + timedelta(days=9):%Y-%m-%dT%H:%M:%SZ}", tared=f"{now:%Y-%m-%dT%H:%M:%SZ}")]
    watched = PreflightService(runtime, settings, lambda: standing[0])
    try:
        until(lambda: set(watched.verdict(time.monotonic_ns()).failing) == {Check.MARGINS, Check.REALTIME})
        runtime.write_json("active.json", ACTIVE)
        runtime.write_json("control.json", CONTROL)
        until(lambda: watched.verdict(time.monotonic_ns()) == PreflightVerdict({}, {}))
        standing[0] = replace(standing[0], tared=None)
        until(lambda: watched.verdict(time.monotonic_ns()).host_checks == Check.TARE)
    finally:
        watched.close()
    assert watched.verdict(time.monotonic_ns() + 2 * STALE_NS).host_checks == Check.HOST  # renewed no more


def test_a_file_that_cannot_be_read_is_not_known(settings: RigSettings, tmp_path: pathlib.Path) -> None:
    (tmp_path / "active.json").write_text("{")
    (tmp_path / "control.json").mkdir()
    found = look(Runtime(tmp_path), settings, Standing(), datetime.now(UTC))
    assert {Check.MARGINS, Check.REALTIME} <= set(found.failing)
