"""The table of culprits: every row has a sign that picks it, and what it says and asks first is safe."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rigctl.diagnosis.part import AT_THE_LOAD, LOAD_IS_LOOSE
from rigctl.diagnosis.residuals import Residuals
from rigctl.diagnosis.table import TABLE, Clue
from rigctl.model.faults import Fault
from rigctl.model.parts import Part
from rigctl.model.states import Mode

HEALTHY = Residuals(
    Fault.LIMIT, "tension_rate_n_s above", Mode.COMPENSATING, frozenset(), 6.0, 5.0, before_n=300.0, after_n=300.0,
    least_n=300.0, step_n=0.1, unexplained_mm=0.0, command_mm_s=0.0, speed_mm_s=0.0, position_mm_s=0.0,
    stretch_mm_s=0.0, current_n=300.0,
)  # fmt: skip
NAN = float("nan")
BOTH = frozenset({"tension_cell", "cylinder"})
GONE: dict[str, Any] = {"after_n": 0.0, "least_n": -0.1, "step_n": 200.0, "fall_ms": 2.0, "stretch_mm_s": -800.0}

SHOWN: list[tuple[Fault, dict[str, Any], tuple[Part, ...], str]] = [
    (Fault.E_STOP, {}, (Part.E_STOP,), "pressed"),
    (Fault.LOOP_EXCEPTION, {}, (Part.PROCESS,), "exception"),
    (Fault.RIVAL, {"foreign": True}, (Part.MASTER,), "gives commands"),
    (Fault.CELL_STALE, {"device": "tension_cell", "foreign": True}, (Part.MASTER,), "gives commands"),
    (Fault.DRIVE_FAULT, {"stalled_ms": 300.0}, (Part.COMPUTER,), "300 ms"),
    (Fault.BUS_SILENT, {"queued": 40.0, "silent": BOTH}, (Part.COMPUTER,), "at once"),
    (Fault.CELL_STALE, {"queued": 6.0, "device": "tension_cell"}, (Part.COMPUTER,), "at once"),
    (Fault.CELL_STALE, {"queued": 6.0, "device": "tension_cell", "silent": frozenset({"tension_cell"})},
     (Part.AMPLIFIER,), "fails to report"),
    (Fault.LIMIT, {**GONE, "current_n": 0.0, "queued": 7.0, "stalled_ms": 300.0}, (Part.ROPE,), "carries nothing"),
    (Fault.TENSION_HIGH, {"queued": 7.0, "stretch_mm_s": 5.0}, (Part.PAYLOAD, Part.CELL), "rises by 5.0"),
    (Fault.DRIVE_NOT_FOLLOWING, {"queued": 6.0, "stalled_ms": 5.0, "speed_mm_s": -1.4, "position_mm_s": -1.5},
     (Part.DRIVE,), "moves at -1.4"),
    (Fault.DRIVE_NOT_FOLLOWING, {"stalled_ms": 120.0}, (Part.COMPUTER,), "120 ms"),
    (Fault.OVERRUN, {}, (Part.COMPUTER,), "stand still"),
    (Fault.BUS_SILENT, {"silent": BOTH}, (Part.BUS,), "Several devices"),
    (Fault.DRIVE_UNASKED, {"silent": BOTH}, (Part.BUS,), "Several devices"),
    (Fault.DRIVE_EMERGENCY, {"bus_reported": True, "lost_share": 0.05, "device": "cylinder"}, (Part.BUS,), "missing"),
    (Fault.SYNC_LOST, {}, (Part.BUS,), "SYNC does not reach"),
    (Fault.BUS_SILENT, {}, (Part.BUS,), "no frames"),
    (Fault.LIMIT, {"text": "error_frames above"}, (Part.BUS,), "error frames"),
    (Fault.LIMIT, {"text": "lateness_us above"}, (Part.COMPUTER,), "late"),
    (Fault.CELL_STALE, {"device": "tension_cell"}, (Part.AMPLIFIER,), "fails to report"),
    (Fault.NODE_NOT_OPERATIONAL, {"device": "inclinometer"}, (Part.INCLINOMETER,), "fails to report"),
    (Fault.DEVICE_RESTARTED, {"booted": frozenset({"cylinder"})}, (Part.DRIVE,), "fails to report"),
    (Fault.SENSOR_EMERGENCY, {"device": "io"}, (Part.IO_NODE,), "fails to report"),
    (Fault.LIMIT_UNSEEN, {"device": "second_force"}, (Part.SECOND_FORCE,), "fails to report"),
    (Fault.DRIVE_UNASKED, {"silent": frozenset({"cylinder"})}, (Part.DRIVE,), "not heard"),
    (Fault.DRIVE_NOT_FOLLOWING, {"causes": frozenset({Fault.E_STOP_UNSEEN})}, (Part.IO_NODE,), "enable has gone"),
    (Fault.ENABLE_IGNORED, {}, (Part.IO_NODE,), "does not act"),
    (Fault.DRIVE_NOT_FOLLOWING, {"causes": frozenset({Fault.SUPERVISION_LOST})}, (Part.DRIVE,), "setting"),
    (Fault.STROKE_JUMPED, {}, (Part.ENCODER,), "jumped"),
    (Fault.ENCODER_STUCK, {"unanswered": True}, (Part.DRIVE,), "no answer to a command"),
    (Fault.DRIVE_NOT_FOLLOWING, {"speed_noise_mm_s": 5.0}, (Part.ENCODER,), "noise"),
    (Fault.DRIVE_NOT_FOLLOWING, {"powered": False}, (Part.DRIVE,), "not in operation"),
    (Fault.DRIVE_NOT_FOLLOWING, {"position_mm_s": 1.4, "command_mm_s": 1.4}, (Part.ENCODER,), "contradict"),
    (Fault.DRIVE_NOT_FOLLOWING, {"command_mm_s": 2.0, "stretch_mm_s": 2.1}, (Part.ENCODER,), "follows the commands"),
    (Fault.DRIVE_NOT_FOLLOWING, {"command_mm_s": 2.0}, (Part.DRIVE, Part.ENCODER), "or it follows them"),
    (Fault.DRIVE_NOT_FOLLOWING, {"command_mm_s": 2.0, "stretch_mm_s": -4.0}, (Part.DRIVE, Part.BRAKE), "does not move"),
    (Fault.DRIVE_NOT_FOLLOWING, {"speed_mm_s": -1.4, "position_mm_s": -1.5}, (Part.DRIVE,), "moves at -1.4"),
    (Fault.DRIVE_NOT_FOLLOWING, {"command_mm_s": 5.1, "speed_mm_s": 5.1, "position_mm_s": 6.4},
     (Part.ENCODER,), "speed is"),
    (Fault.DRIVE_NOT_FOLLOWING, {"command_mm_s": 1.9, "speed_mm_s": 1.0, "position_mm_s": 1.0},
     (Part.DRIVE, Part.BRAKE), "motor or brake"),
    (Fault.STROKE_MOVES, {"gone_mm": -0.1, "unexplained_mm": 0.1}, (Part.ENCODER,), "does not show it"),
    (Fault.DRIVE_UNASKED, {"off_with_a": 0.6}, (Part.DRIVE,), "off while its motor carries 0.60 A"),
    (Fault.DRIVE_UNASKED, {}, (Part.MASTER, Part.DRIVE), "without this program's command"),
    (Fault.DRIVE_REFUSES, {}, (Part.DRIVE, Part.MASTER), "as commanded"),
    (Fault.DRIVE_FAULT, {}, (Part.DRIVE,), "fault of its own"),
    (Fault.ENCODER_STUCK, {}, (Part.ENCODER,), "does not show"),
    (Fault.STROKE_MOVES, {}, (Part.BRAKE,), "lets the load down"),
    (Fault.STROKE_MOVES, {"before_n": 0.1, "after_n": -0.1}, (Part.ENCODER, Part.BRAKE), "no load moves it"),
    (Fault.POSITION_DRIFTS, {}, (Part.ENCODER, Part.DRIVE), "correction"),
    (Fault.STROKE_NOT_HELD, {"position_mm_s": 5.0}, (Part.ENCODER,), "left its place by 5.0 mm/s"),
    (Fault.STROKE_NOT_HELD, {}, (Part.DRIVE, Part.BRAKE), "left its place"),
    (Fault.LIMIT, {"tilt_step_deg": 20.0}, (Part.INCLINOMETER,), "jumped by 20.0"),
    (Fault.LIMIT, {"text": "tangential_deg above", "tilt_deg": 5.2}, (Part.INCLINOMETER, Part.PAYLOAD), "5.2 degrees"),
    (Fault.INCLINATION_INVALID, {}, (Part.INCLINOMETER,), "cannot measure"),
    (Fault.CELL_NOISY, {"crowd": 1.4, "step_n": 150.0}, (Part.MASTER,), "another device"),
    (Fault.FORCES_DISAGREE, {}, (Part.CELL, Part.SECOND_FORCE), "disagree"),
    (Fault.CELL_INVALID, {}, (Part.AMPLIFIER,), "no valid value"),
    (Fault.CELL_STUCK, {}, (Part.AMPLIFIER,), "repeats"),
    (Fault.LIMIT, {"after_n": -300.0, "least_n": -300.0, "step_n": 600.0}, (Part.AMPLIFIER,), "cannot push"),
    (Fault.LIMIT, GONE | {"fall_ms": 1.0}, (Part.CELL,), "motor still carries about 300 N"),
    (Fault.CELL_NOISY, {"step_n": 50.0}, (Part.CELL,), "noise"),
    (Fault.LIMIT, {"after_n": 220.0, "step_n": 80.0}, (Part.CELL,), "80 N from one sample"),
    (Fault.LIMIT, GONE | {"current_n": 0.0}, (Part.ROPE,), "carries nothing"),
    (Fault.CELL_STUCK, GONE | {"current_n": NAN}, (Part.ROPE, Part.CELL), "cell's cable"),
    (Fault.STRETCH_UNEXPLAINED, {"stretch_mm_s": -0.5, "command_mm_s": -0.3}, (Part.ENCODER,), "follows the commands"),
    (Fault.STRETCH_UNEXPLAINED, {"stretch_mm_s": -5.0, "later_mm_s": 0.0}, (Part.DRIVE,), "until the drive was off"),
    (Fault.LIMIT, {"stretch_mm_s": -30.0}, (Part.ROPE, Part.PAYLOAD), "falls"),
    (Fault.STRETCH_UNEXPLAINED, {"stretch_mm_s": -2.0}, (Part.ROPE, Part.CELL), "falls"),
    (Fault.STROKE_END, {"mode": Mode.TENSIONING}, (Part.ROPE,), "too long"),
    (Fault.STROKE_END, {}, (Part.PAYLOAD,), "further than"),
    (Fault.LOAD_UNSEEN, {"text": "22.5 N by the motor's current, 0.0 N by the cell"}, (Part.CELL,), "does not show"),
    (Fault.LOAD_UNSEEN, {"gone_mm": 4.5, "unexplained_mm": -4.5}, (Part.ROPE, Part.CELL), "shortened"),
    (Fault.LOAD_UNSEEN, {"gone_mm": -4.5, "unexplained_mm": 4.5}, (Part.PAYLOAD, Part.CELL), "paid out"),
    (Fault.LIMIT, {"stretch_mm_s": 30.0, "after_n": 480.0, "current_n": 450.0}, (Part.PAYLOAD,), "caught"),
    (Fault.LIMIT, {"stretch_mm_s": 30.0}, (Part.PAYLOAD, Part.CELL), "rises"),
    (Fault.SIGN_CELL, {}, (Part.CELL,), "do not fit"),
    (Fault.ROPE_CHANGED, {}, (Part.ROPE,), "lost"),
    (Fault.TENSION_LOW, {}, (Part.ROPE, Part.CELL), "reads too little"),
    (Fault.LOAD_SINKS, {}, (Part.BRAKE, Part.PAYLOAD), "closed brake"),
    *((fault, {}, (fault.part,), "words") for fault in Fault if fault.part is not None),
]  # fmt: skip


def picked(fault: Fault, shown: dict[str, Any]) -> Clue | None:
    found = replace(HEALTHY, fault=fault, **({"text": ""} if fault is not Fault.LIMIT else {}) | shown)
    return next((row for row in TABLE if row.matches(found)), None)


def says(row: Clue, found: Residuals) -> str:
    names = {name: getattr(found, name) for name in found.__dataclass_fields__} | {"fault_words": "words"}
    return row.says.format(**names)


@pytest.mark.parametrize(
    ("fault", "shown", "parts", "words"), SHOWN, ids=lambda x: x.name if isinstance(x, Fault) else ""
)
def test_a_sign_names_its_part(fault: Fault, shown: dict[str, Any], parts: tuple[Part, ...], words: str) -> None:
    row = picked(fault, shown)
    assert row is not None
    assert (row.part, *([row.second] if row.second else [])) == parts
    assert words in says(row, replace(HEALTHY, fault=fault, **shown))


def test_every_row_is_picked_by_some_sign() -> None:
    used = [picked(fault, shown) for fault, shown, *_ in SHOWN]
    assert [row.says for row in TABLE if row not in used] == []


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.says[:40])
def test_a_row_has_a_question_where_it_has_two_parts_and_a_first_step(row: Clue) -> None:
    assert bool(row.second) == bool(row.question)
    assert not row.question or row.question.endswith("?")
    assert row.first.endswith(".")
    touched = {row.part, row.second}
    if touched & (AT_THE_LOAD | LOAD_IS_LOOSE):
        assert row.first.startswith(("Keep out", "Bring")) or "Keep out" in row.first, "somebody is sent to the load"


@pytest.mark.parametrize("fault", list(Fault)[1:], ids=lambda fault: fault.name)
def test_a_fault_without_a_record_is_not_taken_for_a_loose_rope_or_a_cell_that_is_wrong(fault: Fault) -> None:
    """Where nothing is known but the fault, only rows whose fault says it all may match."""
    blind = Residuals(fault, "", None, frozenset(), 6.0, 5.0)
    row = next((row for row in TABLE if row.matches(blind)), None)
    assert row is None or fault in row.faults or row.shows(blind)
    if fault in (Fault.LIMIT, Fault.INNOVATION, Fault.STRETCH_UNEXPLAINED, Fault.LOAD_UNSEEN):
        assert row is None


def test_a_broken_rope_is_never_the_amplifiers_even_where_it_reads_one_value() -> None:
    """The tension falls to 0 within some ms, then reads a constant zero: CELL_STUCK is what trips."""
    for current_n in (0.0, NAN, 20.0):
        row = picked(Fault.CELL_STUCK, GONE | {"current_n": current_n})
        assert row is not None
        assert row.part is Part.ROPE
        assert "Keep out" in row.first
