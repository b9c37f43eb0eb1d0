"""The ``limits`` section of a rig file: further rows of the safety table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require
from rigctl.model.signals import WATCHED

ModeName = Literal["DISARMED", "HOLD", "TENSIONING", "COMPENSATING", "RELEASING", "FAULT"]
if TYPE_CHECKING:
    SignalName = str
else:
    SignalName = Literal[tuple(WATCHED)]


class LimitSettings(Settings):
    """One limit. All but ``log`` latch a fault; ``power_off`` stops first, if the drive follows commands."""

    signal: SignalName
    low: float | None = Field(default=None, description="lowest value allowed")
    high: float | None = Field(default=None, description="highest value allowed")
    rate: float | None = Field(
        default=None, gt=0, description="highest rate of change, per second, low-passed by 20 ms"
    )
    persistence_ms: int = Field(default=0, ge=0, le=3_600_000, description="how long it must be passed")
    action: Literal["log", "ramp_down", "hold", "quick_stop", "power_off"]
    modes: list[ModeName] = Field(
        default=["HOLD", "TENSIONING", "COMPENSATING", "RELEASING"], min_length=1, description="where it is watched"
    )

    @model_validator(mode="after")
    def _bounds_agree(self) -> LimitSettings:
        bounded = any(bound is not None for bound in (self.low, self.high, self.rate))
        require(bounded, "signal", self.signal, "a limit with low, high or rate")
        if self.low is not None and self.high is not None:
            require(self.low < self.high, "low", self.low, f"below high ({self.high:g})")
        return self
