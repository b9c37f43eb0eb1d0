"""The report's calibration agrees with the ledger of the same run."""

from __future__ import annotations

import pathlib

import pytest

from rigctl.ipc.ledger import Entry, Standing
from rigctl.model.states import Mode
from rigctl.recorder.recording import read
from rigctl.report import tables
from rigctl.report.findings import Findings, find
from tests.builders.synthetic import START_NS, run, stay, write

SECOND_NS = 1_000_000_000
EARLIER, LATER = "2023-11-14T22:00:00Z", "2023-11-14T22:13:40Z"


def entry(what: str, when: str, **said: object) -> dict[str, object]:
    plain = Entry(what, when, "anna", "synthetic", "0", "", {"zero_n": 0.0}, {"zero_n": 1.0}, {}, None)
    return {name: getattr(plain, name) for name in plain.__struct_fields__} | said


@pytest.fixture
def found(tmp_path: pathlib.Path) -> Findings:
    """Two phases with a tare and an identification between them."""
    records = run(
        stay(Mode.COMPENSATING, 10.0), stay(Mode.HOLD, 10.0), stay(Mode.COMPENSATING, 10.0), stay(Mode.HOLD, 1.0)
    )
    proposal = entry(
        "identify", LATER, before={"plant.cylinder_lag_s": 0.02}, after={"plant.cylinder_lag_s": 0.021},
        figures={"applied": False, "tension_n": 300.0},
    )  # fmt: skip
    ledger = {"rig": "synthetic", "entries": [entry("tare", LATER), proposal]}
    before, after = Standing(tared=EARLIER), Standing(zero_n=1.0, tared=LATER)
    attached = [
        ("calibration.json", before, START_NS),
        ("calibration.json", after, START_NS + 15 * SECOND_NS),
        ("calibration_ledger.json", ledger, START_NS + 15 * SECOND_NS),
    ]
    return find(read(write(tmp_path / "run.mcap", records, attached=attached), frames=False))


def test_every_calibration_of_the_run_is_listed_with_the_phases_judged_with_it(found: Findings) -> None:
    first, second = tables.calibration_rows(found)
    assert (first[1], first[2], first[4]) == ("1", "+0.0000", EARLIER)
    assert (second[1], second[2], second[4]) == ("2", "+1.0000", LATER)


def test_the_newest_tare_of_the_ledger_is_the_newest_in_force(found: Findings) -> None:
    when = next(row[0] for row in tables.ledger_rows(found) if row[1] == "tare")
    assert tables.calibration_rows(found)[-1][4] == when


def test_an_identification_is_no_change(found: Findings) -> None:
    row = next(row for row in tables.ledger_rows(found) if row[1] == "identify")
    assert row[4] == "nothing changed"
    assert "plant.cylinder_lag_s found 0.021 (rig file 0.02)" in row[5]
