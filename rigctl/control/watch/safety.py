"""The safety table: the value each row watches, the modes it watches in, its limit, persistence and action.

The table is evaluated every tick on the snapshot; a row trips once its condition has held for its persistence. The
built-in rows cannot be configured away; the rig file's ``limits`` follow them, see `rigctl.control.watch.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import repeat
from operator import call, gt, lt
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_step import PAYLOAD_MM_S
from rigctl.control.law.run_out import stale_ns
from rigctl.control.load.held_tension import (
    FALLEN_NS,
    GROWS_MM,
    GROWS_NS,
    SINKS_NS,
    STRETCH_NS,
    fall_limit_n,
    stretch_limit_mm,
)
from rigctl.control.snapshot import FieldValue, Snapshot, reader
from rigctl.devices.objects import DEVICE_HEARTBEAT_MS
from rigctl.model.checks import Check
from rigctl.model.device_states import NmtState
from rigctl.model.fault_words import LINGERS, MOVES_OFF, POSITION, RUNAWAY, SPEED
from rigctl.model.faults import Fault, Trait, having
from rigctl.model.reactions import Action
from rigctl.model.states import EStop, Mode
from rigctl.model.verbs import STROKE_SPARE_MM, STROKE_TOLERANCE_MM


class Bars(Enum):
    """When a row whose fault blocks a reset (`Fault.blocks_reset`) does so."""

    AT_ONCE = auto()
    LASTING = auto()  # once it has been bad for its persistence: a drive takes a moment to go off
    NEVER = auto()  # it may stand until its fault is reset; it still bars arming


@dataclass(frozen=True)
class Row:
    """One line of the table: tripped when ``value(snapshot) > limit`` for ``persistence_ns``, in ``modes``.

    ``text``: of its trip, as ``tension_n above`` in a row of the rig file. ``sign``: -1 where the row watches a lower
    limit, to restore the signs of value and limit in the trip.
    """

    fault: Fault
    value: Callable[[Snapshot], float]
    limit: float
    persistence_ns: int
    modes: frozenset[Mode]
    unit: str
    action: Action = Action.HOLD
    text: str = ""
    sign: float = 1.0
    words: Callable[[Snapshot], str] | None = None  # text of the trip beside value and limit
    bars: Bars = Bars.AT_ONCE
    at_once: bool = False  # a power off that does not wait for the drive's own stop

    @property
    def blocks_reset(self) -> bool:
        """While it is active, its fault cannot be reset."""
        return self.fault.blocks_reset and self.bars is not Bars.NEVER

    def trip(self, value: float, snapshot: Snapshot | None = None) -> Trip:
        """The trip of this row at ``value``; its words are evaluated only where a ``snapshot`` is given."""
        text = self.words(snapshot) if self.words is not None and snapshot is not None else self.text
        return Trip(
            self.fault, self.sign * float(value), self.sign * float(self.limit), self.action, text, self.at_once
        )


_ARMED = frozenset({Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT})
ARMED = _ARMED
_ON = _ARMED - {Mode.FAULT}
_CLOSED = frozenset({Mode.TENSIONING, Mode.COMPENSATING})
_TENSIONING = frozenset({Mode.TENSIONING})
_MOVING = _CLOSED | {Mode.RELEASING}
_REGULATED = frozenset({Mode.COMPENSATING})
_OFF = frozenset({Mode.DISARMED})
_AT_REST = frozenset({Mode.HOLD, Mode.FAULT})
_UNASKED = _OFF | {Mode.HOLD, Mode.FAULT}
_HELD = _AT_REST | _OFF
_UNMOVED = _OFF | {Mode.HOLD}
_EVERY = frozenset(Mode)
_OPERATIONAL = NmtState.OPERATIONAL.value
_MS = 1_000_000
LOG_AGAIN_NS = 1_000 * _MS  # least time between two events of a row whose condition comes and goes
STROKE_END_NS = 200 * _MS
MASTER_NS = 500 * _MS  # a controller is heard far more often than this
DRIVE_GRACE_NS = 20 * _MS  # the drive's answer to enable or disable may take this long
INTERNAL_LIMIT_NS = 100 * _MS  # five lags of the drive: it may reach its current limit while it accelerates
LINGER_NS = 1_000 * _MS  # a drive that goes off needs less for its ramp and brake
HEARTBEAT_SILENT_NS = 5 * DEVICE_HEARTBEAT_MS * _MS  # as for STATUS_PERIODS: no burst takes five in a row
ENABLE_NS = 500 * _MS  # for the relay of the drive's enable, its feedback and the node's inhibit time
SPEED_ERROR_MM_S, SPEED_ERROR_NS = 2.5, 15 * _MS  # a lag 50 % above the plant's makes an error of 1.5 mm/s at 10 mm/s
STROKE_ERROR_MM = 0.5
CONTRADICTION_MM = 0.3
SLOPE_REJECTS = 50  # half a second of an inclinometer at 100 Hz; the filter extrapolates that long
# A payload that heaves by 10 mm in 10 s makes 8 mm, a mechanism of 6 N/mm tensioned at 10 mm/s makes 10 mm.
UNEXPLAINED_MM = 12.0
UNEXPLAINED_NS = 15 * _MS  # a single bad sample may show any stretch
UNSEEN_NS = 25 * _MS  # a jump of the cell is INNOVATION first, after 20 samples
UNREST_NOISES = 30.0
UNREST_NS = 5 * _MS
NEGATIVE_NS = 10 * _MS
# A held stroke must stay within 1 mm. At 0.5 mm/s, the slowest creep that reaches this row, the stroke moves another
# 0.1 mm until the drive has stopped and the brake has closed. Faster creep trips DRIVE_NOT_FOLLOWING at 0.5 mm.
NOT_HELD_MM, NOT_HELD_NS = 0.9, 2 * _MS
CORRECTED_MM = 0.8  # as far as a wrong position may take the load, unseen by a cell that has stopped measuring
BRAKE_SLIP_MM_S, BRAKE_SLIP_NS = 0.2, 200 * _MS  # a stop under way is shorter
SINK_MM_S, SINK_NS = 0.02, 1_000 * _MS  # five times what an encoder at rest shows over 5 s
UNHEARD_NS = 1_000 * _MS  # while DISARMED: a device that starts again takes less
WARMTH_MS = 60_000
DISAGREE_NS = 100 * _MS  # of a difference that is low-passed by a second
STATUS_PERIODS = 5  # status frames lost in a row: at 10 % loss once in 10^5 frames, or 1.4 h at 20 Hz


def status_stale_ns(settings: RigSettings) -> int:
    """Age in ns beyond which the drive's current, temperature and inputs are unknown; 0 where not configured."""
    return STATUS_PERIODS * settings.status_divisor * settings.loop.period_ns


