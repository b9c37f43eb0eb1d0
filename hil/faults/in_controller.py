"""Faults of the controller itself that simulated time can show; `hil.faults.processes` has those of real processes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial

from hil.faults.stand import FaultPlace, Injector, Needs, Stand, Step
from hil.lockstep import Lockstep
from rigctl.control.watch.safety import Trip
from rigctl.model.faults import Fault
from rigctl.model.parts import Part
from rigctl.model.reactions import Action
from rigctl.model.verbs import Verb

_of = partial(Injector, FaultPlace.CONTROLLER, needs=Needs.LOOP)
_COMPUTER = (Part.COMPUTER,)


def hangs(ticks: int) -> Injector:
    """The loop stands still for this many ticks, the rig goes on."""

    def inject(stand: Stand) -> None:
        stand.lockstep.clock.skip = ticks

    return _of(_COMPUTER, inject)


def overruns(ticks: int, every_s: float) -> Injector:
    """A few ticks are missed, repeatedly."""

    def inject(stand: Stand) -> Step:
        due = [0.0]

        def step(t_s: float) -> None:
            if t_s >= due[0]:
                due[0] += every_s
                stand.lockstep.clock.skip = ticks

        return step

    return _of(_COMPUTER, inject)


SHORTEST_S, LONGEST_S = 0.0002, 0.015  # pause of a busy computer, drawn evenly on a logarithmic scale
MOST_LATE = 0.85  # of a period: a tick that wakes later than that and works for WORK_NS ends in the next period


def busy(gap_s: float) -> Injector:
    """Another process takes the processor now and then, ``gap_s`` apart in the mean: ticks wake late or are missed."""

    def inject(stand: Stand) -> Step:
        clock, random, period_ns = stand.lockstep.clock, stand.random, stand.settings.loop.period_ns
        due = [random.expovariate(1.0 / gap_s)]

        def step(t_s: float) -> None:
            if t_s >= due[0]:
                due[0] += random.expovariate(1.0 / gap_s)
                pause_s = SHORTEST_S * math.exp(random.random() * math.log(LONGEST_S / SHORTEST_S))
                clock.skip, late_ns = divmod(round(pause_s * 1e9), period_ns)
                clock.late_ns = min(late_ns, round(MOST_LATE * period_ns))

        return step

    return _of(_COMPUTER, inject)


def _give(stand: Stand, verbs: Iterable[Verb]) -> None:
    for verb in verbs:
        stand.lockstep.give(verb)


def commanded(*verbs: Verb, after_s: float = 0.01) -> Injector:
    """An operator's commands: the first at once, the others ``after_s`` apart, without waiting for replies."""

    def inject(stand: Stand) -> Step:
        first, *others = verbs
        stand.lockstep.give(first)
        return stand.ends_after(after_s, lambda: _give(stand, others))

    return _of((), inject)


def trip(rig: Lockstep, action: Action, fault: Fault = Fault.LIMIT) -> None:
    """Have a row of the safety table trip between two ticks."""
    rig.loop.machine.trip(Trip(fault, 1.0, 0.0, action), rig.clock.now())


def brake_known_to_slip() -> Injector:
    """The brake is known not to hold, as by a slip before."""

    def inject(stand: Stand) -> None:
        stand.lockstep.loop.brake.set("known to the row of the catalogue")

    return _of((), inject)


def quick_stop_then(*verbs: Verb, after_s: float = 0.01) -> Injector:
    """A limit whose action is a quick stop trips; the commands come while the drive is still stopping."""

    def inject(stand: Stand) -> Step:
        trip(stand.lockstep, Action.QUICK_STOP)
        return stand.ends_after(after_s, lambda: _give(stand, verbs))

    return _of((Part.E_STOP,), inject)
