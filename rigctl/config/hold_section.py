"""The `hold` section of a rig file."""

from __future__ import annotations

from pydantic import Field

from rigctl.config.settings_base import Settings


class HoldSettings(Settings):
    """HOLD ends on the brake: the motor holds a stroke at standstill for so long, then the drive goes off."""

    park_s: float = Field(
        default=2.0,
        ge=0.5,
        le=30,
        description="standstill in HOLD before the brake takes the load and the drive is off",
    )