def payable_mm(stroke_mm: float, stroke_min_mm: float) -> float:
    """How much of a slack rope may be paid out from ``stroke_mm``."""
    return stroke_mm - stroke_min_mm - STROKE_SPARE_MM


_LOCAL = "it takes no commands from the bus (statusword bit 9, remote, is off)"
_LIMITS = "a limit of its own is active (statusword bit 11)"
_IGNORES = "it does not follow the commanded speed (statusword bit 12 is off)"
_ELSEWHERE = "the drive has been enabled by somebody else"
_POWERED = "the stroke moves under power"
_DEVICE_WORDS = {"cylinder": "cylinder drive", "io": "I/O node"}


def _highest_n(snapshot: Snapshot) -> float:
    """The larger of tension and raw reading: a correction of the cell may bring this trip forward, never delay it."""
    return max(snapshot.tension_n, snapshot.reading_n)


def _probe_words(snapshot: Snapshot) -> str:
    return snapshot.probe.words


def table(settings: RigSettings) -> tuple[Row, ...]:
    """The built-in rows; among equal actions the first row that trips names the fault."""
    s = settings.safety
    stale, slope = s.stale_ms * _MS, s.inclination_stale_ms * _MS
    persist = s.persistence_ms * _MS
    stuck = s.stuck_samples - 1 if s.stuck_samples else math.inf
    unrest_n = max(
        UNREST_NOISES * settings.tension_cell.noise_n,
        settings.plant.stiffness_n_mm * PAYLOAD_MM_S / settings.loop.rate_hz,
    )
    fall_n = fall_limit_n(settings)
    lost = Action.POWER_OFF  # a drive that does not obey cannot hold, so its power is cut
    return (
        Row(Fault.E_STOP, FieldValue("e_stop"), 0, 0, _EVERY, "", Action.QUICK_STOP),
        Row(Fault.BUS_SILENT, FieldValue("bus_age_ns"), s.bus_silent_ms * _MS, 0, _ARMED, "ns"),
        Row(Fault.RIVAL, lambda x: x.master_age_ns < MASTER_NS, 0, 0, _ARMED, "", words=lambda x: x.master_words),
        Row(Fault.SUPERVISION_LOST, FieldValue("readback.lost"), 0, 0, _ARMED, "", words=lambda x: x.readback.words),
        Row(Fault.SUPERVISION_LOST, FieldValue("readback.unsupervised"), 0, 0, _ARMED, "drive", Action.QUICK_STOP,
            words=lambda x: x.readback.words),
        Row(Fault.SUPERVISION_LOST, FieldValue("readback.disobeys"), 0, 0, _ARMED, "commands", lost,
            words=lambda x: x.readback.words),
        Row(Fault.STROKE_JUMPED, FieldValue("stroke_jump_mm"), STROKE_TOLERANCE_MM, 0, _ARMED, "mm", lost),
        Row(Fault.SYNC_LOST, FieldValue("sync_age_ns"), stale, 0, _ARMED, "ns"),
        Row(Fault.DRIVE_STALE, FieldValue("drive_age_ns"), stale, 0, _ARMED, "ns"),
        Row(Fault.SYNC_LOST, _of_load(settings, "sync_age_ns"), stale, UNHEARD_NS, _OFF, "ns",
            text="of a load"),
        Row(Fault.DRIVE_STALE, _of_load(settings, "drive_age_ns"), stale, UNHEARD_NS, _OFF, "ns",
            text="of a load"),
        Row(Fault.CELL_STALE, FieldValue("cell_age_ns"), stale, 0, _ARMED, "ns"),
        Row(Fault.INCLINATION_STALE, FieldValue("inclination_age_ns"), slope, 0, _ARMED, "ns"),
        *_io_rows(settings),
        *_status_rows(settings),
        Row(Fault.DRIVE_FAULT, FieldValue("drive_faulted"), 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_NOT_FOLLOWING, FieldValue("plausibility.runaway_mm_s"), SPEED_ERROR_MM_S, 0, _ARMED,
            "mm/s", lost, RUNAWAY, at_once=True),
        Row(Fault.DRIVE_NOT_FOLLOWING, _moves_off_mm_s, BRAKE_SLIP_MM_S, 0, _ON, "mm/s", lost, MOVES_OFF, at_once=True),
        Row(Fault.DRIVE_NOT_FOLLOWING, _dropped_out, 0, DRIVE_GRACE_NS, _ON, ""),
        Row(Fault.DRIVE_REFUSES, FieldValue("drive_local"), 0, DRIVE_GRACE_NS, _ARMED, "", text=_LOCAL),
        Row(Fault.DRIVE_REFUSES, FieldValue("drive_limited"), 0, INTERNAL_LIMIT_NS, _ARMED, "", text=_LIMITS,
            bars=Bars.NEVER),
        Row(Fault.DRIVE_REFUSES, FieldValue("drive_ignores"), 0, DRIVE_GRACE_NS, _ARMED, "", lost, _IGNORES),
        Row(Fault.DRIVE_UNASKED, FieldValue("drive_not_requested"), 0, DRIVE_GRACE_NS, _UNASKED, "", lost, _ELSEWHERE),
        Row(Fault.DRIVE_UNASKED, FieldValue("drive_off_pending"), 0, LINGER_NS, _UNASKED, "", lost, LINGERS,
            bars=Bars.LASTING),
        Row(Fault.DRIVE_UNASKED, _powered_mm_s(stale), BRAKE_SLIP_MM_S, BRAKE_SLIP_NS, _UNMOVED, "mm/s", lost, _POWERED,
            bars=Bars.LASTING),
        Row(Fault.SIGN_DRIVE, FieldValue("signs.drive_reversed"), 0, 0, _TENSIONING, ""),
        Row(Fault.SIGN_CELL, FieldValue("signs.cell_reversed"), 0, 0, _TENSIONING, "", words=lambda x: x.signs.words),
        Row(Fault.CELL_INVALID, FieldValue("cell_quality"), 0, 0, _ARMED, ""),
        Row(Fault.INCLINATION_INVALID, FieldValue("inclination_quality"), 0, 0, _ARMED, ""),
        Row(Fault.TENSION_HIGH, _highest_n, s.tension_high_n, persist, _EVERY, "N"),
        Row(Fault.CELL_NEGATIVE, FieldValue("tension_n", -1.0), settings.slack_reading_n, NEGATIVE_NS, _ARMED, "N",
            sign=-1.0),
        Row(Fault.TENSION_LOW, FieldValue("tension_n", -1.0), -s.tension_low_n, persist, _REGULATED, "N", sign=-1.0),
        Row(Fault.TENSION_LOW, _lost_n, -settings.tension.slack_n, persist, _TENSIONING | _AT_REST, "N of a load",
            sign=-1.0),
        Row(Fault.CELL_STUCK, FieldValue("plausibility.cell_repeats"), stuck, 0, _ARMED, "samples"),
        Row(Fault.CELL_NOISY, FieldValue("plausibility.cell_unrest_n"), unrest_n, UNREST_NS, _ARMED, "N"),
        Row(Fault.SENSOR_EMERGENCY, FieldValue("sensor_emergency"), 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_EMERGENCY, FieldValue("drive_emergency"), 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_NOT_FOLLOWING, FieldValue("plausibility.speed_error_mm_s"), SPEED_ERROR_MM_S, SPEED_ERROR_NS,
            _ARMED, "mm/s", lost, SPEED),
        Row(Fault.DRIVE_NOT_FOLLOWING, _size("plausibility.stroke_error_mm"), STROKE_ERROR_MM, 0, _ARMED, "mm", lost,
            POSITION),
        Row(Fault.DRIVE_CONTRADICTS, _size("plausibility.contradiction_mm"), CONTRADICTION_MM, 0, _ARMED, "mm"),
        Row(Fault.STROKE_NOT_HELD, _size("stroke_hold.excursion_mm"), NOT_HELD_MM, NOT_HELD_NS, _HELD, "mm", lost),
        Row(Fault.POSITION_DRIFTS, _size("stroke_hold.corrected_mm"), CORRECTED_MM, 0, _AT_REST, "mm", lost),
        Row(Fault.STROKE_MOVES, _unbraked_mm_s(stale), BRAKE_SLIP_MM_S, BRAKE_SLIP_NS, _HELD, "mm/s", lost,
            words=_slack_words, bars=Bars.NEVER),
        Row(Fault.STROKE_MOVES, _sinks_mm_s, SINK_MM_S, SINK_NS, _HELD, "mm/s slowly", lost, words=_slack_words),
        Row(Fault.INNOVATION, FieldValue("rejects"), settings.estimator.reject_limit - 1, 0, _MOVING, "samples"),
        Row(Fault.INNOVATION, FieldValue("slope_rejects"), SLOPE_REJECTS - 1, 0, _MOVING, "slopes"),
        Row(Fault.INNOVATION, FieldValue("plausibility.cell_step_n"), 0, 0, _MOVING, "N at once"),
        Row(Fault.CELL_FROZEN, FieldValue("probe.cell_frozen"), 0, 0, _REGULATED, "", words=_probe_words),
        Row(Fault.ENCODER_STUCK, FieldValue("probe.encoder_stuck"), 0, 0, _REGULATED, "", Action.QUICK_STOP,
            words=_probe_words),
        Row(Fault.DRIVE_MOTIONLESS, FieldValue("probe.drive_motionless"), 0, 0, _REGULATED, "", lost,
            words=_probe_words),
        Row(Fault.ROPE_CHANGED, FieldValue("probe.rope_changed"), 0, 0, _REGULATED, "", words=_probe_words),
        Row(Fault.LOAD_UNSEEN, FieldValue("probe.travel.excess_n"), 0, UNSEEN_NS, _CLOSED, "N",
            words=lambda x: f"{x.probe.travel.unseen_n:.1f} N (limit {x.probe.travel.bound_n:.1f} N)"),
        Row(Fault.LOAD_UNSEEN, FieldValue("take_up.excess_n"), 0, 0, _TENSIONING, "N by current",
            words=lambda x: f"{x.take_up.rise_n:.1f} N by the motor's current, {x.take_up.shown_n:.1f} N by the cell "
            f"(limit {x.take_up.limit_n:.1f} N apart)"),
        Row(Fault.STRETCH_UNEXPLAINED, _size("plausibility.unexplained_mm"), UNEXPLAINED_MM, UNEXPLAINED_NS, _MOVING,
            "mm"),
        Row(Fault.STRETCH_UNEXPLAINED, _size("held_tension.stretched_mm"), stretch_limit_mm(settings), STRETCH_NS,
            _AT_REST, "mm at rest", lost),
        Row(Fault.STRETCH_UNEXPLAINED, _size("held_tension.growing_mm"), stretch_limit_mm(settings, GROWS_MM), GROWS_NS,
            _AT_REST, "mm growing", lost),
        Row(Fault.LOAD_SINKS, FieldValue("held_tension.sinks_n"), fall_n, SINKS_NS, _HELD, "N", text="is falling"),
        Row(Fault.LOAD_SINKS, FieldValue("held_tension.fallen_n"), fall_n, FALLEN_NS, _HELD, "N", text="has fallen",
            bars=Bars.NEVER),
        Row(Fault.STROKE_END, FieldValue("stroke_limited"), 0, STROKE_END_NS, _MOVING, ""),
        Row(Fault.DEVICE_RESTARTED, FieldValue("device_restarted"), 0, 0, _ARMED, ""),
        *_node_rows(settings),
        Row(Fault.OVERRUN, FieldValue("skipped_in_window"), s.overrun_ticks - 1, 0, _ARMED, "ticks"),
        *_rail_rows(settings),
        *_warmth_rows(settings),
        *_second_rows(settings),
    )  # fmt: skip


