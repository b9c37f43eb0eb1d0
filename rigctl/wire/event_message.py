"""Slots of the loop's rings as messages for people and programs."""

from __future__ import annotations

import contextlib
import math
from enum import IntEnum
from typing import Any

import numpy as np

from rigctl.model.events import Kind, Worded, worded


def event_message(event: np.void, wall_offset_ns: int) -> tuple[str, dict[str, Any]]:
    """Severity and JSON object of an event; an event of unknown kind is passed on as its numbers."""
    kind, a, b = int(event["kind"]), int(event["a"]), int(event["b"])
    value, limit = float(event["value"]), float(event["limit"])
    text = bytes(event["text"]).decode(errors="replace")
    name, fields = str(kind), dict[str, Any]()
    words = Worded("warning", f"event {kind} (a {a}, b {b}, value {value:g}, limit {limit:g}) {text}".rstrip())
    with contextlib.suppress(ValueError, KeyError, OverflowError):
        row = Kind(kind)
        name, fields = row.name, {field: _in_json(found) for field, found in row.read(a, b, value, limit, text).items()}
        words = worded(kind, a, b, value, limit, text)
    t_ns = int(event["t_ns"])
    return words.severity, {
        "seq": int(event["seq"]), "t_ns": t_ns, "wall_ns": t_ns + wall_offset_ns, "severity": words.severity,
        "source": "loop", "kind": name, "text": words.text, "a": a, "b": b, "value": value, "limit": limit,
        "about": text, "fields": fields,
    }  # fmt: skip


def _in_json(found: Any) -> Any:
    """A field as JSON has it: members of enumerations by name, None for a number that is none."""
    if isinstance(found, IntEnum):
        return found.name
    if isinstance(found, float):
        return float(found) if math.isfinite(found) else None
    return found
