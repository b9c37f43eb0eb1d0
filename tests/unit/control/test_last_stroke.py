"""The file of the last stroke and the brake's flag: written whole, and rejected once it is damaged."""

from __future__ import annotations

import json
import os
import pathlib
import random
import signal

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.load import last_stroke
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.control.load.last_stroke import KeptValues
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Flag
from tests.builders.durable import Disk
from tests.builders.paths import ROOT

WALL_NS = 1_800_000_000_000_000_000
NOTHING = KeptValues(LastStroke(), KeptBrake())
HOLDS, FAILS = KeptBrake(), KeptBrake(fails=True, slipped_n=300.0)


def kept(stroke_mm: float | None, brake: KeptBrake = HOLDS) -> KeptValues:
    return KeptValues(LastStroke(stroke_mm), brake)


def unknown(why: str) -> KeptValues:
    """The stroke has to be confirmed, and the brake tested."""
    return KeptValues(LastStroke(None, why), KeptBrake(fails=True, why=why))


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    paper = config.load(ROOT / "config/paper_rig.yaml")
    return paper.model_copy(update={"directory": str(tmp_path)})


@pytest.mark.parametrize("brake", [HOLDS, FAILS, KeptBrake(fails=True)], ids=["holds", "fails", "at no known load"])
def test_it_stands_beside_the_ledger_and_says_what_was_written(
    settings: RigSettings, tmp_path: pathlib.Path, brake: KeptBrake
) -> None:
    assert last_stroke.read(settings) == NOTHING
    last_stroke.write(settings, kept(52.125), WALL_NS)
    last_stroke.write(settings, kept(-3.5, brake), WALL_NS)
    assert last_stroke.read(settings) == kept(-3.5, brake)
    assert [path.name for path in (tmp_path / "calibration").iterdir()] == ["paper_rig.stroke.json"]


def test_a_flag_is_kept_without_a_stroke_and_the_stroke_is_then_confirmed(settings: RigSettings) -> None:
    last_stroke.write(settings, kept(None, FAILS), WALL_NS)
    assert last_stroke.read(settings) == KeptValues(LastStroke(None, "paper_rig.stroke.json has no stroke"), FAILS)


def test_the_file_of_a_version_without_the_flag_is_read_and_written_as_long_as_it_is_not_set(
    settings: RigSettings,
) -> None:
    former = {"rig": "paper_rig", "stroke_mm": 52.125, "when": "2027-01-15T08:00:00Z"}
    settings.last_stroke.parent.mkdir()
    settings.last_stroke.write_text(json.dumps(former))
    assert last_stroke.read(settings) == kept(52.125)
    last_stroke.write(settings, kept(52.125), WALL_NS)
    assert json.loads(settings.last_stroke.read_bytes()).keys() == former.keys()


@pytest.mark.parametrize(
    "change",
    [
        {"brake_fails": None}, {"brake_fails": "no"}, {"brake_fails": 1}, {"brake_fials": True},
        {"slipped_n": 300.0}, {"brake_fails": False, "slipped_n": 300.0},
        {"brake_fails": True, "slipped_n": -1.0}, {"brake_fails": True, "slipped_n": 1e300}, {"stroke_mm": 1e300},
    ],
    ids=str,
)  # fmt: skip
def test_a_damaged_flag_is_a_brake_that_does_not_hold(settings: RigSettings, change: dict[str, object]) -> None:
    last_stroke.write(settings, kept(52.0), WALL_NS)
    settings.last_stroke.write_text(json.dumps({**json.loads(settings.last_stroke.read_bytes()), **change}))
    assert last_stroke.read(settings) == unknown("paper_rig.stroke.json is damaged")


@pytest.mark.parametrize("brake", [HOLDS, FAILS], ids=["holds", "fails"])
def test_a_truncated_file_is_a_brake_that_does_not_hold(settings: RigSettings, brake: KeptBrake) -> None:
    last_stroke.write(settings, kept(52.0, brake), WALL_NS)
    whole = settings.last_stroke.read_bytes()
    for size in range(len(whole.rstrip())):
        settings.last_stroke.write_bytes(whole[:size])
        assert last_stroke.read(settings) == unknown("paper_rig.stroke.json is damaged"), size


def test_another_rigs_file_is_not_believed(settings: RigSettings) -> None:
    last_stroke.write(settings, kept(52.0), WALL_NS)
    settings.last_stroke.rename(settings.last_stroke.with_name("other.stroke.json"))
    other = settings.model_copy(update={"rig": "other"})
    assert last_stroke.read(other) == unknown("other.stroke.json is of paper_rig")