def _io_rows(settings: RigSettings) -> tuple[Row, ...]:
    """The I/O node's E-stop input has its own row: the drive's input may not be fitted and cannot replace it."""
    if settings.io is None:
        return ()
    unseen = Row(Fault.E_STOP_UNSEEN, FieldValue("io_age_ns"), settings.io.stale_ms * _MS, 0, _ARMED, "ns")
    if not settings.io.enable_block:
        return (unseen,)
    return unseen, Row(Fault.ENABLE_IGNORED, FieldValue("enable_ignored"), 0, ENABLE_NS, _ARMED, "")


def _status_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Without the drive's status neither its emergency stop input nor its temperature is known."""
    stale = status_stale_ns(settings)
    return (Row(Fault.STATUS_STALE, FieldValue("drive_status.age_ns"), stale, 0, _ARMED, "ns"),) if stale else ()


def _rail_rows(settings: RigSettings) -> tuple[Row, ...]:
    """The rail's angle serves feed-forward only, which stops without it; so its loss is logged and nothing else."""
    if (rail := settings.rail_encoder) is None:
        return ()
    ages: tuple[tuple[str, Callable[[Snapshot], float], float], ...] = (
        ("rail_age_ms", FieldValue("rail_age_ns"), stale_ns(rail)),
        ("rail_heartbeat_age_ms", _silence(rail.node), HEARTBEAT_SILENT_NS),
    )
    return tuple(
        Row(Fault.LIMIT, _in_ms(age), limit_ns / _MS, 0, _ARMED, "ms", Action.LOG, f"{name} above")
        for name, age, limit_ns in ages
    )


