"""Single drawn faults for the diagnosis: none of them was used to build its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.faults.drawn import courses, kinds
from hil.faults.drawn.draw import BLOCK, Draw, block_of, pair_of
from hil.faults.drawn.play import Branch, CourseRun, branches
from hil.faults.judging.naming import NamedRow, RecordedRow, culprit, naming
from hil.lockstep import lockstep
from hil.scenario.play import Advance
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.diagnosis.window import AFTER_NS, BEFORE_NS, trips
from rigctl.ipc.record import EVENT
from rigctl.model.loop_event import LoopEvent
from rigctl.model.states import Mode

LONGEST_S = 8.0
"""From the fault on; a fault that has not tripped by then is not named."""
_LOOK_EVERY = 100


def play(rig: RigSettings, seed: int, blocks: Sequence[int], advance: Advance) -> list[NamedRow]:
    """The culprits of the first fault of every pair in these blocks of draws; those that trip nothing are left out.

    Raises:
        ScenarioError: no rig that is drawn has an accepted design.
    """
    rows: list[NamedRow] = []
    for number in blocks:
        drawn, settings, gains, course = block_of(rig, seed, number)
        pairs = [pair_of(seed, number * BLOCK + i, drawn, course) for i in range(BLOCK)]
        singles = [replace(pair, faults=pair.faults[:1], then="nothing") for pair in pairs]
        rows += _block(settings, gains, course, singles)
        advance(len(singles), f"block {number}")
    return rows


def _block(settings: RigSettings, gains: Gains, course: str, draws: Sequence[Draw]) -> list[NamedRow]:
    rows = []
    with lockstep(settings, gains, log=True) as rig:
        run = CourseRun(rig, courses.BY_NAME[course])
        for draw, found in branches(run, draws, _until_diagnosed):
            if isinstance(found, Branch):
                raise RuntimeError(found.error)
            about = culprit(found, settings)
            if about is not None:
                kind = kinds.BY_NAME[draw.faults[0].kind]
                mode = Mode(int(found.records["mode"][max(np.searchsorted(found.records["t_ns"], found.t_ns) - 1, 0)]))
                rows.append(
                    NamedRow(f"{draw.index} {kind.name} {draw.faults[0].size:g}", mode.name, kind.states, about.parts,
                             naming(about, kind.states), about.text)
                )  # fmt: skip
    return rows


def _until_diagnosed(run: CourseRun, draw: Draw) -> RecordedRow:
    """Go on with the fault until the window of its trip is complete, or `LONGEST_S` have passed."""
    rig = run.rig
    before = rig.runtime.records.reader(from_start=True).read()
    rig.events.read()
    run.begin(draw.faults[0], f"{draw.seed}:{draw.index}:0")
    events = [np.empty(0, EVENT.dtype)]
    end_ns = rig.clock.now() + round(LONGEST_S * 1e9)
    records = [before]
    rig.read_records()
    ticks = 0
    while rig.clock.now() < end_ns:
        run.tick()
        ticks += 1
        if ticks % _LOOK_EVERY == 0:
            records.append(rig.read_records())
            events.append(rig.events.read())
            if found := trips(LoopEvent.of_slots(np.concatenate(events))):
                end_ns = min(end_ns, found[0].t_ns + AFTER_NS)
    records.append(rig.read_records())
    events.append(rig.events.read())
    every, said = np.concatenate(records), np.concatenate(events)
    _, first = np.unique(every["seq"], return_index=True)
    every = every[first]
    if found := trips(LoopEvent.of_slots(said)):
        every = every[every["t_ns"] >= found[0].t_ns - BEFORE_NS]
    return RecordedRow(every, said)
