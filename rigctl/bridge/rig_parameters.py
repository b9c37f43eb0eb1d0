"""The rig's settings as flat parameters: ``plant.radius_mm`` and its like, with plain values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_PLAIN = (bool, int, float, str)


def parameters_of(active: Mapping[str, Any]) -> dict[str, Any]:
    """Settings and design of an active configuration by dotted names; what is not set is left out."""
    found = dict(_flat("", active.get("settings") or {}))
    design = active.get("design")
    return found | (dict(_flat("design_in_use.", design)) if isinstance(design, Mapping) else {})


def _flat(before: str, section: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in section.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{before}{name}.", value)
        elif isinstance(value, _PLAIN):
            yield f"{before}{name}", value
        elif isinstance(value, list) and value:
            if all(isinstance(one, _PLAIN) for one in value):
                yield f"{before}{name}", value
            else:
                yield from _flat(f"{before}{name}.", {str(i): one for i, one in enumerate(value)})
