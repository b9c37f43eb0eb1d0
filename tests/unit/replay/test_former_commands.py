"""Commands of recordings made while a slot had one value."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.control.modes import VALUES, Setting, Verb
from rigctl.ipc.record import COMMAND
from rigctl.replay.former_commands import as_of_today

FORMER = np.dtype([("seq", "<u8"), ("t_ns", "<i8"), ("id", "<u8"), ("verb", "u1"), ("value", "<f8")])
K_TENSION, K_SPEED, K_INTEGRAL = 131, 132, 133


def today(*given: tuple[int, float]) -> npt.NDArray[Any]:
    former = [(i, 10 * i, 100 * i, code, value) for i, (code, value) in enumerate(given, 1)]
    made = as_of_today(np.array(former, FORMER))
    assert [made[name].tolist() for name in ("seq", "t_ns", "id")] == [[slot[i] for slot in former] for i in range(3)]
    return made


def test_commands_of_today_stay_as_they_are() -> None:
    commands = np.zeros(3, COMMAND.dtype)
    assert as_of_today(commands) is commands


def test_every_field_that_a_code_uses_is_in_the_slot() -> None:
    assert {name for names in VALUES.values() for name in names} == {field.name for field in COMMAND.fields[3:]}


@pytest.mark.parametrize("code", [code for code in VALUES if code != Setting.LAW_GAINS])
def test_a_value_gets_the_field_of_its_command(code: int) -> None:
    (slot,) = today((code, 7.5))
    given = {field.name for field in COMMAND.fields[3:] if not math.isnan(slot[field.name])}
    assert (slot["verb"], given, slot[VALUES[code][0]]) == (code, {VALUES[code][0]}, 7.5)


def test_a_command_without_a_value_has_none() -> None:
    (slot,) = today((Verb.HOLD, math.nan))
    assert all(math.isnan(slot[field.name]) for field in COMMAND.fields[3:])


def test_three_gains_become_one_set_at_the_last() -> None:
    made = today((K_TENSION, 9.0), (K_TENSION, 1.0), (K_SPEED, 0.1), (Verb.TARGET, 300.0), (K_INTEGRAL, 0.5))
    assert made["verb"].tolist() == [K_TENSION, K_TENSION, K_SPEED, Verb.TARGET, Setting.LAW_GAINS]
    assert [made[-1][name] for name in VALUES[Setting.LAW_GAINS]] == [1.0, 0.1, 0.5]


@pytest.mark.parametrize(
    "given",
    [
        [(K_SPEED, 0.1), (K_INTEGRAL, 0.5)],
        [(K_TENSION, -1.0), (K_SPEED, 0.1), (K_INTEGRAL, 0.5)],
        [(K_TENSION, 1.0), (K_SPEED, math.nan), (K_INTEGRAL, 0.5)],
        [(K_TENSION, 1.0), (K_SPEED, 0.1), (K_TENSION, 1.0), (K_INTEGRAL, 0.5)],
        [(K_TENSION, 1.0), (K_SPEED, 0.1), (K_INTEGRAL, math.inf), (K_INTEGRAL, 0.5)],
    ],
)
def test_a_set_that_was_refused_stays_refused(given: list[tuple[int, float]]) -> None:
    assert today(*given)["verb"].tolist() == [code for code, _ in given]
