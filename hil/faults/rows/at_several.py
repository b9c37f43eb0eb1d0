"""Faults, and an operator's commands, one after the other."""

from __future__ import annotations

from hil.faults.stand import FaultPlace, Injector, Needs, Stand, Step, needs_of, parts_of
from rigctl.model.verbs import Setting, Verb


def in_turn(*parts: tuple[float, Injector]) -> Injector:
    """Each part begins so many seconds after the row's fault; what has begun goes on."""

    def inject(stand: Stand) -> Step:
        waiting = sorted(parts, key=lambda part: part[0])
        steps: list[tuple[float, Step]] = []

        def step(t_s: float) -> None:
            while waiting and t_s >= waiting[0][0]:
                begun = waiting.pop(0)[1](stand)
                if begun is not None:
                    steps.append((t_s, begun))
            for begun_s, go_on in steps:
                go_on(t_s - begun_s)

        step(0.0)
        return step

    injectors = [part for _, part in parts]
    return Injector(FaultPlace.SEVERAL, parts_of(injectors), inject, needs_of(injectors))


def gives(verb: Verb | Setting, *values: float) -> Injector:
    """A command, without waiting for its reply."""

    def inject(stand: Stand) -> None:
        stand.lockstep.give(verb, *values)

    return Injector(FaultPlace.SEVERAL, (), inject, Needs.LOOP)
