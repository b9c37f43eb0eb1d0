"""Base of every section of a rig file."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError


class Settings(BaseModel):
    """Base of every section: unknown keys, wrong types and non-finite numbers are refused; values never change."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def require(agree: bool, key: str, found: object, allowed: str) -> None:
    """Refuse values that are fine alone but not together; ``key`` is dotted, relative to the section."""
    if not agree:
        raise PydanticCustomError("disagree", "{allowed}", {"key": key, "found": found, "allowed": allowed})