def _second_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Two paths that disagree: one is wrong, and the rig holds. A lost one is logged, and bars the next arming."""
    section = settings.second_force
    if section is None:
        return ()
    stale, node = section.stale_ms, section.node
    return (
        Row(Fault.FORCES_DISAGREE, _size("force_gap_n"), section.disagree_n, DISAGREE_NS, _ARMED, "N"),
        Row(Fault.LIMIT, _in_ms(FieldValue("second_age_ns")), stale, 0, _ARMED, "ms", Action.LOG,
            "second_force_age_ms above"),
        Row(Fault.LIMIT, FieldValue("second_quality"), 0, 0, _ARMED, "", Action.LOG, "second_force_quality above"),
        Row(Fault.LIMIT, _in_ms(_silence(node)), HEARTBEAT_SILENT_NS / _MS, 0, _ARMED, "ms", Action.LOG,
            "second_force_heartbeat_age_ms above"),
    )  # fmt: skip


def _second_lost(snapshot: Snapshot, settings: RigSettings) -> bool:
    section = settings.second_force
    if section is None:
        return False
    stale = snapshot.second_age_ns > section.stale_ms * _MS
    return stale or snapshot.second_quality != 0 or not snapshot.second_known


def _warmth_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Without a new temperature the zero stays where it is: a cell warms over minutes, so the loss is only logged."""
    if not settings.cell_temperature_divisor:
        return ()
    text = "cell_temperature_age_ms above"
    return (Row(Fault.LIMIT, _in_ms(FieldValue("warmth_age_ns")), WARMTH_MS, 0, _ARMED, "ms", Action.LOG, text),)


