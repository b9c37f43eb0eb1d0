"""The `simulation` section of a rig file: the rig as built, with its imperfections. Only `python -m hil` reads it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require


class FrictionSettings(Settings):
    """One friction pair: proportional to the rope's load, with stiction, Stribeck transition and a viscous part."""

    friction_static: float = Field(ge=0, le=1, description="coefficient at rest; break-away at atan of it")
    friction_dynamic: float = Field(ge=0, le=1, description="coefficient when sliding")
    stribeck_mm_s: float = Field(gt=0, le=1000, description="speed of the transition from static to dynamic")
    viscous_n_s_m: float = Field(ge=0, le=10_000, description="damping, as seen at the pulley")

    @model_validator(mode="after")
    def _falls(self) -> FrictionSettings:
        low, high = self.friction_dynamic, self.friction_static
        require(low <= high, "friction_dynamic", low, f"at most friction_static ({high:g})")
        return self


class RailSettings(FrictionSettings):
    """The guide rail on its vertical shaft, and how it was mounted."""

    mass_kg: float = Field(ge=0.1, le=1000, description="moment of inertia about the shaft / radius squared")
    eccentricity_normal_mm: float = Field(
        default=0.0, ge=-100, le=100, description="shaft from the mechanism's axis, along its normal at angle 0"
    )
    eccentricity_tangential_mm: float = Field(
        default=0.0, ge=-100, le=100, description="shaft from the mechanism's axis, along its tangent at angle 0"
    )
    slope_mm_m: float = Field(default=0.0, ge=-50, le=50, description="level along the rail, rising outwards")


class PulleySettings(FrictionSettings):
    """The pulley on the rail, with the parts that hang from it above the spring."""

    mass_kg: float = Field(ge=0.05, le=100, description="pulley, cylinder and sensors")
    rest_share: float = Field(
        default=0.0, ge=-1, le=1, description="place at first, outwards of plumb, of the farthest its friction holds"
    )


class RopeSettings(Settings):
    """Rope and spring beyond the settings of `plant`."""

    damping_n_s_mm: float | None = Field(
        default=None,
        ge=0,
        le=100,
        description="D_l of equation (14), spring and rope as one; null = the losses of `plant`",
    )
    slack_mm: float = Field(ge=0, le=500, description="rope left slack at stroke 0")
    mass_kg: float = Field(default=0.0, ge=0, le=10, description="rope")
    elements: int = Field(default=1, ge=1, le=32, description="1 = straight rope, more = it vibrates across its length")
    node_damping_n_s_m: float = Field(default=0.0, ge=0, le=100, description="damping of that vibration, per node")

    @model_validator(mode="after")
    def _nodes_have_mass(self) -> RopeSettings:
        require(self.elements == 1 or self.mass_kg > 0, "elements", self.elements, "1 for a rope without mass_kg")
        return self


class MechanismSettings(Settings):
    """How the mechanism carries the payload, per axis; null = rigid: the motion is prescribed, as in the paper."""

    tangential_n_mm: float | None = Field(default=None, gt=0, le=1e6, description="stiffness, null = rigid")
    normal_n_mm: float | None = Field(default=None, gt=0, le=1e6, description="stiffness, null = rigid")
    vertical_n_mm: float | None = Field(default=None, gt=0, le=1e6, description="stiffness, null = rigid")
    damping_ratio: float = Field(default=0.02, ge=0, le=2, description="of the payload on each of these")


