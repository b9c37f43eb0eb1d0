"""Commands whose offer, as a display has it, is not what the loop answers: each is given in a branch of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from hil.branching import BranchPoint
from hil.lockstep import Lockstep
from rigctl.model.verbs import TRIED_IN, Refusal, Verb
from rigctl.wire.offers import PAY_OUT, bounds_of, refused_with

ANSWERED_S = 0.01
"""A refusal comes in the next tick; a command without an answer by then is under way."""
LATER_S = 0.2
"""Twice the period at which the loop publishes its situation: what is offered wrongly then was not on its way."""


def misoffered(rig: Lockstep, state: Callable[[], dict[str, Any]], go_on: Callable[[float], None]) -> tuple[str, ...]:
    """Commands that are offered and refused, or accepted and not offered, now and after ``LATER_S``, with both answers.

    Args:
        rig: as it is now; what is tried is without effect on it.
        state: the state message, as it would be published now.
        go_on: lets the rig run for some seconds.
    """
    first = {name for name, _ in _differing(rig, state())}
    if not first:
        return ()
    go_on(LATER_S)
    return tuple(words for name, words in _differing(rig, state()) if name in first)


def _differing(rig: Lockstep, state: dict[str, Any]) -> Iterator[tuple[str, str]]:
    start = BranchPoint(rig.runtime.directory)
    for name, verb, value in _tried(state):
        given = () if value is None else (value,)
        answer = start.branch(partial(_answer, rig, verb, given))
        refused = refused_with(state, verb.name.lower(), value if verb in _BOUNDED else None)
        if verb in TRIED_IN and answer in _MEASURED:
            answer = Refusal.NONE
        if bool(refused) != (answer is not Refusal.NONE):
            yield name, f"{name} in {state['mode']}, {state['fault']}: offer {refused or 'accepted'}, {answer.name}"


_BOUNDED = {Verb.RELEASE, Verb.TARGET, Verb.CARRY}
_VALUE = {Verb.RESPONSE: math.nan}
"""In any mode that has a response, as ``rigctl response`` gives it."""
_MEASURED = frozenset({Refusal.UNSTEADY, Refusal.NO_SAMPLES})
"""What a trial that was accepted has found: it answers at its end, at once where nothing can be measured."""


def _tried(state: dict[str, Any]) -> Iterator[tuple[str, Verb, float | None]]:
    """Every command, those with bounds inside and outside of them."""
    for verb in Verb:
        if verb in (Verb.TARGET, Verb.CARRY):
            least, most = bounds_of(state, verb.name.lower()) or (0.0, 0.0)
            yield verb.name, verb, least
            yield f"{verb.name} {most + 1:g}", verb, most + 1
        else:
            yield verb.name, verb, _VALUE.get(verb) if verb is not Verb.CONFIRM_STROKE else state["stroke_mm"]
    _, most = bounds_of(state, PAY_OUT) or (0.0, 0.0)
    yield "RELEASE 1 mm", Verb.RELEASE, min(1.0, most) or 1.0
    yield f"RELEASE {most + 1:g} mm", Verb.RELEASE, most + 1


def _answer(rig: Lockstep, verb: Verb, values: tuple[float, ...]) -> Refusal:
    try:
        return rig.command(verb, *values, limit_s=ANSWERED_S)
    except TimeoutError:
        return Refusal.NONE