def _node_rows(settings: RigSettings) -> tuple[Row, ...]:
    """Heartbeats: a device may send samples and yet no heartbeat, or have left OPERATIONAL.

    A node that boots again sends its boot-up message and trips as DEVICE_RESTARTED.
    """
    rows = []
    for device, node in settings.canopen_nodes.items():
        if device not in ("rail_encoder", "second_force"):  # the loop works without them
            text = f"{_DEVICE_WORDS.get(device, device.replace('_', ' '))} (node {node})"
            rows.append(
                Row(Fault.NODE_NOT_OPERATIONAL, _silence(node), HEARTBEAT_SILENT_NS, 0, _ARMED, "ns", text=text)
            )
            rows.append(Row(Fault.NODE_NOT_OPERATIONAL, _wrong_state(node), 0, 0, _ARMED, "NMT state", text=text))
    return tuple(rows)


def _of_load(settings: RigSettings, age: str) -> Callable[[Snapshot], float]:
    """An age in ns while a load may be on the rope; a tension that is not known is one."""
    slack_n = settings.tension.slack_n
    return lambda x: 0.0 if x.tension_n < slack_n else getattr(x, age)


def _size(field: str) -> FieldValue:
    return FieldValue(field, magnitude=True)


def _in_ms(age: Callable[[Snapshot], float]) -> Callable[[Snapshot], float]:
    return lambda x: age(x) / _MS


