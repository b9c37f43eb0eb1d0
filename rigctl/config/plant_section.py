"""The `plant` section of a rig file."""

from __future__ import annotations

from pydantic import Field

from rigctl.config.settings_base import Settings


class PlantSettings(Settings):
    """The plant as assumed by estimator and design."""

    spring_n_mm: float | None = Field(gt=0, le=10_000, description="series spring, null = none")
    rope_n_mm: float = Field(gt=0, le=100_000, description="rope, axial")
    spring_damping_n_s_mm: float = Field(default=0.0, ge=0, le=100, description="loss in the spring, if there is one")
    rope_damping_n_s_mm: float = Field(default=0.0, ge=0, le=100, description="loss in the rope, axial")
    cylinder_lag_s: float = Field(gt=0, le=1, description="first-order lag of the cylinder's speed")
    command_delay_s: float = Field(ge=0, le=0.1, description="transport delay of the drive")
    rope_length_mm: float = Field(ge=100, le=20_000, description="between the two lifting points")
    radius_mm: float = Field(ge=100, le=20_000, description="mechanism's radius")
    payload_kg: float = Field(ge=0.1, le=1000, description="suspended mass")
    mechanism_n_mm: float | None = Field(default=None, gt=0, le=1e6, description="vertical stiffness, null = rigid")

    @property
    def stiffness_n_mm(self) -> float:
        """Spring and rope in series, equation (17); the rope alone without a spring."""
        if self.spring_n_mm is None:
            return self.rope_n_mm
        return 1.0 / (1.0 / self.spring_n_mm + 1.0 / self.rope_n_mm)

    @property
    def damping_n_s_mm(self) -> float:
        """Loss of spring and rope in series: each part's loss counts by the square of its share of the stretch."""
        if self.spring_n_mm is None:
            return self.rope_damping_n_s_mm
        k = self.stiffness_n_mm
        by_spring = self.spring_damping_n_s_mm * (k / self.spring_n_mm) ** 2
        return by_spring + self.rope_damping_n_s_mm * (k / self.rope_n_mm) ** 2

    @property
    def slow_stiffness_n_mm(self) -> float:
        """What a slow stroke meets: spring, rope and mechanism in series."""
        if self.mechanism_n_mm is None:
            return self.stiffness_n_mm
        return 1.0 / (1.0 / self.stiffness_n_mm + 1.0 / self.mechanism_n_mm)
