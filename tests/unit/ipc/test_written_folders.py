"""Room on the disks that a rig writes to."""

from __future__ import annotations

import os
import pathlib

import pytest

from rigctl.config import rig_file as config
from rigctl.ipc.written_folders import MIB, folders
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")


def test_room_is_that_of_the_folder_or_of_the_nearest_there_is(tmp_path: pathlib.Path) -> None:
    settings = PAPER.model_copy(update={"directory": str(tmp_path / "not" / "there")})
    (found,) = folders(settings)  # all on one disk
    disk = os.statvfs(tmp_path)
    assert found.free_mib == pytest.approx(disk.f_bavail * disk.f_frsize / MIB, rel=0.2)
