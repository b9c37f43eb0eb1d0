"""The service: on record first, in force when the loop has accepted it, withdrawn when it has not."""

from __future__ import annotations

import math
import pathlib
import queue
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.gateway.calibration_service import CalibrationService
from rigctl.ipc import ledger
from rigctl.ipc.ledger import IN_FORCE, Standing, in_force
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.events import Kind
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


def test_an_identification_goes_by_the_ticks_of_its_excitation_alone(
    service: CalibrationService, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []

    def identify(_settings: object, _request: object, records: npt.NDArray[Any], _wall_ns: int) -> None:
        seen.extend(records["t_ns"].tolist())
        raise findings.FindingError("seen")

    monkeypatch.setattr(findings, "identify", identify)
    writer, blank = Runtime(tmp_path).records.writer(), np.zeros(1, RECORD.dtype)[0].item()
    for t_s in range(20):
        writer.write(t_s * S, *blank[2:])
    done: queue.SimpleQueue[Filed] = queue.SimpleQueue()
    service.file(
        Request(Verb.IDENTIFY, "kim"),
        reply(duration_s=6.9, t_ns=15 * S),
        done.put,
    )
    assert done.get(timeout=patience_s()).text == "seen"
    assert seen == [t_s * S for t_s in range(9, 16)]


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


def test_with_an_adopted_scale_that_was_withdrawn_the_check_goes_and_the_loop_gets_it(
    service: CalibrationService, settings: RigSettings
) -> None:
    service.put_in_force(filed(service, Request(Verb.CALIBRATE, "kim", 100.0), 100.1))
    assert service.settings_due(1 * S, time.time_ns()) == []
    service.withdraw(filed(service, Request(Verb.CALIBRATE, "kim", 100.0, adopt=True), 100.4))
    service.close()
    assert service.settings_due(2 * S, time.time_ns()) == [(Setting.OVERDUE, (1.0,))]  # OVERDUE 0 may be in use
    assert ledger.standing(settings, ledger.read(settings), time.time_ns()).due is None


class Interrupted:
    """A calibration service killed by SIGKILL with an entry on record, and the rings it left."""

    def __init__(self, settings: RigSettings, folder: pathlib.Path) -> None:
        self.runtime, self.settings = Runtime(folder), settings
        self.runtime.make_rings(settings)
        self.runtime.write_json(IN_FORCE, Standing(overdue=True))  # as the supervisor does
        self.events = self.runtime.events.writer()
        self.loop_goes_by(0.0, 1.0)
        first = CalibrationService(self.runtime, settings)
        self.filed = filed(first)
        first.close()

    def loop_goes_by(self, zero_n: float, scale: float) -> None:
        self.events.write(5, Kind.CORRECTION, 0, 0, zero_n, scale, b"")

    def entries(self) -> list[str]:
        return [entry.what for entry in ledger.read(self.settings)]


@pytest.fixture
def interrupted(settings: RigSettings, tmp_path: pathlib.Path) -> Interrupted:
    return Interrupted(settings, tmp_path)


@pytest.fixture
def next_service(interrupted: Interrupted) -> Iterator[CalibrationService]:
    made = CalibrationService(interrupted.runtime, interrupted.settings)
    yield made
    made.close()


def test_what_is_on_record_and_not_in_force_is_sent_again(
    interrupted: Interrupted, next_service: CalibrationService, capsys: pytest.CaptureFixture[str]
) -> None:
    assert next_service.settings_due(1 * S, time.time_ns()) == [(Setting.ZERO, (1.5,))]
    interrupted.loop_goes_by(1.5, 1.0)
    assert next_service.settings_due(2 * S, time.time_ns()) == [(Setting.OVERDUE, (1.0,))]
    assert in_force(interrupted.runtime).zero_n == 1.5
    assert interrupted.entries() == ["tare"]
    assert "the tare by kim of" in (said := capsys.readouterr().err)
    assert "is in force" in said
    assert next_service.settings_due(3 * S, time.time_ns()) == []


def test_what_the_loop_still_does_not_take_is_withdrawn(
    interrupted: Interrupted, next_service: CalibrationService, capsys: pytest.CaptureFixture[str]
) -> None:
    assert next_service.settings_due(1 * S, time.time_ns()) == [(Setting.ZERO, (1.5,))]
    assert next_service.settings_due(2 * S, time.time_ns()) == []
    assert next_service.settings_due(4 * S, time.time_ns()) == [(Setting.OVERDUE, (1.0,))]
    next_service.close()
    assert interrupted.entries() == ["tare", "tare withdrawn"]
    assert in_force(interrupted.runtime).zero_n == 0.0
    assert "withdrawn from the ledger" in capsys.readouterr().err


def test_an_answer_that_is_missing_is_looked_for(interrupted: Interrupted, next_service: CalibrationService) -> None:
    interrupted.loop_goes_by(1.5, 1.0)
    next_service.settings_due(1 * S, time.time_ns())
    next_service.settings_due(2 * S, time.time_ns())
    given = filed(next_service, mean_n=2.5)
    assert next_service.settings_due(3 * S, time.time_ns()) == []  # the command server puts it in force
    next_service.unanswered(given)
    assert next_service.settings_due(4 * S, time.time_ns()) == [(Setting.ZERO, (2.5,))]
