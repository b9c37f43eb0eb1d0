"""Settings with other values, by the keys of the rig file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigctl.config.settings import RigSettings


def changed(settings: RigSettings, values: Mapping[str, object]) -> RigSettings:
    """The settings with some values replaced; nothing is validated, but a list stays one.

    Args:
        settings: a rig's.
        values: by dotted key (``plant.spring_n_mm``); a key may also name a whole section.
    """
    for key, value in values.items():
        settings = _replaced(settings, key.split("."), value)
    return settings


def _replaced(section: Any, path: list[str], value: object) -> Any:
    first, *rest = path
    before = getattr(section, first)
    inner = _replaced(before, rest, value) if rest else value
    if isinstance(before, list) and isinstance(inner, tuple):
        inner = [*inner]
    return section.model_copy(update={first: inner})
