"""Drive, brake and load as one machine: its stages as tables, and the one immutable value that the loop has of it.

The words are those of IEC 61800-5-2 (STO, SS1, SOS, SBC, SBT) and of PLCopen's MC_Power. `after` is the only function
that changes a stage. `decide` finds what ends the wait of a command, before the law; `power` what the drive is
commanded in this tick, after it. All are functions of their arguments alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import Any, NamedTuple

from rigctl.control import modes
from rigctl.control.power.arming import NOT_PREPARED, ArmingStep, Preparation
from rigctl.devices.drive import Power
from rigctl.model.reactions import Action
from rigctl.model.states import Event, HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb

ARM_LIMIT_NS = 2_000_000_000
"""Time a drive has to become enabled: by ARM, and when the motor takes the load back from the brake."""
CUT_AFTER_NS = 60_000_000  # the power of a drive that has not stopped by then is cut while it moves
DRIVE_RESET_NS = 1_000_000_000
"""Time a drive has to leave its fault state after a RESET."""
KEPT_NS = 600_000_000_000
"""For so long the motor keeps a load that the brake does not hold, where no operator has stated a time."""
RESET_WORD_NS = 25_000_000
"""How long each of the two words of a fault reset is sent: drives read their controlword each 1 to 16 ms."""


class DriveStage(Enum):
    """Stage of drive, brake and load. The value is its meaning, for docs/modes.md."""

    OFF = "STO and SBC: the drive is seen off, its brake closed"
    STOP = "SS1, then SBC: the stroke comes to rest, the drive closes its brake and goes off"
    RUN = "the motor has the load: it moves the stroke, or holds it (SOS)"
    QUICK = "the drive stops on its own ramp, closes its brake and goes off, whatever the loop commands else"
    CUT = "STO: the power is cut, which closes the brake"
    SILENT = "the power is cut by SDO, then nothing is sent to the drive: its own supervision stops it"
    PREPARE = "a command waits for an off drive, a stroke at rest and the brake test (SBT); the power is as before"
    ENABLE = "the drive is commanded on: its motor takes the load from the brake"
    RESET = "the drive's own fault is being reset"


class Input(Enum):
    """What leads from one stage to another. The value is its meaning, for docs/modes.md."""

    NEEDED = "a command is accepted that needs the motor"
    PREPARED = "all that is awaited has come, the brake has held"
    TAKEN_BACK = (
        "the brake slips in its first second, in `brake-test`, or in the test of `arm` once it is known not to hold"
    )
    ENABLED = "the drive is enabled"
    NOT_ENABLED = "not enabled in its time, with a fault latched"
    KEPT = "the motor keeps a load that it was to give to a brake known not to hold"
    LOWERED = "the motor lowers the load"
    WITHDRAWN = "the command is refused, aborted, or ended by a trip"
    DRIVE_RESET = "`reset` of a drive in its own fault"
    RESET = "the latched fault is reset"
    PARKED = "the brake is to take the load: parking, `disarm`, `brake-test`, or an end of the process"
    SEEN_OFF = "the drive is seen off, its brake closed"
    SEEN_ON = "it is not seen so any more"
    QUICK_STOPPED = "a trip with `quick_stop` or `power_off`"
    CUT_DUE = "`power_off`, and the drive's time to stop is over"
    SILENCED = "a trip with `silence`"


_O, _S, _R, _Q, _C, _N = (
    DriveStage.OFF, DriveStage.STOP, DriveStage.RUN, DriveStage.QUICK, DriveStage.CUT, DriveStage.SILENT
)  # fmt: skip
STEPS = DriveStage.PREPARE, DriveStage.ENABLE, DriveStage.RESET
"""A command waits in these. The stage before them is kept: a command that is withdrawn leaves it."""
_ENDS_STEP = frozenset({Input.ENABLED, Input.NOT_ENABLED, Input.RESET, Input.QUICK_STOPPED, Input.SILENCED})

STAGES: dict[tuple[DriveStage, Input], DriveStage] = {
    **{(stage, Input.NEEDED): DriveStage.PREPARE for stage in (_O, _S, _Q, _C)},
    **{(stage, Input.DRIVE_RESET): DriveStage.RESET for stage in (_O, _S, _R, _Q, _C)},
    (_O, Input.TAKEN_BACK): DriveStage.ENABLE,
    (_S, Input.TAKEN_BACK): DriveStage.ENABLE,
    (DriveStage.PREPARE, Input.PREPARED): DriveStage.ENABLE,
    (DriveStage.ENABLE, Input.ENABLED): _R,
    (DriveStage.ENABLE, Input.NOT_ENABLED): _Q,
    (_O, Input.SEEN_ON): _S,
    (_S, Input.SEEN_OFF): _O,
    (_R, Input.PARKED): _S,
    (_Q, Input.RESET): _S,
    (_C, Input.RESET): _S,
    **{(stage, Input.QUICK_STOPPED): _Q for stage in (_O, _S, _R)},
    (_Q, Input.CUT_DUE): _C,
    **{(stage, Input.SILENCED): _N for stage in (_O, _S, _R, _Q, _C)},
}
"""An input without a row changes no stage. While a command waits, it may also change the stage that is kept."""


_POWER_OF = {
    _O: Power.OFF, _S: Power.OFF, _R: Power.ON, _Q: Power.QUICK_STOP, _C: Power.CUT, _N: Power.QUICK_STOP
}  # fmt: skip


NO_VALUES: Mapping[str, float] = MappingProxyType({})


class Accepted(NamedTuple):
    """A command that is accepted, and what is known of it until it is answered.

    ``id`` is None where no operator has given it: it has no answer. ``values``: by the names of
    `rigctl.model.verbs.VALUES`. ``event``: of the modes, once it is carried out. ``carry_ns``: of a CARRY. ``test``:
    state of what goes before the drive's power. ``since_ns``: when it came, where the motor takes the load from the
    brake for it. ``taken_s``: how long that took; NaN: it does not, or not yet. ``found``: figures of a trial that has
    ended, by the names of their fields in the reply.
    """

    id: int | None
    verb: Verb
    event: Event | None = None
    values: Mapping[str, float] = NO_VALUES
    carry_ns: int = 0
    test: Preparation = NOT_PREPARED
    since_ns: int | None = None
    taken_s: float = math.nan
    found: Mapping[str, float] = NO_VALUES


@dataclass(frozen=True)
class Sequence:
    """Where drive, brake and load are, and what is under way. The fields without a default are derived.

    ``base``: the stage while no command waits for another. ``step``: the stage in which a command waits.
    ``command``: the one that waits for the drive. ``until_ns``: by when it has to be carried out, or the process to
    end. ``tried``: the trial. ``action``: reaction to the latched fault; it may grow stronger while the fault is
    latched, and weaker only by CARRY and LOWER. ``cut_ns``: from when `power_off` cuts the power. ``since_ns``: when
    OFF or SILENT began. ``armed``: by ARM, and neither disarmed nor taken off power since, so that a reset leads to
    HOLD. ``carry_until_ns``: in HOLD and FAULT the motor holds until then and then lowers the load, because the brake
    does not hold; 0: no. ``ends``: the process ends. ``anew``: a reset of the silence is accepted: the loop ends, and
    start-up brings all devices up again.
    """

    base: DriveStage = DriveStage.STOP
    step: DriveStage | None = None
    command: Accepted | None = None
    tried: Accepted | None = None
    until_ns: int = 0
    action: Action = Action.HOLD
    cut_ns: int = 0
    since_ns: int = 0
    armed: bool = False
    carry_until_ns: int = 0
    ends: bool = False
    anew: bool = False

    stage: DriveStage = field(init=False)
    pending: Verb | None = field(init=False)
    """The accepted command that waits for the drive."""
    preparing: bool = field(init=False)
    """It waits for what goes before the drive's power."""
    taking: bool = field(init=False)
    """The drive is commanded on, so that the motor takes the load from the brake."""
    resetting: bool = field(init=False)
    """A RESET waits for the drive to leave its fault state; the fault stays latched until then."""
    trial: Verb | None = field(init=False)
    """The trial under way."""
    disarming: bool = field(init=False)
    """A DISARM waits for the drive to be off, its brake closed."""
    motor: bool = field(init=False)
    """The motor has the load, so the drive has to be enabled."""
    off: bool = field(init=False)
    """The drive is seen off, its brake closed, since the brake was to take the load."""
    carries: bool = field(init=False)
    """The motor carries or lowers a load that the brake does not hold, or is being switched on to."""
    silent: bool = field(init=False)
    """Nothing is sent to the drive any more, until start-up has brought it up again."""
    commanded: Power = field(init=False)
    """Power to command, but for what the drive's own state changes."""

    def __post_init__(self) -> None:
        step, verb = self.step, None if self.command is None else self.command.verb
        made: dict[str, Any] = {
            "stage": self.base if step is None else step,
            "pending": None if step is None else verb,
            "preparing": step is DriveStage.PREPARE,
            "taking": step is DriveStage.ENABLE,
            "resetting": step is DriveStage.RESET,
            "trial": None if self.tried is None else self.tried.verb,
            "disarming": verb is Verb.DISARM,
            "motor": self.base is DriveStage.RUN,
            "off": self.base is DriveStage.OFF,
            "carries": self.carry_until_ns > 0 or (step is not None and verb in modes.CARRIES),
            "silent": self.base is DriveStage.SILENT,
            "commanded": Power.ON if step is DriveStage.ENABLE else _POWER_OF[self.base],
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)


