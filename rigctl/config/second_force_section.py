"""The `second_force` section of a rig file: a second way to the rope's tension, compared and fused with the cell's."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from rigctl.config.settings_base import CanopenDevice, require

EDS = {"cell": "eds/tension_amplifier.eds", "stretch": "eds/stretch_encoder.eds"}


class SecondForceSettings(CanopenDevice):
    """A second cell in the same rope (CiA 404), or the stretch of the series spring (CiA 406).

    ``stretch``: a linear encoder below the spring counts up as the rope shortens there; the drive's stroke is the
    encoder above. Needs `calibration`: zero comes with each tare, scale with each adopted calibration.
    """

    kind: Literal["cell", "stretch"] = Field(description="cell: N; stretch: stroke above less encoder below, mm")
    node: int = Field(default=6, ge=1, le=127, description="CANopen node id")
    eds: str = Field(default="", description="EDS file, relative to the rig file; empty = the one of its kind")
    rate_hz: int = Field(default=50, ge=1, le=4000, description="sample rate; a divisor of the loop's")
    spring_n_mm: float | None = Field(
        default=None, gt=0, le=10_000, description="stretch: of the spring between the encoders, before its calibration"
    )
    counts_per_mm: float = Field(default=1000.0, ge=10, le=1e6, description="stretch: the encoder's, checked at start")
    zero_n: float | None = Field(
        default=None, ge=-1e9, le=1e9, description="its zero before the first tare; null = it arms only after a tare"
    )
    u_n: float = Field(gt=0, le=1000, description="expanded uncertainty (k = 2) of its tension at the target")
    cell_u_n: float = Field(gt=0, le=1000, description="the same of the cell's, as rigctl report states it")
    noise_um: float = Field(default=1.0, gt=0, le=100, description="stretch: rms noise of the encoder below the spring")
    quick_hz: float | None = Field(
        default=None, ge=0.5, le=100,
        description="stretch at the loop's rate: above this it takes noise off the cell; null = the cell alone",
    )  # fmt: skip
    fuse_s: float = Field(default=5.0, ge=0.5, le=1000, description="time constant of the fusion")
    disagree_n: float = Field(
        gt=0, le=1000, description="largest difference of the two, low-passed by 1 s; beyond: HOLD"
    )
    stale_ms: int = Field(
        default=500, ge=10, le=60_000, description="older than this it is not used, and an event says so"
    )

    @model_validator(mode="after")
    def _kind_is_whole(self) -> SecondForceSettings:
        stretches = self.kind == "stretch"
        require(
            (self.spring_n_mm is not None) == stretches, "spring_n_mm", self.spring_n_mm, "a value for stretch only"
        )
        quick = self.quick_hz is None or stretches
        require(quick, "quick_hz", self.quick_hz, "null for a cell: only a stretch has less noise than the cell")
        least = 1.5 * (self.u_n**2 + self.cell_u_n**2) ** 0.5
        allowed = f"{least:.3g} N or more: 3 standard uncertainties of the difference"
        require(self.disagree_n >= least, "disagree_n", self.disagree_n, allowed)
        if not self.eds:
            object.__setattr__(self, "eds", EDS[self.kind])  # frozen, and the default follows from the kind
        return self

    @property
    def weight(self) -> float:
        """Of the second path in the fused tension: inverse variances (JCGM 100, weighted mean)."""
        return self.cell_u_n**2 / (self.cell_u_n**2 + self.u_n**2)
