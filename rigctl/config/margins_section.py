"""The `margins` section of a rig file."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from rigctl.config.settings_base import Settings


class MarginsSettings(Settings):
    """Margins measured while COMPENSATING, each minute, by a multisine on the speed command. Off without this section.

    The sensitivity peak Ms counts as too high once it is above ``ms_max`` by more than its uncertainty at 95 %.
    """

    probe_n: float = Field(default=0.2, gt=0, le=10, description="largest change of tension by the multisine")
    ms_max: float | None = Field(
        default=None, gt=1, le=10, description="highest measured sensitivity peak; null = design.ms_max"
    )
    action: Literal["log", "hold"] = Field(default="log", description="above it: only warn, or hold the stroke")
