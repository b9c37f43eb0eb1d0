"""The ledger only grows, is accepted only when whole and in bounds, and gives the values in force."""

from __future__ import annotations

import json
import pathlib

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc import ledger
from rigctl.ipc.ledger import LedgerError, Standing
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.calibration_findings import Measured
from tests.builders.durable import Disk
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
SECTION = PAPER.calibration.model_copy(update={"waiver": None, "shunt_n": 250.0})
DAY_NS = 86_400 * 10**9
NOW_NS = 1_800_000_000 * 10**9
TARE, CALIBRATE = Request(Verb.TARE, "kim"), Request(Verb.CALIBRATE, "kim")


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    return PAPER.model_copy(update={"calibration": SECTION, "directory": str(tmp_path)})


def measured(mean_n: float, wall_ns: int = NOW_NS) -> Measured:
    return Measured(mean_n, 0.03, wall_ns)


def stands(settings: RigSettings, wall_ns: int = NOW_NS) -> Standing:
    return ledger.standing(settings, ledger.read(settings), wall_ns)


def test_it_begins_with_nothing_and_that_is_overdue(settings: RigSettings) -> None:
    assert ledger.read(settings) == []
    assert stands(settings) == Standing(overdue=True)
    assert stands(settings).correction.overdue
    waived = settings.model_copy(update={"calibration": PAPER.calibration})
    assert stands(waived).overdue
    assert not stands(waived).correction.overdue
    without = settings.model_copy(update={"calibration": None})
    assert not stands(without).correction.overdue


def test_entries_are_added_and_the_newest_zero_and_scale_stand(settings: RigSettings) -> None:
    tare = findings.tare(settings, TARE, stands(settings), measured(1.25))
    ledger.append(settings, tare.entry)
    adopt = Request(Verb.CALIBRATE, "lee", 100.0, adopt=True)
    found = findings.calibrate(settings, adopt, stands(settings), measured(100.25))
    assert found.order == (Setting.SCALE, (pytest.approx(100.0 / 99.0), 0.0))
    entries = ledger.append(settings, found.entry)
    assert [(e.what, e.operator, e.passed) for e in entries] == [("tare", "kim", None), ("calibrate", "lee", True)]
    assert ledger.read(settings) == entries
    now = stands(settings)
    assert (now.zero_n, now.scale) == (1.25, pytest.approx(100.0 / 99.0))
    assert not now.overdue


def test_a_check_holds_until_its_due_date_and_a_failed_one_ends_it(settings: RigSettings) -> None:
    passed = findings.calibrate(settings, CALIBRATE, Standing(), measured(294.2 * 1.004))
    assert passed.good
    ledger.append(settings, passed.entry)
    assert stands(settings).due == ledger.utc(NOW_NS + 365 * DAY_NS)
    assert not stands(settings, NOW_NS + 365 * DAY_NS - 10**9).overdue
    assert stands(settings, NOW_NS + 365 * DAY_NS).overdue
    assert not findings.calibrate(settings, CALIBRATE, Standing(), measured(294.2 * 0.994)).good
    failed = findings.calibrate(settings, CALIBRATE, Standing(), measured(294.2 * 1.006))
    assert not failed.good
    assert failed.order == (Setting.OVERDUE, (1.0,))
    ledger.append(settings, failed.entry)
    assert stands(settings).overdue
    assert settings.calibration is not None
    waived = settings.calibration.model_copy(update={"waiver": "the weight is away"})
    excused = findings.calibrate(
        settings.model_copy(update={"calibration": waived}), CALIBRATE, Standing(), measured(294.2 * 1.006)
    )
    assert not excused.good
    assert excused.order == (Setting.OVERDUE, (0.0,))


def test_what_the_loop_refused_is_withdrawn(settings: RigSettings) -> None:
    given = findings.tare(settings, TARE, Standing(), measured(2.0)).entry
    ledger.append(settings, given)
    ledger.append(settings, findings.withdrawn(settings, given, NOW_NS))
    assert stands(settings).zero_n == 0.0
    assert [e.what for e in ledger.read(settings)] == ["tare", "tare withdrawn"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no calibration ledger"),
        ("{", "no calibration ledger"),
        ("[]", "no calibration ledger"),
        ('{"rig": "paper_rig", "entries": [], "more": 1}', "no calibration ledger"),
        ('{"rig": "other", "entries": []}', "found the ledger of 'other', expected that of 'paper_rig'"),
        ("ENTRY zero_n 10.5", "entry 1: found zero 10.5 N"),
        ("ENTRY scale 1.03", "scale 1.03, expected -10 to 10 N and 0.98 to 1.02"),
        ("ENTRY scale null", "scale None"),
        ("ENTRY when 'yesterday'", "entry 1: found the date 'yesterday'"),
        ("ENTRY when '2026-01-01T00:00:00'", "entry 1: found the date"),
        ("\xff", "no calibration ledger"),
    ],
)
def test_a_ledger_that_cannot_be_believed_is_one_line(settings: RigSettings, text: str, why: str) -> None:
    path = settings.ledger
    assert path is not None
    if text.startswith("ENTRY"):
        ledger.append(settings, findings.tare(settings, TARE, Standing(), measured(1.0)).entry)
        _, key, value = text.split()
        document = json.loads(path.read_text())
        entry = document["entries"][0]
        (entry if key == "when" else entry["after"])[key] = json.loads(value.replace("'", '"'))
        text = json.dumps(document)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(LedgerError) as error:
        ledger.read(settings)
    assert why in str(error.value)
    assert "\n" not in str(error.value)


def test_what_cannot_be_written_leaves_the_file_as_it_was(settings: RigSettings) -> None:
    given = findings.tare(settings, TARE, Standing(), measured(1.0)).entry
    ledger.append(settings, given)
    path = settings.ledger
    assert path is not None
    path.with_name(f"{path.name}.new").mkdir()  # root may write anywhere, but cannot replace a folder by a file
    with pytest.raises(LedgerError, match="cannot be written"):
        ledger.append(settings, given)
    assert ledger.read(settings) == [given]


def test_an_entry_is_on_the_disk_before_the_ledger_has_its_name(
    settings: RigSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    ledger.append(settings, findings.tare(settings, TARE, stands(settings), measured(1.25)).entry)
    assert settings.ledger is not None
    assert disk.replaced(settings.ledger)


def test_without_an_entry_the_cell_is_uncorrected() -> None:
    correction = Standing().correction
    assert (correction.zero_n, correction.scale) == (0.0, 1.0)
