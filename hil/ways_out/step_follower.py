"""An operator who takes the displayed steps, and those alone, until the rig is off with its load at rest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec

from hil.faults.stand import Step
from hil.lockstep import Lockstep
from hil.ways_out.offer_check import misoffered
from rigctl.devices.startup import StartupError
from rigctl.gateway.active import ActiveConfiguration
from rigctl.gateway.gateway_process import StateView
from rigctl.gateway.published_position import Cursor
from rigctl.ipc.ledger import Standing
from rigctl.model.faults import Fault
from rigctl.model.parts import Part
from rigctl.model.reactions import Action
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations.preflight import PreflightVerdict
from rigctl.wire.instructions import Hands, HandsAt, Instruction, ReadAtRig
from rigctl.wire.operator_view import view
from rigctl.wire.trust import doubts

LOOKS_S = 0.1
"""The rig is looked at so often."""
STEPS, ALIKE = 24, 4
"""So many looks at the steps have to be enough, and so many at the same ones."""
GOES_ON = frozenset({"arm", "tension", "hold"})
"""Commands of steps that go on with the work, or stop it where it is: no way out."""
CARRY_S = 60.0
TRIES, BETWEEN_S = 5, 0.83
"""Of a command that is refused: what it waits for may come. A payload may bounce once a second: no multiple of that."""
SETTLES_S, LONGEST_S = 1.0, 120.0
"""A command has had its effect once the mode has stayed for so long; longest wait, a lowering by 2 mm/s."""
AT_REST_S, AT_REST_MM = 2.0, 0.05
LOOSE_MM = 10.0
"""A payload that is supported from below is lifted until the rope has so much slack."""


class End(NamedTuple):
    """What distinguishes one end from another for whoever has to find the way out."""

    mode: str
    fault: str
    action: str
    held_by: str
    at_rest: str
    """What shows that the load is at rest."""
    doubts: tuple[str, ...]
    """Devices whose values are not to be trusted."""

    @classmethod
    def of(cls, state: dict[str, Any], action: Action) -> End:
        """The end that a state message shows, with the action of the latched fault."""
        names = str(state["mode"]), str(state["fault"]), action.name, str(state["held_by"])
        return cls(*names, str(state["load_at_rest"]), tuple(sorted(doubts(state))))


class WayOut(NamedTuple):
    """``leads``: to DISARMED with a slack rope or a load at rest; ``why``: what is in the way, else "".

    ``taken``: the steps taken, in words, with the answer of each command. ``misoffered``: on the way, in words.
    """

    leads: bool
    why: str
    taken: tuple[str, ...]
    misoffered: tuple[str, ...]


class StepFollower:
    """Looks at a lockstep rig as the page and ``rigctl watch`` show it, and takes the steps.

    Args:
        rig: at the end of a row.
        parts: that the fault is in: hands mend it where a step names one of them.
        mend: takes the fault out.
        step: of the fault, called every tick until it is mended.
    """

    def __init__(self, rig: Lockstep, parts: Sequence[str], mend: Callable[[], None], step: Step | None) -> None:
        self._rig, self._parts, self._mend, self._step = rig, frozenset(parts), mend, step
        self._begun_ns = self._looked_ns = rig.clock.now()
        self._view = StateView(rig.runtime, rig.settings, ActiveConfiguration(rig.runtime), {})
        self._cursor = Cursor(rig.runtime.gateway_cursor, rig.runtime.records.path, 0)
        self._lifted_mm = 0.0
        self._taken: list[str] = []
        self._misoffered: dict[str, None] = {}

    def run(self, seconds: float) -> None:
        """Let the rig go on; the fault too, unless it is mended."""
        rig = self._rig
        end_ns, period_ns = rig.clock.now() + round(seconds * 1e9), rig.settings.loop.period_ns
        while (now_ns := rig.clock.now()) < end_ns:
            if self._step is not None:
                self._step((now_ns - self._begun_ns) * 1e-9)
            rig.clock.skip = max(0, min(rig.clock.skip, (end_ns - now_ns) // period_ns - 1))
            rig.tick()
            if now_ns - self._looked_ns >= LOOKS_S * 1e9:
                self.state()

    def state(self) -> dict[str, Any]:
        """The state message, as the gateway would publish it now."""
        now_ns = self._looked_ns = self._rig.clock.now()
        made = self._view.make(now_ns, 0, Standing(), None, PreflightVerdict(), self._cursor)
        return dict(msgspec.json.decode(made))

    def go(self) -> WayOut:
        """Take what is displayed until the rig is out, or until nothing displayed changes anything."""
        idle, seen = 0, Counter[tuple[Instruction, ...]]()
        for _ in range(STEPS):
            if self._is_out():
                return self._way("")
            state = self.state()
            steps = view(state).steps
            if not seen[steps]:
                self._misoffered |= dict.fromkeys(misoffered(self._rig, self.state, self.run))
            seen[steps] += 1
            idle = 0 if self._take(steps) else idle + 1
            if idle > 1 or seen[steps] > ALIKE:
                return self._way(f"{state['mode']}, {state['fault']}: no step leads on")
        state = self.state()
        return self._way(f"{state['mode']}, {state['fault']}: after {STEPS} looks")

    def _way(self, why: str) -> WayOut:
        return WayOut(not why, why, tuple(self._taken), tuple(self._misoffered))

    def _is_out(self) -> bool:
        loop, rig = self._rig.loop, self._rig.rig
        if (
            loop.machine.mode is not Mode.DISARMED
            or loop.machine.fault is not Fault.NONE
            or rig.drive.control.stage.powered
        ):
            return False
        before_mm = rig.truth.stroke_mm
        self.run(AT_REST_S)
        if loop.machine.mode is not Mode.DISARMED or loop.machine.fault is not Fault.NONE:
            return False
        slack = rig.truth.tension_n < self._rig.settings.tension.slack_n
        return slack or abs(rig.truth.stroke_mm - before_mm) < AT_REST_MM

    def _take(self, steps: Sequence[Instruction]) -> bool:
        """Take steps in their order, until one has changed the state."""
        changed = False
        for step in steps:
            if step.verb in GOES_ON:
                continue
            done = self._command(step) if step.verb else self._hands(step)
            changed |= done
            if done and (step.verb or step.hands is Hands.START):
                return True
        self.run(BETWEEN_S)
        return changed

    def _command(self, step: Instruction) -> bool:
        verb = Verb[step.verb.replace("-", "_").upper()]
        values: tuple[float, ...] = (CARRY_S,) if verb is Verb.CARRY else ()
        if step.read_at_rig is ReadAtRig.STROKE:
            values = (self._rig.rig.truth.stroke_mm,)
        elif step.read_at_rig is ReadAtRig.WITNESS:
            values = (float(Witness.CELL if Part.ENCODER in self._parts else Witness.ENCODER),)
        refusal = Refusal.NONE
        for _ in range(TRIES):
            refusal = self._rig.command(verb, *values, limit_s=30.0)
            if refusal is Refusal.NONE:
                break
            self.run(BETWEEN_S)
        self._taken.append(f"{step.text} -> {verb.name} {refusal.name}")
        if refusal is Refusal.NONE:
            self._settle()
        return refusal is Refusal.NONE

    def _settle(self) -> None:
        loop, waited_s = self._rig.loop, 0.0
        while waited_s < LONGEST_S:
            mode = loop.machine.mode
            self.run(SETTLES_S)
            waited_s += SETTLES_S
            if loop.machine.mode is mode and mode not in (Mode.RELEASING, Mode.TENSIONING):
                return

    def _hands(self, step: Instruction) -> bool:
        """Whether hands could change anything."""
        if step.hands is Hands.LOOK:
            return False
        changed = _BY_HANDS[step.hands](self, step)
        self._taken.append(f"{step.text} -> {step.hands.name} at {' or '.join(step.places)}{'' if changed else ': no'}")
        self.run(BETWEEN_S)
        return changed

    def _mend_part(self, step: Instruction) -> bool:
        if self._parts.isdisjoint(step.places) and HandsAt.RIG not in step.places:
            return False  # what is looked at is in order
        found, self._mend, self._step = self._mend, lambda: None, None
        found()
        self._parts = frozenset()
        self._rig.rig.plant.parameters["free_length"] += self._lifted_mm
        return True

    def _support(self, _step: Instruction) -> bool:
        rig = self._rig.rig
        if self._lifted_mm:
            return False
        self._lifted_mm = rig.truth.tension_n / self._rig.settings.plant.slow_stiffness_n_mm + LOOSE_MM
        rig.plant.parameters["free_length"] += self._lifted_mm
        return True

    def _press(self, _step: Instruction) -> bool:
        return self._e_stop(pressed=True)

    def _release(self, _step: Instruction) -> bool:
        return self._e_stop(pressed=False)

    def _e_stop(self, *, pressed: bool) -> bool:
        rig = self._rig.rig
        rig.drive.press_e_stop(pressed)
        if rig.io is not None:
            rig.io.press_e_stop(pressed)
        return True

    def _start(self, _step: Instruction) -> bool:
        try:
            self._rig.start_anew()
        except StartupError as error:
            self._taken.append(f"the start is refused: {error}")
            return False
        return True


_BY_HANDS: dict[Hands, Callable[[StepFollower, Instruction], bool]] = {
    Hands.MEND: StepFollower._mend_part,
    Hands.SUPPORT: StepFollower._support,
    Hands.PRESS: StepFollower._press,
    Hands.RELEASE: StepFollower._release,
    Hands.START: StepFollower._start,
}
