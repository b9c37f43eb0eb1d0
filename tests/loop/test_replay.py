"""A replayed recording gives the same results bit by bit; any change in the recording is found."""

from __future__ import annotations

import dataclasses
import pathlib
import re
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from hil.faults.in_device import brake_slips
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl import __version__
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power.ending import WAITS_NS
from rigctl.ipc.correction import Correction
from rigctl.ipc.ledger import IN_FORCE, Standing
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.model.checks import Check
from rigctl.model.states import Flag, Mode
from rigctl.model.verbs import Refusal, Setting, Verb
from rigctl.recorder.continuous import Continuous
from rigctl.recorder.recording import Recording, parts_of, read
from rigctl.replay.compare import Against, first_difference
from rigctl.replay.play import ProcessSpan, ReplayError, made_by, play, spans

STOP_S = 3.0


def recorded(
    settings: RigSettings, gains: Gains, folder: pathlib.Path, script: Callable[[Lockstep], None]
) -> Recording:
    """The recording of a loop in simulated time that runs ``script`` and is then stopped."""
    recording = settings.recording.model_copy(update={"folder": str(folder / "kept")})
    audit = settings.audit.model_copy(update={"file": str(folder / "audit.jsonl")})
    settings = settings.model_copy(update={"recording": recording, "audit": audit})
    with lockstep(settings, gains, correction=Correction(0.25, 1.001), host_checks=int(Check.HOST)) as rig:
        design = {"gains": msgspec.to_builtins(gains)}
        rig.runtime.write_json(ACTIVE, {"settings": settings.model_dump(mode="json"), "design": design})
        rig.runtime.write_json("control.json", rig.report.as_json())
        rig.runtime.write_json(IN_FORCE, Standing(zero_n=0.25, scale=1.001))
        writer = Continuous(rig.runtime, settings, 7, time.time_ns())
        ticked = rig.loop.tick

        def tick() -> None:
            ticked()
            if rig.record["tick"] % 500 == 0:
                writer.poll(rig.clock.now(), time.time_ns(), final=True)

        rig.loop.tick = tick  # type: ignore[method-assign]
        script(rig)
        rig.loop.stop_requested = True
        rig.run(STOP_S)
        assert rig.loop.finished
        writer.close(rig.clock.now(), time.time_ns())
    (first,) = (folder / "kept").glob("*.mcap")
    return read(*parts_of(first))


def drill(rig: Lockstep) -> None:
    """Every mode, a changed gain, a refused command, a lost frame, late ticks, a trip and its reset."""
    rig.run(0.3)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT  # the gateway has not reported the host checks yet
    rig.command(Setting.HOST_CHECKS, 0.0)
    assert rig.command(Verb.ARM) is Refusal.NONE
    assert rig.command(Verb.TARGET, 5000.0) is Refusal.OUT_OF_RANGE
    rig.command(Verb.TARGET, 60.0)
    rig.command(Verb.TENSION)
    rig.run_until(Mode.COMPENSATING, 20.0)
    rig.run(0.5)
    rig.command(Setting.LAW_GAINS, 1.0, 0.1, 0.5)
    rig.clock.skip = 3
    rig.run(0.5)
    rig.inject(frame(0x182, bytes(5)[:4]))
    rig.run(0.2)
    rig.inject(frame(0x182, bytes([0, 0, 0, 0, 1])))
    rig.run(0.5)
    rig.command(Verb.RESET)
    assert rig.hold() is Refusal.NONE
    rig.command(Verb.RELEASE)
    rig.run(0.2)
    assert rig.hold() is Refusal.NONE
    rig.command(Verb.RELEASE)
    rig.run(1.0)


def end_with_a_load(rig: Lockstep) -> None:
    """The motor carries a load for a brake that slips, and the loop is to end."""
    rig.run(0.3)
    rig.command(Setting.HOST_CHECKS, 0.0)
    assert rig.command(Verb.ARM) is Refusal.NONE
    rig.command(Verb.TARGET, 60.0)
    rig.command(Verb.TENSION)
    rig.run_until(Mode.COMPENSATING, 20.0)
    rig.hold()
    brake_slips(0.5)(Stand(rig, "replay"))
    rig.run(4.0)
    assert rig.view.carries
    rig.loop.stop_requested = True


