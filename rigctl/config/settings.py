"""A rig file (YAML) as frozen, validated settings.

Units are in the names (``_n _mm _mm_s _rad _deg _s _ms _ns _hz``). Every refusal is one line:
``FILE:LINE: key: found X, expected Y``.
"""

from __future__ import annotations

import math
import pathlib

from pydantic import Field, model_validator

from rigctl.config import layout
from rigctl.config.audit_section import AuditSettings
from rigctl.config.bounds import findings
from rigctl.config.can_section import CanSettings
from rigctl.config.canopen import SIMULATOR_NODE
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.cylinder_section import CylinderSettings
from rigctl.config.design_section import DesignSettings
from rigctl.config.estimator_section import EstimatorSettings
from rigctl.config.hold_section import HoldSettings
from rigctl.config.io_section import IoSettings
from rigctl.config.limits_section import LimitSettings
from rigctl.config.margins_section import MarginsSettings
from rigctl.config.page_section import PageSettings
from rigctl.config.plain import PlainMessage
from rigctl.config.plant_section import PlantSettings
from rigctl.config.rail_sections import RailEncoderSettings, RunOutSettings
from rigctl.config.recording_section import RecordingSettings
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.sensor_sections import InclinometerSettings, PlainMessages, TensionCellSettings
from rigctl.config.settings_base import CanopenDevice, Settings, Waiver, require
from rigctl.config.simulation_section import SimulationSettings
from rigctl.config.telemetry_section import TelemetrySettings
from rigctl.model.signals import STATUS, WATCHED

ADDED = frozenset({"directory", "plain"})  # settings that ``load`` adds to those of the file
_LARGEST_RAW = 2**31 - 1  # of the target velocity, 0x60FF
_TEMPERATURE_HZ, _MOST_SYNCS = 5, 240  # a cell takes minutes to warm; most SYNCs of a transmission type
_SDO_TRANSFERS = 100  # most transfers of a device at start-up, with room


