"""The catalogue of signals: what the loop records each tick, what a limit may watch of it, and what a person reads.

A signal is a row here and nowhere else. From the rows come the record (`rigctl.ipc.record.RECORD`), and with it the
wire schema, the state message, recordings, exports and a replay's comparison; what ``limits`` may watch, with refusals
and events; the lines of ``rigctl status``, ``rigctl watch`` and the page, and the metrics.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.presentation import Enumeration, MetricRow, Shown
from rigctl.model.samples import Quality, Verdict
from rigctl.model.states import Flag, HeldBy, LoadAtRest, Mode, PowerOff

CELL, INCLINOMETER, DRIVE, STATUS = "cell_age_ns", "inclination_age_ns", "drive_age_ns", "drive_status.age_ns"
"""Ages in the snapshot: of each device's newest sample, and of the drive's status (``cylinder.status_rate_hz``)."""


NEVER_AGE_NS = 1 << 60
"""A larger age means that no sample has come yet; messages and exports have null in its place."""


class Reading(NamedTuple):
    """A signal as limits see it: ``factor`` times a field of the loop's snapshot, or the magnitude of that."""

    place: int
    """In the lists of names that operators read."""
    name: str
    unit: str
    meaning: str
    snapshot: str
    """The field of `rigctl.control.snapshot.Snapshot`, with its group."""
    factor: float = 1.0
    magnitude: bool = False
    words: str = ""
    """What is missing when a device does not send it."""
    age: str = ""
    """The snapshot's age of the sample behind it; "" for what the loop itself knows."""
    fast: bool = False
    """A limit that acts on it only after seconds would protect nothing."""


class Signal(NamedTuple):
    """A field of the record: its struct code, unit ("" for none), meaning.

    Without a code it is not recorded: the state message derives it from others, or, without a name, it is only watched.
    """

    name: str = ""
    code: str = ""
    unit: str = ""
    meaning: str = ""
    exact: bool = False
    """A double that a recording keeps with 64 bits instead of 32."""
    limit: Reading | None = None
    enum: Enumeration | None = None
    device: str = ""
    """Whose sample it is, one of `DEVICES`: where that is bad, or a cause puts it in doubt, it is not to be trusted."""
    degrees: str = ""
    """Of an angle: the state's field for people, in degrees."""
    shown: Shown = Shown()
    metric: MetricRow | None = None

    @property
    def field(self) -> str:
        """The state's field that people read."""
        return self.degrees or self.name

    @property
    def field_unit(self) -> str:
        """Its unit."""
        return "deg" if self.degrees else self.unit


DEVICES = TENSION, ON_DRIVE, INCLINATION = "tension", "drive", "inclination"
"""The devices whose samples have a quality; the drive's are stroke, speed and whether it is on."""
_MODES, _FAULTS = (
    Enumeration("modes", Mode),
    Enumeration("faults", Fault, "latched fault's name, null without one", none=True),
)
_QUALITY, _VERDICTS = Enumeration("quality", Quality), Enumeration("verdicts", Verdict)
_HELD_BY = Enumeration(
    "held_by", HeldBy, "what carries the load: MOTOR, BRAKE, or the step between; NOTHING in a mode that moves"
)
_POWER_OFF = Enumeration(
    "power_off",
    PowerOff,
    "what shows that a drive commanded off is without power: INPUT, TENSION or STROKE, else AWAITED or "
    "UNCONFIRMED; null without such a command",
    none=True,
)
_LOAD_AT_REST = Enumeration(
    "load_at_rest",
    LoadAtRest,
    "what shows that the load has been at rest for 2 s: TENSION, STROKE or BOTH; else MOVES, or UNKNOWN if neither "
    "is seen",
)
_INCLINATION_RAD = "inclination_radians", "Inclination of the rope.", "axis"
_AGE_S = "sample_age_seconds", "Age of the newest sample.", "device"
_TEMPERATURE_C = "temperature_celsius", "Temperature of a device.", "device"
_FRAMES = "frames", "CAN frames since the loop's start.", "what"
_AGE = "age of that sample; null before the first one (in a record: above 2^60)"
_DEG = math.degrees(1.0)

