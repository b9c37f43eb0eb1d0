"""The drawn pairs of faults that are played for the digests, each in a branch of its block's course."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults.digests.streams import Digests, HashedStreams, digests, frames_array
from hil.faults.drawn import courses, play
from hil.faults.drawn.draw import BLOCK, Draw, block_of, pair_of
from hil.faults.drawn.play import Branch, CourseRun
from hil.lockstep import lockstep
from rigctl.config.settings import RigSettings

SEED, COUNT = 1, 200
"""Of the draws and how many there are; with another seed they are other runs."""
_TRUTH = ("t_ns", "tension_n", "stroke_mm", "free_mm", "powered", "braked")
_PART = 1000
"""Periods after which the rings are read: they hold the last seconds only."""


def key(index: int) -> str:
    """Names the draw in the file."""
    return f"draw {SEED} {index}"


def by_block(indices: Iterable[int]) -> dict[int, list[int]]:
    """Draws by the number of their block, whose draws share the run before their faults."""
    found: dict[int, list[int]] = {}
    for index in indices:
        found.setdefault(index // BLOCK, []).append(index)
    return found


def play_block(rig: RigSettings, number: int, indices: Sequence[int]) -> dict[str, Digests | dict[str, Any]]:
    """Digests of draws of one block by key; of one that cannot be played, why.

    Raises:
        ScenarioError: no rig that is drawn has an accepted design.
    """
    drawn_rig, settings, gains, course = block_of(rig, SEED, number)
    draws = [pair_of(SEED, index, drawn_rig, course) for index in indices]
    with lockstep(settings, gains, log=True) as started:
        run = CourseRun(started, courses.BY_NAME[course])
        found = {draw.index: _row(one) for draw, one in play.branches(run, draws, _digests)}
    return {key(index): found[index] for index in indices}


def _row(found: Digests | Branch) -> Digests | dict[str, Any]:
    if not isinstance(found, Branch):
        return found
    error, _, text = found.error.strip().splitlines()[-1].partition(": ")
    return {"not played": {error: text}}


def _digests(run: CourseRun, draw: Draw) -> Digests:
    streams = _Collected(run)
    rows = play.branch(run, draw).rows[streams.from_row :]
    return digests(streams.all({name: rows[name] for name in _TRUTH}))


class _Collected:
    """Frames, records, events and replies of a branch from its beginning on."""

    def __init__(self, run: CourseRun) -> None:
        self._log, self._watch = run.rig.frames, run.watch
        self.from_row = len(run.watch.rows)
        rings = run.rig.runtime
        self._rings = [ring.reader() for ring in (rings.records, rings.events, rings.replies)]
        self._frames: list[tuple[int, bytes]] = []
        self._parts: list[list[npt.NDArray[Any]]] = [[] for _ in range(4)]
        run.rig.on_advance = self._look

    def _look(self) -> None:
        self._frames += self._log
        self._watch()  # it clears the log
        if len(self._watch.rows) % _PART == 0:
            self._read()

    def _read(self) -> None:
        found = [frames_array(self._frames), *(ring.read() for ring in self._rings)]
        self._frames.clear()
        for parts, part in zip(self._parts, found, strict=True):
            parts.append(part)

    def all(self, truth: dict[str, npt.NDArray[Any]]) -> HashedStreams:
        """All of it, with the plant's ``truth``."""
        self._read()
        frames, records, events, replies = (np.concatenate(parts) for parts in self._parts)
        return HashedStreams(frames, records, events, replies, truth)
