"""A rig file (YAML) as frozen, validated settings.

Units are in the names (``_n _mm _mm_s _rad _deg _s _ms _ns _hz``). Every refusal is one line:
``FILE:LINE: key: found X, expected Y``.
"""

from __future__ import annotations

import math
import pathlib
from typing import Annotated

from pydantic import Field, model_validator

from rigctl.config import layout
from rigctl.config.address import is_address
from rigctl.config.bounds import findings
from rigctl.config.canopen import SIMULATOR_NODE, VELOCITY_ACTUAL, VELOCITY_ACTUAL_16
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.io_section import IoSettings
from rigctl.config.limits_section import LimitSettings
from rigctl.config.margins_section import MarginsSettings
from rigctl.config.page_section import PageSettings
from rigctl.config.plain import PlainMessage
from rigctl.config.recording_section import RecordingSettings
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings_base import CanopenDevice, Hexadecimal, Settings, require
from rigctl.config.signals import STATUS, WATCHED
from rigctl.config.simulation_section import SimulationSettings
from rigctl.config.telemetry_section import TelemetrySettings

ADDED = frozenset({"directory", "plain"})  # settings that ``load`` adds to those of the file
_LARGEST_RAW = 2**31 - 1  # 0x6064, 0x60FF are INTEGER32
_TEMPERATURE_HZ, _MOST_SYNCS = 5, 240  # a cell takes minutes to warm; most SYNCs of a transmission type
_SDO_TRANSFERS = 100  # most transfers of a device at start-up, with room
PdoNumber = Annotated[int, Field(ge=1, le=4, description="number of the PDO")]
NodeId = Annotated[int, Field(ge=1, le=127, description="CANopen node id")]


class LoopSettings(Settings):
    """The fixed-rate loop and its real-time settings, each of which is optional (0, null or false)."""

    rate_hz: int = Field(ge=50, le=4000, description="loop rate")
    spin_us: int = Field(default=0, ge=0, le=200, description="busy-wait before each grid point")
    priority: int = Field(default=80, ge=0, le=98, description="SCHED_FIFO priority, 0 = normal scheduling")
    cpu: int | None = Field(default=None, ge=0, le=1023, description="processor the loop is pinned to, null = any")
    lock_memory: bool = Field(default=True, description="mlockall, so that no tick waits for a page")
    realtime_waiver: str | None = Field(
        default=None, min_length=10, description="why it may arm where these are refused by the system, in words"
    )

    @model_validator(mode="after")
    def _whole_period(self) -> LoopSettings:
        whole = 1_000_000_000 % self.rate_hz == 0
        require(whole, "rate_hz", self.rate_hz, "a rate whose period is a whole number of nanoseconds")
        return self

    @property
    def period_ns(self) -> int:
        """Tick period in nanoseconds."""
        return 1_000_000_000 // self.rate_hz


class CanSettings(Settings):
    """The one CAN bus the loop owns."""

    interface: str = Field(min_length=1, description="python-can interface: socketcan, rigsim, ...")
    channel: str = Field(min_length=1, max_length=100, description="device or socket, e.g. can0")
    bitrate_bit_s: int | None = Field(
        ge=10_000, le=1_000_000, description="bit rate; null only on rigsim, which has no bit timing"
    )
    controller_node: NodeId = 1
    heartbeat_ms: int = Field(default=20, ge=5, le=1000, description="our heartbeat period (0x1017)")
    boot_wait_s: float = Field(default=10.0, ge=0, le=120, description="start-up waits so long for devices to boot")

    @model_validator(mode="after")
    def _bit_rate_is_known(self) -> CanSettings:
        known = self.bitrate_bit_s is not None or self.interface == "rigsim"
        require(known, "bitrate_bit_s", None, "a bit rate (null is for interface rigsim only)")
        return self


class DbcSettings(Settings):
    """Plain frames described by a DBC file; with such a section, ``node`` and ``eds`` of the device do not apply."""

    file: str = Field(min_length=1, description="DBC file, relative to the rig file")
    message: str = Field(min_length=1, description="the message's name")
    valid: str | None = Field(default=None, min_length=1, description="signal, 0 while it cannot measure; null = none")