# fmt: off
SIGNALS: tuple[Signal, ...] = (
    Signal("t_ns", "q", "ns", "grid point of the tick, CLOCK_MONOTONIC"),
    Signal("tick", "Q", "", "ticks on the grid since the loop started, skipped ones included",
           metric=MetricRow("ticks", "Periods of the loop since its start.", is_counter=True)),
    Signal("skipped", "Q", "", "ticks skipped so far because the one before ran over",
           metric=MetricRow("ticks_skipped", "Periods that the loop skipped since its start.", is_counter=True)),
    Signal(limit=Reading(19, "skipped_ticks", "ticks", "skipped within safety.overrun_window_ms", "skipped_in_window")),
    Signal("lateness_ns", "q", "ns", "wake-up after the grid point",
           limit=Reading(18, "lateness_us", "us", "of the tick against its grid", "lateness_ns", factor=1e-3)),
    Signal("work_ns", "q", "ns", "of the tick before, from its wake-up to its end"),
    Signal("mode", "B", "", "mode, see modes", enum=_MODES),
    Signal("held_by", "B", "", "what carries the load, see held_by; 0 in a mode that moves the stroke",
           enum=_HELD_BY),
    Signal("power_off", "B", "", "what shows that a drive commanded off is without power, see power_off; 0: no such "
           "command", enum=_POWER_OFF, shown=Shown("power off", status=70)),
    Signal("load_at_rest", "B", "", "what shows that the load has been at rest for 2 s, see load_at_rest",
           enum=_LOAD_AT_REST, shown=Shown("load at rest", status=80, part=40, inferred=True)),
    Signal("sink_mm_s", "d", "mm/s", "speed of the stroke on the closed brake, negative: the load sinks; 0 at rest"),
    Signal("slack_s", "d", "s", "time until the rope is slack at that speed; NaN for a load that does not sink"),
    Signal("end_s", "d", "s", "of an end that a load delays: time until it is lowered, 0 while it is; NaN for none"),
    Signal("slipped_n", "d", "N", "load at which the brake slipped, while it is known not to hold; NaN: unknown"),
    Signal("fault", "H", "", "latched fault, see faults; 0 none", enum=_FAULTS),
    Signal("flags", "H", "", "bits, see flags", enum=Enumeration("flags", Flag)),
    Signal("tension_n", "d", "N", "tension cell, along the rope",
           limit=Reading(1, "tension_n", "N", "tension of the rope, corrected", "tension_n", words="tension", age=CELL,
                       fast=True),
           device=TENSION,
           shown=Shown("tension", 2, status=10, line="{} (vertical {})", beside=("vertical_n",), style="bold"),
           metric=MetricRow("tension_newtons", "Tension of the rope at the cell.")),
    Signal(limit=Reading(2, "tension_rate_n_s", "N/s", "its rate of change, low-passed by 5 ms, absolute",
                       "plausibility.tension_rate_n_s", magnitude=True, words="tension rate", age=CELL, fast=True)),
    Signal("reading_n", "d", "N", "the same as the cell sends it, before zero and scale"),
    Signal("second_n", "d", "N", "tension by the second force path; NaN without one or its zero"),
    Signal("force_gap_n", "d", "N", "the same less the cell's tension, low-passed by 1 s"),
    Signal("fused_n", "d", "N", "what the second force path adds to the cell's tension"),
    Signal("creep_n", "d", "N", "creep of the cell taken out of the tension"),
    Signal("crept_1_n", "d", "N", "the load as the first term of the creep has followed it; NaN without a creep"),
    Signal("crept_2_n", "d", "N", "the same of the second term"),
    Signal("zero_drift_n", "d", "N", "the zero's drift with temperature since the tare, taken out of the reading"),
    Signal("cell_temperature_c", "d", "deg C", "temperature that the zero follows; NaN while it is not known",
           metric=MetricRow(*_TEMPERATURE_C, "cell")),
    Signal("tension_age_ns", "q", "ns", _AGE,
           limit=Reading(13, "cell_age_ms", "ms", "age of the newest tension sample", "cell_age_ns", factor=1e-6),
           metric=MetricRow(*_AGE_S, "cell")),
    Signal("tension_quality", "B", "", "bits, see quality; 0 good", enum=_QUALITY),
    Signal("tangential_rad", "d", "rad", "rope inclination along the move",
           limit=Reading(4, "tangential_deg", "deg", "inclination of the rope along the move", "tangential_rad",
                       factor=_DEG, words="tangential inclination", age=INCLINOMETER, fast=True),
           device=INCLINATION, degrees="tangential_deg", shown=Shown("tangential", 2, sign=True, value=40, finer=1),
           metric=MetricRow(*_INCLINATION_RAD, "tangential")),
    Signal("normal_rad", "d", "rad", "rope inclination along the rail",
           limit=Reading(5, "normal_deg", "deg", "inclination of the rope along the rail", "normal_rad", factor=_DEG,
                       words="normal inclination", age=INCLINOMETER, fast=True),
           device=INCLINATION, degrees="normal_deg", shown=Shown("normal", 2, sign=True, value=50, finer=1),
           metric=MetricRow(*_INCLINATION_RAD, "normal")),
    Signal("inclination_age_ns", "q", "ns", _AGE,
           limit=Reading(14, "inclination_age_ms", "ms", "age of the newest inclination", "inclination_age_ns",
                       factor=1e-6),
           metric=MetricRow(*_AGE_S, "inclinometer")),
    Signal("inclination_quality", "B", "", "bits, see quality; 0 good", enum=_QUALITY),
    Signal("stroke_mm", "d", "mm", "cylinder stroke, positive shortens the rope",
           limit=Reading(6, "stroke_mm", "mm", "stroke of the cylinder, positive = shorter rope", "stroke_mm",
                       words="stroke", age=DRIVE, fast=True),
           device=ON_DRIVE,
           shown=Shown("stroke", 2, status=40, value=20, strip=30, span=5.0, line="{}, {}", beside=("speed_mm_s",)),
           metric=MetricRow("stroke_meters", "Stroke of the cylinder, positive shortens the rope.")),
    Signal(limit=Reading(7, "travel_mm", "mm", "stroke since COMPENSATING began, less what the set-point has moved, "
                       "absolute; 0 unless COMPENSATING", "travel_mm", magnitude=True, words="travel", age=DRIVE,
                       fast=True)),
    Signal("speed_mm_s", "d", "mm/s", "cylinder speed",
           limit=Reading(8, "speed_mm_s", "mm/s", "speed the drive reports", "speed_mm_s", words="cylinder speed",
                       age=DRIVE, fast=True),
           device=ON_DRIVE, shown=Shown("speed", 2, sign=True, value=30, strip=40, span=2.0),
           metric=MetricRow("speed_meters_per_second", "Speed of the cylinder.")),
    Signal("drive_age_ns", "q", "ns", _AGE,
           limit=Reading(15, "drive_age_ms", "ms", "age of the newest word from the drive", "drive_age_ns",
                         factor=1e-6),
           metric=MetricRow(*_AGE_S, "drive")),
    Signal("drive_quality", "B", "", "bits, see quality; 0 good", enum=_QUALITY),
    Signal("statusword", "H", "", "CiA 402 statusword 0x6041"),
    Signal(limit=Reading(12, "drive_warning", "", "1 while the drive warns (statusword bit 7)", "drive_warning",
                       words="drive warning", age=DRIVE)),
    Signal("controlword", "H", "", "CiA 402 controlword 0x6040 sent"),
    Signal("command_mm_s", "d", "mm/s", "speed sent to the drive", exact=True,
           metric=MetricRow("command_meters_per_second", "Speed sent to the drive.")),
    Signal("excitation_mm_s", "d", "mm/s", "speed added to the command on purpose, by a trial or the margins' probe"),
    Signal("sensitivity_peak", "d", "",
           "sensitivity peak of the running loop, measured over a minute of COMPENSATING; NaN before the first",
           limit=Reading(25, "sensitivity_peak", "",
                         "measured sensitivity peak less its uncertainty at 95 %; 0 before the first", "least_peak"),
           metric=MetricRow("sensitivity_peak_ratio", "Measured peak of the running loop's sensitivity.")),
    Signal("sensitivity_peak_error", "d", "", "its uncertainty at 95 %"),
    Signal("target_n", "d", "N", "vertical tension the operator wants",
           shown=Shown("target", 1, status=30, value=10),
           metric=MetricRow("target_newtons", "Vertical tension that the operator wants.")),
    Signal("setpoint_n", "d", "N", "rope tension the law holds now"),
    Signal("vertical_n", "d", "N", "vertical component of the measured tension", device=TENSION,
           shown=Shown("tension, vertical", 2, strip=10, span=10.0),
           metric=MetricRow("vertical_tension_newtons", "Vertical component of the tension.")),
    Signal("error_n", "", "N", "vertical_n - target_n while COMPENSATING, else null", device=TENSION,
           shown=Shown("vertical error", 3, sign=True),
           metric=MetricRow("error_newtons", "Vertical tension less its target, while COMPENSATING.")),
    Signal("error_pct", "", "%", "its magnitude over the target, while COMPENSATING, else null", device=TENSION,
           shown=Shown("vertical error", 3, strip=20, span=2.0)),
    Signal(limit=Reading(3, "vertical_error_n", "N",
                       "vertical tension less its set-point, absolute; 0 where nothing is regulated",
                       "vertical_error_n", magnitude=True, words="vertical error", age=CELL, fast=True)),
    Signal("estimate_n", "d", "N", "estimated tension"),
    Signal("estimate_mm_s", "d", "mm/s", "estimated cylinder speed"),
    Signal("disturbance_mm_s", "d", "mm/s", "estimated disturbance speed",
           limit=Reading(9, "disturbance_mm_s", "mm/s", "speed of the rope's ends as the filter finds it, absolute",
                       "disturbance_mm_s", magnitude=True, words="disturbance speed", age=CELL, fast=True),
           metric=MetricRow("disturbance_meters_per_second", "Estimated speed of the rope's ends.")),
    Signal("integral_mm_s", "d", "mm/s", "integral action"),
    Signal("innovation_n", "d", "N", "innovation of the tension"),
    Signal("innovation_n2", "d", "N^2", "its variance"),
    Signal("tension_verdict", "B", "", "what became of the sample, see verdicts", enum=_VERDICTS),
    Signal(limit=Reading(16, "rejects", "samples",
                       "consecutive samples of cell or drive that the innovation gate refused", "rejects")),
    Signal("tension_nis", "d", "", "running mean of the squared innovation over its variance; 1 fits the model",
           limit=Reading(17, "cell_nis", "",
                       "running mean of the cell's normalised innovation squared: 1 for a filter that fits",
                       "cell_nis")),
    Signal("speed_innovation_mm_s", "d", "mm/s", "innovation of the cylinder speed"),
    Signal("speed_innovation_mm2_s2", "d", "mm^2/s^2", "its variance"),
    Signal("speed_verdict", "B", "", "what became of the sample, see verdicts", enum=_VERDICTS),
    Signal("speed_nis", "d", "", "running mean, as of the tension"),
    Signal("tangential_estimate_rad", "d", "rad", "estimated inclination along the move"),
    Signal("tangential_rate_rad_s", "d", "rad/s", "its rate"),
    Signal("normal_estimate_rad", "d", "rad", "estimated inclination along the rail"),
    Signal("normal_rate_rad_s", "d", "rad/s", "its rate"),
    Signal("tangential_innovation_rad", "d", "rad", "innovation of the inclination along the move"),
    Signal("tangential_innovation_rad2", "d", "rad^2", "its variance"),
    Signal("tangential_verdict", "B", "", "what became of the sample, see verdicts", enum=_VERDICTS),
    Signal("tangential_nis", "d", "", "running mean, as of the tension"),
    Signal("normal_innovation_rad", "d", "rad", "innovation of the inclination along the rail"),
    Signal("normal_innovation_rad2", "d", "rad^2", "its variance"),
    Signal("normal_verdict", "B", "", "what became of the sample, see verdicts", enum=_VERDICTS),
    Signal("normal_nis", "d", "", "running mean, as of the tension"),
    Signal("stretch_mm_s", "d", "mm/s", "disturbance speed known from the inclination"),
    Signal("frames_sent", "Q", "", "frames sent so far", metric=MetricRow(*_FRAMES, "sent", is_counter=True)),
    Signal("frames_received", "Q", "", "frames received so far",
           metric=MetricRow(*_FRAMES, "received", is_counter=True)),
    Signal("frames_lost", "Q", "", "device frames that did not come, so far",
           metric=MetricRow(*_FRAMES, "lost", is_counter=True)),
    Signal("frames_refused", "Q", "", "frames with a wrong length or a non-finite value, so far",
           metric=MetricRow(*_FRAMES, "refused", is_counter=True)),
    Signal("send_failures", "Q", "", "unsent frames, so far: the bus did not take them",
           metric=MetricRow(*_FRAMES, "failed", is_counter=True)),
    Signal("error_frames", "Q", "", "CAN error frames seen so far",
           metric=MetricRow(*_FRAMES, "error", is_counter=True)),
    Signal(limit=Reading(20, "error_frames", "frames", "CAN error frames within the last second", "error_frames")),
    Signal("rail_rad", "d", "rad", "angle of the rail's shaft, -pi up to pi"),
    Signal("rail_quality", "B", "", "bits, see quality; 0 good; NEVER where no encoder is fitted",
           enum=_QUALITY),
    Signal("run_out_mm_s", "d", "mm/s", "disturbance speed known from the run-out table"),
    Signal("learned_mm_s", "d", "mm/s", "speed added to the command by what earlier moves have taught"),
    Signal("move", "B", "", "number of the marked move under way, 0 none"),
    Signal("drive_current_a", "d", "A", "motor current; NaN while it is not known",
           limit=Reading(11, "drive_current_a", "A",
                       "of the motor, absolute; a limit on it is a fault while it does not come",
                       "drive_status.current_a", magnitude=True, words="motor current", age=STATUS),
           device=ON_DRIVE, shown=Shown("motor current", 2, part=50),
           metric=MetricRow("drive_current_amperes", "Motor current.")),
    Signal("drive_temperature_c", "d", "deg C", "of the drive; NaN while it is not known",
           limit=Reading(10, "drive_temperature_c", "deg C",
                       "of the drive; a limit on it is a fault while it does not come",
                       "drive_status.temperature_c", words="drive temperature", age=STATUS),
           device=ON_DRIVE, shown=Shown("drive temperature", part=60), metric=MetricRow(*_TEMPERATURE_C, "drive")),
    Signal("checks", "Q", "", "preflight checks that fail, bits, see checks; not looked at while armed",
           enum=Enumeration("checks", Check)),
    Signal("command_seq", "Q", "", "sequence number of the last slot the loop has taken from the command ring"),
    Signal(limit=Reading(21, "command_age_s", "s", "since an operator gave the last command", "command_age_ns",
                       factor=1e-9)),
    Signal("hold_seq", "Q", "", "sequence number of the last slot the loop has taken from the ring of holds"),
    Signal("cause_bits", "Q", "",
           "causes of a fault that stand now, bits, see cause_bits; the state words them"),
)
# fmt: on
"""In the order of the record."""

RECORDED = tuple(signal for signal in SIGNALS if signal.code)
UNRECORDED = tuple(signal for signal in SIGNALS if signal.name and not signal.code)
"""Derived from a record by the state message."""
SHOWN = {signal.field: signal for signal in SIGNALS if signal.shown.label}
"""By the state's field that people read."""
ANGLES = tuple(signal for signal in SIGNALS if signal.degrees)
ENUMS = {signal.name: signal.enum for signal in SIGNALS if signal.enum is not None}
NAMED = {name: enum for name, enum in ENUMS.items() if enum.named}
"""By signal: enumerations whose names the state message has."""
WATCHED = {watch.name: watch for watch in sorted(signal.limit for signal in SIGNALS if signal.limit is not None)}
