"""What the supervisor hands to the next loop, and the brake's flag where no recorder keeps it."""

from __future__ import annotations

import os
import pathlib
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.control.load import last_stroke
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.control.load.last_stroke import KeptValues
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Flag
from rigctl.supervisor.daemon import Supervisor
from tests.builders.durable import Disk
from tests.builders.paths import ROOT

FAILS = KeptBrake(fails=True, slipped_n=300.0)


class Bench:
    """A supervisor without processes, on a ring that the test writes."""

    def __init__(self, folder: pathlib.Path) -> None:
        paper = config.load(ROOT / "config/paper_rig.yaml")
        self.settings = paper.model_copy(update={"directory": str(folder)})
        self.said: list[str] = []
        self.runtime = Runtime(folder / "run")
        os.close(self.runtime.claim())
        self.runtime.make_rings(self.settings)
        self.supervisor = Supervisor(self.settings, self.said.append)
        self.supervisor._runtime = self.runtime

    def record(self, **values: Any) -> Any:
        zero = {field.name: 0.0 if field.code == "d" else 0 for field in RECORD.fields}
        self.runtime.records.writer().write(*RECORD.values(**(zero | {"slipped_n": float("nan")} | values)))
        return self.runtime.records.reader().latest()

    def handed_over(self, newest: Any) -> KeptValues:
        self.supervisor._put_last_stroke(newest)
        return last_stroke.in_force(self.runtime)


@pytest.fixture
def bench(tmp_path: pathlib.Path) -> Bench:
    return Bench(tmp_path)


def test_the_next_loop_gets_the_flag_of_the_ring_and_the_first_one_that_of_the_file(bench: Bench) -> None:
    assert bench.handed_over(None) == KeptValues(LastStroke(), KeptBrake())
    slipped = bench.record(stroke_mm=48.0, flags=Flag.BRAKE_FAILS, slipped_n=300.0)
    assert bench.handed_over(slipped) == KeptValues(LastStroke(48.0), FAILS), "no recorder has written it"
    last_stroke.write(bench.settings, KeptValues(LastStroke(48.0), FAILS), 0)
    assert bench.handed_over(bench.record(stroke_mm=48.0)) == KeptValues(LastStroke(48.0), KeptBrake())
    assert bench.handed_over(None) == KeptValues(LastStroke(48.0), FAILS)
    assert bench.said == []


def test_a_damaged_file_is_handed_over_as_a_brake_to_be_tested(bench: Bench) -> None:
    bench.settings.last_stroke.parent.mkdir()
    bench.settings.last_stroke.write_bytes(b"\0" * 40)
    assert bench.handed_over(None).brake == KeptBrake(fails=True, why="paper_rig.stroke.json is damaged")


def test_a_runtime_folder_that_takes_no_file_does_not_leave_the_former_flag_in_force(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not bench.handed_over(None).brake.fails

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(bench.runtime, "write_json", full)
    assert bench.handed_over(bench.record(flags=Flag.BRAKE_FAILS)).brake.fails
    (line,) = bench.said
    assert line.endswith("No space left on device; the stroke has to be confirmed, and the brake tested")


def test_the_flag_is_on_the_disk_without_a_recorder(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    bench.supervisor._keep_brake(None)
    bench.supervisor._keep_brake(bench.record(stroke_mm=48.0))
    assert not bench.settings.last_stroke.exists(), "the recorder's alone while the flag is as it was"
    bench.supervisor._keep_brake(bench.record(stroke_mm=48.0, flags=Flag.BRAKE_FAILS, slipped_n=300.0))
    assert last_stroke.read(bench.settings) == KeptValues(LastStroke(48.0), FAILS)
    assert disk.replaced(bench.settings.last_stroke)
    bench.supervisor._keep_brake(bench.record(stroke_mm=48.0))
    assert last_stroke.read(bench.settings) == KeptValues(LastStroke(48.0), KeptBrake())


def test_a_flag_that_cannot_be_kept_is_one_line_that_says_what_to_do(bench: Bench) -> None:
    slipped = bench.record(flags=Flag.BRAKE_FAILS)
    last_stroke.write(bench.settings, KeptValues(LastStroke(48.0), KeptBrake()), 0)
    bench.settings.last_stroke.with_name("paper_rig.stroke.json.new").mkdir()
    for _ in range(3):
        bench.supervisor._keep_brake(slipped)
    (line,) = bench.said
    assert line.startswith(f"WARNING: {bench.settings.last_stroke} cannot be written: ")
    assert line.endswith("not kept: the brake does not hold; after the next start test it: rigctl arm on a tight rope")