def _silence(node: int) -> Callable[[Snapshot], float]:
    return lambda x: x.t_ns - x.heartbeats_t_ns.get(node, x.t_ns)


def _wrong_state(node: int) -> Callable[[Snapshot], float]:
    return lambda x: 0 if (state := x.node_states.get(node, _OPERATIONAL)) == _OPERATIONAL else state


def _unbraked_mm_s(stale_ns: int) -> Callable[[Snapshot], float]:
    """The last speed of a drive that has gone silent is no motion of the stroke."""
    return lambda x: (
        abs(x.speed_mm_s) if (x.drive_off or x.drive_faulted) and x.drive_age_ns <= stale_ns else 0.0
    )  # fmt: skip


def _sinks_mm_s(snapshot: Snapshot) -> float:
    """Of a load on the closed brake; a stroke that moves under a slack rope moves no load."""
    return abs(snapshot.sinking.speed_mm_s) if snapshot.sinking.left_mm else 0.0


def _slack_words(snapshot: Snapshot) -> str:
    """When a load that sinks will have left the rope slack."""
    sinks_mm_s = -snapshot.sinking.speed_mm_s if abs(snapshot.speed_mm_s) <= BRAKE_SLIP_MM_S else -snapshot.speed_mm_s
    if sinks_mm_s <= 0.0 or not snapshot.sinking.left_mm:
        return ""
    return f", the rope is slack in about {snapshot.sinking.left_mm / sinks_mm_s:.0f} s"


def _powered_mm_s(stale_ns: int) -> Callable[[Snapshot], float]:
    """Under power, see `_unbraked_mm_s`."""
    return lambda x: abs(x.speed_mm_s) if x.drive_powered and x.drive_age_ns <= stale_ns else 0.0


def _lost_n(snapshot: Snapshot) -> float:
    """Tension of a rope that carried a load and is slack, negative; as the row's limit is."""
    return -snapshot.tension_n if snapshot.rope_lost else -math.inf


def _moves_off_mm_s(snapshot: Snapshot) -> float:
    return abs(snapshot.speed_mm_s) if snapshot.drive_wanted and snapshot.drive_off else 0.0


def _dropped_out(snapshot: Snapshot) -> float:
    return snapshot.drive_wanted and not snapshot.drive_enabled


@dataclass(frozen=True)
class Trip:
    """A tripped row: its fault, the value found, the limit and the action; ``at_once``: see `Row`."""

    fault: Fault
    value: float
    limit: float
    action: Action = Action.HOLD
    text: str = ""
    at_once: bool = False


class RowReports(NamedTuple):
    """Rows that began to be bad (True) or ended, each with its trip: LOG rows, and the others.

    A LOG row that ends with NaN is not over: its mode does not watch it any more, or its signal has no value.
    """

    limits: tuple[tuple[Trip, bool], ...] = ()
    causes: tuple[tuple[Trip, bool], ...] = ()


class _Watched:
    """The rows watched in one mode, so arranged that a tick in which all of them are good costs little.

    Most rows compare a field of the snapshot. Each field has a range within which none of them is bad, so two
    comparisons of all fields at once replace a call for each row. The other rows are computed.
    """

    def __init__(self, rows: Sequence[Row], mode: Mode) -> None:
        self.rows = {i: row for i, row in enumerate(rows) if mode in row.modes}
        self.computed = {i: row.value for i, row in self.rows.items() if not isinstance(row.value, FieldValue)}
        self._limits = [self.rows[i].limit for i in self.computed]
        least: dict[str, float] = {}
        greatest: dict[str, float] = {}
        for row in self.rows.values():
            if isinstance(row.value, FieldValue):
                name, (low, high) = row.value.field, row.value.good_range(row.limit)
                if low > -math.inf:
                    least[name] = max(low, least.get(name, low))
                if high < math.inf:
                    greatest[name] = min(high, greatest.get(name, high))
        self._read_least, self._least = reader(least), tuple(least.values())
        self._read_greatest, self._greatest = reader(greatest), tuple(greatest.values())
        self._reads = tuple(self.computed.values())

    def compute(self, snapshot: Snapshot) -> list[float]:
        """Values of the ``computed`` rows; call it once a tick, because a rate is the change since the last call."""
        return list(map(call, self._reads, repeat(snapshot)))

    def may_be_bad(self, snapshot: Snapshot, computed: Sequence[float]) -> bool:
        """Whether a row is bad, or so near to it that its value has to be looked at."""
        return (
            any(map(gt, self._read_greatest(snapshot), self._greatest))
            or any(map(lt, self._read_least(snapshot), self._least))
            or any(map(gt, computed, self._limits))
        )


