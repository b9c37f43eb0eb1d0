"""The `design` section of a rig file."""

from __future__ import annotations

from pydantic import Field

from rigctl.config.settings_base import Settings, Waiver


class DesignSettings(Settings):
    """Weights of the linear-quadratic design and the robustness it must show."""

    stretch_weight: float = Field(gt=0, le=1e9, description="cost of tension error as stretch, 1/mm^2")
    integral_weight: float = Field(gt=0, le=1e9, description="cost of that stretch's integral, 1/(mm s)^2")
    command_weight: float = Field(gt=0, le=1e9, description="cost of commanded speed about the feed-forward, s^2/mm^2")
    ms_max: float = Field(default=1.6, gt=1, le=10, description="highest sensitivity peak over the family")
    command_noise_max_mm_s: float = Field(
        default=0.5,
        gt=0,
        le=100,
        description="rms of the command from the cell's noise that an optimised design may have",
    )
    waiver: Waiver = Field(default=None, description="why a design above ms_max may run, in words")
    gains_file: str | None = Field(default=None, min_length=1, description="from `rigctl tune --gains`, null = none")
    identify_days: int = Field(default=180, ge=1, le=3650, description="an identification is believed for this long")
    identified_error_factor: float = Field(
        default=2.0,
        ge=1,
        le=10,
        description="family about an identified plant: times the 95 % uncertainty, at least ...",
    )
    identified_stiffness_pct: float = Field(default=3.0, ge=0, le=50, description="... this share of the stiffness")
    identified_lag_pct: float = Field(default=10.0, ge=0, le=80, description="... this share of the drive's lag")
    identified_delay_ms: float = Field(default=0.5, ge=0, le=50, description="... this much of the drive's delay")
    identified_mechanism_pct: float = Field(default=20.0, ge=0, le=80, description="... this share of K_m")
    identified_damping_pct: float = Field(
        default=50.0, ge=0, le=100, description="... this share of the loss of spring and rope"
    )
