"""Many draws, on as many processors as there are."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from hil.faults.drawn import draw_file, oracle, play
from hil.faults.drawn.draw import BLOCK, Draw, block_of, pair_of
from hil.faults.drawn.oracle import DrawVerdict
from hil.runs import runner
from hil.runs.rows_file import RowsFile
from hil.runs.runner import Work
from hil.scenario.play import Advance, design
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains

LONGER_S = 60.0
"""A draw whose load still moves at its end, within the bounds, goes on for so long: a reaction may be yet to come."""
Judged = tuple[Draw, DrawVerdict]
_rig: list[RigSettings] = []
"""The rig file of this process."""


def drawn(
    rig: RigSettings,
    seed: int,
    indices: Sequence[int],
    advance: Advance,
    rows: RowsFile,
    found: Callable[[Judged], None],
) -> tuple[list[Judged], float]:
    """Draw, play and judge these numbers; returns them in order, and the processor time in s that this took.

    Args:
        rig: the rig file.
        seed: of all draws.
        indices: their numbers.
        advance: called with the number of draws as they are played.
        rows: what it has already is not played again; each draw is kept in it.
        found: called with each draw as it is judged.

    Raises:
        ScenarioError: no rig that is drawn has an accepted design.
    """
    blocks: dict[int, list[int]] = {}
    judged: dict[int, Judged] = {}
    seconds = [0.0]
    for index in indices:
        if (row := rows.get(str(index))) is None:
            blocks.setdefault(index // BLOCK, []).append(index)
        else:
            judged[index] = _of_row(row)
            advance(1, "")
    pieces = {
        number: Work(_play_block, (seed, number, tuple(members)), f"draws {members[0]} to {members[-1]}", len(members))
        for number, members in blocks.items()
    }

    def keep(_: int, block: tuple[list[Judged], float]) -> None:
        seconds[0] += block[1]
        for one in block[0]:
            judged[one[0].index] = one
            rows.put(str(one[0].index), as_row(one))
            found(one)

    runner.play(pieces, advance, keep=keep, start=_start, start_arguments=(rig,))
    return [judged[index] for index in indices], seconds[0]


def as_row(judged: Judged) -> dict[str, Any]:
    """A draw and its verdict for files."""
    return {"draw": judged[0].as_dict(), **judged[1].as_dict()}


def _of_row(row: Mapping[str, Any]) -> Judged:
    verdict = {name: value for name, value in row.items() if name not in ("draw", "ok")}
    several = {name: tuple(verdict[name]) for name in ("trips", "findings")}
    return draw_file.DrawFile.model_validate(row["draw"]).draw, DrawVerdict(**{**verdict, **several})


def replayed(rig: RigSettings, draw: Draw) -> Judged:
    """Play and judge one draw.

    Raises:
        ScenarioError: the design of its rig is refused.
    """
    settings = draw.rig.settings(rig)
    return _watched(settings, design(settings), draw.course, [draw])[0]


def _start(rig: RigSettings) -> None:
    _rig[:] = [rig]


def _play_block(seed: int, number: int, indices: tuple[int, ...]) -> tuple[list[Judged], float]:
    began_s = _processor_s()
    drawn_rig, settings, gains, course = block_of(_rig[0], seed, number)
    draws = [pair_of(seed, index, drawn_rig, course) for index in indices]
    return _watched(settings, gains, course, draws), _processor_s() - began_s


def _watched(settings: RigSettings, gains: Gains, course: str, draws: Sequence[Draw]) -> list[Judged]:
    """Draws, judged; those whose load still moves at their end are watched for `LONGER_S` more."""
    judged = _judged(settings, gains, course, draws)
    longer = [replace(draw, seconds=draw.seconds + LONGER_S) for draw, verdict in judged if verdict.moves_on]
    if longer:
        found = {one[0].index: one for one in _judged(settings, gains, course, longer)}
        judged = [found.get(one[0].index, one) for one in judged]
    return judged


def _judged(settings: RigSettings, gains: Gains, course: str, draws: Sequence[Draw]) -> list[Judged]:
    branches, twin = play.play(settings, gains, course, draws)
    return [(draw, oracle.judge(draw, settings, one, twin)) for draw, one in zip(draws, branches, strict=True)]


def _processor_s() -> float:
    """Of this process and of its branches, which have ended."""
    return sum(os.times()[:4])
