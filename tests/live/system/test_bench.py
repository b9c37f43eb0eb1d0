"""`rigctl bench`: real loop, simulated rig, cyclictest; its verdicts and its refusals."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import pytest

from rigctl.bench import cyclictest
from rigctl.bench.loop import RateResult, bench_settings
from rigctl.cli.bench import judged
from rigctl.cli.demo import own_settings
from rigctl.config.rig_file import load
from rigctl.ipc import runtime_folder as runtime
from tests.builders import daemons
from tests.live.system.test_daemon import PATIENT

LATE = {"p50": 5.0, "p99": 20.0, "p999": 40.0, "max": 900.0}
LOOP: dict[str, Any] = {
    "ticks": 30_000, "skipped_ticks": 3, "frames_missing": 0, "ticks_not_compensating": 0,
    "lateness_us": {**LATE, "p999": 80.0}, "work_us": {**LATE, "p999": 420.0},
}  # fmt: skip
OTHER = {"lateness_us": LATE, "wakeups": 30_000, "later_than_a_period": 1}


@pytest.mark.alone
def test_the_loop_is_measured_in_turn_with_cyclictest_and_nothing_is_left(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, PATIENT)
    before = sorted(tmp_path.iterdir())
    answer = daemons.rigctl("bench", str(file), "--seconds", "1.5", "--json")
    told = json.loads(answer.stdout)
    (rate,) = told["rates"].values()
    assert list(told["rates"]) == ["1000"]
    assert rate["loop"]["ticks"] > 500
    assert set(rate["loop"]["lateness_us"]) == set(rate["cyclictest"]["lateness_us"]) == set(LATE)
    assert 0.0 < rate["loop"]["work_us"]["p50"] <= rate["loop"]["work_us"]["max"]
    assert rate["cyclictest"]["wakeups"] > 1000
    assert answer.returncode == (0 if all(row["met"] for row in told["verdicts"]) else 1), answer.stderr
    assert sorted(tmp_path.iterdir()) == before
    assert [rig for rig, _ in runtime.daemons() if rig.startswith("bench")] == []


@pytest.mark.alone
def test_beside_a_daemon_nothing_is_measured(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, PATIENT)
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, tmp_path / "daemon.log") as daemon:
        answer = daemons.rigctl("bench", str(file))
        assert answer.returncode == 1
        assert f"{daemons.name_of(file)} (process {daemon.pid})" in answer.stderr
        assert len(answer.stderr.splitlines()) == 1


@pytest.mark.simulated_time
@pytest.mark.parametrize(
    ("loop", "other", "unmet"),
    [
        ({}, OTHER, []),
        ({"skipped_ticks": 4}, OTHER, ["1000 Hz: periods skipped"]),
        ({"skipped_ticks": 1}, None, ["1000 Hz: periods skipped"]),  # without an excuse
        ({"skipped_ticks": 0}, None, []),
        ({"lateness_us": {**LATE, "p999": 80.5}}, OTHER, ["1000 Hz: lateness p99.9 over cyclictest's"]),
        ({"work_us": {**LATE, "p999": 921.0}}, OTHER, ["1000 Hz: lateness and work, p99.9, us"]),
        ({"ticks_not_compensating": 1}, OTHER, ["1000 Hz: ticks not compensating"]),
    ],
)
def test_a_rate_is_judged_by_its_period_and_by_cyclictest(
    loop: dict[str, Any], other: dict[str, Any] | None, unmet: list[str]
) -> None:
    assert [name for name, *_, met in judged(RateResult(1000, {**LOOP, **loop}, other)) if not met] == unmet


@pytest.mark.simulated_time
def test_nothing_of_the_rigs_own_is_touched(tmp_path: pathlib.Path) -> None:
    own: dict[str, dict[str, Any]] = {
        "audit": {"file": "/nowhere/audit.jsonl"},
        "calibration": {"file": "/nowhere/ledger.json", "waiver": None},
    }
    settings = load(daemons.rig_file(tmp_path, own))
    played = bench_settings(settings, 2000)
    assert (played.loop.rate_hz, played.can.interface) == (2000, "rigsim")
    assert played.telemetry.listen != settings.telemetry.listen
    for ours, theirs in ((played.audit_log, settings.audit_log), (played.ledger, settings.ledger)):
        assert ours != theirs
        assert ours is not None
        assert ours.is_relative_to(tmp_path)  # the default place, beside the rig file
    assert played.safety == settings.safety
    demo = own_settings(settings, tmp_path / "here")
    assert (demo.rig, demo.telemetry.join, demo.page) == (f"demo_{settings.rig}", [], None)
    assert demo.telemetry.listen not in (settings.telemetry.listen, played.telemetry.listen)
    assert demo.audit_log.is_relative_to(tmp_path)
    assert demo.audit_log != settings.audit_log
    assert demo.recording.folder == str(tmp_path / "here")
    assert bench_settings(settings, 1000).loop == settings.loop


def test_without_a_cyclictest_that_may_run_there_is_nothing_to_compare_with(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cyclictest.measure(1000, 0.05, priority=80, cpu=1023) is None
    assert cyclictest.measure(1000, 0.05, priority=80, cpu=0) is not None
    monkeypatch.setenv("PATH", "")
    assert cyclictest.measure(1000, 0.05, priority=80, cpu=0) is None
