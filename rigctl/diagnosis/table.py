"""The table of what each fault shows: the first row whose signs are there names the part.

A row has the faults it may be behind (all where none is named), the sign that the residuals must show, the part, a
second candidate and the question that decides where signals cannot, what is wrong in one sentence, and the first thing
to do. That thing is safe whichever candidate it is: nobody is sent to the load while it may be loose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rigctl.diagnosis.part import AT_THE_LOAD, OF_DEVICE
from rigctl.diagnosis.residuals import Residuals
from rigctl.model.faults import Fault, Trait, having
from rigctl.model.parts import Part
from rigctl.model.states import Mode

Sign = Callable[[Residuals], bool]
STALL_MS = 4.0
"""A computer that lets the loop wait so long has disturbed more than one device can show."""
QUEUED_TICKS = 5.0
"""Frames of so many ticks at once have waited in a queue: the wire has none, a stalled computer has."""
LONG_STALL_MS, LONG_QUEUED_TICKS = 20.0, 20.0
"""From here on the drive, which goes on at its last speed meanwhile, is away from its commands by more than a lag."""
BREAKS_MM_S = 500.0
"""No payload leaves the rope faster: what unloads it so fast is the rope or the spring."""
LIFT_MM_S = 200.0
"""A tension that changes faster in one sample than a payload moves is not the payload's."""
CONTRADICTS = 0.4
"""Share of the load by which cell and motor current must differ: friction of the screw is half of that."""
FALLS_MM_S = 0.3
CREEPS_MM_S = 4.0
"""A cell may drift more slowly than this; a rope that slips or a payload that is lifted is mostly faster."""
AT_REST_MM_S = 0.12
TILT_STEP_DEG = 1.5
"""From sample to sample: a rope that swings by 5 degrees changes by 0.2 in 10 ms."""
NOISY_MM_S = 1.5
CROWDED = 1.22
"""Frames a tick over those before: one more to the six of a tick is 1.17, two are 1.33."""
LOST_SHARE = 0.01


@dataclass(frozen=True)
class Clue:
    """One line of the table."""

    part: Part
    says: str
    """A template of the residuals' fields."""
    first: str
    shows: Sign
    faults: frozenset[Fault] = frozenset()
    second: Part | None = None
    question: str = ""

    def matches(self, found: Residuals) -> bool:
        """Whether this row is the one, if none before it is."""
        return (not self.faults or found.fault in self.faults) and self.shows(found)


_KEEP_OUT = "Keep out from under the load and leave it as it is; look from outside whether the rope hangs loose."
_FREE = "Keep out from under the load; free the payload, from beside it, of what caught it."
_STAY = "Keep out from under the load."
_RESTART = "Start the daemon anew once the cause is found: it writes all settings again."
_F = Fault
_TENSION, _UNSEEN = having(Trait.SHOWN_BY_TENSION), having(Trait.SHOWN_BY_WAY)
_MOTION, _ABOUT_A_DEVICE = having(Trait.SHOWN_BY_MOTION), having(Trait.SHOWN_BY_DEVICE)
_BY_TIME = _ABOUT_A_DEVICE | {_F.BUS_SILENT, _F.SYNC_LOST, _F.DRIVE_FAULT, _F.DRIVE_UNASKED}
_BY_LONG_WAIT = _MOTION | {_F.INNOVATION, _F.STROKE_NOT_HELD}


def _always(_: Residuals) -> bool:
    return True


# -- Time and bus -------------------------------------------------------------------------------------------------


def _stalled(x: Residuals) -> bool:
    return x.fault is _F.OVERRUN or _waited(x, x.stalled_ms, STALL_MS, LONG_STALL_MS)


def _queued(x: Residuals) -> bool:
    return _waited(x, x.queued, QUEUED_TICKS, LONG_QUEUED_TICKS)


def _waited(x: Residuals, waited: float, short: float, long: float) -> bool:
    """A wait explains the fault: frames or commands that are late, after a long one a drive that does not follow.

    What the cell reads is no matter of time: of a rope that breaks while the computer is busy, the rope is to blame.
    Nor is one device that stays silent, where the others are heard again.
    """
    if x.fault in _BY_TIME and len(x.silent) != 1:
        return waited >= short
    return waited >= long and x.fault in _BY_TIME | _BY_LONG_WAIT


