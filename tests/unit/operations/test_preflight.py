"""The host's part of the preflight: a check fails for its own cause, names the remedy, and may be waived in words."""

from __future__ import annotations

import os
import pathlib
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Standing
from rigctl.ipc.written_folders import Folder, folders
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.operations.preflight import PreflightVerdict, judge
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
STRICT = PAPER.model_copy(
    update={
        "calibration": PAPER.calibration.model_copy(update={"waiver": None}),
        "loop": PAPER.loop.model_copy(update={"realtime_waiver": None}),
    }
)
NOW = datetime(2028, 6, 1, tzinfo=UTC)


def stamp(days_ago: float) -> str:
    return f"{NOW - timedelta(days=days_ago):%Y-%m-%dT%H:%M:%SZ}"


GOOD: dict[str, Any] = {
    "settings": STRICT,
    "standing": Standing(due=stamp(-100), tared=stamp(1)),
    "active": {"design": {"accepted": True, "waiver": None, "verdict": "Ms 1.5"}},
    "control": {
        "realtime": [{"name": "scheduler", "in_force": "SCHED_FIFO 80", "ok": True, "warning": ""}],
        "supervision": [{"name": "deadline", "object": "0x1400:05", "wanted": 30, "found": 30, "ok": True, "why": ""}],
    },
    "folders": [Folder(pathlib.Path("/data"), 10_000)],
    "now": NOW,
}
WRONG_STOP = {"name": "abort connection option", "object": "0x6007", "wanted": 3, "found": 0, "ok": False, "why": ""}
NO_FIFO = {"name": "scheduler", "ok": False, "warning": "SCHED_FIFO 80 not allowed: run as root"}
REFUSED = {"accepted": False, "waiver": None, "verdict": "design refused: Ms 1.9"}
WAIVED = {"accepted": True, "waiver": "a soft\nmechanism only", "verdict": "Ms 1.9 (limit 1.6, waived)"}


def verdict(**changes: Any) -> PreflightVerdict:
    return judge(**{**GOOD, **changes})


def test_nothing_stands_against_a_rig_in_order() -> None:
    assert verdict() == PreflightVerdict({}, {})
    assert verdict().host_checks == Check(0)


@pytest.mark.parametrize(
    ("changes", "check", "words"),
    [
        ({"standing": Standing(overdue=True, tared=stamp(1))}, Check.CALIBRATION, ["no calibration", "rigctl calib"]),
        (
            {"standing": Standing(due=stamp(1), tared=stamp(1))},
            Check.CALIBRATION,
            ["due on 2028-05-31", "rigctl calib"],
        ),
        ({"standing": Standing(due=stamp(-9))}, Check.TARE, ["no tare on record", "rigctl tare"]),
        (
            {"standing": Standing(due=stamp(-9), tared=stamp(31))},
            Check.TARE,
            ["of 2028-05-01", "30 days", "rigctl tare"],
        ),
        ({"active": {}}, Check.MARGINS, ["not known"]),
        ({"active": {"design": {"ms": 1}}}, Check.MARGINS, ["not known"]),
        ({"active": {"design": REFUSED}}, Check.MARGINS, ["Ms 1.9", "rigctl tune"]),
        ({"control": {}}, Check.REALTIME, ["not known yet"]),
        ({"control": {"realtime": [NO_FIFO]}}, Check.REALTIME, ["SCHED_FIFO 80 not allowed", "loop.realtime_waiver"]),
        ({"folders": [Folder(pathlib.Path("/data"), 511)]}, Check.DISK, ["/data has 511 MiB free", "make room", "512"]),
        ({"folders": [Folder(pathlib.Path("/data"), None)]}, Check.DISK, ["/data is not there"]),
        (
            {"control": {**GOOD["control"], "supervision": [WRONG_STOP]}},
            Check.DRIVE_SUPERVISION,
            ["0x6007 (abort connection option) found 0, wanted 3"],
        ),
        (
            {"control": {**GOOD["control"], "supervision": [{**WRONG_STOP, "found": None, "why": "refused: 0x06"}]}},
            Check.DRIVE_SUPERVISION,
            ["found nothing, wanted 3, refused: 0x06"],
        ),
    ],
)
def test_each_check_fails_on_its_own_and_says_what_to_do(
    changes: dict[str, Any], check: Check, words: list[str]
) -> None:
    found = verdict(**changes)
    assert list(found.failing) == [check]
    assert all(word in found.failing[check] for word in words), found.failing[check]
    assert found.host_checks == check & HOST_CHECKS


