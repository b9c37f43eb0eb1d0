"""A recording as tables for other programs: columns with their units, one table for each topic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from rigctl.ipc.record import Slot
from rigctl.model.signals import NEVER_AGE_NS
from rigctl.recorder.enums import Names, enum_of
from rigctl.recorder.recording import SLOTS, Recording, Said

_SEQ = ("", "sequence number, without gaps")
_WALL = ("ns", "t_ns on the wall clock, since 1970 UTC")
_TIME = ("s", "t_ns after the first record")


@dataclass(frozen=True)
class Column:
    """A quantity: ``values`` are an array or a list of texts; ``unit`` is "" for none.

    ``names``: names of an enumeration's numbers, else None. ``absent``: rows without a value, None if there are none.
    """

    name: str
    unit: str
    description: str
    values: npt.NDArray[Any] | list[str]
    names: Names | None = None
    absent: npt.NDArray[np.bool_] | None = None


def tables(recording: Recording) -> dict[str, list[Column]]:
    """Columns by topic; empty topics are left out."""
    found = {}
    for name, slots in (
        ("records", recording.records), ("frames", recording.frames), ("commands", recording.commands),
        ("holds", recording.holds),
    ):  # fmt: skip
        if len(slots):
            found[name] = _slots(name, slots, recording)
    for topic, items in recording.said.items():
        if items:
            found[topic if topic not in found else f"{topic}_said"] = _said(items, recording)
    return found


def _times(t_ns: npt.NDArray[np.int64], recording: Recording) -> list[Column]:
    return [
        Column("t_s", *_TIME, np.round((t_ns - recording.start_ns) * 1e-9, 9)),
        Column("wall_ns", *_WALL, t_ns + recording.wall_offset_ns),
    ]


def _slots(name: str, slots: npt.NDArray[np.void], recording: Recording) -> list[Column]:
    known = {field.name: (field.unit, field.description) for field in SLOTS[name].fields}
    columns = _times(slots["t_ns"], recording)
    for field in slots.dtype.names or ():
        unit, description = known.get(field, _SEQ if field == "seq" else ("", ""))
        if slots.dtype[field].kind == "S":
            width = slots.dtype[field].itemsize
            rows = np.ascontiguousarray(slots[field]).view(np.uint8).reshape(-1, width)
            columns.append(Column(field, unit, description, rows))
        else:
            columns.append(_column(SLOTS[name], field, unit, description, np.ascontiguousarray(slots[field])))
    return columns


def _column(slot: Slot, field: str, unit: str, description: str, values: npt.NDArray[Any]) -> Column:
    named = enum_of(slot, field)
    absent = values > NEVER_AGE_NS if field.endswith("_age_ns") else None
    return Column(field, unit, description, values, named[1] if named is not None else None, absent)


def _said(items: list[Said], recording: Recording) -> list[Column]:
    t_ns = np.array([item.t_ns for item in items], np.int64)
    return [
        *_times(t_ns, recording),
        Column("seq", *_SEQ, np.array([item.seq for item in items], np.int64)),
        Column("t_ns", "ns", "CLOCK_MONOTONIC", t_ns),
        Column("what", "", "kind", [item.what for item in items]),
        Column("who", "", "operator, empty for none", [item.who for item in items]),
        Column("text", "", "in words", [item.text for item in items]),
        Column("details", "", "JSON", [msgspec.json.encode(item.details).decode() for item in items]),
    ]
