"""A rig file with a test's own settings laid over it."""

from __future__ import annotations

import copy
import pathlib
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from rigctl.config import rig_file, strict_yaml
from rigctl.config.settings import RigSettings


def laid_over(file: pathlib.Path, change: Mapping[str, object]) -> RigSettings:
    """The settings of ``file`` with other values by dotted key, validated as those of a file.

    Raises:
        ConfigError: the file is not valid.
        ValueError: a key or value is not; one line.
    """
    settings = rig_file.load(file)
    if not change:
        return settings
    data: dict[str, Any] = copy.deepcopy(strict_yaml.read(file).data)
    for key, value in change.items():
        *sections, last = key.split(".")
        place = data
        for section in sections:
            inner = place.setdefault(section, {})
            if not isinstance(inner, dict):
                raise ValueError(f"change: found {key!r}, and {section} is no section")
            place = inner
        place[last] = value
    try:
        found = RigSettings.model_validate({**data, "directory": settings.directory})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(f"change: {where}: {first['msg']}, found {first['input']!r}") from None
    return found.model_copy(update={"plain": settings.plain})
