"""The safety table: what is watched, when, for how long, and what is done about it.

Evaluated every tick on values the tick already has; a row trips once its condition has held for its persistence. The
built-in rows cannot be configured away; the rig file's ``limits`` come after them, see `rigctl.control.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum, IntFlag, auto

from rigctl.config import RigSettings
from rigctl.control.correction import tare_limit_n
from rigctl.control.homed import TOLERANCE_MM
from rigctl.control.modes import Mode
from rigctl.control.run_out import stale_ns
from rigctl.devices.objects import DEVICE_HEARTBEAT_MS, NmtState


class Action(IntEnum):
    """What a row asks for, the weakest first. All but LOG latch a fault."""

    LOG = 0  # say so
    RAMP_DOWN = 1  # lower the tension on its ramp until the rope is slack, then hold
    HOLD = 2  # hold the stroke under power
    QUICK_STOP = 3  # the drive stops on its own ramp, then power off with the brake closed
    POWER_OFF = 4  # the same, and the brake closes in any case once the drive has had its time to stop


class Fault(IntEnum):
    """What can trip the rig; the number is latched in every record until an operator resets it."""

    NONE = 0
    TENSION_HIGH = 1
    TENSION_LOW = 2
    CELL_STALE = 3
    CELL_INVALID = 4
    INCLINATION_STALE = 5
    INCLINATION_INVALID = 6
    DRIVE_STALE = 7
    DRIVE_FAULT = 8
    BUS_SILENT = 9
    OVERRUN = 10
    LOOP_EXCEPTION = 11
    STROKE_END = 12
    DRIVE_NOT_FOLLOWING = 13
    DEVICE_RESTARTED = 14
    INNOVATION = 15  # tension or drive speed went on contradicting what the filter expects
    SIGN_DRIVE = 16  # a positive command does not move the stroke up
    SIGN_CELL = 17  # a shorter rope does not pull harder, or far from what the plant says
    LIMIT = 18  # a row of the rig file's limits; the trip's event names it
    CELL_STUCK = 19  # the cell goes on sending the very same value
    DRIVE_CONTRADICTS = 20  # the drive's speed is not what its position does
    STROKE_MOVES = 21  # the stroke moves though the drive is off: the brake does not hold
    STRETCH_UNEXPLAINED = 22  # tension changed as no stroke explains, or did not where the stroke says it must
    E_STOP = 23  # the emergency stop is seen pressed
    CELL_NOISY = 24  # far more than the cell's noise, and no payload moves like that
    CELL_NEGATIVE = 25  # a rope cannot push
    SENSOR_EMERGENCY = 26  # cell, inclinometer or I/O node has sent an emergency message, and not taken it back
    DRIVE_EMERGENCY = 27  # the drive has
    RIVAL = 28  # another controller commands this bus
    E_STOP_UNSEEN = 29  # the I/O node that mirrors the emergency stop is silent
    STROKE_NOT_HELD = 30  # the stroke has left where HOLD, FAULT or DISARMED latched it
    POSITION_DRIFTS = 31  # correcting the stroke moved the load: the drive's position is not where the stroke is
    STATUS_STALE = 33  # the drive's current, temperature and inputs have stopped coming
    LIMIT_UNSEEN = 34  # the signal that a limit of the rig file watches is not there
    DRIVE_UNASKED = 35  # the drive is enabled, or moves under power, and not because we asked for it
    DRIVE_REFUSES = 36  # the drive says itself that it does not do as it is told: statusword bits 9, 11, 12
    NODE_NOT_OPERATIONAL = 37  # a device's heartbeat has stopped, or says that it has left OPERATIONAL
    SUPERVISION_LOST = 38  # an object that safety hangs on is not what start-up wrote, or is not answered for
    STROKE_JUMPED = 39  # the drive's position went from one sample to the next where no stroke can go
    BRAKE_SLIPS = 41  # the brake let the stroke move in the brake test


class EStop(IntFlag):
    """Where the emergency stop is seen pressed; the value of its trip."""

    DRIVE = 1
    IO_NODE = 2


class Check(IntFlag):
    """Preflight checks an arm command must pass."""

    CELL_STALE = 1
    CELL_INVALID = 2
    INCLINATION_STALE = 4
    INCLINATION_INVALID = 8
    DRIVE_STALE = 16
    DRIVE_FAULT = 32
    TENSION_HIGH = 64
    STROKE_RANGE = 128
    DRIVE_SUPERVISION = 256  # the drive's own stop was not verified (0x1016, 0x6007, 0x605E, deadline)
    CALIBRATION = 512  # the cell's calibration is missing or overdue, and not waived
    E_STOP = 1024  # the emergency stop is pressed: the drive's input
    CELL_IMPLAUSIBLE = 2048  # stuck, noisy or negative
    EMERGENCY = 4096  # a device's emergency message stands
    LIMIT = 8192  # a limit of the rig file, with an action, is passed now
    E_STOP_UNSEEN = 1 << 14  # an emergency stop is fitted, and the drive's input is not seen
    STROKE_NEAR_END = 1 << 15  # within the margin of an end; ``arm --near-end`` is for that
    TARE = 1 << 16  # no tare on record that still holds, and not waived
    MARGINS = 1 << 17  # of the law in use there are none, or they are refused
    REALTIME = 1 << 18  # the system refused what was asked of it, and not waived
    DISK = 1 << 19  # hardly any room where the rig writes things down
    RIVAL = 1 << 21  # another controller commands this bus
    E_STOP_IO = 1 << 22  # the emergency stop is pressed: the I/O node's input
    E_STOP_IO_UNSEEN = 1 << 23  # an I/O node is fitted, and its input is not seen
    STATUS_STALE = 1 << 24  # the drive's current, temperature and inputs do not come
    DRIVE_REFUSES = 1 << 25  # the drive is somebody else's to command, or limits what it is told
    NODE_NOT_OPERATIONAL = 1 << 26  # no heartbeat of a device, or one of another state
    NOT_AT_STANDSTILL = 1 << 29  # the stroke has moved within the last STILL_NS, see rigctl.control.arming
    SEQUENCE_RUNNING = 1 << 30  # the drive is not off, or its brake has not had its time to close
    HOST = 1 << 20  # these four are not known: the gateway has not judged them within the last seconds
    STROKE_UNCONFIRMED = 1 << 27  # the drive's position is not the stroke that was last known


HOST_CHECKS = Check.TARE | Check.MARGINS | Check.REALTIME | Check.DISK | Check.HOST
"""What the loop cannot see for itself, see `rigctl.commission.preflight`."""


@dataclass(slots=True)
class Sight:
    """What one tick sees: values, ages in ns, quality bits (0 good), counters."""

    t_ns: int = 0
    tension_n: float = math.nan
    reading_n: float = math.nan  # the same before zero and scale
    cell_age_ns: int = 1 << 62
    cell_quality: int = 0
    inclination_age_ns: int = 1 << 62
    inclination_quality: int = 0
    tangential_rad: float = 0.0
    normal_rad: float = 0.0
    stroke_mm: float = math.nan
    travel_mm: float = 0.0  # since the target was reached
    speed_mm_s: float = 0.0
    drive_age_ns: int = 1 << 62
    drive_enabled: bool = False
    drive_off: bool = False  # no power, brake closed or closing
    off_ns: int = 0  # for how long the drive has reported a state without power
    still_ns: int = 0  # for how long the stroke has stood still, see rigctl.control.arming
    brake_slip_known: bool = False  # acknowledged: whoever arms now has the motor carry the load
    drive_faulted: bool = False
    drive_warning: bool = False
    drive_local: bool = False  # statusword bit 9 is off: it does not take our commands
    drive_limited: bool = False  # bit 11
    drive_ignores: bool = False  # enabled, and bit 12 is off: it does not follow the target velocity
    drive_powered: bool = False  # neither off nor in its fault state
    drive_unasked: bool = False  # enabled again since it was off, and we have not asked for it
    drive_lingers: bool = False  # enabled, and we have asked it to go off
    heartbeats_t_ns: dict[int, int] = field(default_factory=dict)  # when each node's newest came
    node_states: dict[int, int] = field(default_factory=dict)  # NMT state it told
    drive_temperature_c: float = math.nan
    drive_current_a: float = math.nan
    e_stop: int = 0  # where it is seen pressed, bits of EStop
    e_stop_unseen: bool = False  # the drive has one, and what it says is not known
    io_age_ns: int = 1 << 62  # since the I/O node's inputs came, where one is fitted
    status_age_ns: int = 1 << 62  # since the drive's current, temperature and inputs came, where they are asked for
    rail_age_ns: int = 1 << 62  # since the rail encoder's angle came, where one is fitted
    bus_age_ns: int = 1 << 62
    error_frames: int = 0  # in the last second
    skipped_in_window: int = 0
    lateness_ns: int = 0
    command_age_ns: int = 0  # since an operator gave the last one
    stroke_limited: bool = False
    drive_wanted: bool = False
    rope_lost: bool = False
    device_restarted: bool = False
    rival_age_ns: int = 1 << 62  # since another controller was heard
    rival_words: str = ""  # what it did
    stroke_unconfirmed: bool = False  # see rigctl.control.homed
    stroke_jump_mm: float = 0.0  # until it is confirmed
    settings_lost: int = 0  # objects found changed, or not answered for, see rigctl.control.readback
    disobeys: bool = False  # one of them is what the drive needs to do as it is commanded
    settings_words: str = ""  # the first of them
    sensor_emergency: int = 0  # node << 16 | code of one that stands
    drive_emergency: int = 0
    drive_reversed: bool = False  # see rigctl.control.signs
    cell_reversed: bool = False
    rejects: int = 0
    slope_rejects: int = 0
    cell_nis: float = 0.0
    calibration_overdue: bool = False
    host_checks: int = 0  # bits of HOST_CHECKS that fail
    failed_checks: int = 0  # bits of Check that failed when they were last looked at
    vertical_error_n: float = 0.0  # from the set-point on its ramp, while there is one
    disturbance_mm_s: float = 0.0
    speed_error_mm_s: float = 0.0  # these seven: see rigctl.control.plausibility
    stroke_error_mm: float = 0.0
    contradiction_mm: float = 0.0
    unexplained_mm: float = 0.0
    excursion_mm: float = 0.0  # these two: see rigctl.control.stroke_hold
    doubt_mm: float = 0.0
    cell_repeats: int = 0
    cell_unrest_n: float = 0.0
    tension_rate_n_s: float = 0.0


class Bars(Enum):
    """When a row whose fault is in `BLOCK_RESET` keeps that fault from being reset."""

    AT_ONCE = auto()
    LASTING = auto()  # once it has been bad for its persistence: a drive takes a moment to go off
    NEVER = auto()  # it may stand until its fault is reset, and bars arming


@dataclass(frozen=True)
class Row:
    """One line of the table: tripped when ``value(sight) > limit`` for ``persistence_ns``, in ``modes``.

    ``text``: for a row of the rig file, what is beyond its limit. ``sign``: -1 where the row watches a lower limit, so
    that found value and limit are shown as they are.
    """

    fault: Fault
    value: Callable[[Sight], float]
    limit: float
    persistence_ns: int
    modes: frozenset[Mode]
    unit: str
    action: Action = Action.HOLD
    text: str = ""
    sign: float = 1.0
    words: Callable[[Sight], str] | None = None  # what the trip says beside value and limit
    bars: Bars = Bars.AT_ONCE

    @property
    def blocks_reset(self) -> bool:
        """While it stands, its fault cannot be reset."""
        return self.fault in BLOCK_RESET and self.bars is not Bars.NEVER

    def trip(self, value: float, sight: Sight | None = None) -> Trip:
        """What it trips with; without a ``sight`` that is looked at, in its own text only."""
        text = self.words(sight) if self.words is not None and sight is not None else self.text
        return Trip(self.fault, self.sign * float(value), self.sign * float(self.limit), self.action, text)


_ARMED = frozenset({Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT})
ARMED = _ARMED
_ON = _ARMED - {Mode.FAULT}
_CLOSED = frozenset({Mode.TENSIONING, Mode.COMPENSATING})
_TENSIONING = frozenset({Mode.TENSIONING})
_MOVING = _CLOSED | {Mode.RELEASING}
_REGULATED = frozenset({Mode.COMPENSATING})
_OFF = frozenset({Mode.DISARMED})
_AT_REST = frozenset({Mode.HOLD, Mode.FAULT})
_UNASKED = _OFF | {Mode.FAULT}
_HELD = _AT_REST | _OFF
_EVERY = frozenset(Mode)
_OPERATIONAL = NmtState.OPERATIONAL.value
_MS = 1_000_000
LOG_AGAIN_NS = 1_000 * _MS  # a row that comes and goes is told no more often than this
STROKE_END_NS = 200 * _MS
RIVAL_NS = 500 * _MS  # a controller is heard far more often than this
DRIVE_GRACE_NS = 20 * _MS  # the drive's answer to enable or disable may take this long
INTERNAL_LIMIT_NS = 100 * _MS  # of current or speed, for an instant, while it accelerates: five lags of the drive
LINGER_NS = 1_000 * _MS  # ramp and brake of a drive that goes off take less
HEARTBEAT_SILENT_NS = 5 * DEVICE_HEARTBEAT_MS * _MS  # as of STATUS_PERIODS: a burst does not take five in a row
STROKE_SPARE_MM = 2.0
SPEED_ERROR_MM_S, SPEED_ERROR_NS = 2.5, 15 * _MS  # a lag half as long again as the plant's makes 1.5 mm/s of 10
STROKE_ERROR_MM = 0.5
CONTRADICTION_MM = 0.3
SLOPE_REJECTS = 50  # half a second of an inclinometer at 100 Hz; until then the filter goes on by itself
# A payload that heaves by 10 mm in 10 s makes 8, a mechanism of 6 N/mm tensioned at 10 mm/s 10 ...
UNEXPLAINED_MM = 12.0
UNEXPLAINED_NS = 15 * _MS  # ... and a single bad sample anything
AT_REST_MM, AT_REST_NS = 1.6, 15 * _MS  # in HOLD: the rail's run-out is 1.5
PAYLOAD_MM_S = 80.0  # faster than any payload; a jolt of 1 mm in 20 ms makes 50
UNREST_NOISES = 30.0
UNREST_NS = 5 * _MS
NEGATIVE_NS = 10 * _MS
# A stroke that is held stays within 1 mm: 0.1 mm are what the slowest creep that gets here, 0.5 mm/s, does until the
# drive has had its time to stop and the brake has closed. What creeps faster trips DRIVE_NOT_FOLLOWING at 0.5 mm.
NOT_HELD_MM, NOT_HELD_NS = 0.9, 2 * _MS
DOUBT_MM = 0.5
BRAKE_SLIP_MM_S, BRAKE_SLIP_NS = 0.2, 200 * _MS  # a stop that has begun takes less
STATUS_PERIODS = 5  # of the drive's status lost in a row: at 10 % of frames lost once in 10^5, 1.4 h at 20 Hz


def status_stale_ns(settings: RigSettings) -> int:
    """Oldest current, temperature and inputs of the drive that count as known; 0 where they are not asked for."""
    return STATUS_PERIODS * settings.status_divisor * settings.loop.period_ns


_LOCAL = "it takes no commands from the bus (statusword bit 9, remote, is off)"
_LIMITS = "a limit of its own is active (statusword bit 11)"
_IGNORES = "it does not follow the commanded speed (statusword bit 12 is off)"
_ELSEWHERE = "the drive has been enabled by somebody else"
_LINGERS = "the drive stays enabled though it is told to go off"
_POWERED = "the stroke moves under power"
_DEVICE_WORDS = {"cylinder": "cylinder drive", "io": "I/O node"}


def _highest_n(sight: Sight) -> float:
    """A correction of the cell can bring this trip forward, never put it off."""
    return max(sight.tension_n, sight.reading_n)


def table(settings: RigSettings) -> tuple[Row, ...]:
    """The built-in rows, in the order in which the first to trip names the fault."""
    s = settings.safety
    stale, slope = s.stale_ms * _MS, s.inclination_stale_ms * _MS
    persist = s.persistence_ms * _MS
    stuck = s.stuck_samples - 1 if s.stuck_samples else math.inf
    unrest_n = max(
        UNREST_NOISES * settings.tension_cell.noise_n,
        settings.plant.stiffness_n_mm * PAYLOAD_MM_S / settings.loop.rate_hz,
    )
    negative_n = settings.tension.slack_n + tare_limit_n(settings)
    lost = Action.POWER_OFF  # a drive that does not obey is not told to hold, but taken off power
    return (
        Row(Fault.E_STOP, lambda x: x.e_stop, 0, 0, _EVERY, "", Action.QUICK_STOP),
        Row(Fault.BUS_SILENT, lambda x: x.bus_age_ns, s.bus_silent_ms * _MS, 0, _ARMED, "ns"),
        Row(Fault.RIVAL, lambda x: x.rival_age_ns < RIVAL_NS, 0, 0, _ARMED, "", words=lambda x: x.rival_words),
        Row(Fault.SUPERVISION_LOST, lambda x: x.settings_lost, 0, 0, _ARMED, "", words=lambda x: x.settings_words),
        Row(Fault.SUPERVISION_LOST, lambda x: x.disobeys, 0, 0, _ARMED, "commands", lost,
            words=lambda x: x.settings_words),
        Row(Fault.STROKE_JUMPED, lambda x: x.stroke_jump_mm, TOLERANCE_MM, 0, _ARMED, "mm", lost),
        Row(Fault.DRIVE_STALE, lambda x: x.drive_age_ns, stale, 0, _ARMED, "ns"),
        Row(Fault.CELL_STALE, lambda x: x.cell_age_ns, stale, 0, _ARMED, "ns"),
        Row(Fault.INCLINATION_STALE, lambda x: x.inclination_age_ns, slope, 0, _ARMED, "ns"),
        *_io_rows(settings),
        *_status_rows(settings),
        Row(Fault.DRIVE_FAULT, lambda x: x.drive_faulted, 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_NOT_FOLLOWING, _dropped_out, 0, DRIVE_GRACE_NS, _ON, ""),
        Row(Fault.DRIVE_REFUSES, lambda x: x.drive_local, 0, DRIVE_GRACE_NS, _ARMED, "", text=_LOCAL),
        Row(Fault.DRIVE_REFUSES, lambda x: x.drive_limited, 0, INTERNAL_LIMIT_NS, _ARMED, "", text=_LIMITS,
            bars=Bars.NEVER),
        Row(Fault.DRIVE_REFUSES, lambda x: x.drive_ignores, 0, DRIVE_GRACE_NS, _ARMED, "", lost, _IGNORES),
        Row(Fault.DRIVE_UNASKED, lambda x: x.drive_unasked, 0, DRIVE_GRACE_NS, _UNASKED, "", lost, _ELSEWHERE),
        Row(Fault.DRIVE_UNASKED, lambda x: x.drive_lingers, 0, LINGER_NS, _UNASKED, "", lost, _LINGERS,
            bars=Bars.LASTING),
        Row(Fault.DRIVE_UNASKED, _powered_mm_s, BRAKE_SLIP_MM_S, BRAKE_SLIP_NS, _OFF, "mm/s", lost, _POWERED,
            bars=Bars.LASTING),
        Row(Fault.SIGN_DRIVE, lambda x: x.drive_reversed, 0, 0, _TENSIONING, ""),
        Row(Fault.SIGN_CELL, lambda x: x.cell_reversed, 0, 0, _TENSIONING, ""),
        Row(Fault.CELL_INVALID, lambda x: x.cell_quality, 0, 0, _ARMED, ""),
        Row(Fault.INCLINATION_INVALID, lambda x: x.inclination_quality, 0, 0, _ARMED, ""),
        Row(Fault.TENSION_HIGH, _highest_n, s.tension_high_n, persist, _EVERY, "N"),
        Row(Fault.CELL_NEGATIVE, lambda x: -x.tension_n, negative_n, NEGATIVE_NS, _ARMED, "N", sign=-1.0),
        Row(Fault.TENSION_LOW, lambda x: -x.tension_n, -s.tension_low_n, persist, _REGULATED, "N", sign=-1.0),
        Row(Fault.TENSION_LOW, lambda x: x.rope_lost, 0, persist, _TENSIONING, ""),
        Row(Fault.CELL_STUCK, lambda x: x.cell_repeats, stuck, 0, _ARMED, "samples"),
        Row(Fault.CELL_NOISY, lambda x: x.cell_unrest_n, unrest_n, UNREST_NS, _ARMED, "N"),
        Row(Fault.SENSOR_EMERGENCY, lambda x: x.sensor_emergency, 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_EMERGENCY, lambda x: x.drive_emergency, 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_NOT_FOLLOWING, lambda x: x.speed_error_mm_s, SPEED_ERROR_MM_S, SPEED_ERROR_NS, _ARMED, "mm/s",
            lost),
        Row(Fault.DRIVE_NOT_FOLLOWING, lambda x: abs(x.stroke_error_mm), STROKE_ERROR_MM, 0, _ARMED, "mm", lost),
        Row(Fault.DRIVE_CONTRADICTS, lambda x: abs(x.contradiction_mm), CONTRADICTION_MM, 0, _ARMED, "mm"),
        Row(Fault.STROKE_NOT_HELD, lambda x: abs(x.excursion_mm), NOT_HELD_MM, NOT_HELD_NS, _HELD, "mm", lost),
        Row(Fault.POSITION_DRIFTS, lambda x: abs(x.doubt_mm), DOUBT_MM, 0, _AT_REST, "mm", lost),
        Row(Fault.STROKE_MOVES, _unbraked_mm_s, BRAKE_SLIP_MM_S, BRAKE_SLIP_NS, _OFF, "mm/s", lost),
        Row(Fault.INNOVATION, lambda x: x.rejects, settings.estimator.reject_limit - 1, 0, _MOVING, "samples"),
        Row(Fault.INNOVATION, lambda x: x.slope_rejects, SLOPE_REJECTS - 1, 0, _MOVING, "slopes"),
        Row(Fault.STRETCH_UNEXPLAINED, lambda x: abs(x.unexplained_mm), UNEXPLAINED_MM, UNEXPLAINED_NS, _MOVING, "mm"),
        Row(Fault.STRETCH_UNEXPLAINED, lambda x: abs(x.unexplained_mm), AT_REST_MM, AT_REST_NS, _AT_REST, "mm at rest",
            lost),
        Row(Fault.STROKE_END, lambda x: x.stroke_limited, 0, STROKE_END_NS, _MOVING, ""),
        Row(Fault.DEVICE_RESTARTED, lambda x: x.device_restarted, 0, 0, _ARMED, ""),
        *_node_rows(settings),
        Row(Fault.OVERRUN, lambda x: x.skipped_in_window, s.overrun_ticks - 1, 0, _ARMED, "ticks"),
        *_rail_rows(settings),
    )  # fmt: skip


def _io_rows(settings: RigSettings) -> tuple[Row, ...]:
    """What the I/O node does not say, nobody knows: the drive's input is seen apart from it, or not fitted at all."""
    if settings.io is None:
        return ()
    return (Row(Fault.E_STOP_UNSEEN, lambda x: x.io_age_ns, settings.io.stale_ms * _MS, 0, _ARMED, "ns"),)