def _foreign(x: Residuals) -> bool:
    return x.foreign or x.fault is _F.RIVAL


def _several_silent(x: Residuals) -> bool:
    return len(x.silent & {"tension_cell", "cylinder"}) == 2 or len(x.booted) > 1


def _frames_go_missing(x: Residuals) -> bool:
    return x.bus_reported and x.lost_share > LOST_SHARE


# -- Devices ------------------------------------------------------------------------------------------------------


def of_device(x: Residuals) -> str:
    """The device that restarted, left its state, reported an error or fell silent; "" for none or several."""
    for names in ({x.device} - {""}, x.booted, x.left, x.reported, x.silent):
        if len(names) == 1:
            return next(iter(names))
    return ""


def _device(name: str) -> Sign:
    return lambda x: of_device(x) == name


# -- Tension ------------------------------------------------------------------------------------------------------


def _weighs(x: Residuals) -> bool:
    return x.current_n == x.current_n and x.before_n > 0.0


def motor_denies(x: Residuals) -> bool:
    """The motor's current shows another load than the cell."""
    return _weighs(x) and abs(x.current_n - x.after_n) > CONTRADICTS * x.before_n


def motor_agrees(x: Residuals) -> bool:
    """The motor's current has followed a large change of the cell."""
    changed = abs(x.after_n - x.before_n) > CONTRADICTS * x.before_n
    return _weighs(x) and changed and not motor_denies(x)


def _gone(x: Residuals) -> bool:
    """The tension has fallen to that of a slack rope, and stays there."""
    return x.fall_ms == x.fall_ms and abs(x.after_n) < x.slack_n


def _snapped(x: Residuals) -> bool:
    return _gone(x) and x.before_n / x.stiffness_n_mm / max(x.fall_ms, 1e-3) * 1e3 > BREAKS_MM_S


def _no_rope_does(x: Residuals) -> bool:
    """A step within one sample to another load: neither rope nor payload changes so fast and stops there."""
    step_mm_s = x.step_n / x.stiffness_n_mm * 1e3
    return step_mm_s > LIFT_MM_S and x.after_n == x.after_n and x.least_n > x.slack_n


def _pushes(x: Residuals) -> bool:
    return x.after_n < -x.slack_n or x.least_n < -x.slack_n


def _falls(x: Residuals) -> bool:
    return x.stretch_mm_s - min(x.position_mm_s, 0.0) < -FALLS_MM_S


def _rises(x: Residuals) -> bool:
    return x.stretch_mm_s - max(x.position_mm_s, 0.0) > FALLS_MM_S


def _encoder_denies(x: Residuals) -> bool:
    """HOLD or the law moves the load, and the position that it wants to keep does not show it."""
    if _rests(x.command_mm_s) or not _rests(x.position_mm_s):
        return False
    return 0.5 < x.stretch_mm_s / x.command_mm_s < 3.0


def _stops_with_motor(x: Residuals) -> bool:
    """The tension changed at a rate while the motor was on, and no more once it was off."""
    moved = abs(x.stretch_mm_s) > max(FALLS_MM_S, 3.0 * abs(x.position_mm_s))
    moved = moved and x.step_n < x.stiffness_n_mm * LIFT_MM_S * 1e-3
    return moved and abs(x.later_mm_s) < 0.25 * abs(x.stretch_mm_s) and not _gone(x)


def _unseen(x: Residuals) -> bool:
    """The stroke has gone a way that the tension does not show."""
    return abs(x.gone_mm) > 0.4 and abs(x.unexplained_mm) > 0.5 * abs(x.gone_mm)


def _leans(x: Residuals) -> bool:
    return "_deg" in x.text or (x.fault is _F.LOAD_UNSEEN and x.tilt_deg > 2.0)


def _about(*signals: str) -> Sign:
    return lambda x: any(name in x.text for name in signals)


def _repeats(x: Residuals) -> bool:
    return x.fault is _F.CELL_STUCK and not _gone(x)


# -- Motion -------------------------------------------------------------------------------------------------------


def _rests(speed_mm_s: float) -> bool:
    return abs(speed_mm_s) < AT_REST_MM_S