class DriveSettings(Settings):
    """Cylinder and drive."""

    brake_ms: int = Field(ge=0, le=2000, description="time the drive waits for the brake to open or to close")
    brake_open_ms: int | None = Field(
        default=None, ge=0, le=2000, description="time the brake itself takes to open, null = brake_ms"
    )
    brake_close_ms: int | None = Field(
        default=None, ge=0, le=2000, description="time the brake itself takes to close, null = brake_ms"
    )
    speed_loop_hz: float | None = Field(
        default=None, ge=1, le=1000, description="bandwidth of the drive's speed controller; null = it never yields"
    )
    moved_kg: float = Field(default=80.0, gt=0, le=1e5, description="mass of rotor and screw as seen by the rope")
    torque_ms: float = Field(
        default=0.0, ge=0, le=1000, description="time in which its torque builds up once the motor has current"
    )
    preload_error_pct: float = Field(
        default=0.0, ge=-50, le=50, description="of the torque offset (0x60B2), how much less the motor gives"
    )
    acceleration_mm_s2: float = Field(gt=0, le=50_000, description="acceleration limit")
    speed_mm_s: float = Field(default=100.0, gt=0, le=1000, description="speed limit")
    dead_band_mm_s: float = Field(default=0.0, ge=0, le=5, description="slower commands do not move it")
    ripple_mm: float = Field(default=0.0, ge=0, le=1, description="stroke error of the screw, amplitude per turn")
    screw_lead_mm: float = Field(default=5.0, gt=0, le=100, description="stroke per turn of the screw")
    backlash_mm: float = Field(default=0.0, ge=0, le=5, description="play of the nut")
    seating_load_n: float = Field(
        default=20.0, ge=0, le=1e6, description="tension above which the load closes the play"
    )
    stop_margin_mm: float = Field(default=5.0, ge=0, le=100, description="mechanical stops beyond the commanded stroke")
    encoder_mm: float = Field(default=0.0, ge=0, le=1, description="resolution of the encoder as stroke, 0 = perfect")
    clock_ppm: float = Field(default=0.0, ge=-1000, le=1000, description="its clock against the controller's")
    force_n_a: float = Field(default=500.0, gt=0, le=1e6, description="rope force per ampere of motor current")
    friction_n: float = Field(default=60.0, ge=0, le=1e5, description="of screw and seals against the motor, as force")
    creep_n_s_mm: float = Field(
        default=600.0, gt=0, le=1e6, description="rope force under which the motor without power gives way by 1 mm/s"
    )
    ambient_c: float = Field(default=25.0, ge=-40, le=80, description="temperature of the drive without current")
    heating_c_a2: float = Field(default=8.0, ge=0, le=1000, description="what 1 A adds to it in the end, by I squared")
    thermal_s: float = Field(default=600.0, gt=0, le=1e5, description="time constant of that")
    increments_per_mm: float | None = Field(
        default=None,
        ge=100,
        le=1e7,
        description="it counts in increments, so many per mm; null = micrometres",
    )

    @property
    def brake_times_ms(self) -> tuple[int, int]:
        """Time the brake takes to open, and to close."""
        opens, closes = self.brake_open_ms, self.brake_close_ms
        return self.brake_ms if opens is None else opens, self.brake_ms if closes is None else closes


class CellSettings(Settings):
    """Tension cell and amplifier beyond the settings of `tension_cell`."""

    quantum_n: float = Field(gt=0, le=10, description="resolution")
    filter_hz: float | None = Field(default=None, gt=0, le=10_000, description="low-pass, first order, null = none")
    bias_n: float = Field(default=0.0, ge=-1000, le=1000, description="what the last tare left of the zero error")
    gain_pct: float = Field(default=0.0, ge=-10, le=10, description="what the last calibration left of the gain error")
    drift_n_h: float = Field(default=0.0, ge=-100, le=100, description="drift of zero per hour")
    creep_pct: float = Field(default=0.0, ge=-1, le=1, description="of the load, reached after several creep_s")
    creep_s: float = Field(default=600.0, gt=0, le=1e5, description="time constant of the creep")
    creep2_pct: float = Field(default=0.0, ge=-1, le=1, description="a second creep, of the load")
    creep2_s: float = Field(default=60.0, gt=0, le=1e5, description="its time constant")
    temperature_c: float = Field(default=20.0, ge=-40, le=85, description="of the cell at the start")
    warming_c_h: float = Field(default=0.0, ge=-100, le=100, description="its change per hour")
    zero_n_k: float = Field(default=0.0, ge=-1, le=1, description="change of zero per kelvin from temperature_c")
    gain_pct_k: float = Field(default=0.0, ge=-1, le=1, description="change of gain per kelvin from temperature_c")
    linearity_pct: float = Field(
        default=0.0, ge=-1, le=1, description="of the range, at half of it: a parabola through zero and the range"
    )
    hysteresis_pct: float = Field(default=0.0, ge=0, le=1, description="of the range, between rising and falling load")
    clock_ppm: float = Field(default=0.0, ge=-1000, le=1000, description="its clock against the controller's")