def after(at: Sequence, input_: Input, t_ns: int, **changes: Any) -> Sequence:
    """The sequence after an input at ``t_ns``, with other ``changes`` of its fields."""
    kept = STAGES.get((at.base, input_))
    to = STAGES.get((at.stage, input_)) or (kept if kept not in STEPS else None)
    if input_ is Input.WITHDRAWN or (at.step is not None and input_ in _ENDS_STEP):
        changes = {"step": None, "command": None, **changes}
    if to is None:
        return replace(at, **changes) if changes else at
    if to is DriveStage.ENABLE:  # a quick stop under way is over, its drive off
        changes["base"] = _S if at.base in (_Q, _C) else at.base
        changes |= {"until_ns": t_ns + ARM_LIMIT_NS, "action": Action.HOLD}
    elif to is DriveStage.RESET:
        changes["until_ns"] = t_ns + DRIVE_RESET_NS
    elif to is _O or to is _N:
        changes["since_ns"] = t_ns
    changes["step" if to in STEPS else "base"] = to
    return replace(at, **changes)


class TickSeen(NamedTuple):
    """What a tick has seen, as far as a command may wait for it.

    ``enabled`` and ``faulted``: the drive, by its own report. ``cause``: what keeps a fault from being reset, which may
    begin while a RESET waits. ``prepared`` and ``barred``: of a command that waits for what goes before the drive's
    power, and by its checks. ``latched``: a fault is. ``due``: a load that the motor holds is to be parked. ``fails``:
    the brake is known not to hold, the rope is tight, and the motor holds. ``gone``:
    the motor that carries for a brake is not enabled, or another cause than the slip ends it. ``ended``: the stroke of
    a process that ends is at rest, or its time is over.
    """

    t_ns: int
    enabled: bool = False
    faulted: bool = False
    cause: bool = False
    prepared: ArmingStep = ArmingStep.WAIT
    barred: bool = False
    latched: bool = False
    due: bool = False
    fails: bool = False
    gone: bool = False
    ended: bool = False