def _contradict(x: Residuals) -> bool:
    """Position and speed of the drive, which one encoder measures, tell two stories."""
    apart = abs(x.position_mm_s - x.speed_mm_s)
    return apart > 0.3 * max(abs(x.position_mm_s), abs(x.speed_mm_s), 1.0)


def _only_speed_follows(x: Residuals) -> bool:
    """The drive's speed is that commanded, and the rate of its position is another."""
    if _rests(x.command_mm_s) or abs(x.speed_mm_s - x.command_mm_s) > 0.1 * abs(x.command_mm_s):
        return False
    return abs(x.position_mm_s - x.speed_mm_s) > 0.15 * abs(x.speed_mm_s)


def _braked(x: Residuals) -> bool:
    """The drive moves as commanded, but more slowly: a brake can do no more than that."""
    return abs(x.speed_mm_s) < abs(x.command_mm_s) and x.speed_mm_s * x.command_mm_s > 0.0


def _moves_unfelt(x: Residuals) -> bool:
    """The position has changed on a tight rope, and the tension has not."""
    tight = x.before_n > 2.0 * x.slack_n and x.after_n > 2.0 * x.slack_n
    return tight and abs(x.gone_mm) > 0.05 and abs(x.unexplained_mm) > 0.6 * abs(x.gone_mm)


def _moves_slack(x: Residuals) -> bool:
    """The rope pulled neither before nor after: no load can move the cylinder."""
    return abs(x.before_n) < x.slack_n and abs(x.after_n) < x.slack_n


def _creeps(x: Residuals) -> bool:
    """The command does not move the stroke, and the tension is kept: without the command the drive would creep.

    On a ramp of the tension the command would change it, were the motor turning.
    """
    kept = x.mode in (Mode.COMPENSATING, Mode.HOLD)
    return kept and _motionless(x) and abs(x.stretch_mm_s) < 0.3 * abs(x.command_mm_s)


def _motionless(x: Residuals) -> bool:
    return _rests(x.position_mm_s) and _rests(x.speed_mm_s) and not _rests(x.command_mm_s)


