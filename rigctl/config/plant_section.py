"""The `plant` section of a rig file."""

from __future__ import annotations

from pydantic import Field

from rigctl.config.settings_base import Settings

MECHANISMS_N_MM: tuple[float | None, ...] = (None, 1000.0, 60.0, 20.0, 6.0)
"""The assumed family: stiffnesses of the mechanism, None = rigid (domain notes, "Control facts worth knowing")."""
STIFFNESS_SCALES = (0.8, 1.0, 1.2)
"""The assumed family: stiffness of spring and rope over that of the file."""
FOUND_SHARE = 0.15
"""Error of a stiffness found over 15 N of tension, at most: the mechanism swings meanwhile."""
FOUND_FACTOR = 3.0
"""Error of a stiffness found beyond which no second look is worth it."""


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
        return in_series(self.spring_n_mm, self.rope_n_mm)

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
        return in_series(self.stiffness_n_mm, self.mechanism_n_mm)

    @property
    def found_n_mm(self) -> tuple[float, float]:
        """Least and largest stiffness that the first tensioning may find: that of the assumed family."""
        k, slowest = self.stiffness_n_mm, min(x for x in (*MECHANISMS_N_MM, self.mechanism_n_mm) if x is not None)
        softest = in_series(min(STIFFNESS_SCALES) * k, slowest)
        least = max((1.0 - FOUND_SHARE) * softest, self.slow_stiffness_n_mm / FOUND_FACTOR)
        return least, (1.0 + FOUND_SHARE) * max(STIFFNESS_SCALES) * k


def in_series(one_n_mm: float, other_n_mm: float) -> float:
    """Stiffness of two springs in a chain."""
    return 1.0 / (1.0 / one_n_mm + 1.0 / other_n_mm)