class StageRow(NamedTuple):
    """In a stage, when a condition holds: its input and the answer to the command that waits, None where none does.

    ``words``: the condition, for docs/modes.md. ``test``: the test that fails without the row.
    """

    stage: DriveStage
    when: Callable[[Sequence, TickSeen], bool]
    input: Input
    answer: Refusal | None
    words: str
    test: str


def _late(at: Sequence, seen: TickSeen) -> bool:
    return seen.t_ns >= at.until_ns


def _stays_faulted(at: Sequence, seen: TickSeen) -> bool:
    return seen.faulted and at.carries and seen.t_ns >= at.until_ns - ARM_LIMIT_NS + DRIVE_RESET_NS


def _s(limit_ns: int) -> str:
    return f"{limit_ns * 1e-9:g} s"


KEPT = StageRow(
    DriveStage.RUN, lambda _, seen: seen.due and seen.fails and seen.enabled, Input.KEPT, None,
    f"a parking is due at standstill, the brake is known not to hold, the rope is tight, and no active cause stops a "
    f"motor that carries: the motor keeps the load for {KEPT_NS // 60_000_000_000} min",
    "test_a_load_is_not_given_to_a_brake_that_is_known_not_to_hold",
)  # fmt: skip
SLIPPED = StageRow(
    DriveStage.PREPARE, lambda _, seen: seen.prepared is ArmingStep.SLIPPED, Input.WITHDRAWN, Refusal.BRAKE_SLIPPED,
    "the load moves in the brake test; the motor takes it back from a brake known not to hold, and in `brake-test`",
    "test_a_brake_that_slips_in_its_test_refuses_the_command",
)  # fmt: skip
READY = StageRow(
    DriveStage.PREPARE, lambda _, seen: seen.prepared is ArmingStep.READY, Input.PREPARED, Refusal.NONE,
    "drive off for its brake's time, stroke at rest, brake tested", "test_a_prepared_command_has_the_drive_enabled",
)  # fmt: skip
NOT_LEFT = StageRow(
    DriveStage.RESET, _late, Input.WITHDRAWN, Refusal.DRIVE_STATE,
    f"the drive is in its fault state after {_s(DRIVE_RESET_NS)}: DRIVE_FAULT is latched",
    "test_a_reset_that_the_drive_does_not_follow_leaves_fault_with_the_drive_as_its_cause",
)  # fmt: skip
ROWS = (
    SLIPPED,
    StageRow(
        DriveStage.PREPARE, lambda _, seen: seen.barred or seen.prepared is ArmingStep.LATE, Input.WITHDRAWN,
        Refusal.PREFLIGHT, "a check fails, or drive and stroke are not at rest in their time",
        "test_a_check_that_fails_while_a_command_is_prepared_refuses_it",
    ),
    READY,
    StageRow(
        DriveStage.RESET, lambda _, seen: seen.cause, Input.WITHDRAWN, Refusal.CAUSE_PRESENT,
        "a cause of the latched fault is present", "test_a_cause_that_begins_meanwhile_ends_a_reset",
    ),
    StageRow(
        DriveStage.RESET, lambda _, seen: not seen.faulted, Input.RESET, Refusal.NONE,
        "the drive has left its fault state", "test_a_reset_of_a_drive_at_fault_is_answered_when_the_drive_has_left_it",
    ),
    NOT_LEFT,
    StageRow(
        DriveStage.ENABLE, lambda _, seen: seen.enabled, Input.ENABLED, Refusal.NONE,
        "the drive is enabled", "test_arming_ends_when_the_drive_is_enabled_or_gives_up",
    ),
    StageRow(
        DriveStage.ENABLE, _stays_faulted, Input.WITHDRAWN, Refusal.DRIVE_STATE,
        f"`carry` or `lower`: the drive is in its fault state after {_s(DRIVE_RESET_NS)}",
        "test_a_carry_whose_drive_stays_in_its_fault_is_refused",
    ),
    StageRow(
        DriveStage.ENABLE, lambda at, seen: seen.latched and _late(at, seen), Input.NOT_ENABLED, Refusal.DRIVE_TIMEOUT,
        f"with a fault latched, not enabled after {_s(ARM_LIMIT_NS)}: the drive is commanded to stop, to close its "
        "brake and to go off, and then its power is cut",
        "test_a_carry_whose_drive_does_not_come_on_has_the_brake_closed",
    ),
    StageRow(
        DriveStage.ENABLE, _late, Input.WITHDRAWN, Refusal.DRIVE_TIMEOUT,
        f"not enabled after {_s(ARM_LIMIT_NS)}", "test_arming_ends_when_the_drive_is_enabled_or_gives_up",
    ),
    StageRow(
        DriveStage.RUN, lambda at, seen: at.carry_until_ns > 0 and seen.gone, Input.PARKED, None,
        "the motor carries, and goes off; or another cause than the slip is active, and the brake is not known to fail",
        "test_a_carry_ends_on_the_brake_or_by_lowering",
    ),
    StageRow(
        DriveStage.RUN, lambda at, seen: 0 < at.carry_until_ns <= seen.t_ns, Input.LOWERED, None,
        "its time is over: RELEASING, until the rope is slack; from HOLD it ends in HOLD, from FAULT in FAULT",
        "test_a_carry_ends_on_the_brake_or_by_lowering",
    ),
    KEPT,
    StageRow(
        DriveStage.RUN, lambda _, seen: seen.due, Input.PARKED, None,
        "HOLD for `hold.park_s`, or FAULT, at standstill; a stroke that does not come to rest in its time as well",
        "test_a_load_whose_hold_is_due_is_parked_and_a_drive_that_went_off_is_armed_again",
    ),
    StageRow(
        DriveStage.RUN, lambda _, seen: seen.ended, Input.PARKED, None,
        "the process ends, and no load delays it: the stroke is at rest, or its time is over",
        "test_a_process_that_ends_leaves_the_load_on_the_brake",
    ),
)  # fmt: skip
"""What ends a wait, and the motor's hold: for each stage in order, the first whose condition holds."""
_ROWS_OF = {stage: tuple(row for row in ROWS if row.stage is stage) for stage in DriveStage}


