"""The culprit of a trip: the part, what is wrong, what decides where two are possible, and the first thing to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rigctl.diagnosis.residuals import Residuals, residuals
from rigctl.diagnosis.table import TABLE
from rigctl.diagnosis.window import TripWindow
from rigctl.model.events import Kind
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault, lasting
from rigctl.model.parts import Part


@dataclass(frozen=True)
class Culprit:
    """One part, or two with the question that decides between them; ``follows``: faults that follow from it."""

    parts: tuple[Part, ...]
    text: str
    question: str
    first: str
    follows: tuple[str, ...]

    @property
    def words(self) -> str:
        """In one line: the parts, what is wrong, and the question."""
        line = f"{' or '.join(self.parts)}: {self.text}" if self.parts else self.text
        return f"{line} To decide: {self.question}" if self.question else line

    def as_message(self) -> dict[str, Any]:
        """For the state message and other JSON."""
        return {
            "parts": [str(part) for part in self.parts], "text": self.text, "question": self.question,
            "first": self.first, "follows": list(self.follows),
        }  # fmt: skip


def diagnose(window: TripWindow) -> Culprit:
    """The culprit of a window's trip."""
    found = residuals(window)
    row = next((row for row in TABLE if row.matches(found)), None)
    follows = _follow(window, found)
    words = _words(window, found)
    if row is None:
        return Culprit((), words, "", found.fault.remedy, follows)
    names = {name: getattr(found, name) for name in found.__dataclass_fields__} | {"fault_words": words}
    parts = (row.part,) if row.second is None else (row.part, row.second)
    return Culprit(parts, row.says.format(**names), row.question, row.first, follows)


def _words(window: TripWindow, found: Residuals) -> str:
    trip = window.trip
    if trip.kind == Kind.EXCEPTION:
        return found.text
    return lasting(fault_text(found.fault, trip.fields["value"], trip.fields["limit"], found.text))


def _follow(window: TripWindow, found: Residuals) -> tuple[str, ...]:
    """Names of the causes that came with or after the trip, in their order, the trip's own fault first."""
    names = [found.fault.name]
    for event in window.events:
        fault = event.fields["fault"] if event.kind is Kind.CAUSE else None
        if isinstance(fault, Fault) and event.t_ns >= window.trip.t_ns:
            names.append(fault.name)
    return tuple(dict.fromkeys(names))
