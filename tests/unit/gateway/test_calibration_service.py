"""The service: on record first, in force when the loop has accepted it, withdrawn when it has not."""

from __future__ import annotations

import math
import pathlib
import queue
import time
from collections.abc import Iterator

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.gateway.calibration_service import CalibrationService
from rigctl.ipc import ledger
from rigctl.ipc.ledger import in_force
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.filing import Filed
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
BARE = PAPER.calibration.model_copy(update={"waiver": None})
TARE = Request(Verb.TARE, "kim")
S = 10**9


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    return PAPER.model_copy(update={"calibration": BARE, "directory": str(tmp_path)})


@pytest.fixture
def service(settings: RigSettings, tmp_path: pathlib.Path) -> Iterator[CalibrationService]:
    runtime = Runtime(tmp_path)
    runtime.make_rings(settings)
    made = CalibrationService(runtime, settings)
    yield made
    made.close()


def reply(reading_n: float = math.nan, duration_s: float = math.nan, t_ns: int = 5) -> dict[str, float]:
    unknown = dict.fromkeys(("samples", "creep_n", "creep_doubt_n", "zero_drift_n", "cell_c", "second_n"), math.nan)
    return unknown | {"reading_n": reading_n, "rms_n": 0.03, "duration_s": duration_s, "t_ns": t_ns, "mode": 1}


def filed(service: CalibrationService, request: Request = TARE, mean_n: float = 1.5) -> Filed:
    done: queue.SimpleQueue[Filed] = queue.SimpleQueue()
    service.file(request, reply(mean_n, 6.9), done.put)
    return done.get(timeout=patience_s())


def test_a_tare_is_on_record_before_it_is_in_force(
    service: CalibrationService, settings: RigSettings, tmp_path: pathlib.Path
) -> None:
    given = filed(service)
    assert given.finding is not None
    assert given.finding.order == (Setting.ZERO, (1.5,))
    assert ledger.read(settings) == [given.finding.entry]
    assert in_force(Runtime(tmp_path)).zero_n == service.standing.zero_n == 0.0
    service.put_in_force(given)
    assert in_force(Runtime(tmp_path)).zero_n == service.standing.zero_n == 1.5


def test_the_standing_in_force_is_read_twice_a_second(service: CalibrationService) -> None:
    service.put_in_force(filed(service, Request(Verb.CALIBRATE, "kim", 100.0), 100.1))
    wall_ns = time.time_ns()
    assert service.settings_due(1 * S, wall_ns) == []
    assert service.settings_due(1 * S + 1, wall_ns + 3650 * 86_400 * S) == ()
    assert service.settings_due(2 * S, wall_ns + 3650 * 86_400 * S) == [(Setting.OVERDUE, (1.0,))]
    assert service.standing.overdue


def test_a_measurement_that_cannot_be_judged_is_answered_and_so_is_the_next(
    service: CalibrationService, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("of\nzero")

    monkeypatch.setattr(findings, "tare", fail)
    given = filed(service)
    assert (given.finding, given.reason) == (None, "out_of_bounds")
    assert "ZeroDivisionError: of zero" in given.text
    monkeypatch.undo()
    assert filed(service).finding is not None
