"""The record of a load's step as it comes from the ring of events."""

from __future__ import annotations

import math
from typing import Any

import numpy.typing as npt

from rigctl.control.logbook import ZERO_C_K
from rigctl.control.trials import LoadBin
from rigctl.model.events import Kind


def bins_of(events: npt.NDArray[Any]) -> list[LoadBin]:
    """Parts of the newest record: of those before its step only the last."""
    found: list[LoadBin] = []
    for event in events[events["kind"] == Kind.LOAD_STEP]:
        kelvin, after_s = int(event["b"]) * 1e-3, float(event["limit"])
        text = bytes(event["text"]).rstrip(b"\0").decode(errors="replace")
        if after_s <= 0.0 or (found and after_s < found[-1].after_s):
            found.clear()
        found.append(
            LoadBin(
                int(event["a"]),
                float(event["value"]),
                _number(text),
                after_s,
                kelvin - ZERO_C_K if kelvin else math.nan,
            )
        )
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
