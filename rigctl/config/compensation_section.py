"""The `compensation` section of a rig file: which of the cell's known errors the loop takes out of its reading."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require


class CompensationSettings(Settings):
    """The cell's errors beside zero and scale. Needs `calibration`; the figures come from the ledger.

    Without this section the tension is ``(reading - zero) * scale``.
    """

    creep: bool = Field(default=True, description="take out the creep that is on the ledger (calibrate --creep)")
    temperature: Literal["cell", "drive"] | None = Field(
        default=None, description="whose temperature the zero follows; null = it is held from tare to tare"
    )
    zero_n_k: float | None = Field(
        default=None, ge=-1, le=1, description="change of zero, N per kelvin; null = from the tares on the ledger"
    )
    zero_u_n_k: float | None = Field(
        default=None, ge=0, le=1, description="its expanded uncertainty (k = 2), with zero_n_k"
    )

    @model_validator(mode="after")
    def _coefficient_is_whole(self) -> CompensationSettings:
        both = (self.zero_n_k is None) == (self.zero_u_n_k is None)
        require(both, "zero_u_n_k", self.zero_u_n_k, "an uncertainty with zero_n_k, and none without")
        known = self.zero_n_k is None or self.temperature is not None
        require(known, "zero_n_k", self.zero_n_k, "none without a temperature")
        return self