def test_everything_that_fails_is_said_at_once() -> None:
    found = verdict(standing=Standing(overdue=True), active={}, control={}, folders=[Folder(pathlib.Path("/"), 0)])
    assert set(found.failing) == {Check.CALIBRATION, Check.TARE, Check.MARGINS, Check.REALTIME, Check.DISK}


def test_a_waiver_in_words_excuses_what_it_is_for_and_is_repeated() -> None:
    bare = {"standing": Standing(overdue=True), "control": {"realtime": [NO_FIFO]}, "active": {"design": WAIVED}}
    found = verdict(settings=PAPER, **bare)
    assert PAPER.calibration is not None
    assert found.failing == {}
    assert found.waived == {
        Check.CALIBRATION: PAPER.calibration.waiver,
        Check.TARE: PAPER.calibration.waiver,
        Check.MARGINS: "a soft mechanism only",
        Check.REALTIME: PAPER.loop.realtime_waiver,
    }
    assert set(verdict(**bare).failing) == {Check.CALIBRATION, Check.TARE, Check.REALTIME}
    assert verdict(settings=PAPER).waived == {}  # a check that passes needs no waiver
    assert verdict(folders=[Folder(pathlib.Path("/"), 0)], settings=PAPER).failing.keys() == {Check.DISK}


def test_without_a_calibration_section_neither_calibration_nor_tare_is_asked_for() -> None:
    settings = STRICT.model_copy(update={"calibration": None})
    assert verdict(settings=settings, standing=Standing()).failing == {}


def test_the_tare_that_holds_is_the_newest_that_was_not_withdrawn() -> None:
    def item(what: str, when: str, **figures: str) -> ledger.Entry:
        return ledger.Entry(what, when, "kim", PAPER.rig, "1", "", {}, {}, dict(figures))

    first, second = item("tare", stamp(5)), item("tare", stamp(2))
    wall_ns = int(NOW.timestamp() * 1e9)
    assert ledger.standing(STRICT, [], wall_ns).tared is None
    assert ledger.standing(STRICT, [first, second], wall_ns).tared == stamp(2)
    withdrawn = item("tare withdrawn", stamp(1), withdraws=stamp(2))
    assert ledger.standing(STRICT, [first, second, withdrawn], wall_ns).tared == stamp(5)
    assert ledger.standing(STRICT, [item("identify", stamp(1))], wall_ns).tared is None


@pytest.fixture
def another_user() -> Iterator[pathlib.Path]:
    """A folder this process may read but not write; root takes another user's id meanwhile."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        root = os.geteuid() == 0
        folder.chmod(0o555)
        if root:
            os.seteuid(65534)
        yield folder
        if root:
            os.seteuid(0)
        folder.chmod(0o755)


def test_a_folder_the_user_may_not_write_to_has_no_room(another_user: pathlib.Path) -> None:
    settings = STRICT.model_copy(update={"directory": str(another_user)})
    found = folders(settings)
    assert not all(folder.writable for folder in found)
    why = verdict(settings=settings, folders=found).failing[Check.DISK]
    assert f"{another_user}/calibration" in why
    assert f"(uid {os.geteuid()}) may not write there" in why


def test_what_it_says_names_the_date_the_room_and_what_is_not_known() -> None:
    old = verdict(standing=Standing(due=stamp(-100), tared=stamp(400)))
    assert f"the last tare is of {stamp(400)[:10]}," in old.failing[Check.TARE]
    short, gone = Folder(pathlib.Path("/data"), 3), Folder(pathlib.Path("/gone"), None)
    said = verdict(folders=[short, gone]).failing[Check.DISK]
    assert "/data has 3 MiB free" in said
    assert "/gone is not there" in said
    for design in ({}, {"accepted": "yes"}, None):
        assert "are not known" in verdict(active={"design": design}).failing[Check.MARGINS]
