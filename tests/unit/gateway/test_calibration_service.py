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
from rigctl.gateway import calibration_findings as findings
from rigctl.gateway.calibration_service import CalibrationService, Filed
from rigctl.ipc import ledger
from rigctl.ipc.ledger import IN_FORCE, Standing, in_force
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.events import Kind
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, Verb
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


@pytest.mark.parametrize(
    ("weight_n", "possible"),
    [(0.5, True), (PAPER.tension_cell.range_n, True), (0.0, False), (-1.0, False), (1e6, False)],
)
def test_a_known_weight_is_above_nothing_and_within_the_cells_range(weight_n: float, possible: bool) -> None:
    why = findings.impossible(PAPER, Request(Verb.CALIBRATE, "kim", weight_n))
    assert (why is None) is possible


def test_what_the_loop_did_not_take_is_withdrawn(service: CalibrationService, settings: RigSettings) -> None:
    service.withdraw(filed(service))
    service.close()
    entries = ledger.read(settings)
    assert [entry.what for entry in entries] == ["tare", "tare withdrawn"]
    assert ledger.standing(settings, entries, 0).zero_n == 0.0


def test_a_ledger_that_cannot_be_read_any_more_changes_nothing(
    service: CalibrationService, settings: RigSettings
) -> None:
    path = settings.ledger
    assert path is not None
    path.parent.mkdir()
    path.write_text("{")
    given = filed(service)
    assert (given.finding, given.reason) == (None, "not_recorded")
    assert "nothing was changed" in given.text
    assert path.read_text() == "{"


def test_an_identification_whose_records_are_gone_is_refused(
    service: CalibrationService, settings: RigSettings, tmp_path: pathlib.Path
) -> None:
    Runtime(tmp_path).make_rings(settings)
    given = filed(service, Request(Verb.IDENTIFY, "kim"))
    assert (given.finding, given.reason) == (None, "out_of_bounds")
    assert "not there any more" in given.text


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


def test_the_due_date_is_sent_once_when_it_has_passed(service: CalibrationService) -> None:
    given = filed(service, Request(Verb.CALIBRATE, "kim", 100.0), 100.1)
    assert given.finding is not None
    wall_ns = time.time_ns()
    assert given.standing is not None
    service.put_in_force(given)
    assert service.settings_due(1 * S, time.time_ns()) == []
    assert service.settings_due(1 * S + 1, 1 << 62) == ()  # the files were read a moment ago
    assert service.settings_due(2 * S, wall_ns + 3650 * 86_400 * S) == [(Setting.OVERDUE, (1.0,))]
    assert service.standing.overdue
    assert service.settings_due(3 * S, wall_ns + 3650 * 86_400 * S) == []
    assert service.settings_due(4 * S, wall_ns) == [(Setting.OVERDUE, (0.0,))], "the clock was ahead, and is set"


@pytest.mark.parametrize("clock_ns", [0, 4_070_908_800 * S], ids=["1970", "2099"])
def test_by_a_clock_that_cannot_be_right_no_due_date_passes(service: CalibrationService, clock_ns: int) -> None:
    service.put_in_force(filed(service, Request(Verb.CALIBRATE, "kim", 100.0), 100.1))
    assert service.settings_due(1 * S, clock_ns) == []
    assert not service.standing.overdue


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


def test_what_is_shown_in_force_and_is_not_is_sent_again(
    interrupted: Interrupted, next_service: CalibrationService
) -> None:
    interrupted.runtime.write_json(IN_FORCE, interrupted.filed.standing)
    assert next_service.settings_due(1 * S, time.time_ns()) == [(Setting.ZERO, (1.5,))]


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


def test_what_the_loop_took_before_its_gateway_died_is_shown_in_force(
    interrupted: Interrupted, next_service: CalibrationService
) -> None:
    interrupted.loop_goes_by(1.5, 1.0)
    assert next_service.settings_due(1 * S, time.time_ns()) == []
    next_service.settings_due(2 * S, time.time_ns())
    assert in_force(interrupted.runtime).zero_n == 1.5
    assert interrupted.entries() == ["tare"]


def test_a_ledger_that_another_program_changed_is_not_put_in_force(
    interrupted: Interrupted, next_service: CalibrationService, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted.loop_goes_by(-3.0, 1.0)
    assert next_service.settings_due(1 * S, time.time_ns()) == []
    assert next_service.settings_due(5 * S, time.time_ns()) == []
    assert interrupted.entries() == ["tare"]
    assert "holds from the daemon's next start" in capsys.readouterr().err


def test_a_check_on_record_that_changed_no_figure_of_the_loop_holds_until_its_due_date(
    service: CalibrationService, settings: RigSettings, tmp_path: pathlib.Path
) -> None:
    runtime = Runtime(tmp_path)
    runtime.write_json(IN_FORCE, Standing(overdue=True))
    assert filed(service, Request(Verb.CALIBRATE, "kim", 100.0), 100.1).standing is not None
    service.close()  # its gateway ends with it
    after = CalibrationService(runtime, settings)
    assert list(after.settings_due(1 * S, time.time_ns())) == []
    assert after.settings_due(2 * S, time.time_ns()) == [(Setting.OVERDUE, (0.0,))]
    assert in_force(runtime).due is not None
    after.close()


def test_a_tare_that_was_withdrawn_and_yet_taken_is_left_to_the_next_start(
    interrupted: Interrupted, next_service: CalibrationService, capsys: pytest.CaptureFixture[str]
) -> None:
    next_service.withdraw(interrupted.filed)
    next_service.close()
    interrupted.loop_goes_by(1.5, 1.0)
    after = CalibrationService(interrupted.runtime, interrupted.settings)
    assert after.settings_due(1 * S, time.time_ns()) == []
    after.close()
    assert interrupted.entries() == ["tare", "tare withdrawn"]
    assert "holds from the daemon's next start" in capsys.readouterr().err


def test_an_answer_that_is_missing_is_looked_for(interrupted: Interrupted, next_service: CalibrationService) -> None:
    interrupted.loop_goes_by(1.5, 1.0)
    next_service.settings_due(1 * S, time.time_ns())
    next_service.settings_due(2 * S, time.time_ns())
    given = filed(next_service, mean_n=2.5)
    assert next_service.settings_due(3 * S, time.time_ns()) == []  # the command server puts it in force
    next_service.unanswered(given)
    assert next_service.settings_due(4 * S, time.time_ns()) == [(Setting.ZERO, (2.5,))]