class Watch:
    """The table with the time since which each row has been bad."""

    def __init__(self, settings: RigSettings, limits: Sequence[Row] = ()) -> None:
        """``limits``: the rig file's rows."""
        self._rows = (*table(settings), *limits)
        self._watched = [_Watched(self._rows, mode) for mode in Mode]
        self._unwatched = [[i for i, row in enumerate(self._rows) if mode not in row.modes] for mode in Mode]
        self._mode: Mode | None = None
        self._since: dict[int, int] = {}  # time since which a row is bad, by its index; no entry for a good row
        self._logged = [False] * len(self._rows)
        self._left: set[int] = set()  # LOG rows that were bad when they were last watched
        self._look_again = False  # one of them is watched now
        self._quiet_until = [-LOG_AGAIN_NS] * len(self._rows)
        self._limits: list[tuple[Trip, bool]] = []  # not reported yet, as are the causes
        self._causes: list[tuple[Trip, bool]] = []
        self._active = [False] * len(self._rows)
        self.standing = 0  # bits of the faults of the rows that have been bad for their persistence, LOG rows excepted

    def look(self, snapshot: Snapshot, mode: Mode, t_ns: int) -> Trip | None:
        """Trip of the strongest row that has been bad for its persistence, the first among equals; None if none has."""
        if mode is not self._mode:
            self._mode = mode
            for i in self._unwatched[mode]:
                self._ends(i, seen=False)
            self._look_again = not self._left.isdisjoint(self._watched[mode].rows)
        watched = self._watched[mode]
        computed = watched.compute(snapshot)
        if self._since or self._look_again or watched.may_be_bad(snapshot, computed):
            return self._judge(watched, computed, snapshot, t_ns)
        return None

    def _judge(self, watched: _Watched, computed: Sequence[float], snapshot: Snapshot, t_ns: int) -> Trip | None:
        """`look` at each row, in a tick in which one may be bad or one was bad before."""
        strongest: Trip | None = None
        since, values = self._since, dict(zip(watched.computed, computed, strict=True))
        for i, row in watched.rows.items():
            value = values[i] if i in values else row.value(snapshot)
            if not value > row.limit:
                if i in since or i in self._left:
                    self._ends(i, seen=not math.isnan(value))
                continue
            if t_ns - since.setdefault(i, t_ns) < row.persistence_ns:
                continue
            if not self._logged[i] and t_ns >= self._quiet_until[i]:
                self._quiet_until[i] = t_ns + LOG_AGAIN_NS
                self._log(i, row.trip(value, snapshot), begins=True)
            if row.action is Action.LOG:
                continue
            if not self._active[i]:
                self._active[i] = True
                self.standing |= row.fault.bit
            if strongest is None or row.action > strongest.action:
                strongest = row.trip(value, snapshot)
        self._look_again = not self._left.isdisjoint(watched.rows)
        return strongest

    def strongest(self, snapshot: Snapshot, bits: int) -> Trip | None:
        """Trip of the strongest row of these faults that has been bad for its persistence; None if none has."""
        found = [row for row, active in zip(self._rows, self._active, strict=True) if active and bits & row.fault.bit]
        if not found:
            return None
        row = max(found, key=lambda one: one.action)
        return row.trip(row.value(snapshot), snapshot)

    def reports(self) -> RowReports:
        """Rows that began or ended since the last call."""
        if not (self._limits or self._causes):
            return _NOTHING
        found = RowReports(tuple(self._limits), tuple(self._causes))
        self._limits.clear()
        self._causes.clear()
        return found

    def beyond(self, snapshot: Snapshot, mode: Mode) -> set[Fault]:
        """Faults whose rows are bad now and would trip in ``mode`` after their persistence."""
        return {
            row.fault
            for row in self._rows
            if mode in row.modes and row.action is not Action.LOG and row.value(snapshot) > row.limit
        }

    def present(self, snapshot: Snapshot) -> Fault:
        """First cause present now, in any mode, that keeps a fault from being reset.

        A fault inside the drive does not, because the reset clears it; nor does a cause that only one mode can show.
        """
        return next(self._blocking(snapshot), Fault.NONE)

    def blocking(self, snapshot: Snapshot) -> int:
        """All causes present now that keep a fault from being reset, see `Fault.bit`."""
        found = 0
        for fault in self._blocking(snapshot):
            found |= fault.bit
        return found

    def _blocking(self, snapshot: Snapshot) -> Iterator[Fault]:
        for row, active in zip(self._rows, self._active, strict=True):
            if row.blocks_reset and (active or row.bars is Bars.AT_ONCE) and row.value(snapshot) > row.limit:
                yield row.fault

    def _ends(self, i: int, *, seen: bool = True) -> None:
        """End a row that is good again or, not ``seen``, whose signal nobody looks at or that has no value."""
        self._since.pop(i, None)
        if self._active[i]:
            self._active[i] = False
            self.standing = 0
            for row, active in zip(self._rows, self._active, strict=True):
                if active:
                    self.standing |= row.fault.bit
        row, logs = self._rows[i], self._rows[i].action is Action.LOG
        if self._logged[i] and not seen and logs:
            self._log(i, row.trip(math.nan), begins=False)
            self._left.add(i)
        elif seen and (self._logged[i] or i in self._left):
            self._log(i, row.trip(row.limit), begins=False)
        self._logged[i] = False

    def _log(self, i: int, trip: Trip, *, begins: bool) -> None:
        self._logged[i] = begins
        self._left.discard(i)
        (self._limits if self._rows[i].action is Action.LOG else self._causes).append((trip, begins))


