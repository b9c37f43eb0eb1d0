"""States, events and the bridge's own figures as JSON messages, with schemas that Lichtblick and Foxglove read.

Their readers know plain types only, so a value that may be null has the type it has otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

STATE, EVENTS, LOG, BRIDGE = "/state", "/events", "/log", "/bridge"
_LEVELS = {"info": 2, "warning": 3, "error": 4}
"""Level in a ``foxglove.Log`` of each severity."""
_TEXTS: dict[str, Any] = {"type": "array", "items": {"type": "string"}}
_OBJECTS: dict[str, Any] = {"type": "array", "items": {"type": "object", "properties": {}}}
_OF_OBJECTS = ("causes",)


def _property(row: Mapping[str, Any]) -> dict[str, Any]:
    kind = str(row["json"]).rstrip("?")
    unit = f" [{row['unit']}]" if row.get("unit") else ""
    words = {"description": f"{row['description']}{unit}"}
    if kind == "array":
        return {**(_OBJECTS if row["name"] in _OF_OBJECTS else _TEXTS), **words}
    return {"type": kind, **({"properties": {}} if kind == "object" else {}), **words}


def _schema(title: str, rows: Iterable[Mapping[str, Any]]) -> str:
    properties = {row["name"]: _property(row) for row in rows}
    return msgspec.json.encode({"title": title, "type": "object", "properties": properties}).decode()


def state_schema(schema: Mapping[str, Any]) -> str:
    """JSON schema of a state, from the daemon's own."""
    return _schema("rigctl.State", schema["state"]["fields"])


def event_schema(schema: Mapping[str, Any]) -> str:
    """JSON schema of events of all sources, from the daemon's own."""
    rows: dict[str, Mapping[str, Any]] = {}
    for source in schema["events"]["sources"].values():
        rows |= {row["name"]: row for row in source["fields"]}
    return _schema("rigctl.Event", rows.values())


LOG_SCHEMA = msgspec.json.encode({
    "title": "foxglove.Log",
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object", "title": "time",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "level": {"type": "integer", "description": "2 info, 3 warning, 4 error"},
        "message": {"type": "string"},
        "name": {"type": "string", "description": "who says it: loop or gateway"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
    },
}).decode()  # fmt: skip

BRIDGE_ROWS = (
    ("clients", "integer", "", "clients connected"),
    ("dropped_clients", "integer", "", "slow clients disconnected so far"),
    ("received", "integer", "", "records received from the daemon so far"),
    ("lost", "integer", "", "records that the daemon no longer held, so far"),
    ("refused", "integer", "", "messages refused so far because they were no daemon's"),
)
BRIDGE_SCHEMA = _schema(
    "rigctl.Bridge", [dict(zip(("name", "json", "unit", "description"), row, strict=True)) for row in BRIDGE_ROWS]
)


def log_line(event: Mapping[str, Any]) -> bytes:
    """An event as a ``foxglove.Log``."""
    sec, nsec = divmod(int(event["wall_ns"]), 1_000_000_000)
    return msgspec.json.encode({
        "timestamp": {"sec": sec, "nsec": nsec}, "level": _LEVELS.get(str(event["severity"]), 0),
        "message": event["text"], "name": event["source"], "file": "", "line": 0,
    })  # fmt: skip