class TensionDbcSettings(DbcSettings):
    """The tension cell's message."""

    tension: str = Field(min_length=1, description="signal, unit N")


class InclinationDbcSettings(DbcSettings):
    """The inclinometer's message."""

    tangential: str = Field(min_length=1, description="signal, unit deg or rad")
    normal: str = Field(min_length=1, description="signal, unit deg or rad")


class TensionCellSettings(CanopenDevice):
    """Tension amplifier, CiA 404 or any with plain frames."""

    node: NodeId = 2
    eds: str = Field(default="eds/tension_amplifier.eds", description="EDS file, relative to the rig file")
    range_n: float = Field(gt=0, le=100_000, description="rated range of the cell")
    noise_n: float = Field(gt=0, le=100, description="noise, rms, per sample")
    dbc: TensionDbcSettings | None = Field(default=None, description="plain frames, null = CANopen")


class InclinometerSettings(CanopenDevice):
    """Two-axis inclinometer, CiA 410 or any with plain frames.

    Slope long is the tangential angle, slope lateral the normal one.
    """

    node: NodeId = 3
    eds: str = Field(default="eds/inclinometer.eds", description="EDS file, relative to the rig file")
    rate_hz: int = Field(ge=1, le=1000, description="sample rate; a divisor of the loop's")
    range_deg: float = Field(default=30.0, gt=0, le=90, description="measuring range")
    dbc: InclinationDbcSettings | None = Field(default=None, description="plain frames, null = CANopen")


class RailEncoderSettings(CanopenDevice):
    """Absolute encoder on the rail's shaft, CiA 406. The rig runs without one."""

    node: NodeId = 5
    eds: str = Field(default="eds/rail_encoder.eds", description="EDS file, relative to the rig file")
    counts_per_turn: int = Field(ge=256, le=2**31, description="measuring units per revolution (0x6001)")
    rate_hz: int = Field(ge=10, le=4000, description="sample rate; a divisor of the loop's")


class RunOutSettings(Settings):
    """Table of the rail's run-out against its angle, learnt move by move. Needs `rail_encoder`."""

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


