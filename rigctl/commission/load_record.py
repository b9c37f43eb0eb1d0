"""The record of a load's step as it comes from the ring of events."""

from __future__ import annotations

import math
from typing import Any

import numpy.typing as npt

from rigctl.control.excitation.trials import LoadBin
from rigctl.control.logbook import ZERO_C_K
from rigctl.model.events import Kind
from rigctl.model.loop_event import LoopEvent


def bins_of(events: npt.NDArray[Any]) -> list[LoadBin]:
    """Parts of the newest record: of those before its step only the last."""
    found: list[LoadBin] = []
    for event in LoopEvent.of_slots(events[events["kind"] == Kind.LOAD_STEP]):
        fields = event.fields
        kelvin, after_s = fields["cell_mk"] * 1e-3, fields["after_s"]
        if after_s <= 0.0 or (found and after_s < found[-1].after_s):
            found.clear()
        cell_c = kelvin - ZERO_C_K if kelvin else math.nan
        found.append(LoadBin(fields["samples"], fields["mean_n"], _number(fields["rms_n"]), after_s, cell_c))
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
