"""The runtime folder of a daemon whose rings the test writes."""

from __future__ import annotations

import pathlib

import pytest

from rigctl.config import rig_file as config
from rigctl.config.audit_section import AuditSettings
from rigctl.config.recording_section import RecordingSettings
from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from tests.builders.paths import ROOT


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    own = AuditSettings(file=str(tmp_path / "log" / "audit.jsonl"), trips=str(tmp_path / "trips"))
    kept = RecordingSettings(folder=str(tmp_path / "recordings"), free_mib=1)
    paper = config.load(ROOT / "config/paper_rig.yaml")
    preflight = paper.preflight.model_copy(update={"disk_free_mib": 1})
    return paper.model_copy(update={"audit": own, "recording": kept, "preflight": preflight})


@pytest.fixture
def runtime(tmp_path: pathlib.Path, settings: RigSettings) -> Runtime:
    found = Runtime(tmp_path / "run")
    found.directory.mkdir()
    found.make_rings(settings)
    found.write_json(ACTIVE, {"settings": settings.model_dump(mode="json"), "started_wall_ns": 5, "version": "1"})
    return found
