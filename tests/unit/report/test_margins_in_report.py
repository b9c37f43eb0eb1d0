"""The report lists each measurement of the margins once."""

from __future__ import annotations

import math
import pathlib

from rigctl.model.states import Mode
from rigctl.recorder.recording import read
from rigctl.report import tables
from rigctl.report.findings import find
from rigctl.report.page import render
from tests.builders.synthetic import run, stay, write


def test_each_measurement_is_a_row_and_a_recording_without_any_says_nothing(tmp_path: pathlib.Path) -> None:
    records = run(stay(Mode.COMPENSATING, 10.0), stay(Mode.HOLD, 1.0))
    assert tables.measured_rows(find(read(write(tmp_path / "none.mcap", records), frames=False))) == []
    records["sensitivity_peak"] = records["sensitivity_peak_error"] = math.nan
    records["sensitivity_peak"][3000:6000], records["sensitivity_peak_error"][3000:6000] = 1.4, 0.02
    records["sensitivity_peak"][6000:10_000], records["sensitivity_peak_error"][6000:10_000] = 1.5, 0.03
    found = find(read(write(tmp_path / "two.mcap", records), frames=False))
    rows = tables.measured_rows(found)
    assert [row[1:] for row in rows] == [("1.400", "0.020"), ("1.500", "0.030")]
    assert "Ms 1.400 to 1.500" in render(found)
