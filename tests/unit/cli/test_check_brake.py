"""A rig without a brake says so in its file, and ``rigctl check`` what creep it is exposed to."""

from __future__ import annotations

import io

import pytest
from pydantic import ValidationError
from rich.console import Console

from rigctl.cli import check
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
WORDS = "the screw locks itself"


def printed(settings: RigSettings) -> str:
    console = Console(width=400, record=True, file=io.StringIO())
    check.show(settings, console)
    return console.export_text()


def test_the_waiver_is_printed_with_the_creep_that_stays_unseen() -> None:
    cylinder = PAPER.cylinder.model_copy(update={"brake_waiver": WORDS, "brake_test": False})
    (line,) = [line for line in printed(PAPER.model_copy(update={"cylinder": cylinder})).splitlines() if WORDS in line
               and line.startswith("WAIVED")]  # fmt: skip
    assert "no holding brake" in line
    assert "after 0.8 mm (4.77 N)" in line


def test_a_rig_with_a_brake_prints_nothing_of_it() -> None:
    assert "no holding brake: HOLD" not in printed(PAPER)


def test_a_brake_that_is_not_there_cannot_be_tested() -> None:
    document = PAPER.cylinder.model_dump() | {"brake_waiver": WORDS, "brake_test": True}
    with pytest.raises(ValidationError, match="no brake to test"):
        type(PAPER.cylinder).model_validate(document)