def _status_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Without it neither the emergency stop's input nor the drive's temperature is seen."""
    stale = status_stale_ns(settings)
    return (Row(Fault.STATUS_STALE, lambda x: x.status_age_ns, stale, 0, _ARMED, "ns"),) if stale else ()


def _rail_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Only feed-forward hangs on the rail's angle, and ends with it: no reason to hold, but to say so."""
    if (rail := settings.rail_encoder) is None:
        return ()
    ages: tuple[tuple[str, Callable[[Sight], float], float], ...] = (
        ("rail_age_ms", lambda x: x.rail_age_ns, stale_ns(rail)),
        ("rail_heartbeat_age_ms", _silence(rail.node), HEARTBEAT_SILENT_NS),
    )
    return tuple(
        Row(Fault.LIMIT, _in_ms(age), limit_ns / _MS, 0, _ARMED, "ms", Action.LOG, f"{name} above")
        for name, age, limit_ns in ages
    )


def _node_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Heartbeats of the devices: one that still sends samples but no heartbeat, or has left OPERATIONAL, is not well.

    A node that has booted anew says so, and trips as DEVICE_RESTARTED.
    """
    rows = []
    for device, node in settings.canopen_nodes.items():
        if device != "rail_encoder":
            text = f"{_DEVICE_WORDS.get(device, device.replace('_', ' '))} (node {node})"
            rows.append(
                Row(Fault.NODE_NOT_OPERATIONAL, _silence(node), HEARTBEAT_SILENT_NS, 0, _ARMED, "ns", text=text)
            )
            rows.append(Row(Fault.NODE_NOT_OPERATIONAL, _wrong_state(node), 0, 0, _ARMED, "NMT state", text=text))
    return tuple(rows)


def _in_ms(age: Callable[[Sight], float]) -> Callable[[Sight], float]:
    return lambda x: age(x) / _MS


def _silence(node: int) -> Callable[[Sight], float]:
    return lambda x: x.t_ns - x.heartbeats_t_ns.get(node, x.t_ns)


def _wrong_state(node: int) -> Callable[[Sight], float]:
    return lambda x: 0 if (state := x.node_states.get(node, _OPERATIONAL)) == _OPERATIONAL else state


def _unbraked_mm_s(sight: Sight) -> float:
    unpowered = sight.drive_off or sight.drive_faulted
    return abs(sight.speed_mm_s) if unpowered and not sight.brake_slip_known else 0.0


def _powered_mm_s(sight: Sight) -> float:
    return abs(sight.speed_mm_s) if sight.drive_powered else 0.0


def _dropped_out(sight: Sight) -> float:
    return sight.drive_wanted and not sight.drive_enabled


@dataclass(frozen=True)
class Trip:
    """What tripped, with the value found, the limit allowed, and what is to be done."""

    fault: Fault
    value: float
    limit: float
    action: Action = Action.HOLD
    text: str = ""


class Watch:
    """The table with its clocks: since when each row has been bad."""

    def __init__(self, settings: RigSettings, limits: Sequence[Row] = ()) -> None:
        """``limits``: the rig file's rows."""
        self._rows = (*table(settings), *limits)
        # By mode: place, value and limit of the rows watched in it; a tick touches no more of a row that is good.
        self._watched = [
            [(i, row.value, row.limit) for i, row in enumerate(self._rows) if mode in row.modes] for mode in Mode
        ]
        self._unwatched = [[i for i, row in enumerate(self._rows) if mode not in row.modes] for mode in Mode]
        self._mode: Mode | None = None
        self._since: list[int | None] = [None] * len(self._rows)
        self._logged = [False] * len(self._rows)
        self._quiet_until = [-LOG_AGAIN_NS] * len(self._rows)
        self.crossed: list[tuple[Trip, bool]] = []  # LOG rows since last taken: True begins, False is over
        self._stands = [False] * len(self._rows)
        self.standing = (
            0  # bits 1 << fault of the rows, but those that only log, that are bad for their persistence now
        )
        self.causes: list[tuple[Trip, bool]] = []  # of these, as ``crossed``

    def trips(self, sight: Sight, mode: Mode, t_ns: int) -> Trip | None:
        """The strongest of the rows that have been bad for their persistence, among equals the first; or None."""
        strongest: Trip | None = None
        since = self._since
        if mode is not self._mode:
            self._mode = mode
            for i in self._unwatched[mode]:
                self._ends(i, watched=False)
        for i, read, limit in self._watched[mode]:
            if not (value := read(sight)) > limit:
                if since[i] is not None:
                    self._ends(i)
                continue
            row, start = self._rows[i], since[i]
            if start is None:
                start = since[i] = t_ns
            if t_ns - start < row.persistence_ns:
                continue
            if not self._logged[i] and t_ns >= self._quiet_until[i]:
                self._quiet_until[i] = t_ns + LOG_AGAIN_NS
                self._log(i, row.trip(value, sight), begins=True)
            if row.action is Action.LOG:
                continue
            if not self._stands[i]:
                self._stands[i] = True
                self.standing |= 1 << row.fault
            if strongest is None or row.action > strongest.action:
                strongest = row.trip(value, sight)
        return strongest

    def beyond(self, sight: Sight, mode: Mode) -> set[Fault]:
        """Faults that would come, sooner or later, if the rig were in ``mode``."""
        return {
            row.fault
            for row in self._rows
            if mode in row.modes and row.action is not Action.LOG and row.value(sight) > row.limit
        }

    def present(self, sight: Sight) -> Fault:
        """First cause that is there at this instant, whatever the mode; what keeps a fault from being reset.

        A fault of the drive itself is not one: the reset is what clears it. Nor is what only a mode can show.
        """
        return next(self._blocking(sight), Fault.NONE)

    def blocking(self, sight: Sight) -> int:
        """All causes that keep a fault from being reset at this instant, bits 1 << fault."""
        found = 0
        for fault in self._blocking(sight):
            found |= 1 << fault
        return found

    def _blocking(self, sight: Sight) -> Iterator[Fault]:
        for row, stands in zip(self._rows, self._stands, strict=True):
            if row.blocks_reset and (stands or row.bars is Bars.AT_ONCE) and row.value(sight) > row.limit:
                yield row.fault

    def _ends(self, i: int, *, watched: bool = True) -> None:
        """A row that is good again, or not watched any more: of these only the rows that log say that they are over."""
        self._since[i] = None
        if self._stands[i]:
            self._stands[i] = False
            self.standing = 0
            for row, stands in zip(self._rows, self._stands, strict=True):
                self.standing |= stands << row.fault
        if self._logged[i]:
            if watched or self._rows[i].action is Action.LOG:
                self._log(i, self._rows[i].trip(self._rows[i].limit), begins=False)
            self._logged[i] = False

    def _log(self, i: int, trip: Trip, *, begins: bool) -> None:
        self._logged[i] = begins
        row = self._rows[i]
        (self.crossed if row.action is Action.LOG else self.causes).append((trip, begins))


