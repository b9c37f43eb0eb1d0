"""A clock or a date that cannot be right is a warning: it refuses nothing for its age, and is not passed in silence."""

from __future__ import annotations

import pathlib
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from rigctl.commission import cell_uncertainty
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc import ledger, wall_clock
from rigctl.ipc.ledger import Standing
from rigctl.ipc.wall_clock import CLOCKS_DIFFER, RELEASED, SERVICE, age, doubt, unset
from rigctl.model.checks import Check
from rigctl.operations import preflight
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
NOW = datetime(2027, 1, 15, tzinfo=UTC)
UNSET, TYPED = datetime(1970, 1, 1, 0, 2, tzinfo=UTC), datetime(2099, 1, 1, tzinfo=UTC)
YESTERDAY = NOW - timedelta(days=1)
WRONG = [(UNSET, YESTERDAY), (TYPED, YESTERDAY), (NOW, UNSET), (NOW, TYPED), (NOW - timedelta(days=3), YESTERDAY)]
"""The clock, and the date on record: one of both is wrong."""


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    section = PAPER.calibration.model_copy(update={"waiver": None}) if PAPER.calibration else None
    return PAPER.model_copy(update={"calibration": section, "directory": str(tmp_path)})


def ns(when: datetime) -> int:
    return round(when.timestamp()) * 10**9


def on_record(settings: RigSettings, when: datetime, now: datetime) -> Standing:
    """A tare and a passed check of one date, at a later or earlier time."""
    entries = [
        ledger.entry(
            settings, what, "kim", ns(when), before={}, after={"zero_n": 0.0, "scale": 1.0}, figures={}, passed=passed
        )
        for what, passed in (("tare", None), ("calibrate", True))
    ]
    return ledger.standing(settings, entries, ns(now))


def test_an_age_is_known_where_clock_and_date_can_be_right() -> None:
    assert age(YESTERDAY, NOW) == timedelta(days=1)
    assert age(NOW + CLOCKS_DIFFER, NOW) == -CLOCKS_DIFFER  # two clocks may differ by so much
    assert age(YESTERDAY, RELEASED + SERVICE) is not None
    assert (unset(RELEASED), unset(RELEASED + SERVICE), doubt(NOW, {"the last tare": YESTERDAY})) == ("", "", "")


@pytest.mark.parametrize(("now", "when"), WRONG)
def test_a_wrong_clock_or_date_is_in_words_with_what_it_contradicts(now: datetime, when: datetime) -> None:
    assert age(when, now) is None
    words = doubt(now, {"the last tare": when})
    assert "\n" not in words
    assert f"{now:%Y-%m-%d}" in words or f"{when:%Y-%m-%d}" in words
    if now is UNSET:
        assert words.startswith("the computer's clock reads 1970-01-01, which is before the release of rigctl ")
    if now < YESTERDAY and now is not UNSET:
        assert words.startswith("the computer's clock reads 2027-01-12, which is before the last tare (2027-01-14): ")


@pytest.mark.parametrize(("now", "when"), WRONG)
def test_calibration_and_tare_are_not_refused_for_an_age_that_is_not_known(
    settings: RigSettings, now: datetime, when: datetime
) -> None:
    known = on_record(settings, when, now)
    assert not known.overdue
    assert not {Check.CALIBRATION, Check.TARE} & preflight.judge(settings, known, {}, {}, [], now).failing.keys()
    assert ledger.clock_doubt(settings, None, now, known)
    assert cell_uncertainty.drifted_u_n(settings, known, None, now) == pytest.approx(0.08)  # of a whole shift


def test_a_date_that_is_known_is_refused_for_its_age_still(settings: RigSettings) -> None:
    late = NOW + timedelta(days=366)
    known = on_record(settings, YESTERDAY, late)
    assert known.overdue
    assert {Check.CALIBRATION, Check.TARE} <= preflight.judge(settings, known, {}, {}, [], late).failing.keys()
    assert ledger.clock_doubt(settings, None, late, known) == ""


def test_a_check_dated_at_the_end_of_time_is_warned_of(settings: RigSettings) -> None:
    known = on_record(settings, datetime(9999, 12, 31, tzinfo=UTC), NOW)
    assert not known.overdue
    assert "the last calibration check" in ledger.clock_doubt(settings, None, NOW, known)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"provenance": {"date_utc": "2099-01-01T00:00:00+00:00"}}, "before the gains of g.yaml (2099-01-01)"),
        ({"identified": ["2027-01-01T00:00:00Z", "1970-01-01T00:02:00Z"]}, "the identification of 1970-01-01 has"),
        ({}, ""),
        ({"provenance": {"date_utc": "today"}}, ""),
        ({"provenance": None}, ""),
        ({"identified": 3}, ""),
        (None, ""),
    ],
)
def test_the_dates_of_a_gain_file_are_looked_at(settings: RigSettings, source: Any, words: str) -> None:
    whole = {"file": "g.yaml", "provenance": {"date_utc": "2027-01-01T00:00:00Z"}, "identified": []}
    found = None if source is None else whole | source
    said = ledger.clock_doubt(settings, {"source": found}, NOW, Standing())
    assert words in said
    assert bool(words) is bool(said)


def test_a_ledger_that_cannot_be_read_has_no_dates(settings: RigSettings) -> None:
    assert settings.ledger is not None
    settings.ledger.parent.mkdir()
    settings.ledger.write_text("{")
    assert ledger.clock_doubt(settings, None, NOW) == ""
    assert ledger.clock_doubt(settings, None, UNSET) == wall_clock.doubt(UNSET, {}) != ""