def lowered(rig: Lockstep) -> None:
    end_with_a_load(rig)
    rig.run(WAITS_NS * 1e-9 + 1.5)


def left(rig: Lockstep) -> None:
    end_with_a_load(rig)
    rig.run(2.0)
    rig.loop.repeated_stops += 1


def frame(can_id: int, data: bytes) -> bytes:
    return can_id.to_bytes(4, "little") + bytes([len(data), 0, 0, 0]) + data.ljust(8, b"\0")


@pytest.fixture(scope="module")
def paper(
    settings: RigSettings, gains: Gains, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Recording, ProcessSpan]:
    found = recorded(settings, gains, tmp_path_factory.mktemp("replay"), drill)
    (span,) = spans(found)
    return found, span


def replayed(recording: Recording, span: ProcessSpan) -> Any:
    return first_difference(play(recording, span), lambda _done, _doing: None)


def test_a_recording_comes_out_bit_identical(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    assert set(np.unique(span.records["mode"])) >= {Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.FAULT}
    assert span.records["skipped"][-1] == 3
    assert span.records["frames_refused"][-1] >= 1
    assert span.records["flags"][-1] & Flag.STOPPING
    assert span.cut_short == ""
    assert replayed(recording, span) == (len(span.records), None)


@pytest.mark.gate("left")
@pytest.mark.parametrize("ending", [lowered, left], ids=["lowered", "left"])
def test_an_end_that_a_load_delays_comes_out_bit_identical(
    settings: RigSettings, gains: Gains, tmp_path: pathlib.Path, ending: Callable[[Lockstep], None]
) -> None:
    recording = recorded(settings, gains, tmp_path, ending)
    (span,) = spans(recording)
    assert np.isfinite(span.records["end_s"]).any()
    assert bool(span.records["tension_n"][-1] < settings.tension.slack_n) is (ending is lowered)
    assert replayed(recording, span) == (len(span.records), None)


def test_a_command_that_was_another_is_found_in_its_tick(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    records = span.records.copy()
    at = int(np.flatnonzero(records["mode"] == Mode.COMPENSATING)[200])
    records["command_mm_s"][at] = np.nextafter(records["command_mm_s"][at], 9.0)
    same, found = replayed(recording, dataclasses.replace(span, records=records))
    assert same == at
    assert found.tick == records["tick"][at]
    assert [row.field for row in found.differences] == ["command_mm_s"]


def test_a_frame_that_was_another_is_found(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    frames = recording.frames.copy()
    cell = np.flatnonzero((frames["can_id"] == 0x182) & (frames["sent"] == 0))
    at = int(cell[len(cell) // 3])
    frames["data"][at] = bytes([frames["data"][at][0] ^ 0x10]) + bytes(frames["data"][at])[1:]
    same, found = replayed(dataclasses.replace(recording, frames=frames), span)
    assert 0 < same < len(span.records)
    assert abs(found.t_ns - int(frames["t_ns"][at])) <= span.settings.loop.period_ns
    assert "reading_n" in {row.field for row in found.differences}


def test_a_frame_sent_that_was_another_is_found(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    frames = recording.frames.copy()
    ours = (frames["sent"] == 1) & (frames["can_id"] == 0x204)
    at = int(np.flatnonzero(ours)[-500])
    frames["data"][at] = b"\xff\x01\x02\x03\x04\x05"
    _, found = replayed(dataclasses.replace(recording, frames=frames), span)
    assert [row.field for row in found.differences] == ["frames sent"]


def test_a_command_the_loop_was_not_given_is_found(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    tension = recording.commands["verb"] == Verb.TENSION
    same, found = replayed(dataclasses.replace(recording, commands=recording.commands[~tension]), span)
    assert {"mode"} <= {row.field for row in found.differences}
    assert span.records["mode"][same] == Mode.TENSIONING


def test_a_hold_the_loop_was_not_given_is_found(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    assert len(recording.holds) == 2
    same, found = replayed(dataclasses.replace(recording, holds=recording.holds[:1]), span)
    assert "mode" in {row.field for row in found.differences}
    assert span.records["mode"][same] == Mode.HOLD


def test_a_gap_ends_what_is_replayed(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, _ = paper
    holed = np.delete(recording.records, slice(2000, 2100))
    (found,) = spans(dataclasses.replace(recording, records=holed))
    assert len(found.records) == 2000
    assert found.cut_short == "records are missing"
    assert replayed(recording, found) == (2000, None)


def test_without_a_start_there_is_nothing_to_replay(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, _ = paper
    with pytest.raises(ReplayError, match="no start of the loop is in it: it begins with tick 101"):
        spans(dataclasses.replace(recording, records=recording.records[100:]))


@pytest.mark.parametrize(
    ("metadata", "said"),
    [({"versions": {"rigctl": "0.0.9"}}, "made by rigctl 0.0.9, which replays it"),
     ({"rigctl": {"version": "0.0.9"}}, "made by rigctl 0.0.9, which replays it"),
     ({}, "made by a release that it does not name, which replays it"),
     ({"versions": {"rigctl": __version__}}, f"made by another build of {__version__}, which replays it")],
    ids=["recording", "dump", "unnamed", "same"],
)  # fmt: skip
def test_a_recording_of_another_loop_names_the_release_that_replays_it(
    paper: tuple[Recording, ProcessSpan], metadata: dict[str, dict[str, str]], said: str
) -> None:
    recording, _ = paper
    assert (recording.release, made_by(recording)) == (__version__, "")
    for ring, field in (("records", "load_at_rest"), ("commands", "creep_held_s"), ("holds", "pid")):
        slots = getattr(recording, ring)
        fewer = slots[[name for name in slots.dtype.names if name != field]]
        other = dataclasses.replace(recording, metadata=metadata, **{ring: fewer})
        with pytest.raises(ReplayError, match="not those of this version's loop: it was " + re.escape(said)):
            spans(other)


def changed(recording: Recording, name: str, change: Callable[[dict[str, Any]], object]) -> Recording:
    """The recording of release 0.0.9 with another content of the document ``name``."""
    found = []
    for document in recording.generations:
        if document.name == name:
            content = msgspec.json.decode(document.data)
            change(content)
            document = dataclasses.replace(document, data=msgspec.json.encode(content))  # noqa: PLW2901
        found.append(document)
    return dataclasses.replace(recording, generations=found, metadata={"rigctl": {"version": "0.0.9"}})


def test_recorded_settings_that_this_version_refuses_are_named(paper: tuple[Recording, ProcessSpan]) -> None:
    other = changed(paper[0], ACTIVE, lambda active: active["settings"]["tension"].update(ramp_n_s=-1.0))
    said = (
        r"refused by this version: .*tension\.ramp_n_s: found -1\.0, expected .*; it was made by rigctl 0\.0\.9, which"
    )
    with pytest.raises(ReplayError, match=said):
        spans(other)


def test_a_recording_without_the_mappings_of_the_devices_names_the_release_that_replays_it(
    paper: tuple[Recording, ProcessSpan],
) -> None:
    other = changed(paper[0], "control.json", lambda control: control.pop("process_data"))
    with pytest.raises(ReplayError, match=r"cannot be read: .*null.*; it was made by rigctl 0\.0\.9, which replays it"):
        spans(other)


@pytest.mark.study
def test_other_gains_command_something_else(paper: tuple[Recording, ProcessSpan]) -> None:
    recording, span = paper
    same, other = Against(), Against()
    for batch in play(recording, span, gains=span.gains):
        same.add(batch)
    stronger = Gains(2.0 * span.gains.k_tension, span.gains.k_speed, span.gains.k_integral)
    for batch in play(recording, span, gains=stronger):
        other.add(batch)
    assert all(row["apart_max_mm_s"] == 0.0 for row in same.rows())
    assert same.first_other_mode is None
    rows = {row["mode"]: row for row in other.rows()}
    assert rows["TENSIONING"]["apart_rms_mm_s"] > 0.0
    assert rows["HOLD"]["apart_rms_mm_s"] == pytest.approx(0.0, abs=1e-6)
