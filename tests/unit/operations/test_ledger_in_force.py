"""Ledger and loop agree again after a gateway that died in between, and a due date that passes reaches the loop."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.ipc import ledger
from rigctl.ipc.ledger import LedgerError, Standing
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, Verb
from rigctl.operations import filing
from rigctl.operations.calibration_findings import Measured
from rigctl.operations.ledger_in_force import LedgerInForce
from tests.builders.paths import ROOT
from tests.builders.rig_in_memory import RigInMemory

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
BARE = PAPER.model_copy(update={"calibration": PAPER.calibration.model_copy(update={"waiver": None})})
S = 10**9
NOW_NS = 1_800_000_000 * S
TARE, CHECK = Request(Verb.TARE, "kim"), Request(Verb.CALIBRATE, "kim", 100.0)


@pytest.fixture
def rig() -> RigInMemory:
    return RigInMemory(BARE, wall_ns=NOW_NS)


def file(rig: RigInMemory, request: Request = TARE, mean_n: float = 1.5) -> Standing:
    standing = filing.file(rig, request, Measured(mean_n, 0.03, NOW_NS), 5).standing
    assert standing is not None
    return standing


def entries(rig: RigInMemory) -> list[str]:
    return [entry.what for entry in rig.ledger]


def test_the_due_date_is_sent_once_when_it_has_passed(rig: RigInMemory) -> None:
    rig.standing, subject = file(rig, CHECK, 100.1), LedgerInForce(rig)
    after_ns = NOW_NS + 3650 * 86_400 * S
    assert subject.settings_due(1 * S, NOW_NS) == []
    assert subject.settings_due(2 * S, after_ns) == [(Setting.OVERDUE, (1.0,))]
    assert rig.standing.overdue
    assert subject.settings_due(3 * S, after_ns) == []
    assert subject.settings_due(4 * S, NOW_NS) == [(Setting.OVERDUE, (0.0,))], "the clock was ahead, and is set"


@pytest.mark.parametrize("clock_ns", [0, 4_070_908_800 * S], ids=["1970", "2099"])
def test_by_a_clock_that_cannot_be_right_no_due_date_passes(rig: RigInMemory, clock_ns: int) -> None:
    rig.standing = file(rig, CHECK, 100.1)
    assert LedgerInForce(rig).settings_due(1 * S, clock_ns) == []
    assert not rig.standing.overdue


def test_a_date_that_the_loop_may_have_otherwise_is_sent(rig: RigInMemory) -> None:
    rig.standing, subject = file(rig, CHECK, 100.1), LedgerInForce(rig)
    subject.overdue_changed()
    assert subject.settings_due(1 * S, NOW_NS) == [(Setting.OVERDUE, (0.0,))]


def test_what_is_on_record_and_not_in_force_is_sent_again(rig: RigInMemory) -> None:
    file(rig)
    subject = LedgerInForce(rig)
    assert subject.settings_due(1 * S, NOW_NS) == [(Setting.ZERO, (1.5,))]
    rig.has = (1.5, 1.0, "")
    assert subject.settings_due(2 * S, NOW_NS) == [(Setting.OVERDUE, (1.0,))]
    assert (rig.standing.zero_n, entries(rig)) == (1.5, ["tare"])
    assert rig.said == [f"the tare by kim of {ledger.utc(NOW_NS)}, left over from before, is in force"]
    assert subject.settings_due(3 * S, NOW_NS) == []


def test_what_is_shown_in_force_and_is_not_is_sent_again(rig: RigInMemory) -> None:
    rig.standing = file(rig)
    assert LedgerInForce(rig).settings_due(1 * S, NOW_NS) == [(Setting.ZERO, (1.5,))]


def test_what_the_loop_still_does_not_take_is_withdrawn(rig: RigInMemory) -> None:
    file(rig)
    subject = LedgerInForce(rig)
    assert subject.settings_due(1 * S, NOW_NS) == [(Setting.ZERO, (1.5,))]
    assert subject.settings_due(2 * S, NOW_NS) == []
    assert subject.settings_due(4 * S, NOW_NS) == [(Setting.OVERDUE, (1.0,))]
    assert (rig.standing.zero_n, entries(rig)) == (0.0, ["tare", "tare withdrawn"])
    assert "withdrawn from the ledger" in rig.said[-1]


def test_what_the_loop_took_before_its_gateway_died_is_shown_in_force(rig: RigInMemory) -> None:
    file(rig)
    subject = LedgerInForce(rig)
    rig.has = (1.5, 1.0, "")
    assert subject.settings_due(1 * S, NOW_NS) == []
    subject.settings_due(2 * S, NOW_NS)
    assert (rig.standing.zero_n, entries(rig)) == (1.5, ["tare"])


def test_a_ledger_that_another_program_changed_is_not_put_in_force(rig: RigInMemory) -> None:
    file(rig)
    subject = LedgerInForce(rig)
    rig.has = (-3.0, 1.0, "")
    assert subject.settings_due(1 * S, NOW_NS) == []
    assert subject.settings_due(5 * S, NOW_NS) == []
    assert entries(rig) == ["tare"]
    assert rig.said == ["the ledger says something else than what is in force; it holds from the daemon's next start"]


def test_a_ledger_that_cannot_be_read_is_said_once(rig: RigInMemory) -> None:
    rig.refuses = LedgerError("no calibration ledger")
    subject = LedgerInForce(rig)
    assert subject.settings_due(1 * S, NOW_NS) == subject.settings_due(2 * S, NOW_NS) == []
    assert rig.said == ["no calibration ledger"]


def test_a_check_on_record_that_changed_no_figure_of_the_loop_holds_until_its_due_date(rig: RigInMemory) -> None:
    file(rig, CHECK, 100.1)
    subject = LedgerInForce(rig)
    assert subject.settings_due(1 * S, NOW_NS) == []
    assert subject.settings_due(2 * S, NOW_NS) == [(Setting.OVERDUE, (0.0,))]
    assert rig.standing.due is not None


def test_a_tare_that_was_withdrawn_and_yet_taken_is_left_to_the_next_start(rig: RigInMemory) -> None:
    file(rig)
    rig.withdraw(rig.ledger[0])
    rig.has = (1.5, 1.0, "")
    assert LedgerInForce(rig).settings_due(1 * S, NOW_NS) == []
    assert entries(rig) == ["tare", "tare withdrawn"]
    assert "holds from the daemon's next start" in rig.said[0]


def test_an_answer_that_is_missing_is_looked_for(rig: RigInMemory) -> None:
    rig.standing = file(rig)
    rig.has = (1.5, 1.0, "")
    subject = LedgerInForce(rig)
    assert subject.settings_due(1 * S, NOW_NS) == []
    file(rig, mean_n=2.5)
    assert subject.settings_due(2 * S, NOW_NS) == []  # who gave the command puts it in force
    subject.unanswered()
    assert subject.settings_due(3 * S, NOW_NS) == [(Setting.ZERO, (2.5,))]