class ForceErrorSettings(Settings):
    """The second force path beyond the settings of `second_force`."""

    bias_n: float = Field(default=0.0, ge=-1000, le=1000, description="zero error, as force")
    gain_pct: float = Field(default=0.0, ge=-10, le=10, description="gain error; of a spring: how much softer it is")
    drift_n_h: float = Field(default=0.0, ge=-1e6, le=1e6, description="drift of zero per hour")
    noise_n: float = Field(default=0.02, ge=0, le=10, description="noise of a cell, rms, per sample")


class SlopeSettings(Settings):
    """Inclinometer beyond the settings of `inclinometer`."""

    kind: Literal["accelerometer", "gyro"] = Field(
        default="gyro", description="accelerometer: reads the swing's acceleration too; gyro: compensated"
    )
    height_mm: float = Field(default=0.0, ge=0, le=20_000, description="distance below the pulley")
    gyro_s: float = Field(default=2.0, gt=0, le=100, description="gyro: faster than this the rate gyro is believed")
    filter_hz: float = Field(gt=0, le=1000, description="low-pass, first order")
    quantum_deg: float = Field(gt=0, le=1, description="resolution")
    noise_deg: float = Field(ge=0, le=1, description="noise, rms, after the filter")
    clock_ppm: float = Field(default=0.0, ge=-1000, le=1000, description="its clock against the controller's")


class DevicesSettings(Settings):
    """Behaviour of CANopen devices on the market; each value other than the default is a variant of a device."""

    rtr: bool = Field(default=True, description="false = bit 30 of a TPDO's COB-ID stays set, else abort 0609 0030")
    fixed_mapping: bool = Field(default=False, description="PDO mappings are read only, else abort 0601 0002")
    sdo_ms: int = Field(default=0, ge=0, le=5000, description="time to an SDO answer")
    boot_s: float = Field(default=0.0, ge=0, le=60, description="time from power-on or reset to the boot-up message")

    @property
    def slow(self) -> bool:
        """Whether their answers take time."""
        return self.sdo_ms > 0 or self.boot_s > 0


class SimulationSettings(Settings):
    """The simulated rig where it differs from `plant`."""

    seed: int = Field(ge=0, le=2**31, description="of every noise source")
    step_us: int = Field(default=100, ge=10, le=1000, description="integration step")
    stiffness_scale: float = Field(default=1.0, gt=0.1, le=10, description="stiffness as built / as in `plant`")
    lag_scale: float = Field(default=1.0, gt=0.1, le=10, description="cylinder lag as built / as in `plant`")
    delay_scale: float = Field(default=1.0, ge=0, le=20, description="command delay as built / as in `plant`")
    dead_load_n: float = Field(default=0.0, ge=0, le=10_000, description="load of both friction pairs beside the rope")
    rail: RailSettings
    pulley: PulleySettings
    rope: RopeSettings
    mechanism: MechanismSettings = Field(default_factory=MechanismSettings)
    drive: DriveSettings
    cell: CellSettings
    second_force: ForceErrorSettings = Field(default_factory=ForceErrorSettings)
    inclinometer: SlopeSettings
    devices: DevicesSettings = Field(default_factory=DevicesSettings)
