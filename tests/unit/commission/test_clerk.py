"""The clerk: on record first, in force when the loop has taken it, withdrawn when it has not."""

from __future__ import annotations

import pathlib
import queue
from collections.abc import Iterator

import pytest

from rigctl import config
from rigctl.commission import ledger
from rigctl.commission.clerk import Clerk, Filed
from rigctl.commission.ledger import in_force
from rigctl.config import RigSettings
from rigctl.control.modes import Setting, Verb
from rigctl.telemetry.request import Request
from rigctl.telemetry.runtime import Runtime

PAPER = config.load(pathlib.Path(__file__).parents[3] / "config/paper_rig.yaml")
assert PAPER.calibration is not None
BARE = PAPER.calibration.model_copy(update={"waiver": None})
TARE = Request(Verb.TARE, "kim")
S = 10**9


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    return PAPER.model_copy(update={"calibration": BARE, "directory": str(tmp_path)})


@pytest.fixture
def clerk(settings: RigSettings, tmp_path: pathlib.Path) -> Iterator[Clerk]:
    made = Clerk(Runtime(tmp_path), settings)
    yield made
    made.close()


def filed(clerk: Clerk, request: Request = TARE, mean_n: float = 1.5) -> Filed:
    done: queue.SimpleQueue[Filed] = queue.SimpleQueue()
    clerk.file(request, {"value": mean_n, "spread": 0.03, "t_ns": 5}, done.put)
    return done.get(timeout=10.0)


def test_a_tare_is_on_record_before_it_is_in_force(clerk: Clerk, settings: RigSettings, tmp_path: pathlib.Path) -> None:
    given = filed(clerk)
    assert given.finding is not None
    assert given.finding.settings == ((Setting.ZERO, 1.5),)
    assert ledger.read(settings) == [given.finding.entry]
    assert in_force(Runtime(tmp_path)).zero_n == clerk.standing.zero_n == 0.0
    clerk.put_in_force(given)
    assert in_force(Runtime(tmp_path)).zero_n == clerk.standing.zero_n == 1.5


def test_what_the_loop_did_not_take_is_withdrawn(clerk: Clerk, settings: RigSettings) -> None:
    clerk.withdraw(filed(clerk))
    clerk.close()
    entries = ledger.read(settings)
    assert [entry.what for entry in entries] == ["tare", "tare withdrawn"]
    assert ledger.standing(settings, entries, 0).zero_n == 0.0


def test_a_ledger_that_cannot_be_read_any_more_changes_nothing(clerk: Clerk, settings: RigSettings) -> None:
    path = settings.ledger
    assert path is not None
    path.parent.mkdir()
    path.write_text("{")
    given = filed(clerk)
    assert (given.finding, given.reason) == (None, "not_recorded")
    assert "nothing was changed" in given.text
    assert path.read_text() == "{"


def test_an_identification_whose_records_are_gone_is_refused(
    clerk: Clerk, settings: RigSettings, tmp_path: pathlib.Path
) -> None:
    Runtime(tmp_path).make_rings(settings)
    given = filed(clerk, Request(Verb.IDENTIFY, "kim"), 6.9)
    assert (given.finding, given.reason) == (None, "out_of_bounds")
    assert "not there any more" in given.text


def test_the_due_date_is_told_once_when_it_has_passed(clerk: Clerk) -> None:
    given = filed(clerk, Request(Verb.CALIBRATE, "kim", 100.0), 100.1)
    assert given.finding is not None
    wall_ns = 1_800_000_000 * S
    assert given.standing is not None
    clerk.put_in_force(given)
    assert clerk.overdue(1 * S, 0) is None
    assert clerk.overdue(1 * S + 1, 1 << 62) is None  # looked at a moment ago
    assert clerk.overdue(2 * S, wall_ns + 3650 * 86_400 * S) == 1.0
    assert clerk.standing.overdue
    assert clerk.overdue(3 * S, wall_ns + 3650 * 86_400 * S) is None