class LearningSettings(Settings):
    """Feed-forward learnt from one marked move to the next (`rigctl move N`). Without the section nothing is learnt."""

    move_s: float = Field(ge=3, le=120, description="longest move, from its mark on; what comes later is not learnt")
    moves: int = Field(default=2, ge=1, le=16, description="moves told apart by their numbers, from 1")
    rate: float = Field(default=0.5, gt=0, le=1, description="share of a move's error that the next table takes away")
    cutoff_hz: float = Field(ge=0.1, le=10, description="of the zero-phase low-pass on each table; the start checks it")
    speed_max_mm_s: float = Field(default=0.5, gt=0, le=10, description="largest speed of a table")
    stroke_max_mm: float = Field(default=0.2, gt=0, le=10, description="largest stroke that a table adds up to")
    same_mm: float = Field(default=0.5, gt=0, le=100, description="stroke beyond the last move's: another move")
    same_deg: float = Field(default=0.3, gt=0, le=10, description="inclination beyond the last move's: another move")


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
    stroke_min_mm: float = Field(ge=-2000, le=2000, description="lowest stroke commanded (positive = shorter rope)")
    stroke_max_mm: float = Field(ge=-2000, le=2000, description="highest stroke commanded")
    status_rate_hz: int | None = Field(
        default=None, ge=5, le=100, description="current, temperature, inputs, at least so often; null = not asked for"
    )
    rated_current_a: float | None = Field(
        default=None, gt=0, le=1000, description="motor's, as its drive has it (0x6075); needed with status_rate_hz"
    )
    e_stop_input: int | None = Field(
        default=None, ge=0, le=31, description="bit of the digital inputs (0x60FD), 0 = pressed; null = none fitted"
    )
    absolute_encoder: bool = Field(
        default=True, description="keeps its position without power; false = the stroke is confirmed at every start"
    )
    stroke_waiver: str | None = Field(
        default=None, min_length=10, description="why a start may arm on a stroke that is not the last known, in words"
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
        return self

    @model_validator(mode="after")
    def _stroke_has_length(self) -> CylinderSettings:
        low, high = self.stroke_min_mm, self.stroke_max_mm
        require(low < high, "stroke_min_mm", low, f"below stroke_max_mm ({high:g})")
        return self

    @model_validator(mode="after")
    def _status_is_complete(self) -> CylinderSettings:
        rate, current, stop = self.status_rate_hz, self.rated_current_a, self.e_stop_input
        require(rate is None or current is not None, "rated_current_a", current, "a current, with status_rate_hz")
        require(rate is not None or stop is None, "e_stop_input", stop, "none without status_rate_hz")
        return self


class PlantSettings(Settings):
    """The plant as assumed by estimator and design."""

    spring_n_mm: float | None = Field(gt=0, le=10_000, description="series spring, null = none")
    rope_n_mm: float = Field(gt=0, le=100_000, description="rope, axial")
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


class TensionSettings(Settings):
    """Target and ramps of the tension, and the bounds of the stroke's motion."""

    target_n: float = Field(ge=1, le=10_000, description="vertical tension to hold")
    target_min_n: float = Field(ge=1, le=10_000, description="lowest target an operator may set")
    target_max_n: float = Field(ge=1, le=10_000, description="highest target an operator may set")
    slack_n: float = Field(default=5.0, gt=0, le=100, description="below this the rope counts as slack")
    ramp_n_s: float = Field(gt=0, le=1000, description="slope of tensioning, releasing and of a new target")
    speed_max_mm_s: float = Field(gt=0, le=500, description="speed limit of every command")
    acceleration_max_mm_s2: float = Field(gt=0, le=50_000, description="acceleration limit of every command")

    @model_validator(mode="after")
    def _target_within_bounds(self) -> TensionSettings:
        low, high = self.target_min_n, self.target_max_n
        require(low <= high, "target_min_n", low, f"at most target_max_n ({high:g})")
        require(
            low <= self.target_n <= high, "target_n", self.target_n, f"{low:g} to {high:g} (target_min_n to _max_n)"
        )
        return self


class EstimatorSettings(Settings):
    """Noise the Kalman filter assumes beside the cell's (spectral densities: per square root of a second)."""

    speed_noise_mm_s: float = Field(gt=0, le=100, description="drive speed measurement, rms")
    cell_noise_scale: float = Field(default=1.0, gt=0, le=1000, description="cell noise assumed / tension_cell.noise_n")
    tension_walk_n: float = Field(gt=0, le=1000, description="process noise of tension, N/sqrt(s)")
    speed_walk_mm_s: float = Field(gt=0, le=1000, description="process noise of drive speed, mm/s/sqrt(s)")
    disturbance_walk_mm_s: float = Field(
        gt=0, le=10_000, description="process noise of disturbance speed, mm/s/sqrt(s)"
    )
    swing_hz: float | None = Field(
        default=None, gt=0, le=100, description="the disturbance swings at this frequency, null = it only walks"
    )
    swing_damping: float = Field(default=0.05, ge=0, le=1000, description="of critical, of that swing")
    acceleration_walk_mm_s2: float = Field(
        default=30.0, gt=0, le=1e6, description="process noise of the swing's acceleration, mm/s^2/sqrt(s)"
    )
    quiet_tension_walk_n: float | None = Field(
        default=None, gt=0, le=1000, description="tension_walk_n while the innovations are small, null = the same"
    )
    quiet_disturbance_walk_mm_s: float | None = Field(
        default=None, gt=0, le=10_000, description="the same of disturbance_walk_mm_s"
    )
    quiet_acceleration_walk_mm_s2: float | None = Field(
        default=None, gt=0, le=1e6, description="the same of acceleration_walk_mm_s2"
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

    @property
    def adapts(self) -> bool:
        """There is a quiet setting beside the open one."""
        return not (
            self.quiet_tension_walk_n is None
            and self.quiet_disturbance_walk_mm_s is None
            and self.quiet_acceleration_walk_mm_s2 is None
        )


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
    waiver: str | None = Field(default=None, min_length=10, description="why a design above ms_max may run, in words")
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


class SafetySettings(Settings):
    """The built-in rows of the safety table, which cannot be left out; ``limits`` adds to them."""

    tension_high_n: float = Field(gt=0, le=100_000, description="trip above, any mode")
    tension_low_n: float = Field(ge=0, le=100_000, description="trip below, while COMPENSATING")
    persistence_ms: int = Field(ge=0, le=1000, description="how long a tension limit must be passed")
    stale_ms: int = Field(ge=1, le=1000, description="oldest tension or drive sample the loop acts on")
    inclination_stale_ms: int = Field(ge=10, le=5000, description="oldest inclination the loop acts on")
    bus_silent_ms: int = Field(ge=1, le=1000, description="no frame at all for this long")
    stuck_samples: int = Field(
        default=20, ge=0, le=10_000, description="equal samples of the cell in a row that are a fault; 0 = never"
    )
    overrun_ticks: int = Field(ge=1, le=1000, description="periods skipped ...")
    overrun_window_ms: int = Field(ge=10, le=60_000, description="... within this time")
    waiver: str | None = Field(
        default=None, min_length=10, description="why settings may be out of the bounds physics give them, in words"
    )


class CalibrationSettings(Settings):
    """Tare and calibration of the tension cell; results are kept in a ledger beside the rig file.

    With this section the rig arms only while a calibration check has passed and is not overdue, or a waiver says why.
    """

    file: str | None = Field(
        default=None, min_length=1, description="ledger, relative to the rig file; null = calibration/RIG.json"
    )
    due_days: int = Field(default=365, ge=1, le=3650, description="a check holds for this long")
    reference_n: float = Field(gt=0, le=100_000, description="known weight, as force")
    reference_u_n: float | None = Field(
        default=None, gt=0, le=1000, description="its expanded uncertainty (k = 2): tolerance, local g, buoyancy"
    )
    shunt_n: float | None = Field(default=None, gt=0, le=100_000, description="what the shunt makes the cell read")
    tolerance_pct: float = Field(default=0.5, gt=0, le=5, description="largest deviation from the reference")
    tare_days: int = Field(default=30, ge=1, le=3650, description="a tare holds for this long")
    tare_limit_n: float = Field(default=10.0, gt=0, le=1000, description="largest zero a tare may set")
    waiver: str | None = Field(default=None, min_length=10, description="why it may arm uncalibrated, in words")


class PreflightSettings(Settings):
    """Conditions of arming beside good signals and devices."""

    stroke_margin_mm: float = Field(default=2.0, ge=0, le=500, description="stroke at least this far from its ends")
    disk_free_mib: int = Field(default=512, ge=1, le=2**30, description="free where the rig writes things down")


class AuditSettings(Settings):
    """Files of the recorder: the audit log, and a dump of each trip. Relative to the rig file."""

    file: str | None = Field(default=None, min_length=1, description="audit log; null = audit/RIG.jsonl")
    trips: str = Field(default="trips", min_length=1, description="folder of the trip dumps")
    trips_kept: int = Field(default=100, ge=1, le=10_000, description="trip dumps of this rig kept, the newest")
    syslog: str | None = Field(
        default=None, description="tcp/HOST:PORT or udp/HOST:PORT of a syslog collector that gets each head of the log"
    )

    @model_validator(mode="after")
    def _syslog_is_an_endpoint(self) -> AuditSettings:
        if self.syslog is not None:
            protocol, _, where = self.syslog.partition("/")
            good = protocol in ("tcp", "udp") and is_address(where)
            require(good, "syslog", self.syslog, "tcp/HOST:PORT or udp/HOST:PORT")
        return self


class DemoSettings(Settings):
    """The paper's move, and the limits of the demo's verdict."""

    angle_deg: float = Field(gt=0, le=180, description="out and back")
    speed_deg_s: float = Field(gt=0, le=10, description="mechanism speed")
    acceleration_deg_s2: float = Field(gt=0, le=100, description="mechanism acceleration ramp")
    eta_max_pct: float = Field(gt=0, le=100, description="true vertical error while COMPENSATING, after settle_s, max")
    eta_rms_pct: float = Field(gt=0, le=100, description="the same, rms")
    settle_s: float = Field(default=2.0, ge=0, le=60, description="left out after COMPENSATING is entered")
    frames_lost_max: int = Field(default=0, ge=0, le=1_000_000, description="CAN frames lost")
    samples_lost_max: int = Field(default=0, ge=0, le=1_000_000, description="fast samples lost to the subscriber")


class PlainMessages(Settings):
    """Messages of the DBC files, as read when the rig file was loaded."""

    tension_cell: PlainMessage | None = None
    inclinometer: PlainMessage | None = None


PROBE_SHARE = 0.01
"""Of the lowest target: a larger multisine beside the law would spoil what it measures."""


def _largest_probe_n(settings: RigSettings) -> float:
    """Half of the tightest limit on the error while COMPENSATING, and `PROBE_SHARE` of the lowest target, in N."""
    limits = [
        0.5 * limit.high
        for limit in settings.limits
        if limit.signal == "vertical_error_n" and limit.high is not None and "COMPENSATING" in limit.modes
    ]
    return min(PROBE_SHARE * settings.tension.target_min_n, *limits, math.inf)


class RigSettings(Settings):
    """A whole rig file; ``load`` adds ``directory`` and ``plain``."""

    rig: str = Field(pattern=r"^[a-z][a-z0-9_]{0,31}$", description="name in every key and lock")
    loop: LoopSettings
    can: CanSettings
    tension_cell: TensionCellSettings
    inclinometer: InclinometerSettings
    rail_encoder: RailEncoderSettings | None = None
    cylinder: CylinderSettings
    io: IoSettings | None = None
    plant: PlantSettings
    tension: TensionSettings
    estimator: EstimatorSettings
    run_out: RunOutSettings | None = None
    learning: LearningSettings | None = None
    design: DesignSettings
    safety: SafetySettings
    limits: list[LimitSettings] = Field(default_factory=list)
    calibration: CalibrationSettings | None = None
    compensation: CompensationSettings | None = None
    second_force: SecondForceSettings | None = None
    margins: MarginsSettings | None = None
    preflight: PreflightSettings = Field(default_factory=PreflightSettings)
    telemetry: TelemetrySettings = Field(default_factory=TelemetrySettings)
    audit: AuditSettings = Field(default_factory=AuditSettings)
    recording: RecordingSettings = Field(default_factory=RecordingSettings)
    page: PageSettings | None = None
    demo: DemoSettings | None = None
    simulation: SimulationSettings | None = None
    directory: str = ""
    plain: PlainMessages = Field(default_factory=PlainMessages)

    @model_validator(mode="after")
    def _parts_agree(self) -> RigSettings:
        seen = {self.can.controller_node: "can.controller_node", SIMULATOR_NODE: "the simulator"}
        for name, node in self.canopen_nodes.items():
            require(node not in seen, f"{name}.node", node, f"a node id of its own ({seen.get(node)} has it)")
            seen[node] = name
        self._check_rates()
        rate = self.loop.rate_hz
        drive = self.cylinder
        for place, watched in enumerate(self.limits):
            key, signal = f"limits.{place}.signal", watched.signal
            comes = drive.status_rate_hz is not None or WATCHED[signal].age != STATUS
            require(comes, key, signal, "none of the drive's status without its status_rate_hz")
            measured = drive.temperature_object is not None or signal != "drive_temperature_c"
            require(measured, key, signal, "none of it: cylinder.temperature_object is null")
        if self.margins is not None:
            probe, most = self.margins.probe_n, _largest_probe_n(self)
            require(
                probe <= most,
                "margins.probe_n",
                probe,
                f"at most {most:g}: 1 % of target_min_n, half of a limit on the error",
            )
        room = self.cylinder.stroke_max_mm - self.cylinder.stroke_min_mm
        margin = self.preflight.stroke_margin_mm
        require(2 * margin < room, "preflight.stroke_margin_mm", margin, f"less than half the stroke ({room / 2:g} mm)")
        known = self.second_force is None or self.calibration is not None
        require(known, "second_force", "a section", "none without a calibration section")
        known = self.run_out is None or self.rail_encoder is not None
        require(known, "run_out", "a section", "none without a rail_encoder section")
        if self.learning is not None:
            found, most = self.learning.speed_max_mm_s, self.tension.speed_max_mm_s
            require(found <= most, "learning.speed_max_mm_s", found, f"up to tension.speed_max_mm_s ({most:g})")
        limit = 2 * self.can.heartbeat_ms
        wait = self.cylinder.heartbeat_timeout_ms
        require(wait >= limit, "cylinder.heartbeat_timeout_ms", wait, f"at least twice can.heartbeat_ms ({limit})")
        target, trip = self.tension.target_max_n, self.safety.tension_high_n
        require(target < trip, "tension.target_max_n", target, f"below safety.tension_high_n ({trip:g})")
        scale = self.tension_cell.range_n
        require(trip <= scale, "safety.tension_high_n", trip, f"within tension_cell.range_n ({scale:g})")
        target, trip = self.tension.target_min_n, self.safety.tension_low_n
        require(target > trip, "tension.target_min_n", target, f"above safety.tension_low_n ({trip:g})")
        if self.calibration is not None:
            zero, low = self.calibration.tare_limit_n, self.safety.tension_low_n
            require(zero < low, "calibration.tare_limit_n", zero, f"below safety.tension_low_n ({low:g})")
            weight = self.calibration.reference_n
            require(weight <= scale, "calibration.reference_n", weight, f"within tension_cell.range_n ({scale:g})")
        self._check_compensation()
        period_ms = 1000 / rate
        stale = min(self.safety.stale_ms, self.safety.bus_silent_ms)
        require(stale >= 2 * period_ms, "safety.stale_ms", stale, f"two loop periods ({2 * period_ms:g} ms) or more")
        if (io := self.io) is not None:
            least = io.event_ms + 2 * period_ms
            require(
                io.stale_ms >= least, "io.stale_ms", io.stale_ms, f"event_ms and two loop periods ({least:g}) or more"
            )
        if self.safety.waiver is None:
            for key, found, allowed in findings(self):
                require(agree=False, key=key, found=found, allowed=allowed)
        return self

    def _check_rates(self) -> None:
        """Every device answers after a whole number of SYNCs, or its status in as many ticks."""
        rate, slope_rate = self.loop.rate_hz, self.inclinometer.rate_hz
        fits = rate % slope_rate == 0 and rate // slope_rate <= _MOST_SYNCS
        require(fits, "inclinometer.rate_hz", slope_rate, f"loop.rate_hz ({rate}) divided by 1 to 240")
        if (rail := self.rail_encoder) is not None:
            fits = rate % rail.rate_hz == 0 and rate // rail.rate_hz <= _MOST_SYNCS
            require(fits, "rail_encoder.rate_hz", rail.rate_hz, f"loop.rate_hz ({rate}) divided by 1 to 240")
        if (second := self.second_force) is not None:
            fits = rate % second.rate_hz == 0 and rate // second.rate_hz <= _MOST_SYNCS
            require(fits, "second_force.rate_hz", second.rate_hz, f"loop.rate_hz ({rate}) divided by 1 to 240")
        if (status := self.cylinder.status_rate_hz) is not None:
            fits = 1 <= rate // status <= _MOST_SYNCS
            require(fits, "cylinder.status_rate_hz", status, f"loop.rate_hz ({rate}) divided by 1 to 240")

    def _check_compensation(self) -> None:
        section, calibration = self.compensation, self.calibration
        if section is None:
            return
        require(calibration is not None, "compensation", "a section", "none without a calibration section")
        assert calibration is not None
        most, found = calibration.tare_limit_n, section.slack_zero_limit_n
        require(found <= most, "compensation.slack_zero_limit_n", found, f"at most calibration.tare_limit_n ({most:g})")
        if section.temperature == "cell":
            plain = self.tension_cell.dbc is not None
            require(not plain, "compensation.temperature", "cell", "drive or null: a plain frame has no temperature")
        if section.temperature == "drive":
            drive = self.cylinder
            comes = drive.status_rate_hz is not None and drive.temperature_object is not None
            key = "compensation.temperature"
            require(comes, key, "drive", "cell or null: the drive's is not asked for (cylinder.status_rate_hz)")

    @property
    def key_folder(self) -> pathlib.Path | None:
        """Folder of the rig's keys; None without certificates."""
        return self.file(self.telemetry.tls.keys) if self.telemetry.tls is not None else None

    @property
    def inclinometer_divisor(self) -> int:
        """The inclinometer answers every this many SYNCs (transmission type of its TPDO)."""
        return self.loop.rate_hz // self.inclinometer.rate_hz

    @property
    def status_divisor(self) -> int:
        """The drive's second TPDO comes every this many SYNCs; 0 = never."""
        rate = self.cylinder.status_rate_hz
        return self.loop.rate_hz // rate if rate is not None else 0

    @property
    def cell_temperature_divisor(self) -> int:
        """The amplifier's second TPDO, with the cell's temperature, comes every this many SYNCs; 0 = never."""
        asked = self.compensation is not None and self.compensation.temperature == "cell"
        return max(1, min(_MOST_SYNCS, self.loop.rate_hz // _TEMPERATURE_HZ)) if asked else 0

    @property
    def start_up_limit_s(self) -> float:
        """Longest start-up with devices that still boot and answer at their time-out."""
        devices: list[CanopenDevice] = [getattr(self, name) for name in self.canopen_nodes]
        return self.can.boot_wait_s + _SDO_TRANSFERS * sum(device.sdo_timeout_ms for device in devices) * 1e-3

    @property
    def canopen_nodes(self) -> dict[str, int]:
        """Node ids of the devices that speak CANopen, by section."""
        cell, slope = self.tension_cell, self.inclinometer
        nodes = {"tension_cell": cell.node} if cell.dbc is None else {}
        nodes |= {"inclinometer": slope.node} if slope.dbc is None else {}
        nodes |= {"rail_encoder": self.rail_encoder.node} if self.rail_encoder is not None else {}
        nodes |= {"io": self.io.node} if self.io is not None else {}
        nodes |= {"second_force": self.second_force.node} if self.second_force is not None else {}
        return {**nodes, "cylinder": self.cylinder.node}

    @property
    def plain_messages(self) -> dict[str, PlainMessage]:
        """Plain frames of the devices that do not, by section.

        Raises:
            ValueError: the settings were not made by ``load``, which reads the DBC files.
        """
        found = {}
        for name in ("tension_cell", "inclinometer"):
            if getattr(self, name).dbc is not None:
                found[name] = getattr(self.plain, name)
                if found[name] is None:
                    raise ValueError(f"{name}: its DBC file has not been read")
        return found

    @property
    def ledger(self) -> pathlib.Path | None:
        """File of the ledger; None without a calibration section."""
        if self.calibration is None:
            return None
        return self.kept(self.calibration.file or f"calibration/{self.rig}.json")

    @property
    def last_stroke(self) -> pathlib.Path:
        """File in which the recorder keeps the last known stroke: beside the ledger.

        In the installed service it is beside the audit log, because the ledger's folder belongs to another user.
        """
        if layout.is_installed(self.directory):
            return self.audit_log.with_name(f"{self.rig}.stroke.json")
        return (self.ledger or self.kept(f"calibration/{self.rig}.json")).with_suffix(".stroke.json")

    @property
    def audit_log(self) -> pathlib.Path:
        """File in which the recorder keeps the audit log."""
        return self.kept(self.audit.file or f"audit/{self.rig}.jsonl")

    def file(self, name: str) -> pathlib.Path:
        """A file named in the rig file that the daemon reads, relative to the rig file's folder."""
        return pathlib.Path(self.directory) / name

    def kept(self, name: str) -> pathlib.Path:
        """A file or folder that the daemon writes; for its place see `rigctl.config.layout`."""
        return layout.state_folder(self.directory) / name
