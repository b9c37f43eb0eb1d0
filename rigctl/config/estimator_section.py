"""The `estimator` section of a rig file."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require


class EstimatorSettings(Settings):
    """Noise the Kalman filter assumes beside the cell's (spectral densities: per square root of a second)."""

    speed_noise_mm_s: float = Field(gt=0, le=100, description="drive speed measurement, rms")
    cell_noise_scale: float = Field(default=1.0, gt=0, le=1000, description="cell noise assumed / tension_cell.noise_n")
    tension_walk_n: float = Field(gt=0, le=1000, description="process noise of tension, N/sqrt(s)")
    speed_walk_mm_s: float = Field(gt=0, le=1000, description="process noise of drive speed, mm/s/sqrt(s)")
    disturbance_walk_mm_s: float = Field(
        gt=0, le=10_000, description="process noise of disturbance speed, mm/s/sqrt(s)"
    )
    quiet_tension_walk_n: float | None = Field(
        default=None, gt=0, le=1000, description="tension_walk_n while the innovations are small, null = the same"
    )
    quiet_disturbance_walk_mm_s: float | None = Field(
        default=None, gt=0, le=10_000, description="the same of disturbance_walk_mm_s"
    )
    swing_hz: float | None = Field(
        default=None, gt=0, le=10, description="swing of the rope's stretch, as a state of the filter; null = none"
    )
    swing_damping: float = Field(default=0.05, ge=0.001, le=0.9, description="damping ratio of that swing")
    swing_walk_mm_s: float = Field(
        default=0.1, gt=0, le=1000, description="process noise of that swing's speed, mm/s/sqrt(s)"
    )
    open_window_ms: float = Field(
        default=100.0, ge=1, le=10_000, description="time constant of the mean innovation that opens a quiet filter"
    )
    open_sigma: float = Field(
        default=4.0,
        ge=1,
        le=100,
        description="of that mean, at which the filter begins to open; open at 1.4 times that",
    )
    quiet_after_ms: float = Field(default=500.0, ge=1, le=60_000, description="time constant of becoming quiet again")
    gate_sigma: float = Field(default=5.0, ge=3, le=10, description="innovations beyond this many sigma are left out")
    gate_speed_mm_s: float = Field(
        default=20.0, gt=0, le=1000, description="burst of disturbance speed the gate allows for, one sigma"
    )
    reject_limit: int = Field(default=20, ge=2, le=1000, description="consecutive rejects of a sensor that are a fault")
    inclination_noise_deg: float = Field(default=0.006, gt=0, le=10, description="inclinometer noise, rms")
    inclination_walk_deg_s: float = Field(
        default=0.3, gt=0, le=100, description="process noise of the rope's angular rate, deg/s/sqrt(s)"
    )
    inclination_swing_hz: float | None = Field(
        default=None,
        gt=0,
        le=10,
        description="the rope's swing, to lead its stretch by the drive's lag; null = no lead",
    )
    inclination_swing_walk_deg: float = Field(
        default=0.06, gt=0, le=100, description="process noise of the angle about which it swings, deg/sqrt(s)"
    )
    inclination_lag_ms: float = Field(
        default=8.0, ge=0.1, le=1000, description="time constant of the inclinometer's low-pass"
    )

    @model_validator(mode="after")
    def _one_swing(self) -> EstimatorSettings:
        if self.swing_hz is not None:
            require(self.inclination_swing_hz is None, "swing_hz", self.swing_hz, "null beside inclination_swing_hz")
        return self

    @property
    def adapts(self) -> bool:
        """There is a quiet setting beside the open one."""
        return self.quiet_tension_walk_n is not None or self.quiet_disturbance_walk_mm_s is not None
