"""The rail's sections of a rig file: its encoder, and the run-out of the wheel on it."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.settings_base import CanopenDevice, NodeId, Settings, require


class RailEncoderSettings(CanopenDevice):
    """Absolute encoder on the rail's shaft, CiA 406. The rig runs without one."""

    node: NodeId = 5
    eds: str = Field(default="eds/rail_encoder.eds", description="EDS file, relative to the rig file")
    counts_per_turn: int = Field(ge=256, le=2**31, description="measuring units per revolution (0x6001)")
    rate_hz: int = Field(ge=10, le=4000, description="sample rate; a divisor of the loop's")


class RunOutSettings(Settings):
    """Table of the rail's run-out against its angle, learned move by move. Needs `rail_encoder`."""

    angle_min_deg: float = Field(ge=-360, le=360, description="where the table begins, as the encoder counts")
    angle_max_deg: float = Field(ge=-360, le=360, description="where it ends")
    bins: int = Field(ge=4, le=360, description="equal parts of it, each with a slope of its own")
    learning_rate: float = Field(gt=0, le=1, description="share of what is still found in a pass that is learnt")
    min_speed_deg_s: float = Field(default=0.1, ge=0.01, le=5, description="a slower rail teaches nothing")

    @model_validator(mode="after")
    def _fits_in_a_turn(self) -> RunOutSettings:
        low, high = self.angle_min_deg, self.angle_max_deg
        require(low < high, "angle_min_deg", low, f"below angle_max_deg ({high:g})")
        most = 360.0 * self.bins / (self.bins + 1)
        require(high - low <= most, "angle_max_deg", high, f"up to {most:g} above angle_min_deg (a turn less one bin)")
        return self