BLOCK_RESET = frozenset(
    {Fault.BUS_SILENT, Fault.DRIVE_STALE, Fault.CELL_STALE, Fault.CELL_INVALID, Fault.INCLINATION_STALE,
     Fault.INCLINATION_INVALID, Fault.TENSION_HIGH, Fault.OVERRUN, Fault.DEVICE_RESTARTED, Fault.CELL_STUCK,
     Fault.E_STOP, Fault.E_STOP_UNSEEN, Fault.CELL_NOISY, Fault.CELL_NEGATIVE, Fault.SENSOR_EMERGENCY,
     Fault.RIVAL, Fault.STATUS_STALE, Fault.DRIVE_UNASKED, Fault.DRIVE_REFUSES,
     Fault.NODE_NOT_OPERATIONAL, Fault.SUPERVISION_LOST, Fault.STROKE_JUMPED}
)  # fmt: skip


_IMPLAUSIBLE = frozenset({Fault.CELL_STUCK, Fault.CELL_NOISY, Fault.CELL_NEGATIVE})
_EMERGENCY = frozenset({Fault.SENSOR_EMERGENCY, Fault.DRIVE_EMERGENCY})
_LIMITED = frozenset({Fault.LIMIT, Fault.LIMIT_UNSEEN})


def preflight(
    sight: Sight, settings: RigSettings, beyond: set[Fault], *, supervision_verified: bool, near_end: bool = False
) -> Check:
    """Checks that fail now; arming needs none to. ``beyond``: `Watch.beyond` of HOLD, the mode that arming leads to.

    ``near_end``: the operator means to drive away from an end of the stroke, where the law lets it go no further.
    """
    s = settings.safety
    cylinder, margin_mm = settings.cylinder, settings.preflight.stroke_margin_mm
    low, high = cylinder.stroke_min_mm - STROKE_SPARE_MM, cylinder.stroke_max_mm + STROKE_SPARE_MM
    inside = cylinder.stroke_min_mm + margin_mm <= sight.stroke_mm <= cylinder.stroke_max_mm - margin_mm
    in_range = low <= sight.stroke_mm <= high
    failing = {
        Check.CELL_STALE: sight.cell_age_ns > s.stale_ms * _MS,
        Check.CELL_INVALID: sight.cell_quality != 0,
        Check.INCLINATION_STALE: sight.inclination_age_ns > s.inclination_stale_ms * _MS,
        Check.INCLINATION_INVALID: sight.inclination_quality != 0,
        Check.DRIVE_STALE: sight.drive_age_ns > s.stale_ms * _MS,
        Check.DRIVE_FAULT: sight.drive_faulted,
        Check.TENSION_HIGH: not _highest_n(sight) <= s.tension_high_n,
        Check.STROKE_RANGE: not in_range,
        Check.STROKE_NEAR_END: in_range and not inside and not near_end,
        Check.DRIVE_SUPERVISION: not supervision_verified,
        Check.CALIBRATION: sight.calibration_overdue,
        Check.E_STOP: sight.e_stop & EStop.DRIVE,
        Check.E_STOP_IO: sight.e_stop & EStop.IO_NODE,
        Check.CELL_IMPLAUSIBLE: not beyond.isdisjoint(_IMPLAUSIBLE),
        Check.EMERGENCY: not beyond.isdisjoint(_EMERGENCY),
        Check.LIMIT: not beyond.isdisjoint(_LIMITED),
        Check.RIVAL: Fault.RIVAL in beyond,
        Check.STROKE_UNCONFIRMED: sight.stroke_unconfirmed,
        Check.E_STOP_UNSEEN: sight.e_stop_unseen,
        Check.E_STOP_IO_UNSEEN: Fault.E_STOP_UNSEEN in beyond,
        Check.STATUS_STALE: Fault.STATUS_STALE in beyond,
        Check.DRIVE_REFUSES: Fault.DRIVE_REFUSES in beyond or sight.drive_unasked,
        Check.NODE_NOT_OPERATIONAL: Fault.NODE_NOT_OPERATIONAL in beyond,
    }
    result = Check(sight.host_checks)
    for check, fails in failing.items():
        if fails:
            result |= check
    return result
