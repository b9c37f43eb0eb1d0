"""The `cylinder` section of a rig file."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.canopen import VELOCITY_ACTUAL, VELOCITY_ACTUAL_16
from rigctl.config.settings_base import CanopenDevice, Hexadecimal, NodeId, PdoNumber, Waiver, require

_LARGEST_RAW = 2**31 - 1  # 0x6064, 0x60FF are INTEGER32
_LARGEST_UNSIGNED = 2**32 - 1  # 0x6085 is UNSIGNED32


class CylinderSettings(CanopenDevice):
    """Electric cylinder's drive, CiA 402, cyclic synchronous velocity."""

    node: NodeId = 4
    eds: str = Field(default="eds/cylinder_drive.eds", description="EDS file, relative to the rig file")
    heartbeat_timeout_ms: int = Field(ge=10, le=1000, description="drive's consumer heartbeat time (0x1016)")
    command_deadline_ms: int = Field(ge=5, le=1000, description="drive's RPDO deadline (0x1400:05)")
    stop_deceleration_mm_s2: float = Field(gt=0, le=10_000, description="quick stop deceleration (0x6085)")
    brake_delay_ms: int = Field(
        default=100, ge=0, le=1000, description="time the brake takes to close; no arming before it has passed"
    )
    brake_test: bool = Field(
        default=True, description="arming a loaded rope waits 2 s on the closed brake, the stroke must not move"
    )
    brake_waiver: Waiver = Field(
        default=None, description="why the cylinder needs no holding brake, in words; null = it has one"
    )
    stroke_min_mm: float = Field(ge=-2000, le=2000, description="lowest stroke commanded (positive = shorter rope)")
    stroke_max_mm: float = Field(ge=-2000, le=2000, description="highest stroke commanded")
    status_rate_hz: int | None = Field(
        default=None, ge=5, le=100, description="current, temperature, inputs, at least so often; null = not asked for"
    )
    rated_current_a: float | None = Field(
        default=None, gt=0, le=1000, description="motor's, as its drive has it (0x6075); needed with status_rate_hz"
    )
    force_per_ampere_n: float | None = Field(
        default=None, gt=0, le=1e6,
        description="rope force per ampere of motor current (rigctl identify), which then shows a slack rope that gets "
        "tight and a cell of wrong scale; null = the cell alone does",
    )  # fmt: skip
    rated_force_n: float | None = Field(
        default=None, gt=0, le=1e6, description="rope force at rated torque (0x6076), for a preload; null = no preload"
    )
    e_stop_input: int | None = Field(
        default=None, ge=0, le=31, description="bit of the digital inputs (0x60FD), 0 = pressed; null = none fitted"
    )
    absolute_encoder: bool = Field(
        default=True, description="keeps its position without power; false = the stroke is confirmed at every start"
    )
    stroke_waiver: Waiver = Field(
        default=None, description="why a start may arm on a stroke that is not the last known, in words"
    )

    position_pdo: PdoNumber = Field(default=1, description="TPDO with statusword and position (0x6041, 0x6064)")
    velocity_pdo: PdoNumber = Field(default=1, description="TPDO with velocity_object")
    status_pdo: PdoNumber = Field(default=2, description="TPDO with current, temperature, inputs")
    velocity_object: Hexadecimal = Field(
        default=VELOCITY_ACTUAL_16,
        description='"0x2044" (16 bits, 10 um/s) or "0x606C" (32 bits, in another TPDO)',
    )
    temperature_object: Hexadecimal | None = Field(
        default=0x2045, ge=0x2000, lt=0x6000, description="drive temperature, 16 bits, 0.1 deg C; null = it has none"
    )
    increments_per_mm: float | None = Field(
        default=None, ge=100, le=1e7, description="position units (0x6064) per mm; null = by lead_mm or 0x60A8"
    )
    lead_mm: float | None = Field(
        default=None, gt=0, le=1000, description="stroke per turn of the shaft: scale by 0x6092; null = not by it"
    )
    speed_units_per_mm_s: float | None = Field(
        default=None, ge=20, le=1e7, description="units of 0x606C, 0x60FF per mm/s; null = as position, or 0x60A9"
    )
    ramp_units_per_mm_s2: float | None = Field(
        default=None, ge=0.1, le=1e7, description="units of 0x6085 per mm/s2; null = as speed"
    )

    @model_validator(mode="after")
    def _values_fit_their_frames(self) -> CylinderSettings:
        known = self.velocity_object in (VELOCITY_ACTUAL_16, VELOCITY_ACTUAL)
        require(known, "velocity_object", f"0x{self.velocity_object:X}", "0x2044 or 0x606C")
        wide, position = self.velocity_object == VELOCITY_ACTUAL, self.position_pdo
        fits = not wide or self.velocity_pdo != position
        allowed = f"another than position_pdo ({position}): status, position and 0x606C are 10 bytes"
        require(fits, "velocity_pdo", self.velocity_pdo, allowed)
        own = self.status_rate_hz is None or self.status_pdo not in (position, self.velocity_pdo)
        require(own, "status_pdo", self.status_pdo, "a PDO of its own")
        if self.increments_per_mm is not None:
            farthest = max(abs(self.stroke_min_mm), abs(self.stroke_max_mm))
            most = _LARGEST_RAW / farthest if farthest else _LARGEST_RAW
            found = self.increments_per_mm
            require(found <= most, "increments_per_mm", found, f"up to {most:g}: the stroke's end fits in 32 bits")
        key, units = self.ramp_units
        if units is not None:
            most = _LARGEST_UNSIGNED / self.stop_deceleration_mm_s2
            require(units <= most, key, units, f"up to {most:g}: stop_deceleration_mm_s2 fits in 32 bits (0x6085)")
        return self

    @property
    def speed_units(self) -> tuple[str, float | None]:
        """The key that gives the units of speed per mm/s, and them; None: the drive gives them at the start."""
        if self.speed_units_per_mm_s is not None:
            return "speed_units_per_mm_s", self.speed_units_per_mm_s
        return "increments_per_mm", self.increments_per_mm

    @property
    def ramp_units(self) -> tuple[str, float | None]:
        """The same of the ramp, per mm/s2."""
        if self.ramp_units_per_mm_s2 is not None:
            return "ramp_units_per_mm_s2", self.ramp_units_per_mm_s2
        return self.speed_units

    @model_validator(mode="after")
    def _stroke_has_length(self) -> CylinderSettings:
        low, high = self.stroke_min_mm, self.stroke_max_mm
        require(low < high, "stroke_min_mm", low, f"below stroke_max_mm ({high:g})")
        return self

    @model_validator(mode="after")
    def _brake_that_is_tested(self) -> CylinderSettings:
        allowed = "false with brake_waiver: there is no brake to test"
        require(not (self.brake_test and self.brake_waiver is not None), "brake_test", self.brake_test, allowed)
        return self

    @model_validator(mode="after")
    def _status_is_complete(self) -> CylinderSettings:
        rate, current, stop = self.status_rate_hz, self.rated_current_a, self.e_stop_input
        require(rate is None or current is not None, "rated_current_a", current, "a current, with status_rate_hz")
        require(rate is not None or stop is None, "e_stop_input", stop, "none without status_rate_hz")
        force_n = self.force_per_ampere_n
        require(rate is not None or force_n is None, "force_per_ampere_n", force_n, "null without status_rate_hz")
        return self
