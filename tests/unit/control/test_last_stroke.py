"""The file of the last stroke: written whole, and rejected once it is damaged."""

from __future__ import annotations

import pathlib
import random

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control import last_stroke
from rigctl.control.homed import LastStroke
from tests.builders.durable import Disk
from tests.builders.paths import ROOT

WALL_NS = 1_800_000_000_000_000_000


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    paper = config.load(ROOT / "config/paper_rig.yaml")
    return paper.model_copy(update={"directory": str(tmp_path)})


def test_it_stands_beside_the_ledger_and_says_what_was_written(settings: RigSettings, tmp_path: pathlib.Path) -> None:
    assert last_stroke.read(settings) == LastStroke()
    last_stroke.write(settings, 52.125, WALL_NS)
    last_stroke.write(settings, -3.5, WALL_NS)
    assert last_stroke.read(settings) == LastStroke(-3.5)
    assert [path.name for path in (tmp_path / "calibration").iterdir()] == ["paper_rig.stroke.json"]


def test_another_rigs_file_is_not_believed(settings: RigSettings) -> None:
    last_stroke.write(settings, 52.0, WALL_NS)
    settings.last_stroke.rename(settings.last_stroke.with_name("other.stroke.json"))
    other = settings.model_copy(update={"rig": "other"})
    assert last_stroke.read(other) == LastStroke(None, "other.stroke.json is of paper_rig")


def test_a_folder_that_cannot_be_written_leaves_the_file_as_it_was(settings: RigSettings) -> None:
    settings.last_stroke.parent.parent.joinpath("calibration").write_text("a file")
    with pytest.raises(OSError, match="calibration"):
        last_stroke.write(settings, 1.0, WALL_NS)
    assert "cannot be read" in last_stroke.read(settings).why


def test_a_thousand_corruptions_are_a_stroke_that_is_not_known_or_one_to_be_held_against(settings: RigSettings) -> None:
    last_stroke.write(settings, 52.0, WALL_NS)
    path, chance = settings.last_stroke, random.Random("last stroke")
    whole = path.read_bytes()
    unknown = 0
    for _ in range(1000):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(bytes(data[: chance.randint(0, len(data))]) if chance.random() < 0.3 else bytes(data))
        found = last_stroke.read(settings)
        assert (found.mm is None) == bool(found.why), "never as if there had been no file"
        unknown += found.mm is None
    assert unknown > 500
    path.write_bytes(b"[" * 100_000)
    assert last_stroke.read(settings).why


def test_it_is_on_the_disk_before_it_has_its_name(settings: RigSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    last_stroke.write(settings, 52.0, WALL_NS)
    assert disk.replaced(settings.last_stroke)
