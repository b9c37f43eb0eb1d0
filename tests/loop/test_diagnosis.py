"""Culprits of faults that end in the same trip, on the real loop: live from its rings, and from its recording."""

from __future__ import annotations

import pathlib
import time

import msgspec
import pytest

from hil.faults.catalogue import BY_ID
from hil.faults.judging.naming import Naming, RecordedRow, culprit, named, recorded
from hil.faults.lockstep_run import Bench
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.diagnosis.live import LatchedCulprit
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.model.parts import Part
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.recorder.continuous import Continuous
from rigctl.recorder.recording import parts_of, read
from rigctl.report.findings import as_dict, find
from rigctl.report.page import render


@pytest.fixture(scope="module")
def bench(settings: RigSettings, gains: Gains) -> Bench:
    return Bench(settings, gains)


@pytest.mark.gate(
    "rope_breaks-3-parts0", "cell_sign-3-parts3", "slope_jump-3-parts5", "brake_stuck_closed-3-parts9",
    "controller_hangs-3-parts10", "burst_50ms-3-parts12",
    "drive_frozen-3-parts13",
)  # fmt: skip
@pytest.mark.parametrize(
    ("fault_id", "mode", "parts"),
    [
        ("rope_breaks", Mode.COMPENSATING, (Part.ROPE,)),
        ("rope_breaks", Mode.HOLD, (Part.ROPE,)),
        ("cell_zero", Mode.COMPENSATING, (Part.CELL,)),
        ("cell_sign", Mode.COMPENSATING, (Part.AMPLIFIER,)),
        ("cell_unit", Mode.COMPENSATING, (Part.CELL,)),
        ("slope_jump", Mode.COMPENSATING, (Part.INCLINOMETER,)),
        ("payload_lifted", Mode.COMPENSATING, (Part.ROPE, Part.PAYLOAD)),
        ("impostor", Mode.COMPENSATING, (Part.MASTER,)),
        ("speed_stuck", Mode.COMPENSATING, (Part.ENCODER,)),
        ("brake_stuck_closed", Mode.COMPENSATING, (Part.DRIVE, Part.BRAKE)),
        ("controller_hangs", Mode.COMPENSATING, (Part.COMPUTER,)),
        ("bus_stalled", Mode.COMPENSATING, (Part.COMPUTER,)),
        ("burst_50ms", Mode.COMPENSATING, (Part.BUS,)),
        ("drive_frozen", Mode.COMPENSATING, (Part.DRIVE,)),
    ],
)
def test_faults_with_one_symptom_have_culprits_of_their_own(
    bench: Bench, fault_id: str, mode: Mode, parts: tuple[Part, ...]
) -> None:
    fault = BY_ID[fault_id]
    found = culprit(recorded(bench.play(fault, mode), fault), bench.settings)
    assert found is not None
    assert found.parts == parts
    assert named(fault, mode, found).naming is (Naming.RIGHT if len(parts) == 1 else Naming.TWO)


@pytest.mark.parametrize("mode", [Mode.COMPENSATING, Mode.HOLD])
def test_at_no_time_after_the_rope_broke_is_somebody_sent_to_the_cell(bench: Bench, mode: Mode) -> None:
    """What is known grows from tick to tick; until the motor's current is known, the rope is the first candidate."""
    fault = BY_ID["rope_breaks"]
    row = recorded(bench.play(fault, mode), fault)
    for after_ms in (0, 1, 2, 3, 5, 7, 10, 20, 31, 50, 80, 119, 121, 150, 200, 300, 600, 1200):
        until_ns = row.t_ns + after_ms * 1_000_000
        part = RecordedRow(row.records[row.records["t_ns"] <= until_ns], row.events[row.events["t_ns"] <= until_ns])
        found = culprit(part, bench.settings)
        assert found is not None
        assert found.parts[0] is Part.ROPE, f"{after_ms} ms after the trip: {found.text}"
        assert "Keep out" in found.first


def _compensating(rig: Lockstep) -> None:
    rig.rig.plant.preload(280.0)
    rig.run(0.4)
    arm_and_tension(rig, limit_s=20.0, settle_s=0.6)


def test_a_running_rig_names_its_culprit_at_once_more_surely_later_and_nothing_after_the_reset(
    settings: RigSettings, gains: Gains
) -> None:
    with lockstep(settings, gains) as rig:
        seen = LatchedCulprit(rig.runtime.records.reader(), settings)
        _compensating(rig)
        seen.note(rig.events.read())
        assert seen.of(rig.runtime.records.reader().latest()) is None
        BY_ID["rope_breaks"].inject(Stand(rig, "a"))
        rig.run(0.03)
        seen.note(rig.events.read())
        early = seen.of(rig.runtime.records.reader().latest())
        assert early is not None
        assert early.parts == (Part.ROPE, Part.CELL)  # the motor's current is not known yet
        assert early.question == "does the rope hang loose?"
        assert "Keep out" in early.first
        rig.run(1.4)
        seen.note(rig.events.read())
        sure = seen.of(rig.runtime.records.reader().latest())
        assert sure is not None
        assert sure.parts == (Part.ROPE,)
        assert rig.command(Verb.RESET) is Refusal.NONE
        seen.note(rig.events.read())
        assert seen.of(rig.runtime.records.reader().latest()) is None


def test_the_report_of_a_recording_names_the_culprit_of_its_trip(
    settings: RigSettings, gains: Gains, tmp_path: pathlib.Path
) -> None:
    kept = settings.recording.model_copy(update={"folder": str(tmp_path), "free_mib": 1})
    settings = settings.model_copy(update={"recording": kept})
    with lockstep(settings, gains, history_s=settings.telemetry.history_s) as rig:
        document = {"settings": settings.model_dump(mode="json"), "design": {"gains": msgspec.to_builtins(gains)}}
        rig.runtime.write_json(ACTIVE, document)
        recording = Continuous(rig.runtime, settings, 7, time.time_ns())
        _compensating(rig)
        BY_ID["cell_sign"].inject(Stand(rig, "a"))
        rig.run(1.5)
        recording.poll(rig.clock.now(), time.time_ns(), final=True)
        recording.close(rig.clock.now(), time.time_ns())
    (file,) = tmp_path.glob("*.mcap")
    found = find(read(*parts_of(file), frames=False))
    (one,) = found.culprits
    assert one.culprit.parts == (Part.AMPLIFIER,)
    assert "a rope cannot push" in one.culprit.text
    assert as_dict(found)["culprits"][0]["parts"] == ["tension cell's amplifier"]
    assert "a rope cannot push" in render(found)
