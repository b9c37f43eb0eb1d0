"""Residuals of a window: what the signals of different sensors say about one another before, at and after a trip.

Pure: a window in, numbers out. A residual that the records do not determine is NaN, and no row of the table takes it
for a sign.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.control.power.drive_power import CURRENT_SHARE
from rigctl.diagnosis.window import TripWindow
from rigctl.model import emergency
from rigctl.model.device_states import NmtState
from rigctl.model.events import Kind
from rigctl.model.faults import Fault, Trait
from rigctl.model.loop_event import LoopEvent
from rigctl.model.reactions import Symptom
from rigctl.model.states import Flag, HeldBy, Mode

Floats = npt.NDArray[np.float64]
_MS = 1_000_000
_NEAR_NS = 300 * _MS
"""What belongs to one incident: devices that are lost, restart or report within this time of the trip."""
_SETTLED_NS = 60 * _MS
"""After the trip: by then the drive has stopped, and the motor's current is that of the load at rest."""
_REFERENCE = 400
"""Samples at the beginning of the mode's part of the window that are the reference of the healthy rig."""
_BRAKED_NS = 300 * _MS
"""After the trip: a drive that was commanded off has stopped, and its brake has closed."""
_MOTION_NS = 60 * _MS
_FEW = 10
_AT_REST_MM_S = 0.5
_WEIGHS_SHARE = 0.4
"""Of the highest target: below it the friction of the screw is more of the current than the load."""
_SAMPLE_LATE_NS = 25 * _MS
_CARRIES = (HeldBy.NOTHING, HeldBy.MOTOR)


@dataclass(frozen=True)
class Residuals:
    """Figures about one trip. Lengths in mm, forces in N, times in ms, speeds in mm/s, angles in degrees."""

    fault: Fault
    text: str
    """Of the trip."""
    mode: Mode | None
    causes: frozenset[Fault]
    """All causes that came within 300 ms of the trip, its own among them."""
    stiffness_n_mm: float
    slack_n: float
    # The time of the loop and of the bus
    stalled_ms: float = 0.0
    """Longest time without a tick."""
    queued: float = 0.0
    """Ticks' worth of frames that came in one tick after a silence: they were kept somewhere, which no wire does."""
    crowd: float = 1.0
    """Frames a tick after the trip's onset over those before it."""
    lost_share: float = 0.0
    """Of the frames of the last half second before the trip."""
    # The devices
    silent: frozenset[str] = frozenset()
    """Devices whose samples have stopped."""
    booted: frozenset[str] = frozenset()
    left: frozenset[str] = frozenset()
    """Devices that have left OPERATIONAL without starting anew."""
    reported: frozenset[str] = frozenset()
    """Devices with an emergency message that stands."""
    bus_reported: bool = False
    """An emergency message is about communication (0x81xx), or the interface reports errors or does not send."""
    foreign: bool = False
    """Another master was heard, by its commands or by service requests."""
    device: str = ""
    """The device that the trip itself names."""
    unanswered: bool = False
    """The drive shows by no change of its state that it has taken the command to stop or to go off."""
    # Tension
    before_n: float = math.nan
    after_n: float = math.nan
    least_n: float = math.nan
    step_n: float = 0.0
    """Largest change of the tension from sample to sample in the 30 ms about the trip."""
    fall_ms: float = math.nan
    """Time in which the tension fell from 80 % of its reference to slack; NaN where it did not."""
    # Motor current: a second witness of the load, in the ratio that it had to the cell's reference
    current_n: float = math.nan
    """Load by the motor's current once it is at rest after the trip."""
    # Stroke
    gone_mm: float = 0.0
    """Stroke since the reference."""
    unexplained_mm: float = math.nan
    """Stretch by the tension that the stroke does not explain, since the reference; negative: tension lost."""
    command_mm_s: float = math.nan
    """Means over the last 60 ms before the trip: of the commands one lag earlier, ..."""
    speed_mm_s: float = math.nan
    """... of the reported speed, ..."""
    position_mm_s: float = math.nan
    """... of the rate of the position, ..."""
    stretch_mm_s: float = math.nan
    """... and of the rate of the tension over the stiffness; ..."""
    falls_mm_s: float = math.nan
    """... the same, positive where the tension falls."""
    later_mm_s: float = math.nan
    """The same once the drive was off after the trip; NaN where it stayed on."""
    speed_noise_mm_s: float = 0.0
    powered: bool = True
    off_with_a: float = 0.0
    """Motor current beside a state without power, at the trip; 0 where it is none."""
    # Inclination
    tilt_step_deg: float = 0.0
    tilt_deg: float = 0.0
    """Largest step from sample to sample, and largest angle off the reference."""