def test_a_folder_that_cannot_be_written_leaves_the_file_as_it_was(settings: RigSettings) -> None:
    settings.last_stroke.parent.parent.joinpath("calibration").write_text("a file")
    with pytest.raises(OSError, match="calibration"):
        last_stroke.write(settings, kept(1.0), WALL_NS)
    assert "cannot be read" in last_stroke.read(settings).stroke.why
    assert last_stroke.read(settings).brake.fails


@pytest.mark.parametrize("brake", [HOLDS, FAILS], ids=["holds", "fails"])
def test_a_thousand_corruptions_are_unknown_or_a_stroke_to_be_held_against_and_never_lose_the_flag(
    settings: RigSettings, brake: KeptBrake
) -> None:
    last_stroke.write(settings, kept(52.0, brake), WALL_NS)
    path, chance = settings.last_stroke, random.Random("last stroke")
    whole = path.read_bytes()
    lost = 0
    for _ in range(1000):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(bytes(data[: chance.randint(0, len(data))]) if chance.random() < 0.3 else bytes(data))
        found = last_stroke.read(settings)
        assert (found.stroke.mm is None) == bool(found.stroke.why), "never as if there had been no file"
        assert found.brake.fails or not (brake.fails or found.stroke.why)
        lost += found.stroke.mm is None
    assert lost > 500
    path.write_bytes(b"[" * 100_000)
    assert last_stroke.read(settings).stroke.why


def test_it_is_on_the_disk_before_it_has_its_name(settings: RigSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    last_stroke.write(settings, kept(52.0, FAILS), WALL_NS)
    assert disk.replaced(settings.last_stroke)


@pytest.mark.parametrize("moment", ["before the rename", "after it"])
def test_a_kill_leaves_the_old_flag_or_the_new_one_and_the_next_write_goes_through(
    settings: RigSettings, moment: str
) -> None:
    last_stroke.write(settings, kept(52.0, FAILS), WALL_NS)
    if (child := os.fork()) == 0:
        move = os.replace

        def killed(source: str, target: str) -> None:
            if moment == "after it":
                move(source, target)
            os.kill(os.getpid(), signal.SIGKILL)

        os.replace = killed  # type: ignore[assignment]
        last_stroke.write(settings, kept(50.0), WALL_NS)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert last_stroke.read(settings) == (kept(50.0) if moment == "after it" else kept(52.0, FAILS))
    last_stroke.write(settings, kept(51.0, FAILS), WALL_NS)
    assert last_stroke.read(settings) == kept(51.0, FAILS)
    assert [path.name for path in settings.last_stroke.parent.iterdir()] == ["paper_rig.stroke.json"]


# -- from the ring --------------------------------------------------------------------------------------------------
def record(runtime: Runtime, **values: float) -> object:
    """The newest record of a ring with these values; the others are 0."""
    given = {field.name: 0.0 if field.code == "d" else 0 for field in RECORD.fields} | {"slipped_n": float("nan")}
    runtime.records.writer().write(*(({**given, **values})[field.name] for field in RECORD.fields))
    return runtime.records.reader().latest()


@pytest.fixture
def runtime(settings: RigSettings, tmp_path: pathlib.Path) -> Runtime:
    found = Runtime(tmp_path / "run")
    os.close(found.claim())
    found.make_rings(settings)
    return found


def test_the_newest_record_comes_before_the_file_which_has_what_it_does_not_show(
    settings: RigSettings, runtime: Runtime
) -> None:
    last_stroke.write(settings, kept(52.0), WALL_NS)
    assert last_stroke.shown_by(settings, None) == kept(52.0)
    slipped = record(runtime, stroke_mm=48.0, flags=Flag.BRAKE_FAILS, slipped_n=300.0)
    assert last_stroke.shown_by(settings, slipped) == kept(48.0, FAILS)
    doubted = record(runtime, stroke_mm=9.0, flags=Flag.BRAKE_FAILS | Flag.STROKE_UNCONFIRMED)
    assert last_stroke.shown_by(settings, doubted) == kept(52.0, KeptBrake(fails=True))
    last_stroke.write(settings, kept(52.0, FAILS), WALL_NS)
    assert last_stroke.shown_by(settings, record(runtime, stroke_mm=48.0)) == kept(48.0), "a test has cleared it"


def test_a_loop_that_finds_no_file_in_the_runtime_folder_or_another_one_tests_the_brake(runtime: Runtime) -> None:
    runtime.write_json(last_stroke.IN_FORCE, kept(52.0, FAILS))
    assert last_stroke.in_force(runtime) == kept(52.0, FAILS)
    runtime.write_json(last_stroke.IN_FORCE, {"mm": 52.0, "why": ""})
    assert last_stroke.in_force(runtime) == unknown("stroke.json cannot be read")
    runtime.place(last_stroke.IN_FORCE).unlink()
    assert last_stroke.in_force(runtime) == unknown("stroke.json cannot be read")