_NOTHING = RowReports()
_IMPLAUSIBLE = having(Trait.CELL_IMPLAUSIBLE)
_EMERGENCY = having(Trait.EMERGENCY)
_LIMITED = having(Trait.OF_RIG_FILE)


def preflight(
    snapshot: Snapshot, settings: RigSettings, beyond: set[Fault], known: Check, *, near_end: bool = False
) -> Check:
    """Checks that fail now and so bar arming. ``beyond``: `Watch.beyond` of HOLD, the mode that arming leads to.

    ``known``: checks that no snapshot shows and that fail: of the host, the calibration, the drive's supervision.
    ``near_end``: the operator wants to drive away from an end of the stroke; the law lets it go no further outward.
    """
    s = settings.safety
    cylinder, margin_mm = settings.cylinder, settings.preflight.stroke_margin_mm
    low, high = cylinder.stroke_min_mm - STROKE_SPARE_MM, cylinder.stroke_max_mm + STROKE_SPARE_MM
    inside = cylinder.stroke_min_mm + margin_mm <= snapshot.stroke_mm <= cylinder.stroke_max_mm - margin_mm
    in_range = low <= snapshot.stroke_mm <= high
    failing = {
        Check.CELL_STALE: not snapshot.cell_heard,
        Check.CELL_INVALID: snapshot.cell_quality != 0,
        Check.INCLINATION_STALE: snapshot.inclination_age_ns > s.inclination_stale_ms * _MS,
        Check.INCLINATION_INVALID: snapshot.inclination_quality != 0,
        Check.DRIVE_STALE: not snapshot.drive_heard,
        Check.DRIVE_FAULT: snapshot.drive_faulted,
        Check.TENSION_HIGH: not _highest_n(snapshot) <= s.tension_high_n,
        Check.STROKE_RANGE: not in_range,
        Check.STROKE_NEAR_END: in_range and not inside and not near_end,
        Check.E_STOP: snapshot.e_stop & EStop.DRIVE,
        Check.E_STOP_IO: snapshot.e_stop & EStop.IO_NODE,
        Check.CELL_IMPLAUSIBLE: not beyond.isdisjoint(_IMPLAUSIBLE),
        Check.EMERGENCY: not beyond.isdisjoint(_EMERGENCY),
        Check.LIMIT: not beyond.isdisjoint(_LIMITED),
        Check.RIVAL: Fault.RIVAL in beyond,
        Check.STROKE_UNCONFIRMED: snapshot.stroke_unconfirmed,
        Check.E_STOP_UNSEEN: snapshot.drive_status.e_stop_unseen,
        Check.E_STOP_IO_UNSEEN: Fault.E_STOP_UNSEEN in beyond,
        Check.STATUS_STALE: Fault.STATUS_STALE in beyond,
        Check.DRIVE_REFUSES: Fault.DRIVE_REFUSES in beyond or snapshot.drive_not_requested,
        Check.ENABLE_IGNORED: Fault.ENABLE_IGNORED in beyond,
        Check.SECOND_FORCE: _second_lost(snapshot, settings),
        Check.FORCES_DISAGREE: Fault.FORCES_DISAGREE in beyond,
        Check.NODE_NOT_OPERATIONAL: Fault.NODE_NOT_OPERATIONAL in beyond,
    }
    result = known
    for check, fails in failing.items():
        if fails:
            result |= check
    return result