def residuals(window: TripWindow) -> Residuals:
    """All residuals of a window."""
    trip, settings = window.trip, window.settings
    fault = Fault.LOOP_EXCEPTION if trip.kind == Kind.EXCEPTION else _fault(trip.fields["fault"])
    near = [event for event in window.events if abs(event.t_ns - trip.t_ns) <= _NEAR_NS]
    causes = {_fault(e.fields["fault"]) for e in near if e.kind in (Kind.TRIP, Kind.CAUSE)} | {fault}
    figures: dict[str, object] = {
        "fault": fault, "text": _seen(trip), "causes": frozenset(causes), "slack_n": settings.tension.slack_n,
        "stiffness_n_mm": settings.plant.stiffness_n_mm, "mode": None,
        **_devices(window), "device": _named(window, fault),
    }  # fmt: skip
    if len(window.records) > 1:
        with np.errstate(all="ignore"):  # what is not a number stays none, and is no sign
            figures |= _time(window) | _signals(window)
    return Residuals(**figures)  # type: ignore[arg-type]


def _fault(found: Fault | int) -> Fault:
    return found if isinstance(found, Fault) else Fault.NONE


def _seen(trip: LoopEvent) -> str:
    """The loop's own words of a trip, or of the exception that stands for one."""
    return str(trip.fields["error" if trip.kind is Kind.EXCEPTION else "seen"])


def _devices(window: TripWindow) -> dict[str, object]:
    """Which devices restarted, left OPERATIONAL or report an error, and whether a foreign master was heard."""
    names = {node: name for name, node in window.settings.canopen_nodes.items()}
    trip_ns = window.trip.t_ns
    booted, left, reported = set(), set(), set()
    about_bus = foreign = unanswered = False
    for event in window.events:
        if event.t_ns < trip_ns - _NEAR_NS:
            continue
        name = names.get(event.fields.get("node", 0), "")
        if event.kind == Kind.NODE_STATE and event.t_ns <= trip_ns + _NEAR_NS:
            if event.fields["state"] == NmtState.BOOT_UP:
                booted.add(name)
            elif event.fields["state"] != NmtState.OPERATIONAL and event.t_ns <= trip_ns + _SHORTLY_NS:
                left.add(name)
        elif event.kind == Kind.EMERGENCY and emergency.stands(event.fields["code"], event.fields["register"]):
            if event.t_ns <= trip_ns + _SHORTLY_NS:
                reported.add(name)
                about_bus |= event.fields["code"] >> 8 == _COMMUNICATION
        elif event.kind in (Kind.BUS_ERROR, Kind.SEND_FAILED, Kind.RECEIVE_FAILED):
            about_bus |= event.t_ns <= trip_ns + _SHORTLY_NS
        elif event.kind == Kind.FOREIGN_SDO:
            foreign |= event.t_ns <= trip_ns + _SHORTLY_NS
        elif event.kind == Kind.ESCALATION:
            unanswered |= event.fields["symptom"] in (Symptom.STOP_UNANSWERED, Symptom.OFF_UNANSWERED)
    rival = any(e.kind in (Kind.TRIP, Kind.CAUSE) and e.fields["fault"] is Fault.RIVAL and e.t_ns <= trip_ns + _NEAR_NS
                for e in window.events)  # fmt: skip
    return {
        "booted": frozenset(booted), "left": frozenset(left - booted), "reported": frozenset(reported),
        "bus_reported": about_bus, "foreign": foreign or rival, "unanswered": unanswered,
    }  # fmt: skip


_SHORTLY_NS = 150 * _MS  # a heartbeat of 100 ms and some; the rig's own NMT stop comes later
_COMMUNICATION = 0x81


def _named(window: TripWindow, fault: Fault) -> str:
    """The device that the trip's own text, node or fault is about; "" for none."""
    names = {node: name for name, node in window.settings.canopen_nodes.items()}
    if Trait.EMERGENCY in fault.traits:
        value = window.trip.fields["value"]
        return names.get(int(value) >> 16, "") if math.isfinite(value) else ""  # of a damaged recording it may be any
    for node, name in names.items():
        if f"node {node}" in _seen(window.trip):
            return name
    return _OF_FAULT.get(fault, "")


_OF_FAULT = {
    Fault.CELL_STALE: "tension_cell", Fault.INCLINATION_STALE: "inclinometer", Fault.DRIVE_STALE: "cylinder",
    Fault.STATUS_STALE: "cylinder", Fault.E_STOP_UNSEEN: "io",
}  # fmt: skip


