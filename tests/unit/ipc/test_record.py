"""Slots of commands and replies: a field for every value, and the one figure that a reply is about."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.ipc.record import COMMAND, REPLY, figure_of
from rigctl.model.verbs import VALUES

FIGURES = [field.name for field in REPLY.fields if field.unit and field.name not in ("t_ns", "rms_n", "taken_s")]


def reply(**figures: float) -> np.void:
    values = REPLY.values(t_ns=5, id=7, accepted=1, reason=0, checks=3, mode=1, **figures)
    found: np.void = np.array([(1, *values)], REPLY.dtype)[0]
    return found


@pytest.mark.parametrize("name", [*FIGURES, "cause"])
def test_a_reply_has_the_figure_that_was_given(name: str) -> None:
    assert figure_of(reply(**{name: -2.5, "rms_n": 0.03})) == -2.5


def test_a_reply_without_a_figure_has_none() -> None:
    assert figure_of(reply()) == figure_of(reply(rms_n=0.03)) == figure_of(reply(taken_s=0.2)) == 0.0


def test_every_value_of_a_command_has_a_field_in_the_slot() -> None:
    assert {name for names in VALUES.values() for name in names} == {field.name for field in COMMAND.fields[3:]}
