"""The courses of operation during which drawn faults begin, and what the operator does after a reaction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hil.faults import in_plant
from hil.lockstep import Lockstep
from hil.plant.inputs import Track
from rigctl.devices import objects
from rigctl.model.states import Mode
from rigctl.model.verbs import Setting, Verb

SILENCE_S = 0.03
"""Silence of the cell that leads to FAULT."""
LOW = 0.3
"""Share of the target that is on the rope before a ramp."""
CARRY_S = 60.0
"""For which the motor is commanded to carry."""
BELOW_N = 25.0
"""Below the target: enough way for the sign checks of the first tensioning."""


@dataclass(frozen=True)
class CourseStep:
    """A command once the loop has been in a mode for some time."""

    mode: Mode
    after_s: float
    verb: Verb | Setting
    values: tuple[float, ...] = ()


_ARM = CourseStep(Mode.DISARMED, 0.8, Verb.ARM)
_TENSION = CourseStep(Mode.HOLD, 0.3, Verb.TENSION)
_WORK = (_ARM, _TENSION)


@dataclass(frozen=True)
class Course:
    """An operator's commands from power-on; the first fault begins between ``begin_s`` and ``end_s`` after that."""

    name: str
    begin_s: float
    end_s: float
    steps: tuple[CourseStep, ...] = ()
    preload: Callable[[float], float] = lambda target_n: target_n
    motion: Callable[[], Mapping[int, Track]] | None = None
    motion_s: float = 0.0
    silence_s: float | None = None  # when the cell is silent for a moment, so that FAULT is latched


def _below(target_n: float) -> float:
    return target_n - BELOW_N


COURSES = (
    Course("disarmed", 0.7, 3.0),
    Course("arming", 0.75, 1.6, (_ARM,)),
    Course("hold", 1.3, 8.0, (_ARM,)),
    Course("taking_back", 5.0, 7.5, (_ARM, CourseStep(Mode.HOLD, 4.5, Verb.TENSION)), _below),
    Course("tensioning", 1.4, 5.0, _WORK, lambda target_n: LOW * target_n),
    Course("tensioning_from_slack", 0.7, 3.0, _WORK, lambda _: 0.0),
    Course("compensating", 3.5, 9.0, _WORK, _below),
    Course("compensating_heave", 4.0, 9.0, _WORK, _below, in_plant.heaving, 4.0),
    Course("compensating_turn", 4.0, 9.0, _WORK, _below, in_plant.rotating, 4.0),
    Course("response", 4.0, 12.0, (*_WORK, CourseStep(Mode.COMPENSATING, 1.0, Verb.RESPONSE, (1.0,))), _below),
    Course("identify", 1.5, 8.0, (_ARM, CourseStep(Mode.HOLD, 0.5, Verb.IDENTIFY, (1.0,))), _below),
    Course("gains", 3.8, 6.0, (*_WORK, CourseStep(Mode.COMPENSATING, 1.5, Verb.GAINS)), _below),
    Course("releasing", 1.4, 5.0, (_ARM, CourseStep(Mode.HOLD, 0.3, Verb.RELEASE))),
    Course("fault", 1.9, 7.0, (_ARM,), silence_s=1.8),
    Course("disarming", 1.4, 5.0, (_ARM, CourseStep(Mode.HOLD, 1.5, Verb.DISARM))),
    Course("carrying", 4.5, 9.0, (_ARM, CourseStep(Mode.FAULT, 1.5, Verb.CARRY, (CARRY_S,))), silence_s=1.8),
    Course("lowering", 4.0, 8.0, (_ARM, CourseStep(Mode.FAULT, 1.5, Verb.LOWER)), silence_s=1.8),
)
BY_NAME = {course.name: course for course in COURSES}

THEN: dict[str, tuple[Verb, ...]] = {
    "nothing": (),
    "reset": (Verb.RESET,),
    "reset, arm": (Verb.RESET, Verb.ARM),
    "reset, arm, tension": (Verb.RESET, Verb.ARM, Verb.TENSION),
    "reset, arm, disarm": (Verb.RESET, Verb.ARM, Verb.DISARM),
    "carry": (Verb.CARRY,),
    "carry, lower": (Verb.CARRY, Verb.LOWER),
    "lower": (Verb.LOWER,),
    "disarm, reset": (Verb.DISARM, Verb.RESET),
}
"""What the operator does after a reaction."""
_VALUES: dict[Verb, tuple[float, ...]] = {Verb.CARRY: (CARRY_S,)}
APART_S = 2.5
"""Between two commands after a reaction: an arming takes less."""


class Operator:
    """Gives the commands of a course, then those after a reaction, twice at most; waits for no reply."""

    MOST = 2

    def __init__(self, rig: Lockstep, course: Course) -> None:
        self._rig = rig
        self._steps = list(course.steps)
        self._then: tuple[Verb, ...] = ()
        self._after_s = 0.0
        self._left = 0
        self._queue: list[tuple[int, Verb]] = []
        self._mode, self._since_ns = Mode.DISARMED, rig.clock.now()

    def afterwards(self, then: str, after_s: float) -> None:
        """What to do ``after_s`` after a reaction."""
        self._then, self._after_s = THEN[then], after_s
        self._left = self.MOST if self._then else 0

    @property
    def done(self) -> bool:
        """Whether no command will follow."""
        waits = bool(self._steps) and self._mode is self._steps[0].mode
        return not self._queue and not waits and not (self._left and self._mode is Mode.FAULT)

    def step(self, now_ns: int) -> None:
        """Give what is due, before a tick."""
        mode = self._rig.loop.machine.mode
        if mode is not self._mode:
            self._mode, self._since_ns = mode, now_ns
        for_s = (now_ns - self._since_ns) * 1e-9
        if self._steps and mode is self._steps[0].mode and for_s >= self._steps[0].after_s:
            due = self._steps.pop(0)
            self._rig.give(due.verb, *due.values)
        if mode is Mode.FAULT and not self._queue and self._left and for_s >= self._after_s:
            self._left -= 1
            self._steps.clear()
            self._queue = [(now_ns + round(i * APART_S * 1e9), verb) for i, verb in enumerate(self._then)]
        if self._queue and now_ns >= self._queue[0][0]:
            _, verb = self._queue.pop(0)
            self._rig.give(verb, *_VALUES.get(verb, ()))


def silenced(rig: Lockstep, course: Course, t_s: float) -> None:
    """Begin or end the short silence of the cell."""
    if course.silence_s is None:
        return
    begins, ends = course.silence_s, course.silence_s + SILENCE_S
    period_s = 1.0 / rig.settings.loop.rate_hz
    samples = objects.TPDO1_BASE + rig.settings.tension_cell.node
    if begins <= t_s < begins + period_s:
        rig.hub.tap = lambda _, frame: () if int.from_bytes(frame[:2], "little") == samples else (frame,)
    elif ends <= t_s < ends + period_s:
        rig.hub.tap = None