def _time(window: TripWindow) -> dict[str, object]:
    """Ticks that did not come, frames that came late at once, and samples that stopped."""
    records, trip_ns = window.records, window.trip.t_ns
    times, period_ns = records["t_ns"], window.settings.loop.period_ns
    steps = np.diff(times)
    held = (times[1:] > trip_ns - _NEAR_NS * 2) & (times[1:] <= trip_ns + _SHORTLY_NS)
    # A tick that is missed is skipped on the grid; a gap in what was recorded shows in seq and is no stall.
    whole = np.diff(records["seq"].astype(np.int64)) == 1
    for begun in (event for event in window.events if event.kind == Kind.STARTED):  # between two loops there is none
        whole &= (times[1:] < begun.t_ns) | (times[:-1] >= begun.t_ns)
    stalls = steps[held & whole]
    frames = np.diff(records["frames_received"].astype(np.int64)) / np.maximum(np.round(steps / period_ns), 1)
    usual = max(float(np.mean(frames[len(frames) // 8 : len(frames) // 2 + 1])), 1.0)
    quiet = np.convolve(np.diff(records["frames_received"].astype(np.int64)) == 0, np.ones(5), "full")[: len(frames)]
    after_quiet = np.concatenate([[False], quiet[:-1] >= 5])
    bursts = np.diff(records["frames_received"].astype(np.int64))[after_quiet & (steps < 3 * period_ns)]
    last = (times[1:] > trip_ns - 20 * _MS) & (times[1:] <= trip_ns + 20 * _MS) & (steps < 2 * period_ns)
    half = records[(times > trip_ns - 500 * _MS) & (times <= trip_ns)]
    lost, got = (_growth(half[name]) for name in ("frames_lost", "frames_received"))
    at = min(int(np.searchsorted(times, trip_ns)), len(records) - 1)
    slow = window.settings.safety.inclination_stale_ms * _MS
    ages = {"tension_cell": ("tension_age_ns", _SAMPLE_LATE_NS), "cylinder": ("drive_age_ns", _SAMPLE_LATE_NS),
            "inclinometer": ("inclination_age_ns", slow)}  # fmt: skip
    shortly = records[at : min(at + 30, len(records))]
    silent = {name for name, (field, late) in ages.items() if np.any(shortly[field] > min(late, 15 * _MS + late // 4))}
    return {
        "stalled_ms": (float(stalls.max()) - period_ns) / _MS if len(stalls) else 0.0,
        "queued": float(bursts.max()) / usual if len(bursts) else 0.0,
        "crowd": float(np.mean(frames[last])) / usual if last.any() else 1.0,
        "lost_share": lost / max(got + lost, 1),
        "silent": frozenset(silent),
    }


def _growth(counter: npt.NDArray[np.uint64]) -> int:
    return int(counter[-1]) - int(counter[0]) if len(counter) else 0


def _signals(window: TripWindow) -> dict[str, object]:
    """Tension, current, stroke and inclination against one another."""
    records, trip_ns = window.records, window.trip.t_ns
    times, tension = records["t_ns"], records["tension_n"].astype(np.float64)
    trip = min(int(np.searchsorted(times, trip_ns)), len(records) - 1)
    found: dict[str, object] = {}
    mode = int(records["mode"][max(trip - 1, 0)])
    first = trip
    while first > 0 and int(records["mode"][first - 1]) == mode and times[first] - times[first - 1] < 10 * _MS:
        first -= 1
    healthy = slice(first, min(first + _REFERENCE, max(trip - 30, first + 1)))
    found["mode"] = Mode(mode) if mode in list(Mode) else None
    reference_n = _median(tension[healthy])
    later = (times > trip_ns + 5 * _MS) & (times <= trip_ns + 300 * _MS)
    found |= {"before_n": reference_n, "after_n": _median(tension[later]),
              "least_n": float(np.nanmin(tension[max(trip - 5, 0) :], initial=math.inf))}  # fmt: skip
    about = tension[max(trip - 30, 0) : trip + 2]
    steps = np.abs(np.diff(about))
    found["step_n"] = float(np.nanmax(steps, initial=0.0))
    found["fall_ms"] = _fall_ms(times, tension, reference_n, window.settings)
    found |= _current(records, trip_ns, healthy, reference_n, window.settings)
    stiffness = window.settings.plant.stiffness_n_mm
    found["later_mm_s"] = _later_mm_s(records, trip_ns, stiffness)
    stroke, speed = records["stroke_mm"].astype(np.float64), records["speed_mm_s"].astype(np.float64)
    gone_mm = float(stroke[trip] - _median(stroke[healthy]))
    found["gone_mm"] = gone_mm if math.isfinite(gone_mm) else 0.0
    found["unexplained_mm"] = (tension[trip] - reference_n) / stiffness - gone_mm
    found["powered"] = bool(records["flags"][max(trip - 1, 0)] & Flag.DRIVE_ENABLED)
    found["off_with_a"] = _off_with_a(records[max(trip - 1, 0)], window.settings)
    found |= _motion(records, trip, window.settings)
    span = slice(max(trip - 200, 0), trip + 1)
    found["speed_noise_mm_s"] = float(np.sqrt(np.mean(np.diff(speed[span]) ** 2) / 2.0)) if trip > 2 else 0.0
    found |= _tilt(records, healthy, trip)
    return found


def _off_with_a(record: np.void, settings: RigSettings) -> float:
    current_a = abs(float(record["drive_current_a"]))
    flows = current_a > CURRENT_SHARE * (settings.cylinder.rated_current_a or math.inf)  # False for NaN
    return current_a if flows and record["flags"] & Flag.DRIVE_OFF else 0.0


def _median(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else math.nan


def _fall_ms(times: npt.NDArray[np.int64], tension: Floats, before_n: float, settings: RigSettings) -> float:
    slack_n = settings.tension.slack_n
    if not before_n > 4.0 * slack_n:
        return math.nan
    low = np.flatnonzero(np.abs(tension) < slack_n)
    low = low[low > 0]
    if not len(low):
        return math.nan
    end = int(low[0])
    high = np.flatnonzero(tension[:end] > 0.8 * before_n)
    return float(times[end] - times[high[-1]]) / _MS if len(high) else math.nan


def _current(
    records: npt.NDArray[np.void], trip_ns: int, healthy: slice, before_n: float, settings: RigSettings
) -> dict[str, object]:
    """The load by the motor's current, which carried ``before_n`` in the reference; friction is in both."""
    current, times = records["drive_current_a"].astype(np.float64), records["t_ns"]
    rest = np.abs(records["speed_mm_s"]) < _AT_REST_MM_S
    on = np.isin(records["held_by"], _CARRIES) & ((records["flags"] & Flag.DRIVE_ENABLED) != 0)
    usual_a = _median(current[healthy][on[healthy]])
    after = on & rest & (times > trip_ns + 2 * _SETTLED_NS)
    if not before_n > _WEIGHS_SHARE * settings.tension.target_max_n or not usual_a > 0.0:
        return {}
    return {"current_n": before_n * _median(current[after]) / usual_a}


def _motion(records: npt.NDArray[np.void], trip: int, settings: RigSettings) -> dict[str, object]:
    """Four witnesses of the motion just before the trip."""
    period_ns = settings.loop.period_ns
    ticks = max(round(_MOTION_NS / period_ns), 2)
    if trip <= ticks:
        return {}
    delay = round((settings.plant.cylinder_lag_s + settings.plant.command_delay_s) * 1e9 / period_ns)
    span = slice(trip - ticks, trip)
    lagged = slice(max(trip - ticks - delay, 0), max(trip - delay, 1))
    seconds = (records["t_ns"][trip] - records["t_ns"][trip - ticks]) * 1e-9
    stretch_mm_s = _rate(records["tension_n"][trip - ticks : trip + 1], seconds) / settings.plant.stiffness_n_mm
    return {
        "command_mm_s": float(np.mean(records["command_mm_s"][lagged])),
        "speed_mm_s": float(np.mean(records["speed_mm_s"][span])),
        "position_mm_s": float(records["stroke_mm"][trip] - records["stroke_mm"][trip - ticks]) / seconds,
        "stretch_mm_s": stretch_mm_s,
        "falls_mm_s": -stretch_mm_s,
    }


def _later_mm_s(records: npt.NDArray[np.void], trip_ns: int, stiffness: float) -> float:
    off = (records["flags"] & Flag.DRIVE_ENABLED) == 0
    rows = records[off & (records["t_ns"] > trip_ns + _BRAKED_NS) & (records["t_ns"] <= trip_ns + 2 * _BRAKED_NS)]
    if len(rows) < 2:
        return math.nan
    seconds = float(rows["t_ns"][-1] - rows["t_ns"][0]) * 1e-9
    return _rate(rows["tension_n"], seconds) / stiffness


def _rate(values: Floats, seconds: float) -> float:
    """Change a second, from the means of the first and the last samples: one sample's noise is as large as a creep."""
    few = max(min(_FEW, len(values) // 4), 1)
    share = (len(values) - few) / max(len(values) - 1, 1)
    return float(np.mean(values[-few:]) - np.mean(values[:few])) / (seconds * share)


def _tilt(records: npt.NDArray[np.void], healthy: slice, trip: int) -> dict[str, object]:
    steps, angles = [0.0], [0.0]
    for name in ("tangential_rad", "normal_rad"):
        values = np.degrees(records[name].astype(np.float64))
        steps.append(float(np.nanmax(np.abs(np.diff(values[max(trip - 300, 0) : trip + 2])), initial=0.0)))
        angles.append(abs(float(values[trip] - _median(values[healthy]))))
    return {"tilt_step_deg": max(steps), "tilt_deg": max(angles)}
