"""Why a command is refused, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from rigctl.model.check_words import failed_checks
from rigctl.model.checks import Check
from rigctl.model.device_states import DriveState
from rigctl.model.faults import Fault, Trait, faults_of
from rigctl.model.quantity import significant
from rigctl.model.states import Mode
from rigctl.model.verbs import OFF_LIMIT_NS, STROKE_TOLERANCE_MM, TRIED_IN, Refusal, Verb


def refusal_text(
    refusal: Refusal,
    verb: Verb,
    mode: Mode,
    checks: int,
    fault: Fault,
    limits: tuple[float, float],
    value: float = math.nan,
    known: Mapping[Check, str] = MappingProxyType({}),
    standing: Mapping[Fault, str] = MappingProxyType({}),
) -> str:
    """Why a command was refused, in one line; ``value`` is the reply's, ``known`` as in `failed_checks`.

    ``standing``: causes present now, in words, the strongest first.
    """
    match refusal:
        case Refusal.ALREADY:
            slack = verb is Verb.LOWER or (verb is Verb.RELEASE and mode is Mode.HOLD)
            return "rope is slack already" if slack else f"already {mode.name}"
        case Refusal.PREFLIGHT:
            return "; ".join(failed_checks(checks, known)) + (_SILENT_HINT if checks & _UNSEEN else "")
        case Refusal.LOADED:
            return f"the rope is not unloaded: the cell reads {value:z.2f} N, more than calibration.tare_limit_n"
        case Refusal.OUT_OF_RANGE if verb.row.out_of_range:
            return verb.row.out_of_range
        case Refusal.OUT_OF_RANGE:
            return f"target must be {significant(limits[0])} to {significant(limits[1], 'N')}"
        case Refusal.STROKE_DIFFERS:
            return (
                f"the drive's position is {value:z.2f} mm, expected within {STROKE_TOLERANCE_MM:g} mm of the stroke "
                "measured: measure it again, or home the drive with its own tool"
            )
        case Refusal.CAUSE_PRESENT:
            there = faults_of(checks) or [fault]
            there.sort(key=lambda cause: list(standing).index(cause) if cause in standing else len(standing))
            words = [f"{cause.name} ({standing[cause]})" if cause in standing else cause.name for cause in there]
            return f"cause still present: {', '.join(words)}" + (
                _SILENT_HINT if any(Trait.DEVICE_SILENT in cause.traits for cause in there) else ""
            )
        case Refusal.WRONG_MODE:
            return f"{verb.name.lower()} is not possible in {mode.name}{_HINT.get((mode, verb), '')}"
        case Refusal.STOP_RUNNING:
            return f"the drive is still stopping or closing its brake ({value:.2f} mm/s): wait a second, then reset"
        case Refusal.DRIVE_TIMEOUT | Refusal.DRIVE_STATE | Refusal.OFF_UNSEEN:
            return _DRIVE_TEXT[refusal] + _drive_state(value)
        case Refusal.BRAKE_SLIPPED:
            return f"brake test: the stroke moved by {value:.2f} mm on the closed brake: secure the load"
        case _:
            return _PLAIN_TEXT.get(refusal, "unknown command").format(value)


_DRIVE_TEXT = {
    Refusal.DRIVE_TIMEOUT: "drive did not become enabled",
    Refusal.OFF_UNSEEN: f"not confirmed: the drive has not reported that it is off within {OFF_LIMIT_NS * 1e-9:g} s",
    Refusal.DRIVE_STATE: "the drive has not left its fault state, whose cause is still there",
}


def _drive_state(value: float) -> str:
    """The drive's state in words, for the end of a sentence; "" where none is known."""
    known = {float(state): state for state in DriveState}
    return f": it now reports {known[value].name.replace('_', ' ')}" if value in known else ""


_PLAIN_TEXT = {
    Refusal.CARRIED: "the motor carries the load for another {:.0f} s, because the brake does not hold it: rigctl "
    "lower, or rigctl disarm to try the brake, then reset",
    Refusal.SUNK: "the load has sunk by {:.1f} mm in the arms before, because the motor turns back when it takes it: "
    "support the payload from below until the rope is slack, arm, and let the motor have the load with tension; "
    "cylinder.rated_force_n gives the motor a preload",
    Refusal.DISAGREE: "encoder and tension disagree by {:.2f} mm on how the load moves: see at the rig which of them "
    "is right, then rigctl carry (or lower) --by encoder or --by cell",
    Refusal.STOPPING: "daemon is stopping",
    Refusal.EXPIRED: "command came too late and was not carried out",
    Refusal.ABORTED: "cut short by a command, a trip or a change of mode; nothing was changed",
    Refusal.UNSTEADY: "the stroke or the cell's reading moves: wait until everything is at rest",
    Refusal.NO_SAMPLES: "the cell gives no good samples",
    Refusal.SLACK: "the rope is slack",
    Refusal.NO_STEP: "no weight was hung on the cell, or taken off it, 2 s to 2 min after the command",
    Refusal.NO_LEARNING: "the rig file has no section learning, so nothing would be learnt from the move",
    Refusal.FAULT_LATCHED: "a limit has the tension ramped down; only hold stops that",
    Refusal.TIGHT: "the rope is tight: release without a length ramps the tension down",
    Refusal.NO_BRAKE: "the rig has no brake to test (cylinder.brake_waiver): the motor holds the load",
    Refusal.LITTLE_LOAD: "a brake test needs at least {:.0f} N on the rope to show that the brake holds: rigctl "
    "target, then rigctl tension, which ends in HOLD",
    Refusal.STRAYED: "tension or stroke left the bounds of the excitation, or would have; the excitation was ended",
    Refusal.UNFELT: "the stroke moved and the cell did not show it: look at cell and rope; the excitation was ended",
}
_UNSEEN = (
    Check.DRIVE_SUPERVISION
    | Check.CELL_STALE
    | Check.INCLINATION_STALE
    | Check.DRIVE_STALE
    | Check.E_STOP_IO_UNSEEN
    | Check.STATUS_STALE
    | Check.NODE_NOT_OPERATIONAL
)
_SILENT_HINT = " (a device that was switched off or a CAN interface that was unplugged needs the daemon started anew)"
_MOVES_STROKE = tuple(mode for mode in Mode if mode.moves_stroke)
_HINT: dict[tuple[Mode, Verb], str] = {
    **{(Mode.FAULT, verb): ": reset first" for verb in (Verb.ARM, Verb.TENSION, Verb.RELEASE, Verb.HOLD, *TRIED_IN)},
    **{(Mode.DISARMED, verb): ": arm first" for verb in (Verb.TENSION, Verb.RELEASE, Verb.HOLD, Verb.IDENTIFY)},
    (Mode.DISARMED, Verb.RESPONSE): ": arm and tension first",
    (Mode.HOLD, Verb.RESPONSE): ": tension first",
    **{(mode, verb): ": hold first" for mode in _MOVES_STROKE for verb in (Verb.DISARM, Verb.BRAKE_TEST, *TRIED_IN)},
    **{(mode, Verb.RELEASE): ": a length is paid out in HOLD" for mode in (Mode.TENSIONING, Mode.COMPENSATING)},
    (Mode.DISARMED, Verb.BRAKE_TEST): ": arm on a tight rope tests it",
    **{(mode, Verb.CONFIRM_STROKE): ": hold, then disarm first" for mode in _MOVES_STROKE},
    (Mode.HOLD, Verb.CONFIRM_STROKE): ": disarm first",
    **{(mode, Verb.RESET): ": there is no fault" for mode in Mode if mode is not Mode.FAULT},
}
