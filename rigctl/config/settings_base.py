"""Base of every section of a rig file."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

_HEXADECIMAL = re.compile(r"0x[0-9A-Fa-f]{1,8}\Z")


def _from_hexadecimal(value: object) -> object:
    return int(value, 16) if isinstance(value, str) and _HEXADECIMAL.match(value) else value


_Digits = Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{1,8}$")]
Hexadecimal = Annotated[int, BeforeValidator(_from_hexadecimal, json_schema_input_type=int | _Digits)]
"""A number given in hexadecimal by data sheets: quoted, as strict YAML has no such numbers, or an integer."""
PdoNumber = Annotated[int, Field(ge=1, le=4, description="number of the PDO")]
NodeId = Annotated[int, Field(ge=1, le=127, description="CANopen node id")]
Waiver = Annotated[str, Field(min_length=10)] | None
"""Why the rig may go without what the rig file otherwise demands, in words; null = it does not."""


class Settings(BaseModel):
    """Base of every section: unknown keys, wrong types and non-finite numbers are refused; values never change."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class CanopenDevice(Settings):
    """Settings of every CANopen device."""

    sdo_timeout_ms: int = Field(default=300, ge=20, le=10_000, description="longest time to an SDO answer")
    vendor: Hexadecimal | None = Field(default=None, ge=0, lt=2**32, description="0x1018:01, null = any")
    product: Hexadecimal | None = Field(default=None, ge=0, lt=2**32, description="0x1018:02, null = any")


def require(agree: bool, key: str, found: object, allowed: str) -> None:
    """Refuse values that are valid alone but not together; ``key`` is dotted, relative to the section."""
    if not agree:
        raise PydanticCustomError("disagree", "{allowed}", {"key": key, "found": found, "allowed": allowed})
