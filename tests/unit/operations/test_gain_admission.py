"""Gains may follow while the rig runs, or are refused in one line."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.operations.gain_admission import NotAdmittedError, admitted
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")


@pytest.mark.parametrize("text", ["", "gains: {}\n", "{"])
def test_what_is_no_gain_file_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(NotAdmittedError, match=r"^a\.gains\.yaml") as refused:
        admitted(PAPER, text, "a.gains.yaml")
    assert "\n" not in str(refused.value)
