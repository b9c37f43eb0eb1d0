"""What a trial found is on record first, and in force when the loop has taken it; other answers have a reason."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.control.law.tension import Gains
from rigctl.ipc import ledger
from rigctl.ipc.ledger import LedgerError, Standing
from rigctl.ipc.record import RECORD
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, Verb
from rigctl.operations import filing
from rigctl.operations.calibration_findings import Measured
from rigctl.operations.evaluation import EvaluationError
from rigctl.operations.filing import Filed
from rigctl.operations.gain_admission import NotAdmittedError
from tests.builders.paths import ROOT
from tests.builders.rig_in_memory import RigInMemory

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
BARE = PAPER.model_copy(update={"calibration": PAPER.calibration.model_copy(update={"waiver": None})})
NOW_NS = 1_800_000_000 * 10**9
TARE = Request(Verb.TARE, "kim")
GAINS = {"k_tension": 1.3, "k_speed": 0.15, "k_integral": 1.0}
DESIGN = {"gains": GAINS, "ms_max": 1.5, "limit": 1.6, "waiver": None, "source": {}, "verdict": "Ms 1.5"}


@pytest.fixture
def rig() -> RigInMemory:
    return RigInMemory(BARE, wall_ns=NOW_NS)


def filed(rig: RigInMemory, request: Request = TARE, mean_n: float = 1.5, t_ns: int = 5) -> Filed:
    return filing.file(rig, request, Measured(mean_n, 0.03, NOW_NS, 6.9), t_ns)


def test_a_tare_is_on_record_and_not_yet_in_force(rig: RigInMemory) -> None:
    given = filed(rig)
    assert given.finding is not None
    assert given.finding.order == (Setting.ZERO, (1.5,))
    assert rig.ledger == [given.finding.entry]
    assert given.standing == ledger.standing(BARE, rig.ledger, NOW_NS)
    assert rig.standing.zero_n == 0.0


def test_a_calibration_goes_on_from_the_zero_in_force(rig: RigInMemory) -> None:
    rig.standing = Standing(zero_n=0.1)
    given = filed(rig, Request(Verb.CALIBRATE, "kim", 100.0), 100.2)
    assert given.finding is not None
    assert given.finding.entry.figures["reading_n"] == pytest.approx(100.1)


def test_a_record_without_a_step_is_no_creep(rig: RigInMemory) -> None:
    given = filed(rig, Request(Verb.CALIBRATE, "kim", 100.0, creep_s=60.0))
    assert (given.finding, given.reason, rig.ledger) == (None, "out_of_bounds", [])


def test_a_rig_without_a_calibration_section_says_that_nothing_is_on_record() -> None:
    rig = RigInMemory(PAPER.model_copy(update={"calibration": None}), design={"gains": GAINS}, answer=DESIGN)
    given = filed(rig, Request(Verb.GAINS, "kim", gain_file="", name="a.yaml"))
    assert given.finding is not None
    assert given.finding.text.endswith(" (not on record: no calibration section)")
    assert (given.standing, given.design, rig.ledger) == (None, DESIGN, [])


def test_admitted_gains_are_on_record_with_those_before(rig: RigInMemory) -> None:
    rig.design, rig.answer = {"gains": GAINS | {"k_speed": 0.2}}, DESIGN
    given = filed(rig, Request(Verb.GAINS, "kim", gain_file="", name="a.yaml"))
    assert given.finding is not None
    assert given.design == DESIGN
    assert (rig.ledger[0].before["k_speed"], rig.ledger[0].after["k_speed"]) == (0.2, 0.15)
    assert given.finding.order == (Setting.LAW_GAINS, Gains(**GAINS).in_order)


def test_an_identification_goes_by_the_ticks_of_its_excitation_alone(rig: RigInMemory) -> None:
    rig.ticks = np.zeros(20, RECORD.dtype)
    rig.ticks["t_ns"] = np.arange(20) * 10**9
    seen = rig.records(15 * 10**9 - round(6.9e9), 15 * 10**9)
    assert seen["t_ns"].tolist() == [t_s * 10**9 for t_s in range(9, 16)]
    rig.ticks = rig.ticks[:0]
    given = filed(rig, Request(Verb.IDENTIFY, "kim"))
    assert (given.finding, given.reason) == (None, "out_of_bounds")
    assert "not there any more" in given.text


@pytest.mark.parametrize(
    ("verb", "answer", "reason", "text"),
    [
        (Verb.RESPONSE, EvaluationError("no excitation"), "out_of_bounds", "no excitation"),
        (Verb.GAINS, NotAdmittedError("Ms 1.9"), "not_admitted", "Ms 1.9"),
        (Verb.RESPONSE, ZeroDivisionError("of\nzero"), "out_of_bounds",
         "the measurement cannot be judged (ZeroDivisionError: of zero); nothing was changed"),
    ],
)  # fmt: skip
def test_what_has_no_finding_has_a_reason(
    rig: RigInMemory, verb: Verb, answer: Exception, reason: str, text: str
) -> None:
    rig.answer = answer
    assert filed(rig, Request(verb, "kim")) == Filed(reason=reason, text=text)
    assert rig.ledger == []


def test_a_ledger_that_cannot_be_read_changes_nothing(rig: RigInMemory) -> None:
    rig.refuses = LedgerError("no calibration ledger")
    assert filed(rig) == Filed(reason="not_recorded", text="no calibration ledger; nothing was changed")


def test_what_the_loop_did_not_take_is_withdrawn(rig: RigInMemory) -> None:
    given = filed(rig)
    assert given.finding is not None
    assert filing.withdraw(rig, given.finding.entry, NOW_NS) is None
    assert [entry.what for entry in rig.ledger] == ["tare", "tare withdrawn"]
    assert ledger.standing(BARE, rig.ledger, NOW_NS).zero_n == 0.0


def test_with_an_adopted_scale_that_is_withdrawn_the_check_goes(rig: RigInMemory) -> None:
    assert filed(rig, Request(Verb.CALIBRATE, "kim", 100.0), 100.1).finding is not None
    given = filed(rig, Request(Verb.CALIBRATE, "kim", 100.0, adopt=True), 100.4)
    assert given.finding is not None
    standing = filing.withdraw(rig, given.finding.entry, NOW_NS)
    assert standing is not None
    assert (standing.due, standing.overdue) == (None, True)