class LoopSettings(Settings):
    """The fixed-rate loop and its real-time settings, each of which is optional (0, null or false)."""

    rate_hz: int = Field(ge=50, le=4000, description="loop rate")
    spin_us: int = Field(default=0, ge=0, le=200, description="busy-wait before each grid point")
    priority: int = Field(default=80, ge=0, le=98, description="SCHED_FIFO priority, 0 = normal scheduling")
    cpu: int | None = Field(default=None, ge=0, le=1023, description="processor the loop is pinned to, null = any")
    lock_memory: bool = Field(default=True, description="mlockall, so that no tick waits for a page")
    realtime_waiver: Waiver = Field(
        default=None, description="why it may arm where these are refused by the system, in words"
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


class LearningSettings(Settings):
    """Feed-forward learned from one marked move to the next (`rigctl move N`); none without the section."""

    move_s: float = Field(ge=3, le=120, description="longest move, from its mark on; what comes later is not learnt")
    moves: int = Field(default=2, ge=1, le=16, description="moves told apart by their numbers, from 1")
    rate: float = Field(default=0.5, gt=0, le=1, description="share of a move's error that the next table takes away")
    cutoff_hz: float = Field(ge=0.1, le=10, description="of the zero-phase low-pass on each table; the start checks it")
    speed_max_mm_s: float = Field(default=0.5, gt=0, le=10, description="largest speed of a table")
    stroke_max_mm: float = Field(default=0.2, gt=0, le=10, description="largest stroke that a table adds up to")
    same_mm: float = Field(default=0.5, gt=0, le=100, description="stroke beyond the last move's: another move")
    same_deg: float = Field(default=0.3, gt=0, le=10, description="inclination beyond the last move's: another move")


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


class SafetySettings(Settings):
    """The built-in rows of the safety table, which cannot be left out; ``limits`` adds to them."""

    tension_high_n: float = Field(gt=0, le=100_000, description="trip above, any mode")
    tension_low_n: float = Field(ge=0, le=100_000, description="trip below, while COMPENSATING")
    persistence_ms: int = Field(ge=0, le=1000, description="how long a tension limit must be passed")
    stale_ms: int = Field(ge=1, le=1000, description="oldest tension or drive sample the loop acts on")
    inclination_stale_ms: int = Field(ge=10, le=5000, description="oldest inclination the loop acts on")
    bus_silent_ms: int = Field(ge=1, le=1000, description="no frame at all for this long")
    heave_mm: float | None = Field(
        default=None, gt=0, le=1000, description="vertical motion of the payload from where COMPENSATING began"
    )
    heave_mm_s: float | None = Field(default=None, gt=0, le=80, description="its largest speed")
    stuck_samples: int = Field(
        default=20, ge=0, le=10_000, description="equal samples of the cell in a row that are a fault; 0 = never"
    )
    overrun_ticks: int = Field(ge=1, le=1000, description="periods skipped ...")
    overrun_window_ms: int = Field(ge=10, le=60_000, description="... within this time")
    lock_out: str | None = Field(
        default=None, min_length=2, max_length=40,
        description="name of the switch that locks the drive out before somebody walks in, as it is marked in the "
        "hall, and what it leaves powered: Q1 (24 V stays on)",
    )  # fmt: skip
    waiver: Waiver = Field(
        default=None, description="why settings may be out of the bounds physics give them, in words"
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
    waiver: Waiver = Field(default=None, description="why it may arm uncalibrated, in words")


class PreflightSettings(Settings):
    """Conditions of arming beside good signals and devices."""

    stroke_margin_mm: float = Field(default=2.0, ge=0, le=500, description="stroke at least this far from its ends")
    disk_free_mib: int = Field(default=512, ge=1, le=2**30, description="free where the rig writes things down")


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
    hold: HoldSettings = Field(default_factory=HoldSettings)
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
    def _speed_fits_its_frame(self) -> RigSettings:
        key, units = self.cylinder.speed_units
        if units is not None:
            most = _LARGEST_RAW / self.tension.speed_max_mm_s
            allowed = f"up to {most:g}: tension.speed_max_mm_s fits in 32 bits (0x60FF)"
            require(units <= most, f"cylinder.{key}", units, allowed)
        return self

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
        self._check_filter()
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
            same = second.quick_hz is None or second.rate_hz == rate
            require(same, "second_force.rate_hz", second.rate_hz, f"loop.rate_hz ({rate}) where quick_hz is given")
        if (status := self.cylinder.status_rate_hz) is not None:
            fits = 1 <= rate // status <= _MOST_SYNCS
            require(fits, "cylinder.status_rate_hz", status, f"loop.rate_hz ({rate}) divided by 1 to 240")

    def _check_filter(self) -> None:
        """The cell's low-pass is a fact of its amplifier: a simulated one has that of the file."""
        if self.simulation is not None:
            built, found = (
                "null" if each.filter_hz is None else each.filter_hz
                for each in (self.simulation.cell, self.tension_cell)
            )
            require(found == built, "tension_cell.filter_hz", found, f"that of simulation.cell ({built})")

    def _check_compensation(self) -> None:
        section = self.compensation
        if section is None:
            return
        require(self.calibration is not None, "compensation", "a section", "none without a calibration section")
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
    def tare_limit_n(self) -> float:
        """Largest zero of the cell; none without a calibration section."""
        return self.calibration.tare_limit_n if self.calibration is not None else 0.0

    @property
    def slack_reading_n(self) -> float:
        """Largest reading of a slack rope: with the largest zero. One further below 0 is no rope's."""
        return self.tension.slack_n + self.tare_limit_n

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
    def kept_results(self) -> pathlib.Path:
        """File in which the supervisor keeps results of the design; without it a start takes longer."""
        name = f"{self.rig}.design.json"
        return layout.CACHE / name if layout.is_installed(self.directory) else self.last_stroke.with_name(name)

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
