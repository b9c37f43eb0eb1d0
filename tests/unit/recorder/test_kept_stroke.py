"""The recorder keeps the last stroke, once a second, and the brake's flag, at once and on the disk."""

from __future__ import annotations

import math
import pathlib

import pytest

from rigctl.config.settings import RigSettings
from rigctl.control.load import last_stroke
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.control.load.last_stroke import KeptValues
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.model.states import Flag, Mode
from rigctl.recorder.recorder_process import Recorder
from tests.builders.durable import Disk

MS = 1_000_000
S = 1000 * MS
HOLDS, FAILS = KeptBrake(), KeptBrake(fails=True, slipped_n=300.0)


@pytest.fixture
def settings(settings: RigSettings, tmp_path: pathlib.Path) -> RigSettings:
    """Its last stroke is in a folder of the test's own too."""
    return settings.model_copy(update={"directory": str(tmp_path)})


class Watched:
    """A recorder, and the loop whose newest record it sees."""

    def __init__(self, runtime: Runtime, settings: RigSettings) -> None:
        self.settings, self._runtime = settings, runtime
        self._records = runtime.records.writer()
        self._recorder = Recorder(runtime, settings, 0, 0)

    def at(
        self, t_ns: int, stroke_mm: float, brake: KeptBrake = HOLDS, *, mode: Mode = Mode.HOLD, known: bool = True
    ) -> KeptValues:
        """A record; what the file has after the recorder has seen it."""
        flags = (Flag.BRAKE_FAILS if brake.fails else 0) | (0 if known else Flag.STROKE_UNCONFIRMED)
        load_n = math.nan if brake.slipped_n is None else brake.slipped_n
        given = {"t_ns": t_ns, "stroke_mm": stroke_mm, "flags": flags, "slipped_n": load_n, "mode": mode}
        zero = {field.name: 0.0 if field.code == "d" else 0 for field in RECORD.fields}
        self._records.write(*RECORD.values(**(zero | given)))
        self._recorder.poll(t_ns, t_ns)
        return last_stroke.read(self.settings)

    def anew(self) -> None:
        """The recorder has been killed, and the next one starts."""
        self._recorder = Recorder(self._runtime, self.settings, 0, 0)


@pytest.fixture
def kept(runtime: Runtime, settings: RigSettings) -> Watched:
    return Watched(runtime, settings)


def test_a_flag_is_on_the_disk_at_once_while_the_stroke_waits_for_its_second(
    kept: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert kept.at(1 * S, 50.0) == KeptValues(LastStroke(50.0), HOLDS)
    assert kept.at(1 * S + 50 * MS, 51.0) == KeptValues(LastStroke(50.0), HOLDS)
    disk = Disk(monkeypatch)
    assert kept.at(1 * S + 100 * MS, 51.1, FAILS, mode=Mode.COMPENSATING) == KeptValues(LastStroke(51.1), FAILS)
    assert disk.replaced(kept.settings.last_stroke)
    assert kept.at(1 * S + 150 * MS, 51.1, HOLDS, mode=Mode.COMPENSATING) == KeptValues(LastStroke(51.1), HOLDS)
    assert disk.replaced(kept.settings.last_stroke)


def test_a_load_that_is_found_later_is_kept_with_the_flag(kept: Watched) -> None:
    kept.at(1 * S, 50.0, KeptBrake(fails=True))
    assert kept.at(3 * S, 50.0, FAILS).brake == FAILS
    assert kept.at(5 * S, 50.0, KeptBrake(fails=True, slipped_n=300.4)).brake == FAILS, "the noise of the cell"


def test_a_flag_without_a_confirmed_stroke_leaves_the_stroke_as_it_was(kept: Watched) -> None:
    kept.at(1 * S, 50.0)
    assert kept.at(2 * S, 9.0, FAILS, known=False) == KeptValues(LastStroke(50.0), FAILS)
    assert kept.at(4 * S, 48.0, FAILS) == KeptValues(LastStroke(48.0), FAILS)


def test_a_damaged_file_stays_until_stroke_or_flag_are_known(kept: Watched) -> None:
    kept.at(1 * S, 50.0, FAILS)
    kept.settings.last_stroke.write_bytes(b"{")
    kept.anew()
    assert kept.at(2 * S, 9.0, KeptBrake(fails=True), known=False).stroke.why == "paper_rig.stroke.json is damaged"
    assert kept.at(4 * S, 9.0, KeptBrake(fails=True)) == KeptValues(LastStroke(9.0), KeptBrake(fails=True))


def test_the_next_recorder_writes_what_the_one_before_has_not(kept: Watched) -> None:
    kept.at(1 * S, 50.0)
    kept.anew()
    assert kept.at(1 * S + 50 * MS, 50.0, FAILS).brake == FAILS
    kept.anew()
    assert kept.at(1 * S + 100 * MS, 50.0, HOLDS).brake == HOLDS


def test_a_flag_that_cannot_be_written_is_reported_and_tried_again(kept: Watched, runtime: Runtime) -> None:
    kept.at(1 * S, 50.0)
    folder = kept.settings.last_stroke.parent
    folder.rename(folder.with_name("away"))
    folder.write_text("a file in its place")
    kept.at(2 * S, 50.0, FAILS)
    (why,) = runtime.read_json(RECORDED)["warnings"]
    assert "paper_rig.stroke.json cannot be written" in why
    folder.unlink()
    folder.with_name("away").rename(folder)
    assert kept.at(2 * S + 50 * MS, 50.0, FAILS).brake == HOLDS, "once a second at most"
    assert kept.at(3 * S + 50 * MS, 50.0, FAILS).brake == FAILS
