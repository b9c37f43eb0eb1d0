"""The `recording` section of a rig file."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require


class RecordingSettings(Settings):
    """The continuous recording: everything the rings carry, in parts. Relative to the rig file."""

    enabled: bool = Field(default=True, description="record from the daemon's start to its end")
    folder: str = Field(default="recordings", min_length=1, description="folder of the parts")
    part_mb: int = Field(default=256, ge=1, le=65_536, description="a part is closed at this size, 10^6 bytes ...")
    part_s: int = Field(default=3600, ge=1, le=86_400, description="... or after this time")
    keep_mb: int = Field(default=20_000, ge=2, le=2**30, description="parts of this rig kept, the newest, 10^6 bytes")
    free_mib: int = Field(
        default=1024, ge=1, le=2**30, description="not recorded while less is free: audit log and trip dumps need it"
    )

    @model_validator(mode="after")
    def _keeps_more_than_it_writes(self) -> RecordingSettings:
        least = 2 * self.part_mb
        require(self.keep_mb >= least, "keep_mb", self.keep_mb, f"twice part_mb ({least}) or more")
        return self