TABLE: tuple[Clue, ...] = (
    Clue(Part.E_STOP, "The emergency stop was pressed.", "Find who pressed it and why before it is released.",
        _always, frozenset({_F.E_STOP})),
    Clue(Part.PROCESS, "The loop ended in an exception of its own: {text}.",
        "Keep the trip dump and report it; nothing at the rig is known to be wrong.",
        _always, frozenset({_F.LOOP_EXCEPTION})),
    Clue(Part.MASTER, "Another master or tool gives commands on this bus ({text}).",
        "Find it and disconnect it before anything moves.", _foreign),
    Clue(Part.COMPUTER, "This computer let the loop stand still for {stalled_ms:.0f} ms.",
        "Run rigctl doctor on this computer: real-time rights and other load; the rig needs nothing.", _stalled),
    Clue(Part.COMPUTER, "The frames of {queued:.0f} ticks came at once: this computer, or the process that serves the "
        "bus, stood still; a cable keeps no frames.",
        "Run rigctl doctor on this computer; the cable and its termination need nothing.", _queued),
    Clue(Part.BUS, "SYNC does not reach the devices, and other frames do: {fault_words}.",
        "Find what keeps SYNC from them, away from the load: cable, gateway, a second node with its identifier.",
        _always, frozenset({_F.SYNC_LOST})),
    Clue(Part.BUS, "Several devices fell silent at once: the bus, its interface or the devices' supply.",
        "Check the CAN interface, cable, termination and the devices' power, away from the load.", _several_silent,
        frozenset(_ABOUT_A_DEVICE | {_F.BUS_SILENT, _F.DRIVE_FAULT, _F.DRIVE_UNASKED})),
    Clue(Part.BUS, "Frames go missing on the bus ({lost_share:.1%} of the last half second's).",
        "Check cable, plugs and termination of the bus, away from the load.", _frames_go_missing),
    Clue(Part.BUS, "The bus carries no frames.",
        "Check the CAN interface, cable, termination and the devices' power, away from the load.", _always,
        frozenset({_F.BUS_SILENT})),
    Clue(Part.BUS, "The interface counts error frames.", "Check cable, plugs and termination of the bus.",
        _about("error_frames"), frozenset({_F.LIMIT})),
    Clue(Part.COMPUTER, "This computer woke the loop late.", "Run rigctl doctor on this computer.",
        _about("lateness", "skipped"), frozenset({_F.LIMIT})),
    *(Clue(part, words, first, _device(name), _ABOUT_A_DEVICE) for name, part, words, first in (
        ("tension_cell", OF_DEVICE["tension_cell"], "The cell's amplifier fails to report: {fault_words}.",
         f"{_STAY} The load hangs as it did; then check the amplifier's power and cable."),
        ("inclinometer", OF_DEVICE["inclinometer"], "The inclinometer fails to report: {fault_words}.",
         f"{_STAY} The load hangs as it did; then check the inclinometer's power and cable."),
        ("cylinder", OF_DEVICE["cylinder"], "The drive fails to report, or reports an error: {fault_words}.",
         f"{_STAY} Read the drive's display; check its power and cable."),
        ("io", OF_DEVICE["io"], "The I/O node fails to report: {fault_words}.",
         "Check the I/O node's power and cable, away from the load."),
        ("second_force", OF_DEVICE["second_force"], "The second force path fails to report: {fault_words}.",
         f"{_STAY} Then check its power and cable."),
    )),
    Clue(Part.DRIVE, "The drive is not heard, so nothing shows that it has gone off.",
        f"{_STAY} Check the drive's power and cable, away from the load.", lambda x: "cylinder" in x.silent,
        frozenset({_F.DRIVE_UNASKED})),
    Clue(Part.IO_NODE, "The I/O node is silent, and the drive's enable has gone with it.",
        "Check the I/O node's power and cable, away from the load.",
        lambda x: bool({_F.E_STOP_UNSEEN, _F.ENABLE_IGNORED} & x.causes), frozenset({_F.DRIVE_NOT_FOLLOWING})),
    Clue(Part.IO_NODE, "The drive's hard-wired enable does not act: relay, wire or feedback.",
        f"{_STAY} Lock the drive out, then check relay and wire of its enable.", _always,
        frozenset({_F.ENABLE_IGNORED, _F.E_STOP_UNSEEN})),
    # The drive, its encoder and the brake
    Clue(Part.DRIVE, "A setting of the drive is not what start-up wrote.", f"{_STAY} {_RESTART}",
        lambda x: _F.SUPERVISION_LOST in x.causes, _MOTION),
    Clue(Part.DRIVE, "The drive shows no answer to a command to stop or to switch off.",
        f"{_STAY} Lock the drive out, then switch it off and on again.", lambda x: x.unanswered,
        frozenset({_F.ENCODER_STUCK, _F.DRIVE_MOTIONLESS, _F.DRIVE_UNASKED})),
    Clue(Part.ENCODER, "The drive's position jumped or was counted anew: {fault_words}.",
        "Measure the stroke at the cylinder once the drive is locked out, then rigctl confirm-stroke MM.", _always,
        frozenset({_F.STROKE_JUMPED, _F.DRIVE_CONTRADICTS})),
    Clue(Part.ENCODER, "The drive's speed signal is noise of {speed_noise_mm_s:.1f} mm/s.",
        f"{_STAY} Lock the drive out, then check its encoder.", lambda x: x.speed_noise_mm_s > NOISY_MM_S, _MOTION),
    Clue(Part.DRIVE, "The drive reports that it is not in operation, without a command.",
        f"{_STAY} Read the drive's display.", lambda x: not x.powered,
        frozenset({_F.DRIVE_NOT_FOLLOWING})),
    Clue(Part.ENCODER, "Position ({position_mm_s:.1f} mm/s) and speed ({speed_mm_s:.1f} mm/s) of the drive contradict "
        "each other.", f"{_STAY} Lock the drive out, then check its encoder.", _contradict, _MOTION),
    Clue(Part.ENCODER, "The tension follows the commands ({command_mm_s:.1f} mm/s), and the drive's position does not.",
        f"{_STAY} Lock the drive out, then check its encoder.", _encoder_denies,
        frozenset({_F.DRIVE_NOT_FOLLOWING, _F.INNOVATION})),
    Clue(Part.DRIVE, "{command_mm_s:.1f} mm/s are commanded, neither position nor tension changes: the drive creeps "
        "against the commands, or it follows them and its encoder is stuck.",
        f"{_STAY} Lock the drive out; check its encoder and its velocity offset (0x60B1).", _creeps,
        frozenset({_F.DRIVE_NOT_FOLLOWING}), Part.ENCODER, "has the stroke moved, against a mark on the cylinder?"),
    Clue(Part.DRIVE, "The drive does not move though {command_mm_s:.1f} mm/s are commanded: motor or brake.",
        f"{_STAY} Read the drive's display.", _motionless, frozenset({_F.DRIVE_NOT_FOLLOWING, _F.INNOVATION}),
        Part.BRAKE, "does the brake open, with a click, when the drive comes on?"),
    Clue(Part.ENCODER, "The drive's speed is the {command_mm_s:.1f} mm/s commanded, its position changes by "
        "{position_mm_s:.1f} mm/s.", f"{_STAY} Lock the drive out, then check its encoder.", _only_speed_follows,
        frozenset({_F.DRIVE_NOT_FOLLOWING})),
    Clue(Part.DRIVE, "The drive moves at {speed_mm_s:.1f} mm/s where {command_mm_s:.1f} mm/s are commanded: motor or "
        "brake.", f"{_STAY} Lock the drive out; read its display.", _braked, frozenset({_F.DRIVE_NOT_FOLLOWING}),
        Part.BRAKE, "did the brake close, with a click, while the drive was on?"),
    Clue(Part.DRIVE, "The drive moves at {speed_mm_s:.1f} mm/s where {command_mm_s:.1f} mm/s are commanded.",
        f"{_STAY} Lock the drive out; read its display.", _always, frozenset({_F.DRIVE_NOT_FOLLOWING, _F.SIGN_DRIVE})),
    Clue(Part.DRIVE, "The drive reports that it is off while its motor carries {off_with_a:.2f} A.",
        f"{_STAY} Lock the drive out: its own report of being off is wrong.", lambda x: x.off_with_a > 0.0,
        frozenset({_F.DRIVE_UNASKED})),
    Clue(Part.MASTER, "The drive was enabled or moved without this program's command.",
        f"{_STAY} Find the tool or panel that commands the drive, and withdraw it.", _always,
        frozenset({_F.DRIVE_UNASKED}), Part.DRIVE, "is a service tool or panel connected to the drive?"),
    Clue(Part.DRIVE, "The drive reports that it does not do as commanded: {fault_words}.",
        f"{_STAY} Read the drive's display; withdraw its panel or service tool.", _always,
        frozenset({_F.DRIVE_REFUSES}), Part.MASTER, "is a service tool or panel connected to the drive?"),
    Clue(Part.DRIVE, "The drive reports a fault of its own: {fault_words}.", f"{_STAY} Read the drive's display.",
        _always, frozenset({_F.DRIVE_FAULT, _F.DRIVE_MOTIONLESS})),
    Clue(Part.ENCODER, "The drive's encoder does not show the motion that the tension shows.",
        f"{_STAY} Secure the load, then check the drive's encoder.", _always, frozenset({_F.ENCODER_STUCK})),
    Clue(Part.ENCODER, "The position has changed by {gone_mm:.2f} mm on the closed brake, and the tension does "
        "not show it.",
        f"{_STAY} Lock the drive out, then check its encoder.", _moves_unfelt,
        having(Trait.BRAKE_FAILS)),
    Clue(Part.ENCODER, "The position moves on the closed brake, and the rope is slack: no load moves it.",
        f"{_STAY} Lock the drive out, then check its encoder.", _moves_slack,
        having(Trait.BRAKE_FAILS), Part.BRAKE, "does the cylinder move, against a mark on it?"),
    Clue(Part.BRAKE, "The closed brake lets the load down: {fault_words}.",
        f"{_STAY} rigctl carry has the motor hold the load, rigctl lower lowers it.", _always,
        having(Trait.BRAKE_FAILS)),
    Clue(Part.ENCODER, "Holding the stroke takes ever more correction: the encoder drifts, or the drive creeps.",
        f"{_STAY} Read the drive's display.", _always, frozenset({_F.POSITION_DRIFTS}), Part.DRIVE,
        "has the load moved, against a mark on the cylinder?"),
    Clue(Part.ENCODER, "The stroke left its place by {position_mm_s:.1f} mm/s, and the drive's speed is "
        "{speed_mm_s:.1f} mm/s.", f"{_STAY} Lock the drive out, then check its encoder.", _contradict,
        frozenset({_F.STROKE_NOT_HELD})),
    Clue(Part.DRIVE, "The stroke left its place while it was held: the drive creeps, or the brake slips.",
        _STAY, _always, frozenset({_F.STROKE_NOT_HELD}), Part.BRAKE, "was the motor on or the brake closed?"),
    # The inclinometer
    Clue(Part.INCLINOMETER, "The inclination jumped by {tilt_step_deg:.1f} degrees, which no rope does.",
        f"{_STAY} The load hangs as it did; then check the inclinometer's mounting and cable.",
        lambda x: x.tilt_step_deg > TILT_STEP_DEG),
    Clue(Part.INCLINOMETER, "The inclination has changed by {tilt_deg:.1f} degrees.",
        f"{_STAY} Look from outside whether the rope leans; if it does not, check the inclinometer.", _leans,
        second=Part.PAYLOAD, question="does the rope lean by so much?"),
    Clue(Part.INCLINOMETER, "The inclinometer reports that it cannot measure.",
        f"{_STAY} The load hangs as it did; then check the inclinometer's mounting and range.", _always,
        frozenset({_F.INCLINATION_INVALID})),
    # Tension: cell and amplifier, rope and spring, payload
    Clue(Part.MASTER, "More frames come than the devices send while the cell's reading jumps: another device uses its "
        "node number.", "Find the second device with the cell's node number and disconnect it.",
        lambda x: x.crowd > CROWDED and x.step_n > x.slack_n, _TENSION),
    Clue(Part.CELL, "The two force paths disagree: one of them is wrong.", f"{_STAY} The load hangs as it did.",
        _always, frozenset({_F.FORCES_DISAGREE}), Part.SECOND_FORCE, "which of them shows a known weight?"),
    Clue(Part.AMPLIFIER, "The cell's amplifier says that it has no valid value.",
        f"{_STAY} The load hangs as it did; then check cell, cable and amplifier.", _always,
        frozenset({_F.CELL_INVALID})),
    Clue(Part.AMPLIFIER, "The cell's amplifier repeats its last value, {after_n:.1f} N.",
        f"{_STAY} The load hangs as it did; then check the amplifier.", _repeats, _TENSION),
    Clue(Part.AMPLIFIER, "The cell reads {least_n:.0f} N, but a rope cannot push: sign or scale of the amplifier.",
        f"{_STAY} The load hangs as it did; then check the amplifier's settings.", _pushes, _TENSION),
    Clue(Part.CELL, "The cell shows {after_n:z.0f} N, and the motor still carries about {current_n:.0f} N: the cell, "
        "its cable or its amplifier.", f"{_STAY} The load hangs as it did; then check cell, cable and amplifier.",
        motor_denies, _TENSION),
    Clue(Part.CELL, "The cell's reading is noise.", f"{_STAY} The load hangs as it did; then check the cell's cable "
        "and shield.", _always, frozenset({_F.CELL_NOISY})),
    Clue(Part.CELL, "The cell's reading changed by {step_n:.0f} N from one sample to the next, which neither rope nor "
        "payload can do.", f"{_STAY} The load hangs as it did; then check cell, cable and amplifier.", _no_rope_does,
        _TENSION),
    Clue(Part.ROPE, "The tension fell from {before_n:.0f} N to nothing within {fall_ms:.0f} ms and the motor carries "
        "nothing: rope or spring has broken, or slipped out of its clamp.", _KEEP_OUT,
        lambda x: _snapped(x) and motor_agrees(x), _TENSION),
    Clue(Part.ROPE, "The tension fell from {before_n:.0f} N to nothing within {fall_ms:.0f} ms: rope or spring has "
        "broken, or the cell's cable.", _KEEP_OUT, _snapped, _TENSION, Part.CELL, "does the rope hang loose?"),
    Clue(Part.ENCODER, "The tension follows the commands ({command_mm_s:.1f} mm/s), and its position does not.",
        f"{_STAY} Lock the drive out, then check its encoder.", _encoder_denies, _TENSION),
    Clue(Part.DRIVE, "The tension changed at {stretch_mm_s:.1f} mm/s of stretch until the drive was off: its motor "
        "moved, and its encoder did not show it.", f"{_STAY} Lock the drive out; read its display.", _stops_with_motor,
        _TENSION),
    Clue(Part.ROPE, "The tension falls by {falls_mm_s:.1f} mm/s of stretch that the stroke does not explain.",
        _KEEP_OUT, lambda x: _falls(x) and x.stretch_mm_s < -CREEPS_MM_S, _TENSION, Part.PAYLOAD,
        "has the payload moved, or the rope in its clamp?"),
    Clue(Part.ROPE, "The tension falls by {falls_mm_s:.1f} mm/s of stretch that the stroke does not explain.",
        _KEEP_OUT, _falls, _TENSION, Part.CELL, "has the rope moved in its clamp, or the payload?"),
    Clue(Part.ROPE, "The stroke's end came before the tension: the rope is too long or too short for it.",
        f"{_STAY} Bring the stroke back: release, or arm --near-end.", lambda x: x.mode is not Mode.COMPENSATING,
        frozenset({_F.STROKE_END})),
    Clue(Part.PAYLOAD, "The payload went further than the stroke reaches.", _KEEP_OUT, _always,
        frozenset({_F.STROKE_END})),
    Clue(Part.CELL, "The motor carries a load that the cell does not show: {text}.",
        f"{_STAY} The rope is tight. Check the cell against a known weight once the load is secured.",
        _about("motor's current"), frozenset({_F.LOAD_UNSEEN})),
    Clue(Part.ROPE, "The rope was shortened by {gone_mm:.1f} mm and the tension does not show it: the rope slips, "
        "the payload rises, or the cell is wrong.", _KEEP_OUT, lambda x: _unseen(x) and x.gone_mm > 0.0, _UNSEEN,
        Part.CELL, "has the rope moved in its clamp, or the payload?"),
    Clue(Part.PAYLOAD, "The rope was paid out by {gone_mm:.1f} mm and the tension does not show it: the payload "
        "sinks, or the cell is wrong.", _KEEP_OUT, _unseen, _UNSEEN, Part.CELL, "has the payload moved by so much?"),
    Clue(Part.PAYLOAD, "The tension and the motor's current rise, and the stroke does not explain it: the payload "
        "is caught or pulled.", _FREE, lambda x: _rises(x) and motor_agrees(x), _TENSION),
    Clue(Part.PAYLOAD, "The tension rises by {stretch_mm_s:.1f} mm/s of stretch that the stroke does not explain.",
        _FREE, _rises, _TENSION, Part.CELL, "has the payload moved?"),
    Clue(Part.CELL, "Tension and stroke do not fit the plant: the cell's sign or scale, or the stiffness in the file.",
        f"{_STAY} Check sign and scale against a known weight before the next load.", _always,
        frozenset({_F.SIGN_CELL, _F.CELL_FROZEN})),
    Clue(Part.ROPE, "The tension was lost.", _KEEP_OUT, _always, frozenset({_F.ROPE_CHANGED})),
    Clue(Part.ROPE, "The tension was lost, or the cell reads too little.", _KEEP_OUT, _always,
        frozenset({_F.TENSION_LOW}), Part.CELL, "does the rope hang loose?"),
    Clue(Part.BRAKE, "The tension falls on the closed brake.", _KEEP_OUT, _always, frozenset({_F.LOAD_SINKS}),
        Part.PAYLOAD, "has the payload or the rail been moved?"),
    *(Clue(fault.part, "{fault_words}.", f"{_STAY} {fault.remedy}" if fault.part in AT_THE_LOAD else fault.remedy,
           _always, frozenset({fault})) for fault in Fault if fault.part is not None),
)  # fmt: skip
"""In this order; the first row that matches is the one. The last are of faults that name their part themselves."""


def suspects(fault: Fault) -> tuple[Part, ...]:
    """The parts that a fault may be about, as long as nothing else is known of it."""
    clues = [clue for clue in TABLE if fault in clue.faults]
    return tuple(dict.fromkeys(part for clue in clues for part in (clue.part, clue.second) if part is not None))
