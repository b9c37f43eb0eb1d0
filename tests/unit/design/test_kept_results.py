"""Results kept from start to start: the same as computed, without the libraries, and never those of another design."""

from __future__ import annotations

import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest

from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from rigctl.control.law.gain_table import ScheduledGains
from rigctl.design import kept_results
from rigctl.design.identified import Identified, Uncertain
from rigctl.design.in_use import design_in_use
from rigctl.design.kept_results import JudgedLoop, KeptResults
from rigctl.ipc import ledger
from tests.builders import daemons
from tests.builders.identifications import NOON_NS, response
from tests.builders.paths import ROOT

Rig = Callable[..., RigSettings]
Command = Callable[..., "subprocess.CompletedProcess[str]"]
NOW = datetime.fromtimestamp(NOON_NS / 1e9, UTC)
QUIETER = {"quiet_tension_walk_n": 0.002, "quiet_disturbance_walk_mm_s": 2.0}
FOUND = Identified(
    when="2026-10-30T12:00:00+00:00", entries=(), tension_n=300.0, believed_n_mm=5.96,
    stiffness_n_mm=Uncertain(6.0, 0.01), lag_s=Uncertain(0.02, 1e-4), delay_s=Uncertain(0.002, 1e-4),
)  # fmt: skip
START = """
import json, pathlib, sys
from rigctl.config import rig_file
from rigctl.design.in_use import design_in_use
from rigctl.design.kept_results import KeptResults
results = KeptResults(pathlib.Path(sys.argv[2]))
found = design_in_use(rig_file.load(sys.argv[1]), results=results)
results.keep()
print(json.dumps([found.as_dict(), sorted({"scipy", "control", "filterpy", "matplotlib"} & {*sys.modules})]))
"""


@pytest.fixture
def file(tmp_path: pathlib.Path) -> pathlib.Path:
    return tmp_path / "paper_rig.design.json"


def nothing_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_arguments: object, **_names: object) -> None:
        raise AssertionError("computed again")

    for name in ("design", "judge", "dwell_time_s"):
        monkeypatch.setattr(kept_results, name, refused)


def kept(file: pathlib.Path, settings: RigSettings) -> JudgedLoop:
    results = KeptResults(file)
    loop = JudgedLoop(settings, results.gains(settings), None)
    results.judged(loop)
    results.keep()
    return loop


@pytest.mark.parametrize(
    "changes",
    [{}, {"estimator": QUIETER}, {"plant": {"spring_n_mm": None}}],
    ids=["paper", "two settings of the filter", "unstable with some plants"],
)
def test_a_kept_design_is_the_computed_one(
    rig: Rig, file: pathlib.Path, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = rig(**changes)
    computed = design_in_use(settings)
    kept(file, settings)
    nothing_computed(monkeypatch)
    assert design_in_use(settings, results=KeptResults(file)) == computed


def test_a_kept_gain_table_is_the_computed_one(
    tmp_path: pathlib.Path, file: pathlib.Path, in_process: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = daemons.rig_file(tmp_path, {"design": {"gains_file": "gains.yaml", "identify_days": 3650}}, rig="known")
    settings = rig_file.load(place)
    for tension_n, k_n_mm, stroke_mm in ((300.0, 6.0, 50.0), (150.0, 5.2, 40.0)):
        plant = {"stiffness_n_mm": {"value": k_n_mm, "error": 0.01}}
        ledger.append(settings, response(settings, 2.0, tension_n, plant=plant, stroke_mm=stroke_mm))
    gains = place.with_name("gains.yaml")
    assert in_process("rigctl", "tune", place, "--from", settings.ledger, "--gains", gains, "--table").returncode == 0
    results = KeptResults(file)
    computed = design_in_use(settings, NOW, results)
    assert isinstance(computed.gains, ScheduledGains)
    assert computed == design_in_use(settings, NOW)
    results.keep()
    nothing_computed(monkeypatch)
    assert design_in_use(settings, NOW, KeptResults(file)) == computed


def test_a_second_start_loads_no_library_of_the_design(tmp_path: pathlib.Path) -> None:
    rig, file = daemons.rig_file(tmp_path, {}), tmp_path / "kept.json"
    said = []
    for _ in range(2):
        answer = subprocess.run(
            [sys.executable, "-c", START, str(rig), str(file)], cwd=ROOT, capture_output=True, text=True, check=True
        )
        said.append(json.loads(answer.stdout))
    (first, loaded), (second, none) = said
    assert loaded
    assert none == []
    assert second == first


@pytest.mark.parametrize(
    "changed",
    [
        lambda loop: loop._replace(settings=loop.settings.model_copy(update={"rig": "other"})),
        lambda loop: loop._replace(gains=replace(loop.gains, k_speed=loop.gains.k_speed * (1.0 + 1e-12))),
        lambda loop: loop._replace(plant=FOUND),
    ],
    ids=["settings", "gains", "plant"],
)  # fmt: skip
def test_anything_else_is_computed(
    rig: Rig, file: pathlib.Path, changed: Callable[[JudgedLoop], JudgedLoop], monkeypatch: pytest.MonkeyPatch
) -> None:
    other = changed(kept(file, rig()))
    nothing_computed(monkeypatch)
    with pytest.raises(AssertionError, match="computed again"):
        KeptResults(file).judged(other)


def test_results_of_other_code_are_computed(rig: Rig, file: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = kept(file, rig())
    monkeypatch.setattr(kept_results, "_code", lambda: "another")
    nothing_computed(monkeypatch)
    with pytest.raises(AssertionError, match="computed again"):
        KeptResults(file).judged(loop)


def _edited(file: pathlib.Path) -> None:
    text = file.read_text()
    assert '"ms_max": 1.5' in text
    file.write_text(text.replace('"ms_max": 1.5', '"ms_max": 1.1'))


def _linked(file: pathlib.Path) -> None:
    file.rename(file.with_name("there"))
    file.symlink_to("there")


@pytest.mark.parametrize(
    "damaged",
    [
        lambda file: file.unlink(),
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(file.read_bytes()[:-100]),
        _edited,
        _linked,
        lambda file: file.chmod(0o620),
        lambda file: file.chmod(0o602),
    ],
    ids=["missing", "empty", "short", "edited", "a link", "of its group", "of all"],
)
def test_a_file_that_is_not_whole_or_not_this_users_alone_counts_for_nothing(
    rig: Rig, file: pathlib.Path, damaged: Callable[[pathlib.Path], object]
) -> None:
    settings = rig()
    kept(file, settings)
    damaged(file)
    results = KeptResults(file)
    assert results._kept == {}
    assert design_in_use(settings, results=results) == design_in_use(settings)


def test_another_users_file_counts_for_nothing(rig: Rig, file: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(file, rig())
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert KeptResults(file)._kept == {}


def test_what_is_not_used_any_more_goes(rig: Rig, file: pathlib.Path) -> None:
    kept(file, rig(plant={"spring_n_mm": 13.0}))
    size = file.stat().st_size
    kept(file, rig())
    assert file.stat().st_size < 1.1 * size


def test_a_folder_that_cannot_be_written_is_no_reason_not_to_start(rig: Rig, tmp_path: pathlib.Path) -> None:
    (tmp_path / "calibration").write_text("no folder")
    kept(tmp_path / "calibration" / "paper_rig.design.json", rig())
