"""The culprit that a diagnosis names for a row of the catalogue, against the part that the row states."""

from __future__ import annotations

import pathlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults.expected import InjectedFault
from hil.faults.lockstep_run import Run
from rigctl.config.settings import RigSettings
from rigctl.diagnosis.diagnose import Culprit, diagnose
from rigctl.diagnosis.part import AT_THE_LOAD, LOAD_IS_LOOSE
from rigctl.diagnosis.window import AFTER_NS, BEFORE_NS, around, trips
from rigctl.model.loop_event import LoopEvent
from rigctl.model.parts import Part
from rigctl.model.states import Mode

RIGHT_SHARE, TWO_SHARE = 0.9, 0.2
"""Of the rows that trip: at least so many right or with the right one of two, at most so many with two."""


class Naming(StrEnum):
    """How a culprit was named."""

    RIGHT = "right"
    TWO = "one of two, with the question"
    WRONG = "wrong"
    UNNAMED = "not named"
    SENDS = "wrong, and sends somebody to a loose load"


@dataclass(frozen=True)
class NamedRow:
    """One row: what it states, and what was named first."""

    id: str
    mode: str
    states: tuple[Part, ...]
    named: tuple[Part, ...]
    naming: Naming
    text: str

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "id": self.id, "mode": self.mode, "states": list(map(str, self.states)),
            "named": list(map(str, self.named)), "naming": str(self.naming), "text": self.text,
        }  # fmt: skip


@dataclass(frozen=True)
class RecordedRow:
    """Records and events around the trip of a played row, or none where nothing tripped."""

    records: npt.NDArray[Any]
    events: npt.NDArray[Any]

    @property
    def t_ns(self) -> int:
        """Time of the first trip; 0 without one."""
        found = trips(LoopEvent.of_slots(self.events))
        return found[0].t_ns if found else 0

    def save(self, file: pathlib.Path) -> None:
        """Write both to a file of numpy."""
        np.savez_compressed(file, records=self.records, events=self.events)

    @classmethod
    def load(cls, file: pathlib.Path) -> RecordedRow:
        """Read such a file."""
        with np.load(file) as found:
            return cls(found["records"], found["events"])


def recorded(run: Run, fault: InjectedFault) -> RecordedRow:
    """What a diagnosis sees of a run: its first trip, or its last one where commands are part of the fault."""
    found = trips(LoopEvent.of_slots(run.events))
    if not found:
        return RecordedRow(run.records[:0], run.events[:0])
    trip = found[-1] if fault.ends_elsewhere else found[0]
    records = np.concatenate([run.lead, run.records])
    near = (records["t_ns"] >= trip.t_ns - BEFORE_NS) & (records["t_ns"] <= trip.t_ns + AFTER_NS)
    about = (run.events["t_ns"] >= trip.t_ns - BEFORE_NS) & (run.events["t_ns"] <= trip.t_ns + AFTER_NS)
    return RecordedRow(records[near], run.events[about])


def culprit(row: RecordedRow, settings: RigSettings, *, last: bool = False) -> Culprit | None:
    """The culprit of a recorded row; None where nothing tripped. ``last``: of its last trip instead of the first."""
    events = LoopEvent.of_slots(row.events)
    found = trips(events)
    if not found:
        return None
    return diagnose(around(found[-1] if last else found[0], settings, events, row.records))


def named(fault: InjectedFault, mode: Mode, found: Culprit) -> NamedRow:
    """Judge what was named for a row."""
    return NamedRow(fault.id, mode.name, fault.part, found.parts, naming(found, fault.part), found.text)


def naming(found: Culprit, states: Sequence[Part]) -> Naming:
    """Judge a culprit by the parts that may be named."""
    if not found.parts:
        return Naming.UNNAMED
    if len(found.parts) == 1 and found.parts[0] in states:
        return Naming.RIGHT
    if len(found.parts) == 2 and not set(found.parts).isdisjoint(states) and found.question:
        return Naming.TWO
    sends = found.parts[0] in AT_THE_LOAD and not LOAD_IS_LOOSE.isdisjoint(states)
    return Naming.SENDS if sends else Naming.WRONG


def shares(rows: Sequence[NamedRow]) -> Mapping[Naming, int]:
    """Rows by how they were named."""
    counted = Counter(row.naming for row in rows)
    return {kind: counted[kind] for kind in Naming}


def good(rows: Sequence[NamedRow]) -> bool:
    """Whether the shares are as required."""
    counted, whole = shares(rows), len(rows)
    enough = counted[Naming.RIGHT] + counted[Naming.TWO] >= RIGHT_SHARE * whole
    return enough and counted[Naming.TWO] <= TWO_SHARE * whole and not counted[Naming.SENDS]


def confusion(rows: Sequence[NamedRow]) -> dict[Part, Counter[str]]:
    """For each part that rows state first: how often each part was named first; two candidates as ``A or B``."""
    found: dict[Part, Counter[str]] = {}
    for row in rows:
        right = next((part for part in row.named if part in row.states), None)
        stated = right if right is not None else row.states[0]
        found.setdefault(stated, Counter())[" or ".join(row.named) or "-"] += 1
    return {part: found[part] for part in Part if part in found}