def decide(at: Sequence, seen: TickSeen) -> StageRow | None:
    """The row that ends the wait of the command in this tick, None: it goes on."""
    for row in _ROWS_OF[at.stage]:
        if row.when(at, seen):
            return row
    return None


def power(at: Sequence, t_ns: int, *, drive_enabled: bool, drive_faulted: bool) -> tuple[Sequence, Power]:
    """The sequence, and the power to command now.

    Only ENABLE switches a drive on; one that dropped out stays off.
    """
    if drive_faulted and (at.resetting or (at.taking and at.carries)):
        edges = (at.until_ns - t_ns) // RESET_WORD_NS
        return at, Power.RESET if edges % 2 == 0 else Power.RESET_LOW
    if at.base is _Q and not at.taking and at.action is Action.POWER_OFF and t_ns >= at.cut_ns:
        at = after(at, Input.CUT_DUE, t_ns)
    return at, Power.OFF if at.motor and not drive_enabled else at.commanded


def held_by(
    at: Sequence, mode: Mode, *, known: bool, enabled: bool, braked: bool, rests: bool, settles: bool
) -> HeldBy:
    """What carries the load now: by the stage, by what the drive reports, and by the load.

    Args:
        at: the sequence.
        mode: the mode.
        known: the drive's state is fresh.
        enabled: the drive reports that it is.
        braked: the drive has been off for as long as its brake takes to close.
        rests: the load is at rest; a closed brake alone does not show that it holds.
        settles: the brake has closed so lately that the load may not have been seen at rest yet.
    """
    if not known:
        return HeldBy.UNKNOWN
    if at.taking:
        return HeldBy.TAKING
    if braked:
        return HeldBy.BRAKE if rests else HeldBy.CLOSING if settles else HeldBy.UNKNOWN
    if not (at.motor and enabled):
        return HeldBy.CLOSING
    return HeldBy.NOTHING if mode.moves_stroke else HeldBy.MOTOR
